"""The other end of the link: a loopback autopilot, and a transport that shares its bytes with a real link.

`LoopbackAutopilot` is a transport of the bridge: what the bridge sends, it parses and keeps; what the bridge receives
is an autopilot's heartbeat, attitude, pressure and temperature, and time. It has a clock of its own, answers TIMESYNC
and commands, and can be heard late and start anew in flight. `Tee` puts a real link beside it, so that a ground station
sees autopilot and bridge.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

from msp_range.clock import Clock
from msp_range.mavlink.dialect import dialect
from msp_range.mavlink.distance_sensor import Autopilot
from msp_range.mavlink.transport import Transport, TransportStats
from msp_sim.vehicle import Pose

BOOTED_BEFORE_S = 42.5
"""How long before the flight the autopilot was switched on [s]: its clock is not the bridge's."""
REBOOT_S = 3.0
"""It is silent for this long when it starts anew [s]."""
SEA_LEVEL_HPA = 1013.25
BAROMETER_WARMER_C = 15.0
"""The barometer's die is this much warmer than the air [K]."""

_INTERVALS_S = {"heartbeat": 1.0, "system_time": 1.0, "pressure": 1.0, "attitude": 0.1}


class LoopbackAutopilot:
    """An autopilot in this process; a `Transport` of the bridge.

    Parameters
    ----------
    clock
        The flight's clock; ``start_s`` on it is the flight's beginning.
    pose, air_c
        The vehicle's pose and the air temperature [deg C] at a time of the flight [s].
    kind
        Which autopilot it claims to be.
    heard_from_s, reboots_at_s
        Times of the flight [s].
    """

    description = "loopback"
    last_error = None

    def __init__(
        self,
        clock: Clock,
        pose: Callable[[float], Pose],
        air_c: Callable[[Pose], float],
        *,
        kind: Autopilot = "ardupilot",
        heard_from_s: float = 0.0,
        reboots_at_s: Sequence[float] = (),
    ) -> None:
        self.stats = TransportStats()
        self.received: list[tuple[float, Any]] = []
        self._clock = clock
        self._start_s = clock.now()
        self._pose = pose
        self._air_c = air_c
        self._kind = dialect.MAV_AUTOPILOT_PX4 if kind == "px4" else dialect.MAV_AUTOPILOT_ARDUPILOTMEGA
        self._heard_from_s = heard_from_s
        self._reboots_at_s = sorted(reboots_at_s)
        self._boot_s = -BOOTED_BEFORE_S
        self._mav = dialect.MAVLink(None, srcSystem=1, srcComponent=dialect.MAV_COMP_ID_AUTOPILOT1)
        self._mav.robust_parsing = True
        self._due_s = dict.fromkeys(_INTERVALS_S, 0.0)
        self._outgoing = bytearray()

    @property
    def connected(self) -> bool:
        """A loopback is always there."""
        return True

    def send(self, frame: bytes) -> bool:
        """Take a frame from the bridge."""
        now_s = self._flight_s()
        self.stats.sent_frames += 1
        if not self._is_up(now_s):
            return True
        for message in self._mav.parse_buffer(frame) or ():
            self.received.append((now_s, message))
            self._answer(now_s, message)
        return True

    def receive(self) -> bytes:
        """What the autopilot has sent since the last call."""
        now_s = self._flight_s()
        if self._reboots_at_s and now_s >= self._reboots_at_s[0]:
            self._boot_s = self._reboots_at_s.pop(0)
            self._heard_from_s = max(self._heard_from_s, self._boot_s + REBOOT_S)
            self._outgoing.clear()
        if self._is_up(now_s):
            self._speak(now_s)
        sent = bytes(self._outgoing)
        self._outgoing.clear()
        return sent

    def close(self) -> None:
        """Nothing to release."""

    def _flight_s(self) -> float:
        return self._clock.now() - self._start_s

    def _is_up(self, now_s: float) -> bool:
        return now_s >= self._heard_from_s

    def _speak(self, now_s: float) -> None:
        boot_ms = round((now_s - self._boot_s) * 1e3)
        pose = None
        for what, due_s in self._due_s.items():
            if now_s < due_s:
                continue
            self._due_s[what] = max(due_s + _INTERVALS_S[what], now_s)
            if what == "heartbeat":
                message = dialect.MAVLink_heartbeat_message(
                    dialect.MAV_TYPE_QUADROTOR, self._kind, 0, 0, dialect.MAV_STATE_ACTIVE, 3
                )
            elif what == "system_time":
                message = dialect.MAVLink_system_time_message(0, boot_ms)
            else:
                pose = pose or self._pose(now_s)
                message = self._attitude(boot_ms, pose) if what == "attitude" else self._pressure(boot_ms, pose)
            self._put(message)

    def _attitude(self, boot_ms: int, pose: Pose) -> Any:
        return dialect.MAVLink_attitude_message(boot_ms, pose.roll_rad, pose.pitch_rad, pose.yaw_rad, 0.0, 0.0, 0.0)

    def _pressure(self, boot_ms: int, pose: Pose) -> Any:
        """Barometric formula p = p0 exp(-h / 8434 m); the temperature is the barometer's and too warm."""
        height_m = -pose.position_ned_m[2]
        temperature_cdeg = round((self._air_c(pose) + BAROMETER_WARMER_C) * 100)
        pressure_hpa = SEA_LEVEL_HPA * math.exp(-height_m / 8434.0)
        return dialect.MAVLink_scaled_pressure_message(boot_ms, pressure_hpa, 0.0, temperature_cdeg)

    def _answer(self, now_s: float, message: Any) -> None:
        kind = message.get_type()
        if kind == "TIMESYNC" and message.tc1 == 0:
            self._put(dialect.MAVLink_timesync_message(round((now_s - self._boot_s) * 1e9), message.ts1))
        elif kind == "COMMAND_LONG" and message.target_component == dialect.MAV_COMP_ID_AUTOPILOT1:
            source = (message.get_srcSystem(), message.get_srcComponent())
            result = dialect.MAV_RESULT_ACCEPTED
            self._put(dialect.MAVLink_command_ack_message(message.command, result, 0, 0, *source))

    def _put(self, message: Any) -> None:
        self._outgoing += message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256


class Tee:
    """A real link beside the loopback autopilot: both hear the bridge, and the real link hears the autopilot too."""

    def __init__(self, link: Transport, autopilot: LoopbackAutopilot) -> None:
        self.description = link.description
        self._link = link
        self._autopilot = autopilot

    @property
    def stats(self) -> TransportStats:
        """The real link's."""
        return self._link.stats

    @property
    def last_error(self) -> str | None:
        """The real link's."""
        return self._link.last_error

    @property
    def connected(self) -> bool:
        """The real link's."""
        return self._link.connected

    def send(self, frame: bytes) -> bool:
        """To both; True where the real link took it."""
        self._autopilot.send(frame)
        return self._link.send(frame)

    def receive(self) -> bytes:
        """From both."""
        spoken = self._autopilot.receive()
        if spoken:
            self._link.send(spoken)
        return spoken + self._link.receive()

    def close(self) -> None:
        """Close the real link."""
        self._link.close()
