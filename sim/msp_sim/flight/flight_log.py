"""Record what became of each reading of a simulated flight, together with the truth.

Pings and the bridge's steps become a `FlightResult`, from which table, picture and ``summary.json`` are made.
"""

import math
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from msp_range.acoustics.air import speed_of_sound
from msp_range.bridge import Bridge, Records, Step
from msp_range.config import Airframe
from msp_range.fusion import Fused
from msp_range.pilot_texts import Severity
from msp_range.reading import Status
from msp_range.reading_model.sensor_model import SensorModel
from msp_sim.world.vehicle import Pose
from msp_sim.world.world import Ping, World

LEVEL_M = 0.15
"""Largest difference of the ground between the sensors at which the fused distance is compared with the truth [m]. With
a larger difference no single distance is true. A larger value counts edges as errors of the fusion."""
EDGE_S = 0.5
"""Time without comparison after the ground below the vehicle's middle has changed by `LEVEL_M` [s]: a polling cycle of
four sensors, during which they still see the old ground."""
USED = (None, Status.AT_MINIMUM.value)
"""Values of `SensorTrack.why` for readings that the bridge used."""


@dataclass(slots=True)
class SensorTrack:
    """The readings of one sensor or of the fused stream during a flight; None if there was no value.

    ``below_m`` is the true distance from the fused stream's reference point along the vehicle's down axis at that time:
    None for sensors that do not look down, and where the ground differs between the sensors.
    """

    time_s: list[float] = field(default_factory=list)
    truth_m: list[float | None] = field(default_factory=list)
    raw_m: list[float | None] = field(default_factory=list)
    filtered_m: list[float | None] = field(default_factory=list)
    why: list[str | None] = field(default_factory=list)
    below_m: list[float | None] = field(default_factory=list)

    def add(
        self,
        time_s: float,
        truth_m: float | None,
        raw_m: float | None,
        filtered_m: float | None,
        why: str | None,
        below_m: float | None = None,
    ) -> None:
        """Append one reading, or one fused distance."""
        self.time_s.append(time_s)
        self.truth_m.append(truth_m)
        self.raw_m.append(raw_m)
        self.filtered_m.append(filtered_m)
        self.why.append(why)
        self.below_m.append(below_m)


@dataclass(slots=True)
class FlightResult:
    """The result of a flight."""

    tracks: dict[str, SensorTrack]
    """Readings by sensor."""
    fused: SensorTrack
    """The fused stream; its ``raw_m`` is empty, and ``why`` is ``edge`` where the ground differs between the
    sensors."""
    texts: list[tuple[float, str, str]]
    """Health messages: time [s], severity, text."""
    sent: dict[str, int] = field(default_factory=dict)
    dropped: dict[str, int] = field(default_factory=dict)
    """Numbers of messages by type."""
    autopilot_received: dict[str, int] = field(default_factory=dict)
    frames_sha256: str = ""
    """Hash of all bytes sent, in order."""
    duration_s: float = 0.0
    """Time flown [s]."""

    @property
    def rejected(self) -> dict[str, Counter[str]]:
        """Number of readings that the bridge did not use, by sensor and reason."""
        return {
            name: Counter(why for why in track.why if why is not None and why not in USED)
            for name, track in self.tracks.items()
        }


class FlightLog:
    """Records what became of each reading of a flight, together with the truth.

    Parameters
    ----------
    airframe, models
        The vehicle, and the sensor models by name of the sensor.
    world, pose
        The world, and the vehicle's pose at a time of the flight [s].
    start_s
        Start of the flight [s on the bridge's clock].
    recorder
        Records the truth; may be None.
    """

    def __init__(
        self,
        airframe: Airframe,
        models: Mapping[str, SensorModel],
        world: World,
        pose: Callable[[float], Pose],
        start_s: float,
        recorder: Records | None,
    ) -> None:
        self.flight = FlightResult({sensor.name: SensorTrack() for sensor in airframe.sensors}, SensorTrack(), [])
        self._models = models
        self._downward = {sensor.name: sensor for sensor in airframe.downward}
        self._reference_down_m = airframe.reference_down_m
        self._world = world
        self._pose = pose
        self._start_s = start_s
        self._recorder = recorder
        self._truths: dict[str, Ping] = {}
        self._steps_m: dict[str, float] = {}
        self._level_m: float | None = None
        self._edge_s = float("-inf")

    def record_truth(self, sensor: str, ping_s: float, ping: Ping, context: Mapping[str, Any]) -> None:
        """Record the truth of a ping at a time of the flight [s], with all of its context."""
        self._truths[sensor] = ping
        mounted = self._downward.get(sensor)
        if mounted is not None and ping.slant_range_cm is not None:
            ground_m = self._world.down_axis_m(self._pose(ping_s))
            if ground_m is not None:
                seen_m = ping.slant_range_cm / 100 * math.cos(mounted.tilt_from_down_rad) + mounted.position_m[2]
                self._steps_m[sensor] = seen_m - ground_m
        if self._recorder is not None:
            not_recorded = ("has_echo", "slant_range_cm")
            truth = {key: value for key, value in context.items() if value is not None and key not in not_recorded}
            self._recorder.write(f"/truth/{sensor}", ping_s + self._start_s, truth)

    def record_step(self, step: Step) -> None:
        """Record what became of a reading."""
        reading, estimate = step.ranging.reading, step.filtered.estimate
        time_s = reading.time_s - self._start_s
        at_minimum = reading.status.value if reading.status is Status.AT_MINIMUM else None
        self.flight.tracks[reading.sensor].add(
            time_s,
            self._truth_m(reading.sensor),
            reading.range_m,
            estimate.range_m if estimate else None,
            step.filtered.rejected or at_minimum,
            self._record_below(time_s, step.fused) if reading.sensor in self._downward else None,
        )

    def _record_below(self, time_s: float, fused: Fused | None) -> float | None:
        """Record the fused distance; return the true one [m], or None over an edge."""
        pose = self._pose(time_s)
        ground_m = self._world.down_axis_m(pose)
        truth_m = None if ground_m is None else ground_m - self._reference_down_m
        is_edge = ground_m is None or self._update_edge(time_s, pose, ground_m)
        below_m = None if is_edge else truth_m
        if fused is not None:
            self.flight.fused.add(time_s, truth_m, None, fused.range_m, "edge" if is_edge else None, below_m)
        return below_m

    def _update_edge(self, time_s: float, pose: Pose, ground_m: float) -> bool:
        """Whether there is an edge, or was one just now, by how far away the ground is along the down axis [m]."""
        # Down from the start to where the axis meets the ground, so that climbing or descending is not an edge.
        level_m = pose.position_ned_m[2] + ground_m * math.cos(pose.pitch_rad) * math.cos(pose.roll_rad)
        if self._level_m is not None and abs(level_m - self._level_m) > LEVEL_M:
            self._edge_s = time_s
        self._level_m = level_m
        return time_s - self._edge_s < EDGE_S or any(abs(step_m) > LEVEL_M for step_m in self._steps_m.values())

    def record_text(self, time_s: float, severity: Severity, text: str) -> None:
        """Record a health message at a time of the flight [s]."""
        self.flight.texts.append((time_s, severity.name.lower(), text))

    def finish(self, duration_s: float, bridge: Bridge) -> None:
        """Complete `flight` with the bridge's counters."""
        self.flight.duration_s = duration_s
        self.flight.sent = dict(bridge.link.sent)
        self.flight.dropped = dict(bridge.link.dropped)

    def _truth_m(self, sensor: str) -> float | None:
        """True range at the time of the last echo [m]."""
        ping = self._truths.get(sensor)
        if ping is None or not ping.has_echo:
            return None
        model = self._models[sensor]
        range_cm = ping.slant_range_cm if model.oblique_reading == "slant" else ping.true_range_cm
        if range_cm is None:
            return None
        if model.medium != "sound":
            return range_cm / 100
        return at_echo_m(range_cm, ping.range_rate_cm_s or 0.0, ping.air_temperature_c)


def at_echo_m(range_cm: float, rate_cm_s: float, air_c: float) -> float:
    """True range at the time of an echo, by that at its ping: the vehicle moves while the sound travels [m]."""
    range_m = range_cm / 100
    return range_m + rate_cm_s / 100 * range_m / speed_of_sound(air_c)
