"""A simulated flight: a scenario's vehicle, world and emulated sensors around the real bridge.

Everything that varies is an argument: with a virtual clock and a seed, the same flight gives the same bytes on the
link. What comes out is what each reading became beside the truth, for the table, the picture and ``summary.json``.
"""

import hashlib
import math
import random
from collections.abc import Callable, Mapping
from collections.abc import Generator as Steps
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

from numpy.random import Generator, SeedSequence, default_rng

from msp_range.acoustics.air import speed_of_sound
from msp_range.bridge import Bridge, Records, Step
from msp_range.bus import Bus
from msp_range.clock import Clock
from msp_range.config import Airframe, Sensor
from msp_range.correction.temperature import FileSource
from msp_range.health import Severity
from msp_range.mavlink.transport import Transport
from msp_range.reading import Status
from msp_range.reading_model.sensor_model import SensorModel
from msp_sim.autopilot import LoopbackAutopilot
from msp_sim.bus import EmulatedBus
from msp_sim.device import MB1242, Fault, Timing
from msp_sim.model.model import Model
from msp_sim.model.sampler import Sampler
from msp_sim.scenario import Scenario
from msp_sim.vehicle import Pose
from msp_sim.world import Beam, Ping, World

RUN = "flight"
"""Run of the readings of a simulated flight: one session."""
LEVEL_M = 0.15
"""Where the ground below the sensors differs by more than this, one fused distance has no truth to compare with [m]."""
EDGE_S = 0.5
"""Nor has it for a round of the sensors after the ground below the vehicle's middle has changed by as much [s]."""


KeepTruth: TypeAlias = Callable[[str, float, Ping, Mapping[str, float]], None]
"""Takes a sensor's name, the time of a ping in the flight [s], what it met, and further context by column."""


class EmulatedSensor:
    """One sensor's pings: what they meet, and what the sensor makes of it.

    What a ping meets is the context from which the sensor's model draws the reading. Where it hears nothing within its
    beam, the true range is unknown to the model.

    Parameters
    ----------
    sensor
        As mounted on the vehicle.
    model
        What it reads.
    world, pose
        What is there, and where the vehicle is at a time of the flight [s].
    generator
        Its chance.
    keep
        Called with (time of the ping in the flight [s], truth, further context) for each ping.
    others
        Time [s] and true range [cm] of the last ping of each sensor of the vehicle, by name; kept up to date here.
    """

    def __init__(
        self,
        sensor: Sensor,
        model: SensorModel,
        world: World,
        pose: Callable[[float], Pose],
        generator: Generator,
        keep: KeepTruth,
        others: dict[str, tuple[float, float | None]],
    ) -> None:
        self._name = sensor.name
        self._beam = Beam(sensor.position_m, sensor.boresight, model.beam.half_angle_rad)
        self._readings = Sampler(Model.of(model), generator)
        self._world = world
        self._pose = pose
        self._keep = keep
        self._others = others
        self._previous_cm: float | None = None

    def echo(self, ping_s: float) -> int:
        """The reading [cm] of a ping at a time of the flight [s]."""
        pose = self._pose(ping_s)
        ping = self._world.ping(pose, self._beam)
        extra: dict[str, float] = {"uptime_s": ping_s}
        if pose.throttle is not None:
            extra["throttle"] = pose.throttle
        neighbours = [each for name, each in self._others.items() if name != self._name]
        if neighbours:
            neighbour_s, neighbour_cm = max(neighbours)
            extra["neighbour_lag_ms"] = 1e3 * (ping_s - neighbour_s)
            if neighbour_cm is not None:
                extra["neighbour_range_cm"] = neighbour_cm
        self._others[self._name] = (ping_s, ping.true_range_cm)
        self._keep(self._name, ping_s, ping, extra)
        context: dict[str, Any] = ping._asdict() | extra
        context["sensor"], context["run"] = self._name, RUN
        context["previous_reading_cm"] = self._previous_cm
        if not ping.heard:
            context["true_range_cm"] = None
        self._previous_cm = reading_cm = self._readings.sample_one(context)
        return reading_cm


def emulated_bus(
    airframe: Airframe,
    models: dict[str, SensorModel],
    world: World,
    pose: Callable[[float], Pose],
    now: Callable[[], float],
    seed: SeedSequence,
    keep: KeepTruth,
    faults: dict[str, list[Fault]],
) -> Bus:
    """The airframe's sensors on an emulated bus; each draws from a stream of chance of its own."""
    devices = []
    others: dict[str, tuple[float, float | None]] = {}
    for sensor, of_sensor in zip(airframe.sensors, seed.spawn(len(airframe.sensors)), strict=True):
        model = models[sensor.name]
        for_readings, for_faults = of_sensor.spawn(2)
        emulated = EmulatedSensor(sensor, model, world, pose, default_rng(for_readings), keep, others)
        timing = Timing(model.timing.ready_s, model.timing.s_per_cm, model.timing.cycle_s)
        chance = random.Random(int(for_faults.generate_state(1)[0]))
        devices.append(MB1242(sensor.address, now, emulated.echo, timing, faults.get(sensor.name, ()), chance))
    return EmulatedBus(devices, now)


@dataclass(slots=True)
class Track:
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
class Flight:
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

    tracks: dict[str, Track]
    fused: Track
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
        self.flight = Flight({sensor.name: Track() for sensor in airframe.sensors}, Track(), [])
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
        below_m = self._world.height_above_ground(self._pose(ping_s)).down_axis_m
        if sensor in self._downward and ping.slant_range_cm is not None and below_m is not None:
            mounted = self._downward[sensor]
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
        below_m = self._world.height_above_ground(pose).down_axis_m
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
        return range_m + (ping.range_rate_cm_s or 0.0) / 100 * range_m / speed_of_sound(ping.air_temperature_c)


class _Keeping:
    """A transport that keeps a copy of what is sent: its hash, and its frames in a telemetry log.

    The log is in the form of ground stations' tlog files: microseconds since 1970 as eight bytes, most significant
    first, before each frame.
    """

    def __init__(self, transport: Transport, clock: Clock, tlog: Path | None) -> None:
        self._transport = transport
        self._clock = clock
        self._utc_s = clock.utc() - clock.now()
        self._tlog = tlog.open("wb") if tlog is not None else None
        self.sha256 = hashlib.sha256()
        self.receive = transport.receive
        self.description = transport.description
        self.stats = transport.stats

    @property
    def last_error(self) -> str | None:
        return self._transport.last_error

    @property
    def connected(self) -> bool:
        return self._transport.connected

    def send(self, frame: bytes) -> bool:
        self.sha256.update(frame)
        if self._tlog is not None:
            self._tlog.write(round((self._clock.now() + self._utc_s) * 1e6).to_bytes(8, "big") + frame)
        return self._transport.send(frame)

    def close(self) -> None:
        if self._tlog is not None:
            self._tlog.close()
        self._transport.close()


class Simulation:
    """One flight of a scenario.

    Parameters
    ----------
    scenario
        The flight.
    clock
        Virtual, or the system's for a flight in real time.
    seed
        Of all chance.
    model
        What the sensors read, for all of them; None: each sensor's own model file.
    recorder
        Keeps every stage of every reading and the truth.
    link
        A real link to share the flight with.
    tlog
        File for the frames sent.
    """

    def __init__(
        self,
        scenario: Scenario,
        clock: Clock,
        seed: int,
        *,
        model: SensorModel | None = None,
        recorder: Records | None = None,
        link: Callable[[LoopbackAutopilot], Transport] | None = None,
        tlog: Path | None = None,
    ) -> None:
        airframe = scenario.airframe
        for_vehicle, for_sensors = SeedSequence(seed).spawn(2)
        self._clock = clock
        self._start_s = clock.now()
        self._duration_s = scenario.duration_s
        self._world = scenario.world()
        self._vehicle = scenario.vehicle(self._world, default_rng(for_vehicle))
        models = {sensor.name: model or sensor.sensor_model for sensor in airframe.sensors}
        self._log = FlightLog(airframe, models, self._world, self._vehicle.pose, self._start_s, recorder)
        self.flight = self._log.flight
        faults: dict[str, list[Fault]] = {}
        for planned in scenario.faults:
            faults.setdefault(planned.sensor, []).append(planned.on_device())
        bus = emulated_bus(
            airframe,
            models,
            self._world,
            self._vehicle.pose,
            self.now_s,
            for_sensors,
            self._log.keep_truth,
            faults,
        )
        plan = scenario.autopilot
        self._autopilot = LoopbackAutopilot(
            clock,
            self._vehicle.pose,
            lambda pose: self._world.air_temperature_c(-pose.position_ned_m[2]),
            kind=(plan.kind if plan else None) or airframe.link.autopilot,
            heard_from_s=plan.heard_from_s if plan else float("inf"),
            reboots_at_s=plan.reboots_at_s if plan else (),
        )
        transport = link(self._autopilot) if link is not None else self._autopilot
        self._transport = _Keeping(transport, clock, tlog)
        self._bridge = Bridge(
            airframe,
            bus,
            clock,
            self._transport,
            recorder=recorder,
            report=lambda severity, text: self._log.note(self.now_s(), severity, text),
            thermometer=self._thermometer,
        )

    def now_s(self) -> float:
        """Time of the flight [s]."""
        return self._clock.now() - self._start_s

    def pose(self) -> Pose:
        """Where the vehicle is now."""
        return self._vehicle.pose(self.now_s())

    def height_m(self) -> float:
        """Vertical distance to what is below the vehicle now [m]."""
        return self._world.height_above_ground(self.pose()).vertical_m

    def fly(self) -> Steps[list[Step], None, None]:
        """Fly to the end, a step of the bridge at a time; `flight` is complete when the iterator is."""
        try:
            while self.now_s() < self._duration_s:
                steps = self._bridge.step()
                for step in steps:
                    self._log.take(step)
                yield steps
        finally:
            self._finish()

    def _thermometer(self, source: FileSource) -> float:
        """The air about the vehicle, in place of this computer's own files."""
        return self._world.air_temperature_c(-self.pose().position_ned_m[2]) / source.scale

    def _finish(self) -> None:
        self._log.finish(self.now_s(), self._bridge)
        flight = self.flight
        for _, message in self._autopilot.received:
            name = message.get_type()
            flight.autopilot_received[name] = flight.autopilot_received.get(name, 0) + 1
        flight.frames_sha256 = self._transport.sha256.hexdigest()
        self._transport.close()

    @property
    def link_error(self) -> str | None:
        """What is wrong with the real link; None: nothing, or there is none."""
        return self._transport.last_error

    @property
    def received(self) -> list[tuple[float, Any]]:
        """What the autopilot has received: time of the flight [s], message."""
        return self._autopilot.received
