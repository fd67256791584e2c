"""The whole bridge on an emulated bus in virtual time, and the frames that it sends as pymavlink decodes them."""

import random
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import common

from msp_range.bridge import Bridge, Step
from msp_range.clock import VirtualClock
from msp_range.config import Airframe
from msp_range.mavlink.transport.base import TransportStats
from msp_sim.device.bus import Device, EmulatedBus
from msp_sim.device.device import Fault
from msp_sim.device.table import emulated_kind
from tests.support.shipped import CONFIGS

CALIBRATED_C = 22.5
"""Air in which an MB1242's reading is the range."""
FUSED_ID = 10
START_S = 50.0
"""The bench's clock at its start: not zero, because time_boot_ms counts from there."""


def sensor(name: str, number: int, pitch_deg: float = -90.0, yaw_deg: float = 0.0) -> dict[str, Any]:
    """A sensor of an airframe file: DISTANCE_SENSOR id ``number``, address 0x6f + number, at the reference point."""
    return {
        "name": name,
        "id": number,
        "address": 0x6F + number,
        "model": "sensors/mb1242.yaml",
        "position_m": [0, 0, 0],
        "rotation_deg": {"pitch": pitch_deg, "yaw": yaw_deg},
    }


FOUR_DOWN = [sensor(name, number) for number, name in enumerate(("a", "b", "c", "d"), start=1)]


def airframe(sensors: Sequence[dict[str, Any]] = FOUR_DOWN, **changed: Any) -> Airframe:
    """Downward sensors with a fused stream only, in air that needs no correction; ``changed`` are keys of the file."""
    content: dict[str, Any] = {
        "vehicle": "bench",
        "sensors": sensors,
        # Known exactly: what it leaves uncertain is tested on its own.
        "temperature": {"fixed_c": CALIBRATED_C, "fixed_std_c": 0.0},
        "link": {"url": "udpout:127.0.0.1:14550"},
        "send": {"fused": {"id": FUSED_ID}},
        # It puts out the first reading, which the changepoint filter keeps back.
        "filters": [{"filter": "kalman"}],
    }
    return Airframe.model_validate(content | changed, context={"folder": CONFIGS})


def one_down(**changed: Any) -> Airframe:
    """One downward sensor, ``a``, with a stream of its own and no filters."""
    return airframe(FOUR_DOWN[:1], **({"send": {"sensors": ["a"]}, "filters": []} | changed))


class Sent(NamedTuple):
    """A message that the bridge sent, and when [s on the bench's clock]."""

    time_s: float
    message: Any


class Wire:
    """A Transport that keeps frames and gives what it was handed."""

    def __init__(self, clock: VirtualClock) -> None:
        self.description = "wire"
        self.stats = TransportStats()
        self.last_error: str | None = None
        self.connected = True
        self.quiet_until_s = float("-inf")
        self.files: tuple[int, ...] = ()
        self.arriving = b""
        self.frames: list[tuple[float, bytes]] = []
        self._clock = clock

    def send(self, frame: bytes) -> bool:
        self.frames.append((self._clock.now(), frame))
        return True

    def receive(self) -> bytes:
        arrived, self.arriving = self.arriving, b""
        return arrived

    def close(self) -> None:
        self.connected = False


class Bench:
    """An airframe's bridge with an emulated range finder for each of its sensors.

    Parameters
    ----------
    vehicle
        The airframe.
    reading_cm
        What the world gives a sensor: (sensor, time since the start [s]) -> whole centimetres; or always the same.
    faults
        Of each sensor, in seconds since the start.
    others
        Further devices on the bus.
    absent
        Sensors that are not on the bus.
    """

    def __init__(
        self,
        vehicle: Airframe,
        reading_cm: Callable[[str, float], float] | float = 300,
        *,
        faults: Mapping[str, Sequence[Fault]] | None = None,
        others: Sequence[Device] = (),
        absent: Sequence[str] = (),
        **bridge: Any,
    ) -> None:
        self.clock = VirtualClock(START_S)
        self.pings: list[tuple[float, str, float]] = []
        """Time since the start [s], sensor, and what the world gave it [cm]."""
        self._reading_cm = reading_cm if callable(reading_cm) else lambda name, time_s: reading_cm
        self.sonars = {
            each.name: emulated_kind(each.sensor_model.driver)(
                each.address,
                self.now,
                lambda ping_s, name=each.name: self._echo(name, ping_s),  # type: ignore[misc]
                faults=(faults or {}).get(each.name, ()),
                chance=random.Random(each.id),
            )
            for each in vehicle.sensors
            if each.name not in absent
        }
        self.bus = EmulatedBus([*self.sonars.values(), *others], self.now)
        self.wire = Wire(self.clock)
        self.reports: list[tuple[float, str]] = []
        """Health: time since the start [s], text."""
        self.bridge = Bridge(
            vehicle,
            self.bus,
            self.clock,
            self.wire,
            report=lambda severity, text: self.reports.append((self.now(), text)),
            **bridge,
        )
        self.steps: list[Step] = []

    def now(self) -> float:
        """Time since the start [s]."""
        return self.clock.now() - START_S

    def _echo(self, name: str, ping_s: float) -> float:
        reading_cm = self._reading_cm(name, ping_s)
        self.pings.append((ping_s, name, reading_cm))
        return reading_cm

    def fly(self, until_s: float, with_autopilot: bool = False) -> "Bench":
        """Step the bridge until this time since the start [s]; with an autopilot's heartbeat each second."""
        next_s = self.now()
        while self.now() < until_s:
            if with_autopilot and self.now() >= next_s:
                next_s += 1.0
                self.receive(common.MAVLink_heartbeat_message(2, common.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 4, 3))
            self.steps += self.bridge.step()
        return self

    def sent(self, kind: str = "DISTANCE_SENSOR") -> list[Sent]:
        """All messages of a kind; times since the start."""
        parser = common.MAVLink(None)
        messages = [
            Sent(time_s - START_S, message)
            for time_s, frame in self.wire.frames
            for message in parser.parse_buffer(frame)
        ]
        return [each for each in messages if each.message.get_type() == kind]

    def distances_cm(self, stream: int = FUSED_ID, from_s: float = 0.0, to_s: float = 1e9) -> list[int]:
        """``current_distance`` of a stream's messages in a time."""
        return [distance_cm for _, distance_cm in self.timed_cm(stream, from_s, to_s)]

    def timed_cm(self, stream: int = FUSED_ID, from_s: float = 0.0, to_s: float = 1e9) -> list[tuple[float, int]]:
        """The same with their times."""
        return [
            (time_s, message.current_distance)
            for time_s, message in self.sent()
            if message.id == stream and from_s <= time_s < to_s
        ]

    def longest_gap_s(self, from_s: float = 0.0, to_s: float = 1e9) -> float:
        """Between two messages of the fused stream in a time [s]."""
        times_s = [time_s for time_s, _ in self.timed_cm(FUSED_ID, from_s, to_s)]
        return max(late - early for early, late in pairwise(times_s))

    def texts(self) -> list[str]:
        """STATUSTEXT in order."""
        return [message.text for _, message in self.sent("STATUSTEXT")]

    def reported(self, from_s: float = 0.0, to_s: float = 1e9) -> list[str]:
        """Changes of health in a time."""
        return [text for time_s, text in self.reports if from_s <= time_s < to_s]

    def rejected(self, name: str) -> dict[str, int]:
        """Readings of a sensor that were not used, by reason."""
        return self.bridge.counts()[name].rejected

    def receive(self, *messages: Any, system: int = 1) -> None:
        """Messages from the autopilot, which arrive now."""
        if not hasattr(self, "_autopilot"):
            self._autopilot = common.MAVLink(None, srcSystem=system, srcComponent=1)
        for message in messages:
            self.wire.arriving += message.pack(self._autopilot)
            self._autopilot.seq = (self._autopilot.seq + 1) % 256


def assert_reported(bench: Bench, from_s: float, to_s: float, text: str, reason: str) -> None:
    """A fault of sensor a was reported before anything else in this time, its readings rejected, its end reported."""
    assert bench.reported(from_s, to_s)[0] == f"Range a: {text}"
    assert "Range a: good again" in bench.reported(to_s)
    assert reason in bench.rejected("a")
