"""A simulated bench: emulated sensors on an emulated bus, in virtual time, without a person.

A point's set-up is given as columns of measured data; the readings are drawn from a model and go through the bus that
the bridge's polling drives. Every point has its own start time and random stream, so that an interrupted collection
resumes as if it had not been, and a change of one point does not change the others.
"""

import random
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.random import Generator, SeedSequence, default_rng

from msp_lab.campaigns.bench import Columns
from msp_lab.campaigns.campaign import Campaign
from msp_lab.campaigns.collect import Arranged, Decision, Place
from msp_lab.campaigns.plan import Point, reading_s, setup_s
from msp_lab.campaigns.watch import Outlier, PointWatch
from msp_range.bus import Address, Bus
from msp_range.clock import Clock, VirtualClock
from msp_range.reading import Reading
from msp_sim.device.bus import Device, EmulatedBus
from msp_sim.device.device import Fault
from msp_sim.device.emulated import ranging_timing
from msp_sim.device.table import emulated_kind
from msp_sim.model.model import Model, load_model
from msp_sim.model.streams import RandomStreams

BIT_S = 1 / 50_000
"""Time of a bit on the bus [s]: 50 kHz, the maker's highest clock without clock stretching. A byte has nine, with its
acknowledgement, and a transfer two more, for start and stop."""
MAX_DRAWN = 1024
"""Readings drawn at a time, at most: more costs memory, fewer cost time."""
MARGIN = 1.3
"""Time reserved for a point, as a multiple of its planned time, for pings that are repeated: with less the next point
would start late, and its readings would depend on the faults of this one."""

Draw = Callable[[Mapping[str, float | str]], int]
"""Draws a reading [cm] for the context of a ping."""


class TimedBus(EmulatedBus):
    """A bus on which transfers take time: two simultaneous pings are sent one after the other.

    `busy_s` is not reported, because attempts take time.

    Parameters
    ----------
    devices
        Everything on the bus.
    clock
        Advanced by each transfer before the device receives it.
    """

    def __init__(self, devices: Sequence[Device], clock: VirtualClock) -> None:
        super().__init__(devices, clock.now)
        self._clock = clock

    def write(self, address: Address, data: bytes) -> None:
        """Send ``data``, address first."""
        self._pass(1 + len(data))
        super().write(address, data)

    def read(self, address: Address, count: int) -> bytes:
        """Read ``count`` bytes; a device that does not acknowledge its address ends the transfer there."""
        self._pass(1)
        answer = super().read(address, count)
        self._pass(count)
        return answer

    def _pass(self, count: int) -> None:
        self._clock.sleep_until(self._clock.now() + (2 + 9 * count) * BIT_S)


class SimulatedBench:
    """A `msp_lab.campaigns.bench.Bench` whose sensors read by a model.

    The true range is the campaign's plus an error for each placement of the target, normal with the reference's
    uncertainty.

    Parameters
    ----------
    campaign, points
        What is to be measured.
    models
        Returns what draws the readings of a sensor, from its name and a random generator.
    seed
        Random seed.
    of
        Description of what the readings are drawn from.
    faults
        Faults of the electronics by sensor, in the bench's time.
    """

    def __init__(
        self,
        campaign: Campaign,
        points: Sequence[Point],
        models: Callable[[str, Generator], Draw],
        seed: int,
        of: str,
        faults: Mapping[str, Sequence[Fault]] | None = None,
    ) -> None:
        self._campaign = campaign
        self._models = models
        self._seed = seed
        self._faults = dict(faults or {})
        self._clock = VirtualClock()
        self.clock: Clock = self._clock
        self.description = f"the simulator, {of}, seed {seed}"
        self.begins_s: dict[str, float] = {}
        begin_s = 0.0
        for before, point in zip([None, *points], points, strict=False):
            begin_s += setup_s(before, point)
            self.begins_s[point.name] = begin_s
            begin_s += MARGIN * reading_s(campaign, point)
        self._length_s = begin_s

    def begin(self, point: Point, attempt: int, columns: Columns, done: int) -> tuple[Bus, int]:
        """Create the sensors; rangings recorded before an interruption are repeated and passed over."""
        self._clock.sleep_until((attempt - 1) * self._length_s + self.begins_s[point.name])
        chance = SeedSequence([self._seed, zlib.crc32(point.name.encode()), attempt])
        for_placing, *for_sensors = chance.spawn(1 + len(point.setup.sensors))
        off_cm = self._campaign.reference.uncertainty_cm * default_rng(for_placing).standard_normal()
        scene = _Scene(columns, off_cm, point, attempt, self._clock.now())
        devices = []
        for name, of_sensor in zip(point.setup.sensors, for_sensors, strict=True):
            for_readings, for_faults = of_sensor.spawn(2)
            sensor = self._campaign.sensor(name)
            kind = emulated_kind(sensor.sensor_model.driver)
            devices.append(
                kind(
                    sensor.address,
                    self._clock.now,
                    scene.echo_of(name, self._models(name, default_rng(for_readings))),
                    ranging_timing(kind, sensor.sensor_model),
                    self._faults.get(name, ()),
                    random.Random(int(for_faults.generate_state(1)[0])),
                )
            )
        return TimedBus(devices, self._clock), done

    def air_c(self, now_s: float) -> float | None:
        """Return None: there is no thermometer, and the air is as planned."""
        return None


class _Scene:
    """What is in front of the sensors of a point."""

    def __init__(self, columns: Columns, off_cm: float, point: Point, attempt: int, start_s: float) -> None:
        self._columns = dict(columns)
        self._run = f"{point.name}.{attempt}"
        self._start_cm = float(columns["true_range_cm"]) + off_cm
        self._rate_cm_s = 0.0 if point.setup.movement is None else point.setup.movement.rate_cm_s
        self._start_s = start_s
        self._last_s: dict[str, float] = {}

    def echo_of(self, name: str, draw: Draw) -> Callable[[float], int]:
        """Return what gives the sensor's reading at the time of a ping [s]."""

        def echo(ping_s: float) -> int:
            columns = {**self._columns, "sensor": name, "run": self._run, "true_range_cm": self._range_cm(ping_s)}
            self._last_s.pop(name, None)
            if self._last_s:
                other_s = max(self._last_s.values())
                columns["neighbour_lag_ms"] = round((ping_s - other_s) * 1e3, 6)
                columns["neighbour_range_cm"] = self._range_cm(other_s)
            self._last_s[name] = ping_s
            return draw(columns)

        return echo

    def _range_cm(self, time_s: float) -> float:
        return self._start_cm + self._rate_cm_s * (time_s - self._start_s)


def readings_of(campaign: Campaign, model_file: Path | None) -> tuple[Callable[[str, Generator], Draw], str]:
    """Return what draws the readings of each sensor, and its description.

    Parameters
    ----------
    campaign
        Names the sensor model files of its simulated sensors.
    model_file
        Sensor model file for all of them instead; None: their own.

    Raises
    ------
    ConfigError
        A file cannot be used.
    """
    paths = {sensor.name: model_file or sensor.simulated_by for sensor in campaign.sensors}
    models = {name: load_model(path) for name, path in paths.items()}
    texts = "".join(path.read_text(encoding="utf-8") for path in paths.values())
    files = " and ".join(dict.fromkeys(path.name for path in paths.values()))
    # With the content: after a change of the file an interrupted campaign must not be resumed.
    words = f"{files} ({zlib.crc32(texts.encode()):08x})"
    return lambda name, generator: _ModelReadings(models[name], generator).draw, words


class _ModelReadings:
    """Readings of a model; several are drawn at a time while the context stays the same."""

    def __init__(self, model: Model, generator: Generator) -> None:
        self._model = model
        self._streams = RandomStreams(generator)
        self._columns: Mapping[str, float | str] = {}
        self._drawn: Iterator[float] = iter(())
        self._count = 1

    def draw(self, columns: Mapping[str, float | str]) -> int:
        """The reading [cm] of a ping."""
        if columns != self._columns:
            self._columns, self._drawn, self._count = columns, iter(()), 1
        reading_cm = next(self._drawn, None)
        if reading_cm is None:
            contexts = {name: np.full(self._count, value) for name, value in columns.items()}
            self._drawn = iter(self._model.sample(contexts, self._streams).tolist())
            self._count = min(4 * self._count, MAX_DRAWN)
            reading_cm = next(self._drawn)
        return int(reading_cm)


@dataclass
class AutoOperator:
    """A `msp_lab.campaigns.collect.Operator` that sets up at once, accepts every point, and counts."""

    progress: Callable[[Point, int], None] = lambda point, readings: None
    """Called with the point and the readings so far."""
    stopped: Callable[[], bool] = lambda: False
    """Whether the collection should end."""
    readings: int = 0
    outliers: int = 0
    failed: int = 0
    """Numbers of usable answers, of outliers among them, and of pings without one."""
    texts: list[str] = field(default_factory=list)
    """Reports on silent sensors."""

    def arrange(self, point: Point, to_change: Sequence[str], place: Place) -> Arranged:
        """Accept the set-up as planned."""
        self.progress(point, self.readings)
        return Arranged(Decision.STOP if self.stopped() else Decision.GO)

    def on_reading(
        self, point: Point, watches: Mapping[str, PointWatch], reading: Reading, outlier: Outlier | None
    ) -> Decision:
        """Count the reading."""
        if reading.status.is_fault:
            self.failed += 1
        else:
            self.readings += 1
            self.outliers += outlier is not None
        if self.readings % 500 == 0:
            self.progress(point, self.readings)
            if self.stopped():
                return Decision.STOP
        return Decision.GO

    def review(self, point: Point, watches: Mapping[str, PointWatch]) -> Decision:
        """Accept the point."""
        return Decision.GO

    def on_trouble(self, text: str) -> Decision:
        """Store the report and try again; the collection gives up by itself."""
        self.texts.append(text)
        return Decision.GO
