"""Flights for the blind tables: what a vehicle does, and readings of its sensors with nothing hidden.

Draws enter, context columns and a `Ping` leave. Contexts hang together as they do in the air: throttle with climb and
wind, tilt with throttle, vibration with throttle, humidity against temperature, heat with time in the sun.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.signal import lfilter

from evaluation.blind import air
from evaluation.blind.ping import REFLECTION_DB, Ping
from evaluation.blind.receiver import NEAREST_CM, NO_ECHO_CM, Receiver
from evaluation.blind.sound import Array

Columns = dict[str, NDArray[Any]]
Regime = Literal["iid", "ar1", "run_offsets", "whole_centimetres", "drifting", "heavy_outliers"]
REGIMES: tuple[Regime, ...] = ("iid", "ar1", "run_offsets", "whole_centimetres", "drifting", "heavy_outliers")

STRONG = Receiver(
    level_db=120.5,
    rise_s=20e-6,
    late_s=6e-6,
    threshold_range_cm=(20.0, 35.0, 50.0, 75.0, 100.0, 150.0, 200.0, 250.0, 300.0, 350.0, 400.0, 450.0, 765.0),
    threshold_db=(100.9, 95.6, 92.1, 87.9, 84.7, 79.8, 75.9, 72.5, 69.5, 66.8, 64.2, 61.8, 61.8),
)
"""A louder sensor than the report's, whose gain follows the level of a wall's echo: 27 dB to spare at all ranges up to
4.5 m, so that level hardly matters unless something takes the echo away."""

SENSORS = ("front", "rear")
TARGETS = ("asphalt", "concrete", "grass")
AIR = ("air_temperature_c", "target_temperature_c", "humidity_pct")
"""Contexts that the speed of sound depends on: at both ends of the path, and how humid it is there."""


@dataclass(frozen=True)
class Habits:
    """Of a vehicle with its sensor and reference: what is the same in a campaign with nothing hidden and in flight."""

    receiver: Receiver = STRONG
    reference_cm: float = 0.7
    """Standard deviation of the reference and of the sensor's place: legs give, lidar scatters."""
    tail_dof: float = 12.0
    """Of its Student distribution."""
    eddies_k: float = 0.8
    memory: float = 0.0
    """Correlation of that scatter from one reading to the next in a run."""
    run_offset_cm: float = 0.0
    misfire: float = 0.02
    obstruct: float = 0.02
    """Chance that something hangs or stands between sensor and ground."""
    obstruct_m: float = 1.2
    """Scale of its depth, a Weibull distribution of shape 1.1."""
    paralysed: float = 0.01
    """Chance that the amplifier locks up on a spike and reports when it recovers, at any time."""
    saturated: float = 0.2
    shroud_deg: float = 13.0
    """A tube about the sensor, which cuts the beam off sharply at this angle."""
    low_cm: float = 40.0
    high_cm: float = 380.0


def habits(regime: Regime) -> Habits:
    """What each noise regime is."""
    usual = Habits()
    return {
        "iid": usual,
        "ar1": replace(usual, memory=0.9),
        "run_offsets": replace(usual, run_offset_cm=0.4),
        "whole_centimetres": replace(usual, reference_cm=0.15, eddies_k=0.3),
        "drifting": usual,
        "heavy_outliers": replace(usual, misfire=0.08, obstruct=0.08, paralysed=0.04),
    }[regime]


@dataclass
class Flight:
    """Contexts, pings and the faults of codes on the way to the file."""

    columns: Columns
    ping: Ping
    habits: Habits
    believed_s_m: Array
    """Slowness with which the sensor turns time into centimetres."""
    clock: float = 1.0
    """Length of its tick, relative to what it should be."""
    codes: list[Callable[[Array], Array]] = field(default_factory=list)
    """What happens to readings between the sensor and the file, in order."""

    def __getitem__(self, name: str) -> NDArray[Any]:
        """A column of its contexts."""
        return self.columns[name]

    @property
    def rows(self) -> int:
        """Number of pings."""
        return len(self.ping.range_m)


def run_numbers(columns: Columns) -> NDArray[np.intp]:
    """The run of each row, as a number."""
    return np.unique(columns["run"], return_inverse=True)[1]


class _Runs:
    """Times of the readings of runs, and random courses through them."""

    def __init__(self, rng: Generator, runs: int, rows: int, step_s: float) -> None:
        self._rng, self.count = rng, runs
        self.run = np.repeat(np.arange(runs), rows)
        self.time_s = np.tile(np.arange(rows) * step_s, runs)
        self.span_s = rows * step_s
        self.drift = 2.0 * self.time_s / self.span_s - 1.0

    def each(self, values: Array) -> Array:
        """A value of each run, at each of its readings."""
        return values[self.run]

    def normal(self, mean: float, deviation: float) -> Array:
        """A normal one of each run."""
        return self.each(self._rng.normal(mean, deviation, self.count))

    def uniform(self, low: float, high: float) -> Array:
        """An even one of each run."""
        return self.each(self._rng.uniform(low, high, self.count))

    def wander(self, period_s: float, tones: int = 4) -> tuple[Array, Array]:
        """A smooth unit-variance wander in each run, and its rate of change."""
        value, rate = np.zeros(self.run.size), np.zeros(self.run.size)
        for _ in range(tones):
            omega = self.each(2.0 * np.pi / (period_s * self._rng.uniform(0.5, 2.0, self.count)))
            phase = self.uniform(0.0, 2.0 * np.pi)
            value += np.sin(omega * self.time_s + phase)
            rate += omega * np.cos(omega * self.time_s + phase)
        scale = np.sqrt(2.0 / tones)
        return value * scale, rate * scale


def contexts(rng: Generator, runs: int, rows: int, regime: Regime = "iid", step_s: float = 0.5) -> Columns:
    """Context columns of flights.

    Parameters
    ----------
    rng
        Source of randomness.
    runs, rows
        Flights, and readings in each.
    regime
        "drifting": temperature, humidity and range go one way through every flight.
    step_s
        Between two readings.
    """
    of = _Runs(rng, runs, rows, step_s)
    n, low_cm, high_cm = runs * rows, Habits.low_cm, Habits.high_cm
    true_cm, rate_cm_s = _ranges(of, rng, regime, low_cm, high_cm)
    wind, _ = of.wander(20.0)
    gust, _ = of.wander(5.0)
    load = of.normal(0.0, 0.04)
    throttle = np.clip(0.5 + load + 0.06 * wind + 0.05 * gust + 0.03 * rng.standard_normal(n), 0.05, 0.95)
    pitch, _ = of.wander(7.0)
    vibration = 30.0 + 70.0 * throttle + 6.0 * rng.standard_normal(n)
    uptime_s = of.uniform(0.0, 1200.0) + of.time_s
    day_c = of.normal(17.0, 8.0)
    warm, _ = of.wander(60.0)
    temperature = day_c + 0.6 * warm + 1.5 * (1.0 - np.exp(-uptime_s / 600.0))
    ground = temperature + of.normal(3.0, 5.0) + 0.5 * rng.standard_normal(n)
    humidity = 60.0 - 1.2 * (day_c - 17.0) + of.normal(0.0, 15.0) + 2.0 * warm
    if regime == "drifting":
        temperature += 4.0 * of.drift
        humidity -= 10.0 * of.drift
    segment = np.minimum((of.time_s / of.span_s * 3).astype(int), 2)
    over = rng.integers(0, len(TARGETS), (runs, 3))[of.run, segment]
    slot = rng.integers(0, 4, n)
    return {
        "time_s": of.time_s,
        "sensor": np.array(SENSORS)[rng.integers(0, 2, n)],
        "run": np.char.add("flight", np.char.zfill(of.run.astype(str), 3)),
        "true_range_cm": true_cm,
        "air_temperature_c": temperature,
        "target_temperature_c": ground,
        "humidity_pct": np.clip(humidity, 5.0, 99.0),
        "incidence_deg": 3.5 * pitch + 1.5 * wind,
        "range_rate_cm_s": rate_cm_s,
        "throttle": throttle,
        "vibration_hz": vibration,
        "uptime_s": uptime_s,
        "target": np.array(TARGETS)[over],
        "neighbour_lag_ms": np.choose(slot, (2.0, 4.0, 30.0, 60.0)) + rng.uniform(0.0, 1.0, n),
        "neighbour_range_cm": np.clip(true_cm + 12.0 * rng.standard_normal(n), low_cm, high_cm),
    }


def _ranges(of: _Runs, rng: Generator, regime: Regime, low_cm: float, high_cm: float) -> tuple[Array, Array]:
    """Ranges [cm], folded smoothly into the limits, with the rate of change that goes with it [cm/s]."""
    height, climb = of.wander(14.0)
    if regime == "drifting":
        sign = of.each(rng.choice((-1.0, 1.0), of.count))
        height, climb = 0.6 * height + 1.2 * sign * of.drift, 0.6 * climb + 1.2 * sign * (2.0 / of.span_s)
    middle_cm, reach_cm = 0.5 * (low_cm + high_cm), 0.5 * (high_cm - low_cm)
    u = (middle_cm + of.normal(0.0, 25.0) + 105.0 * height - middle_cm) / reach_cm
    return middle_cm + reach_cm * np.tanh(u), 105.0 * climb / np.cosh(u) ** 2


def fly(columns: Columns, ways: Habits, rng: Generator) -> Flight:
    """Stage the pings of flights with nothing hidden: a sensor that knows its air, over ground that mirrors."""
    true_cm = columns["true_range_cm"]
    n = true_cm.size
    near_c, far_c, humidity = (columns[each] for each in AIR)
    slowness = air.mean_slowness_s_m(near_c, far_c, humidity)
    run = run_numbers(columns)
    scatter = rng.standard_t(ways.tail_dof, n) / np.sqrt(ways.tail_dof / (ways.tail_dof - 2.0))
    if ways.memory > 0.0:
        scatter = _remember(scatter, run, ways.memory)
    offset = ways.run_offset_cm * rng.standard_normal(run.max() + 1)[run]
    ping = Ping(ways.receiver, (true_cm + ways.reference_cm * scatter + offset) / 100.0)
    ping.fade *= 0.5
    ping.temperature_c, ping.humidity_pct, ping.slowness_s_m = 0.5 * (near_c + far_c), humidity, slowness
    ping.off_axis_rad = np.radians(columns["incidence_deg"])
    ping.eddies_k[:] = ways.eddies_k
    ping.misfire[:] = ways.misfire
    ping.saturated = ways.saturated
    # Grass is mown short and counts as asphalt here: its coherent echo is an effect of its own.
    for word in TARGETS:
        ping.reflection_db[columns["target"] == word] = REFLECTION_DB["asphalt" if word == "grass" else word]
    behind = np.clip((np.abs(columns["incidence_deg"]) - ways.shroud_deg) / 0.05, -1.0, 1.0)
    ping.reflection_db -= 40.0 * (1.0 + behind)
    obstructed = rng.random(n) < ways.obstruct
    # Depth of a Weibull distribution of shape 1.1, given that it is before the ground.
    before = -np.expm1(-((np.maximum(true_cm - NEAREST_CM, 1.0) / 100.0 / ways.obstruct_m) ** 1.1))
    depth_m = ways.obstruct_m * (-np.log1p(-before * rng.random(n))) ** (1.0 / 1.1) + NEAREST_CM / 100.0
    ping.crossings_s.append(np.where(obstructed, 2.0 * depth_m * slowness, np.inf))
    recovers_s = rng.uniform(NEAREST_CM, NO_ECHO_CM, n) * ping.receiver.tick_s
    ping.locked_s = np.where(rng.random(n) < ways.paralysed, recovers_s, np.nan)
    return Flight(columns, ping, ways, slowness.copy())


def land(flight: Flight, rng: Generator) -> Array:
    """Readings of staged flights [cm]."""
    flight.ping.tick_s = 0.02 * flight.believed_s_m * flight.clock
    reading_cm = flight.ping.listen(rng)
    for fault in flight.codes:
        reading_cm = fault(reading_cm)
    return reading_cm


def _remember(scatter: Array, run: NDArray[np.intp], memory: float) -> Array:
    """First-order autoregression in each run, of the same variance."""
    out = np.empty_like(scatter)
    for each in range(run.max() + 1):
        (rows,) = np.nonzero(run == each)
        drawn = np.sqrt(1.0 - memory**2) * scatter[rows]
        drawn[0] = scatter[rows[0]]
        out[rows] = lfilter([1.0], [1.0, -memory], drawn)
    return out
