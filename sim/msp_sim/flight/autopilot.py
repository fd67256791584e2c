"""The other end of the link: a simulated autopilot, and a transport that also sends its messages over a real link.

`LoopbackAutopilot` is a transport of the bridge. It parses and keeps what the bridge sends; the bridge receives from it
an autopilot's heartbeat, attitude, acceleration, pressure, temperature, and time. It has its own clock, answers
TIMESYNC and commands, and can appear late and reboot in flight. `Tee` adds a real link, so that a ground station
receives both autopilot and bridge.
"""

import math
import random
from collections import Counter
from collections.abc import Callable, Sequence
from functools import cache
from typing import Annotated, Any, Literal

from fastcrc.crc16 import mcrf4xx
from pydantic import Field

from msp_range.clock import Clock
from msp_range.geometry import Vector, rotate_back, rotation_matrix
from msp_range.mavlink.dialect import dialect
from msp_range.mavlink.distance_sensor import Autopilot
from msp_range.mavlink.transport import Transport, TransportStats, Wrapped
from msp_range.yaml_file import Section
from msp_sim.world.profiles import NotNegative, Positive
from msp_sim.world.vehicle import GRAVITY_M_S2, HOVER_THROTTLE, Pose

BOOTED_BEFORE_S = 42.5
"""Time between the autopilot's start and the flight [s], so that its clock differs from the bridge's. Any value will
do."""
REBOOT_S = 3.0
"""Time for which it is silent when it reboots [s]."""
SEA_LEVEL_HPA = 1013.25
BAROMETER_WARMER_C = 15.0
"""Difference between the barometer's chip and the air [K]; typical for autopilots."""
BAROMETER_STD_M, BAROMETER_DRIFT_M = 0.15, 0.05
"""Noise of a pressure as a height [m], and random walk of its error [m per root second]; assumed, a good barometer."""
SCALE_HEIGHT_M, STANDARD_C = 8434.0, 15.0
"""Scale height R T / g of the standard atmosphere, and the temperature that it is for [m, deg C]."""
ACCELEROMETER_STD_M_S2, ACCELEROMETER_BIAS_M_S2 = 0.3, 0.1
"""Noise and constant error of each axis [m/s^2]; assumed, vibration after an autopilot's low-pass filter."""

_MESSAGES = {
    dialect.MAVLINK_MSG_ID_ATTITUDE: "attitude",
    dialect.MAVLINK_MSG_ID_SCALED_PRESSURE: "pressure",
    dialect.MAVLINK_MSG_ID_RAW_IMU: "raw_imu",
    dialect.MAVLINK_MSG_ID_HIGHRES_IMU: "highres_imu",
}
"""Messages whose rate can be set."""
_ANSWERED = (dialect.MAVLINK_MSG_ID_TIMESYNC, dialect.MAVLINK_MSG_ID_COMMAND_LONG)
_INTERVALS_S = {"heartbeat": 1.0, "system_time": 1.0, "pressure": 1.0, "attitude": 0.1}
"""Messages that are sent without a request, and their intervals [s]."""
_MOTION = ("pressure", "raw_imu", "highres_imu")
"""Messages that are not sent if ``sends_motion`` is False."""


class AttitudeFault(Section):
    """Invalid attitude messages for some time."""

    kind: Literal["roll", "huge", "not_a_number"]
    """roll: this roll is sent; huge: 1e38 rad; not_a_number: NaN"""
    from_s: NotNegative
    """when it begins, from the start of the flight [s]"""
    to_s: NotNegative
    """when it ends [s]"""
    roll_deg: float = 180.0
    """the roll of the kind roll [deg]"""

    @property
    def roll_rad(self) -> float:
        """The roll that is sent [rad]."""
        return {"roll": math.radians(self.roll_deg), "huge": 1e38, "not_a_number": math.nan}[self.kind]


class BarometerSection(Section):
    """What the autopilot's barometer does on a vehicle, on top of noise and drift.

    The defaults are a barometer that only the weather disturbs.
    """

    ground_effect_m: Annotated[float, Field(ge=-10, le=10)] = 0.0
    """error of its height on the ground at hover thrust [m]; negative: the rotors raise the pressure below the vehicle
    and it reads too low, as most do. It grows with the thrust. Autopilots expect up to 4 or 5 m"""
    ground_effect_height_m: Positive = 1.0
    """height of the vehicle's feet at which that has faded to nothing, along a straight line [m]; one to two rotor
    diameters. ArduPilot's own simulation has 2 m"""
    gust_m: NotNegative = 0.0
    """standard deviation of the error of its height by gusts [m]"""
    gust_s: Positive = 3.0
    """correlation time of that error [s]"""
    in_air_temperature: bool = False
    """whether the pressure falls with height as in the scenario's air, faster the colder it is; otherwise as in air of
    15 C, which autopilots and the bridge assume. In air of -15 C a climb of 9 m then reads 10 m"""


class AutopilotSection(Section):
    """The simulated autopilot at the other end of the link."""

    kind: Autopilot | None = None
    """ardupilot or px4; default: the one that the airframe's link names"""
    first_heartbeat_s: NotNegative = 0.0
    """time of its first heartbeat, from the start of the flight [s]"""
    reboots_at_s: tuple[NotNegative, ...] = ()
    """times at which it reboots, which resets its clock [s]"""
    attitude_faults: tuple[AttitudeFault, ...] = ()
    """invalid attitudes, in any order"""
    barometer: BarometerSection = BarometerSection()
    """errors of its barometer"""
    sends_motion: bool = True
    """whether it sends accelerations and pressures; without pressures it does not send its barometer's temperature
    either"""

    def sent_roll_rad(self, pose: Pose) -> float:
        """The roll that its messages contain [rad]: that of the last fault of this time."""
        faults = [
            attitude_fault.roll_rad
            for attitude_fault in self.attitude_faults
            if attitude_fault.from_s <= pose.time_s < attitude_fault.to_s
        ]
        return faults[-1] if faults else pose.roll_rad


class LoopbackAutopilot:
    """An autopilot in this process; a `Transport` of the bridge.

    Parameters
    ----------
    clock
        The flight's clock; its time at construction is the start of the flight.
    pose, air_c
        The vehicle's pose and the air temperature [deg C] at a time of the flight [s].
    plan
        What it does; without a ``kind`` it is an ArduPilot.
    draw
        Source of its accelerometer's and barometer's noise; None: no noise.
    ground_c
        Temperature of the air at the ground [deg C].
    """

    description = "loopback"
    last_error = None
    connected = True
    files = ()

    def __init__(
        self,
        clock: Clock,
        pose: Callable[[float], Pose],
        air_c: Callable[[Pose], float],
        plan: AutopilotSection,
        *,
        draw: random.Random | None = None,
        ground_c: float = STANDARD_C,
    ) -> None:
        self.stats = TransportStats()
        self._frames: list[tuple[float, bytes]] = []
        self._decoded: list[tuple[float, Any]] = []
        self._clock = clock
        self._start_s = clock.now()
        self._pose = pose
        self._plan = plan
        self._air_c = air_c
        is_px4 = plan.kind == "px4"
        self._kind = dialect.MAV_AUTOPILOT_PX4 if is_px4 else dialect.MAV_AUTOPILOT_ARDUPILOTMEGA
        self._first_heartbeat_s = plan.first_heartbeat_s
        self._reboots_at_s = sorted(plan.reboots_at_s)
        self._boot_s = -BOOTED_BEFORE_S
        self._mav = dialect.MAVLink(None, srcSystem=1, srcComponent=dialect.MAV_COMP_ID_AUTOPILOT1)
        self._refused = () if plan.sends_motion else _MOTION
        self._intervals_s = {what: interval_s for what, interval_s in _INTERVALS_S.items() if what not in self._refused}
        self._due_s = dict.fromkeys(self._intervals_s, 0.0)
        self._gauss = draw.gauss if draw else lambda mean, std: mean
        self._drift_m = self._gust_m = self._drift_s = 0.0
        self._barometer_c = ground_c if plan.barometer.in_air_temperature else STANDARD_C
        self._sampled = pose(0.0)
        self._force_bias = [self._gauss(0.0, ACCELEROMETER_BIAS_M_S2) for _ in range(3)]
        self._outgoing = bytearray()

    @property
    def quiet_until_s(self) -> float:
        """Time of its next message [s on the flight's clock]."""
        if self._outgoing:
            return float("-inf")
        due_s = min(self._due_s.values())
        return self._start_s + (min(due_s, self._reboots_at_s[0]) if self._reboots_at_s else due_s)

    def send(self, frame: bytes) -> bool:
        """Receive a frame from the bridge."""
        now_s = self._flight_s()
        self.stats.sent_frames += 1
        if not self._is_up(now_s):
            return True
        self._frames.append((now_s, frame))
        if _message_id(frame) in _ANSWERED:
            self._answer(now_s, self._decode(frame))
        return True

    @property
    def received(self) -> list[tuple[float, Any]]:
        """Messages from the bridge: time of the flight [s], message."""
        # Decoded only when asked for, because decoding takes longer than everything else done with a frame.
        for time_s, frame in self._frames[len(self._decoded) :]:
            self._decoded.append((time_s, self._decode(frame)))
        return self._decoded

    def received_counts(self) -> Counter[str]:
        """Number of messages received from the bridge, by name."""
        return Counter(dialect.mavlink_map[_message_id(frame)].msgname for _, frame in self._frames)

    def _decode(self, frame: bytes) -> Any:
        return self._mav.decode(bytearray(frame))

    def receive(self) -> bytes:
        """Bytes that the autopilot has sent since the last call."""
        now_s = self._flight_s()
        if self._reboots_at_s and now_s >= self._reboots_at_s[0]:
            self._boot_s = self._reboots_at_s.pop(0)
            self._first_heartbeat_s = max(self._first_heartbeat_s, self._boot_s + REBOOT_S)
            self._outgoing.clear()
        if self._is_up(now_s):
            self._send_due(now_s)
        sent = bytes(self._outgoing)
        self._outgoing.clear()
        return sent

    def close(self) -> None:
        """Nothing to release."""

    def _flight_s(self) -> float:
        return self._clock.now() - self._start_s

    def _is_up(self, now_s: float) -> bool:
        return now_s >= self._first_heartbeat_s

    def _send_due(self, now_s: float) -> None:
        boot_ms = round((now_s - self._boot_s) * 1e3)
        pose = None
        for what, due_s in self._due_s.items():
            if now_s < due_s:
                continue
            self._due_s[what] = max(due_s + self._intervals_s[what], now_s)
            if what == "heartbeat":
                flying = dialect.MAV_TYPE_QUADROTOR, self._kind, 0, 0, dialect.MAV_STATE_ACTIVE, 3
                self._put(dialect.MAVLink_heartbeat_message, *flying)
            elif what == "system_time":
                self._put(dialect.MAVLink_system_time_message, 0, boot_ms)
            else:
                pose = pose or self._pose(now_s)
                self._put_measured(what, boot_ms, now_s, pose)

    def _put_measured(self, what: str, boot_ms: int, now_s: float, pose: Pose) -> None:
        if what == "attitude":
            roll_rad = self._plan.sent_roll_rad(pose)
            self._put(dialect.MAVLink_attitude_message, boot_ms, roll_rad, pose.pitch_rad, pose.yaw_rad, 0.0, 0.0, 0.0)
        elif what == "pressure":
            self._put(dialect.MAVLink_scaled_pressure_message, boot_ms, *self._pressure(now_s, pose), 0)
        elif what == "raw_imu":
            milli_g = [round(1000 * each / GRAVITY_M_S2) for each in self._specific_force(pose)]
            self._put(dialect.MAVLink_raw_imu_message, 1000 * boot_ms, *milli_g, *[0] * 8)
        else:
            force = self._specific_force(pose)
            self._put(dialect.MAVLink_highres_imu_message, 1000 * boot_ms, *force, *[0.0] * 9, 15.0, 7, 0)

    def _specific_force(self, pose: Pose) -> Vector:
        """Specific force that the accelerometer measures, body FRD: f = R^T (a - g), with its noise [m/s^2].

        The acceleration a is the mean since the previous sample, so that a sudden change of speed is included.
        """
        before, self._sampled = self._sampled, pose
        elapsed_s = (pose.time_s - before.time_s) or math.inf
        velocities = zip(pose.velocity_ned_m_s, before.velocity_ned_m_s, strict=True)
        north, east, down = ((now - earlier) / elapsed_s for now, earlier in velocities)
        rotation = rotation_matrix(pose.roll_rad, pose.pitch_rad, pose.yaw_rad)
        force = zip(rotate_back(rotation, (north, east, down - GRAVITY_M_S2)), self._force_bias, strict=True)
        x, y, z = (axis + bias + self._gauss(0.0, ACCELEROMETER_STD_M_S2) for axis, bias in force)
        return x, y, z

    def _pressure(self, now_s: float, pose: Pose) -> tuple[float, float, int]:
        """Pressure by the barometric formula p = p0 exp(-h / H) [hPa], H = 8434 m T / 288 K the scale height of the
        air; the difference that is not measured; and the temperature of the barometer's chip [1/100 deg C]."""
        of = self._plan.barometer
        elapsed_s = now_s - self._drift_s
        self._drift_m += self._gauss(0.0, BAROMETER_DRIFT_M * math.sqrt(elapsed_s))
        self._drift_s = now_s
        scale = (273.15 + STANDARD_C) / (273.15 + self._barometer_c)
        height_m = self._drift_m + self._gauss(0.0, BAROMETER_STD_M) - scale * pose.position_ned_m[2]
        if of.gust_m > 0.0:
            kept = math.exp(-elapsed_s / of.gust_s)
            self._gust_m = kept * self._gust_m + self._gauss(0.0, of.gust_m * math.sqrt(1.0 - kept * kept))
            height_m += self._gust_m
        if of.ground_effect_m and pose.throttle is not None:
            near = max(1.0 - max(pose.clearance_m, 0.0) / of.ground_effect_height_m, 0.0)
            height_m += of.ground_effect_m * near * pose.throttle / HOVER_THROTTLE
        temperature_cdeg = round((self._air_c(pose) + BAROMETER_WARMER_C) * 100)
        pressure_hpa = SEA_LEVEL_HPA * math.exp(-height_m / SCALE_HEIGHT_M)
        return pressure_hpa, 0.0, temperature_cdeg

    def _answer(self, now_s: float, message: Any) -> None:
        kind = message.get_type()
        if kind == "TIMESYNC" and message.tc1 == 0:
            self._put(dialect.MAVLink_timesync_message, round((now_s - self._boot_s) * 1e9), message.ts1)
        elif kind == "COMMAND_LONG" and message.target_component == dialect.MAV_COMP_ID_AUTOPILOT1:
            source = (message.get_srcSystem(), message.get_srcComponent())
            result = dialect.MAV_RESULT_ACCEPTED
            if message.command == dialect.MAV_CMD_SET_MESSAGE_INTERVAL and int(message.param1) in _MESSAGES:
                what = _MESSAGES[int(message.param1)]
                if what in self._refused:
                    result = dialect.MAV_RESULT_DENIED
                else:
                    self._intervals_s[what] = message.param2 * 1e-6
                    self._due_s.setdefault(what, now_s)
            self._put(dialect.MAVLink_command_ack_message, message.command, result, 0, 0, *source)

    def _put(self, kind: Any, *values: float) -> None:
        """Send a message, from its class and its numbers; extensions that are left out are 0."""
        self._outgoing += _frame(kind, values, self._mav.seq)
        self._mav.seq = (self._mav.seq + 1) % 256


def _frame(kind: Any, values: Sequence[float], sequence: int) -> bytes:
    """A MAVLink 2 frame of the autopilot: what pymavlink makes, which takes four times as long."""
    values = (*values, *[0] * (len(kind.fieldnames) - len(values)))
    payload: bytes = kind.unpacker.pack(*[values[field] for field in _wire_order(kind)])
    # Zeros at the end are left out, but not the first byte.
    payload = payload[:1] + payload[1:].rstrip(b"\0")
    message_id = kind.id.to_bytes(3, "little")
    head = bytes((len(payload), 0, 0, sequence, 1, dialect.MAV_COMP_ID_AUTOPILOT1, *message_id))
    checksum = mcrf4xx(head + payload + bytes((kind.crc_extra,)))
    return b"\xfd" + head + payload + checksum.to_bytes(2, "little")


@cache
def _wire_order(kind: Any) -> tuple[int, ...]:
    """Which of a message's fields are where in a frame, all of them numbers."""
    return tuple(kind.fieldnames.index(name) for name in kind.ordered_fieldnames)


def _message_id(frame: bytes) -> int:
    """The number of a MAVLink 2 frame's message."""
    return int.from_bytes(frame[7:10], "little")


class Tee(Wrapped):
    """A real link next to the simulated autopilot: both receive the bridge, and the link also gets the autopilot's
    messages."""

    def __init__(self, link: Transport, autopilot: LoopbackAutopilot) -> None:
        super().__init__(link)
        self._autopilot = autopilot

    def send(self, frame: bytes) -> bool:
        """Send to both; True if the real link accepted it."""
        self._autopilot.send(frame)
        return super().send(frame)

    def receive(self) -> bytes:
        """Receive from both."""
        sent = self._autopilot.receive()
        if sent:
            super().send(sent)
        return sent + super().receive()
