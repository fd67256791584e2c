"""The airframe's sensors, emulated: what a ping meets in the simulated world, and what the sensor makes of it.

An airframe, a world, a pose over time and sensor models make a bus behind which the bridge finds its sensors.
"""

import math
import random
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.random import Generator, SeedSequence, default_rng

from msp_range.bus import Bus
from msp_range.config import Airframe, SensorSettings
from msp_range.reading_model.sensor_model import SensorModel
from msp_sim.device.bus import EmulatedBus
from msp_sim.device.device import DeviceTiming, Fault, RangeFinder
from msp_sim.device.table import emulated_kind
from msp_sim.effects.base import PATH, TRUE_RANGE
from msp_sim.model.model import Model
from msp_sim.model.sampler import Sampler
from msp_sim.world.vehicle import Pose
from msp_sim.world.world import MountedBeam, Ping, World

RUN = "flight"
"""Run of the readings of a simulated flight: one session."""
LastPings: TypeAlias = dict[str, tuple[float, float | None]]
"""Time [s] and true range [cm] of each sensor's last ping, by name."""
KeepTruth: TypeAlias = Callable[[str, float, Ping, Mapping[str, Any]], None]
"""Takes a sensor's name, the time of a ping in the flight [s], what it met, and all of its context by column."""


@dataclass(frozen=True)
class Surroundings:
    """The world around emulated sensors, and the vehicle's pose in it."""

    world: World
    pose: Callable[[float], Pose]
    """Where the vehicle is at a time of the flight [s]."""
    keep: KeepTruth = lambda *_: None
    """Called for each ping."""


class FlownPath:
    """The path of one ping's true range: what the vehicle was above at another time.

    Parameters
    ----------
    range_cm
        True range at a time of the flight [s]; None: there is no surface.
    ping_s, now_cm
        When the ping was [s], and the true range then [cm].
    """

    size = 1

    def __init__(self, range_cm: Callable[[float], float | None], ping_s: float, now_cm: float | None) -> None:
        self._range_cm, self._ping_s, self._now_cm = range_cm, ping_s, now_cm

    def __getitem__(self, part: slice) -> "FlownPath":
        return self

    def moved_cm(self, ago_s: Any) -> float:
        """Range ``ago_s`` before the ping, minus that at the ping [cm]; NaN where there was no surface."""
        then_cm, now_cm = self._range_cm(self._ping_s - float(np.squeeze(ago_s))), self._now_cm
        return math.nan if then_cm is None or now_cm is None else then_cm - now_cm


class EmulatedSensor:
    """One sensor's pings: what they meet, and what the sensor makes of it.

    What a ping meets is the context from which the sensor's model draws the reading. Where it gets no echo within its
    beam, the true range is unknown to the model.

    Parameters
    ----------
    sensor
        As mounted on the vehicle.
    model
        The sensor model from which its readings are drawn.
    around
        The world, and the vehicle's pose in it.
    generator
        Draws its readings.
    others
        Time [s] and true range [cm] of the last ping of each sensor of the vehicle, by name; kept up to date here.
    """

    def __init__(
        self,
        sensor: SensorSettings,
        model: SensorModel,
        around: Surroundings,
        generator: Generator,
        others: LastPings,
    ) -> None:
        self._name = sensor.name
        half_angle_rad = model.beam.half_angle_rad if model.medium == "sound" else None
        self._beam = MountedBeam(sensor.position_m, sensor.boresight, half_angle_rad)
        self._readings = Sampler(Model.of(model), generator)
        self._around = around
        self._others = others
        self._previous_cm: float | None = None

    def echo(self, ping_s: float) -> float:
        """The reading of a ping at a time of the flight [s], in steps of the model [cm]."""
        context = self.context(ping_s)
        context["previous_reading_cm"] = self._previous_cm
        context[PATH] = FlownPath(lambda time_s: self._ping(time_s).true_range_cm, ping_s, context[TRUE_RANGE])
        self._previous_cm = reading_cm = self._readings.sample_one(context)
        return reading_cm

    def _ping(self, time_s: float) -> Ping:
        return self._around.world.ping(self._around.pose(time_s), self._beam)

    def context(self, ping_s: float) -> dict[str, Any]:
        """What a ping at a time of the flight [s] meets, as the context of its reading; None where it is unknown."""
        pose, ping = self._around.pose(ping_s), self._ping(ping_s)
        context: dict[str, Any] = ping._asdict()
        context["uptime_s"] = ping_s
        if pose.throttle is not None:
            context["throttle"] = pose.throttle
        self._others.pop(self._name, None)
        if self._others:
            neighbour_s, neighbour_cm = max(self._others.values())
            context["neighbour_lag_ms"] = 1e3 * (ping_s - neighbour_s)
            if neighbour_cm is not None:
                context["neighbour_range_cm"] = neighbour_cm
        self._others[self._name] = (ping_s, ping.true_range_cm)
        self._around.keep(self._name, ping_s, ping, context)
        context["sensor"], context["run"], context["time_in_run_s"] = self._name, RUN, ping_s
        if not ping.has_echo:
            context["true_range_cm"] = None
        return context


def ping_contexts(
    airframe: Airframe, model: SensorModel | None, around: Surroundings, pings: Iterable[tuple[float, str]]
) -> Iterator[dict[str, Any]]:
    """The contexts of pings without a bridge, each with its time [s] and its sensor; model None: each sensor's own."""
    others: LastPings = {}
    sensors = {
        sensor.name: EmulatedSensor(sensor, model or sensor.sensor_model, around, default_rng(0), others)
        for sensor in airframe.sensors
    }
    for time_s, name in pings:
        yield sensors[name].context(time_s)


def ranging_timing(kind: type[RangeFinder], model: SensorModel) -> DeviceTiming:
    """How long a sensor of this kind and model is busy."""
    of_model = model.timing
    return replace(
        kind.default_timing, ready_s=of_model.ready_s, s_per_cm=of_model.s_per_cm, no_echo_s=of_model.cycle_s
    )


def within_limits(
    echo: Callable[[float], float], model: SensorModel, kind: type[RangeFinder]
) -> Callable[[float], float]:
    """Readings of a model as a device of this kind can answer them.

    A model of another sensor may read less or more than the device. A reading below the device's shortest becomes its
    shortest; no echo, or more than its longest, becomes its code for no echo. A reading below the model's own shortest
    is a word with a lost byte, and arrives unchanged.
    """
    if kind.minimum_cm <= model.minimum_cm and model.maximum_cm == kind.no_echo_cm:
        return echo

    def limited(ping_s: float) -> float:
        reading_cm = echo(ping_s)
        if reading_cm >= min(model.maximum_cm, kind.no_echo_cm):
            return kind.no_echo_cm
        return reading_cm if reading_cm < model.minimum_cm else max(reading_cm, kind.minimum_cm)

    return limited


def emulated_bus(
    airframe: Airframe,
    models: dict[str, SensorModel],
    around: Surroundings,
    now: Callable[[], float],
    seed: SeedSequence,
    faults: Mapping[str, Sequence[Fault]],
) -> Bus:
    """The airframe's sensors on an emulated bus; each draws from its own random stream."""
    devices = []
    others: LastPings = {}
    for sensor, of_sensor in zip(airframe.sensors, seed.spawn(len(airframe.sensors)), strict=True):
        model = models[sensor.name]
        for_readings, for_faults = of_sensor.spawn(2)
        emulated = EmulatedSensor(sensor, model, around, default_rng(for_readings), others)
        chance = random.Random(int(for_faults.generate_state(1)[0]))
        kind = emulated_kind(sensor.sensor_model.driver)
        # Readings of another kind of sensor are answered as the device on the bus answers, at its times too.
        same_kind = model.driver == sensor.sensor_model.driver
        timing = ranging_timing(kind, model if same_kind else sensor.sensor_model)
        echo = within_limits(emulated.echo, model, kind)
        devices.append(kind(sensor.address, now, echo, timing, faults.get(sensor.name, ()), chance))
    return EmulatedBus(devices, now, reports_busy=True)
