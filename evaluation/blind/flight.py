"""Flights for the blind tables: what a vehicle does, and readings of its sensors with nothing hidden.

Draws enter, context columns and a `Ping` leave. Contexts hang together as they do in the air: throttle with climb and
wind, tilt with throttle, vibration with throttle, humidity against temperature, heat with time in the sun.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from evaluation.blind import air
from evaluation.blind.ping import REFLECTION_DB, Ping
from evaluation.blind.receiver import NEAREST_CM, NO_ECHO_CM, Receiver
from evaluation.blind.sound import Array

Columns = dict[str, NDArray[np.generic]]
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

    def number(self, name: str) -> Array:
        """A column of numbers."""
        return np.asarray(self.columns[name], dtype=float)

    @property
    def rows(self) -> int:
        """Number of pings."""
        return len(self.ping.range_m)


def contexts(rng: np.random.Generator, runs: int, rows: int, regime: Regime = "iid", step_s: float = 0.5) -> Columns:
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
    n = runs * rows
    run = np.repeat(np.arange(runs), rows)
    t = np.tile(np.arange(rows) * step_s, runs)
    span_s = rows * step_s
    base = Habits()

    def per_run(values: Array) -> Array:
        return values[run]

    def wander(period_s: float, tones: int = 4) -> tuple[Array, Array]:
        """A smooth unit-variance wander in each run, and its rate of change."""
        value, rate = np.zeros(n), np.zeros(n)
        for _ in range(tones):
            omega = per_run(2.0 * np.pi / (period_s * rng.uniform(0.5, 2.0, runs)))
            phase = per_run(rng.uniform(0.0, 2.0 * np.pi, runs))
            value += np.sin(omega * t + phase)
            rate += omega * np.cos(omega * t + phase)
        scale = np.sqrt(2.0 / tones)
        return value * scale, rate * scale

    height, climb = wander(14.0)
    drift = 2.0 * t / span_s - 1.0
    slope = 2.0 / span_s
    if regime == "drifting":
        sign = per_run(rng.choice((-1.0, 1.0), runs))
        height, climb = 0.6 * height + 1.2 * sign * drift, 0.6 * climb + 1.2 * sign * slope
    middle = 0.5 * (base.low_cm + base.high_cm) + per_run(rng.normal(0.0, 25.0, runs))
    # Folded smoothly into the limits, with the rate of change that goes with it.
    reach = 0.5 * (base.high_cm - base.low_cm)
    u = (middle + 105.0 * height - 0.5 * (base.low_cm + base.high_cm)) / reach
    true_cm = 0.5 * (base.low_cm + base.high_cm) + reach * np.tanh(u)
    rate_cm_s = 105.0 * climb / np.cosh(u) ** 2

    wind, _ = wander(20.0)
    gust, _ = wander(5.0)
    load = per_run(rng.normal(0.0, 0.04, runs))
    throttle = np.clip(0.5 + load + 0.06 * wind + 0.05 * gust + 0.03 * rng.standard_normal(n), 0.05, 0.95)
    pitch, _ = wander(7.0)
    incidence = 3.5 * pitch + 1.5 * wind
    vibration = 30.0 + 70.0 * throttle + 6.0 * rng.standard_normal(n)
    started_s = per_run(rng.uniform(0.0, 1200.0, runs))
    day_c = per_run(rng.normal(17.0, 8.0, runs))
    warm, _ = wander(60.0)
    temperature = day_c + 0.6 * warm + 1.5 * (1.0 - np.exp(-(started_s + t) / 600.0))
    ground = temperature + per_run(rng.normal(3.0, 5.0, runs)) + 0.5 * rng.standard_normal(n)
    humidity = 60.0 - 1.2 * (day_c - 17.0) + per_run(rng.normal(0.0, 15.0, runs)) + 2.0 * warm
    if regime == "drifting":
        temperature += 4.0 * drift
        humidity -= 10.0 * drift
    segment = np.minimum((t / span_s * 3).astype(int), 2)
    over = rng.integers(0, len(TARGETS), (runs, 3))[run, segment]
    slot = rng.integers(0, 4, n)
    return {
        "time_s": t,
        "sensor": np.array(SENSORS)[rng.integers(0, 2, n)],
        "run": np.char.add("flight", np.char.zfill(run.astype(str), 3)),
        "true_range_cm": true_cm,
        "air_temperature_c": temperature,
        "target_temperature_c": ground,
        "humidity_pct": np.clip(humidity, 5.0, 99.0),
        "incidence_deg": incidence,
        "range_rate_cm_s": rate_cm_s,
        "throttle": throttle,
        "vibration_hz": vibration,
        "uptime_s": started_s + t,
        "target": np.array(TARGETS)[over],
        "neighbour_lag_ms": np.choose(slot, (2.0, 4.0, 30.0, 60.0)) + rng.uniform(0.0, 1.0, n),
        "neighbour_range_cm": np.clip(true_cm + 12.0 * rng.standard_normal(n), base.low_cm, base.high_cm),
    }


def fly(columns: Columns, ways: Habits, rng: np.random.Generator) -> Flight:
    """Stage the pings of flights with nothing hidden: a sensor that knows its air, over ground that mirrors."""

    def number(name: str) -> Array:
        return np.asarray(columns[name], dtype=float)

    true_cm = number("true_range_cm")
    n = true_cm.size
    near_c, far_c, humidity = number("air_temperature_c"), number("target_temperature_c"), number("humidity_pct")
    slowness = air.mean_slowness_s_m(near_c, far_c, humidity)
    run = np.unique(np.asarray(columns["run"]), return_inverse=True)[1]
    scatter = rng.standard_t(ways.tail_dof, n) / np.sqrt(ways.tail_dof / (ways.tail_dof - 2.0))
    if ways.memory > 0.0:
        scatter = _remember(scatter, run, ways.memory)
    offset = ways.run_offset_cm * rng.standard_normal(run.max() + 1)[run]
    ping = Ping(ways.receiver, (true_cm + ways.reference_cm * scatter + offset) / 100.0)
    ping.fade *= 0.5
    ping.temperature_c, ping.humidity_pct, ping.slowness_s_m = 0.5 * (near_c + far_c), humidity, slowness
    ping.off_axis_rad = np.radians(number("incidence_deg"))
    ping.eddies_k[:] = ways.eddies_k
    ping.misfire[:] = ways.misfire
    ping.saturated = ways.saturated
    words = np.asarray(columns["target"])
    # Grass is mown short and counts as asphalt here: its coherent echo is an effect of its own.
    for word in TARGETS:
        ping.reflection_db[words == word] = REFLECTION_DB["asphalt" if word == "grass" else word]
    behind = np.clip((np.abs(number("incidence_deg")) - ways.shroud_deg) / 0.05, -1.0, 1.0)
    ping.reflection_db = ping.reflection_db - 40.0 * (1.0 + behind)
    obstructed = rng.random(n) < ways.obstruct
    # Depth of a Weibull distribution of shape 1.1, given that it is before the ground.
    before = -np.expm1(-((np.maximum(true_cm - NEAREST_CM, 1.0) / 100.0 / ways.obstruct_m) ** 1.1))
    depth_m = ways.obstruct_m * (-np.log1p(-before * rng.random(n))) ** (1.0 / 1.1) + NEAREST_CM / 100.0
    ping.crossings_s.append(np.where(obstructed, 2.0 * depth_m * slowness, np.inf))
    recovers_s = rng.uniform(NEAREST_CM, NO_ECHO_CM, n) * ping.receiver.tick_s
    ping.locked_s = np.where(rng.random(n) < ways.paralysed, recovers_s, np.nan)
    return Flight(columns, ping, ways, slowness.copy())


def land(flight: Flight, rng: np.random.Generator) -> Array:
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
