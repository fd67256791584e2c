"""What a simulated flight leaves behind: what each reading became, beside the truth.

Pings and the bridge's steps enter; a `FlightResult` leaves, which the table, the picture and ``summary.json`` are made of.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from msp_range.acoustics.air import speed_of_sound
from msp_range.bridge import Bridge, Records, Step
from msp_range.config import Airframe
from msp_range.health import Severity
from msp_range.reading import Status
from msp_range.reading_model.sensor_model import SensorModel
from msp_sim.world.vehicle import Pose
from msp_sim.world.world import Ping, World

LEVEL_M = 0.15
"""Where the ground below the sensors differs by more than this, one fused distance has no truth to compare with [m]."""
EDGE_S = 0.5
"""Nor has it for a round of the sensors after the ground below the vehicle's middle has changed by as much [s]."""


@dataclass(slots=True)
class SensorTrack:
    """One sensor's flight, reading by reading, or the fused stream's; None where there was no value.

    ``below_m`` is the distance from the fused stream's reference point along the vehicle's down axis at that time: None
    for sensors that look elsewhere, and where the ground differs from sensor to sensor.
    """

    time_s: list[float] = field(default_factory=list)
    truth_m: list[float | None] = field(default_factory=list)
    raw_m: list[float | None] = field(default_factory=list)
    filtered_m: list[float | None] = field(default_factory=list)
    why: list[str | None] = field(default_factory=list)
    below_m: list[float | None] = field(default_factory=list)


@dataclass(slots=True)
class FlightResult:
    """What a flight left behind.

    Attributes
    ----------
    tracks
        By sensor.
    fused
        The fused stream; its ``raw_m`` stays empty, and ``why`` says ``edge`` where the ground below differs.
    texts
        Health changes: time [s], severity, text.
    rejected, sent, dropped
        Readings by sensor and reason; messages by type.
    frames_sha256
        Of all bytes sent, in order.
    duration_s
        Time flown [s].
    """

    tracks: dict[str, SensorTrack]
    fused: SensorTrack
    texts: list[tuple[float, str, str]]
    rejected: dict[str, dict[str, int]] = field(default_factory=dict)
    sent: dict[str, int] = field(default_factory=dict)
    dropped: dict[str, int] = field(default_factory=dict)
    autopilot_received: dict[str, int] = field(default_factory=dict)
    frames_sha256: str = ""
    duration_s: float = 0.0


class FlightLog:
    """What each reading of a flight became, beside the truth.

    Parameters
    ----------
    airframe, models
        The vehicle, and what its sensors read by, by name.
    world, pose
        What is there, and where the vehicle is at a time of the flight [s].
    start_s
        When the flight began [s on the bridge's clock].
    recorder
        Keeps the truth.
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
        self._by_sound = {name: model.medium == "sound" for name, model in models.items()}
        self._slant = {name: model.oblique_reading == "slant" for name, model in models.items()}
        self._downward = {sensor.name: sensor for sensor in airframe.downward}
        self._reference_down_m = airframe.send.fused.reference_down_m if airframe.send.fused else 0.0
        self._world = world
        self._pose = pose
        self._start_s = start_s
        self._recorder = recorder
        self._truths: dict[str, Ping] = {}
        self._steps_m: dict[str, float] = {}
        self._ground_m: float | None = None
        self._edge_s = float("-inf")

    def keep_truth(self, sensor: str, ping_s: float, ping: Ping, extra: Mapping[str, float]) -> None:
        """Note what a ping met, at a time of the flight [s], and further context."""
        self._truths[sensor] = ping
        mounted = self._downward.get(sensor)
        if mounted is not None and ping.slant_range_cm is not None:
            below_m = self._world.down_axis_m(self._pose(ping_s))
            if below_m is not None:
                down_m = ping.slant_range_cm / 100 * math.cos(mounted.tilt_from_down_rad) + mounted.position_m[2]
                self._steps_m[sensor] = down_m - below_m
        if self._recorder is not None:
            unsaid = ("heard", "slant_range_cm")
            truth = {key: each for key, each in ping._asdict().items() if each is not None and key not in unsaid}
            self._recorder.write(f"/truth/{sensor}", ping_s + self._start_s, truth | dict(extra))

    def take(self, step: Step) -> None:
        """Note what a reading became."""
        reading = step.ranging.reading
        time_s = reading.time_s - self._start_s
        track = self.flight.tracks[reading.sensor]
        track.time_s.append(time_s)
        track.truth_m.append(self._truth_m(reading.sensor))
        track.raw_m.append(reading.range_m)
        track.filtered_m.append(step.filtered.estimate.range_m if step.filtered.estimate else None)
        at_minimum = reading.status.value if reading.status is Status.AT_MINIMUM else None
        track.why.append(step.filtered.rejected or at_minimum)
        if reading.sensor not in self._downward:
            track.below_m.append(None)
            return
        pose = self._pose(time_s)
        below_m = self._world.down_axis_m(pose)
        truth_m = None if below_m is None else below_m - self._reference_down_m
        is_edge = below_m is None or self._is_edge(time_s, pose, below_m)
        track.below_m.append(None if is_edge else truth_m)
        if step.fused is not None:
            fused = self.flight.fused
            fused.time_s.append(time_s)
            fused.truth_m.append(truth_m)
            fused.filtered_m.append(step.fused.range_m)
            fused.why.append("edge" if is_edge else None)
            fused.below_m.append(None if is_edge else truth_m)

    def _is_edge(self, time_s: float, pose: Pose, below_m: float) -> bool:
        # Where the down axis meets the ground: what the vehicle does up and down is no edge.
        ground_m = pose.position_ned_m[2] + below_m * math.cos(pose.pitch_rad) * math.cos(pose.roll_rad)
        if self._ground_m is not None and abs(ground_m - self._ground_m) > LEVEL_M:
            self._edge_s = time_s
        self._ground_m = ground_m
        return time_s - self._edge_s < EDGE_S or any(abs(step_m) > LEVEL_M for step_m in self._steps_m.values())

    def note(self, time_s: float, severity: Severity, text: str) -> None:
        """Note a change of health, at a time of the flight [s]."""
        self.flight.texts.append((time_s, severity.name.lower(), text))

    def finish(self, duration_s: float, bridge: Bridge) -> None:
        """Complete `flight` with what the bridge has counted."""
        self.flight.duration_s = duration_s
        self.flight.rejected = {name: counts.rejected for name, counts in bridge.counts().items()}
        self.flight.sent = dict(bridge.link.sent)
        self.flight.dropped = dict(bridge.link.dropped)

    def _truth_m(self, sensor: str) -> float | None:
        """The range at the time of the last echo."""
        ping = self._truths.get(sensor)
        if ping is None or not ping.heard:
            return None
        range_cm = ping.slant_range_cm if self._slant[sensor] else ping.true_range_cm
        if range_cm is None:
            return None
        range_m = range_cm / 100
        if not self._by_sound[sensor]:
            return range_m
        return range_m + (ping.range_rate_cm_s or 0.0) / 100 * range_m / speed_of_sound(ping.air_temperature_c)
