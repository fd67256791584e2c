"""Pairs of effects that look alike in confounded contexts, and readings with one of them.

A seed enters, columns with readings leave; what is hidden is worked out from its physics here, without the product.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from random import Random
from typing import Any

import numpy as np
from numpy.random import Generator, default_rng
from numpy.typing import NDArray

from tests.support.measured import sensor

Floats = NDArray[np.floating[Any]]
Columns = dict[str, Any]
RUNS, ROWS = 10, 120
"""Of the old readings."""
CALIBRATED_C, ZERO_K = 22.5, 273.15
HEIGHT_CM, LAG_MS = 220.0, 3.0
STRUT_CM = HEIGHT_CM - 51.7
"""Where the echo of a ping that a neighbour sent `LAG_MS` earlier seems to be, at 345 m/s."""
FALSE_CM = 2.0
"""Scatter of a false echo."""


def sound_m_s(celsius: Floats | float) -> Floats:
    """Speed of sound in dry air [m/s]."""
    return 331.3 * np.sqrt(1.0 + np.asarray(celsius) / ZERO_K)


@dataclass(frozen=True)
class Hidden:
    """An effect: its name in the catalogue (empty: none of it), its size, and what it does."""

    name: str
    least: float
    most: float
    """Sizes are drawn between; the sign too where it may be negative."""
    bias: Callable[[Columns, float], Any] = lambda columns, size: 0.0
    spread: Callable[[Columns, float], Any] = lambda columns, size: 1.0
    shorts: Callable[[Columns, float], Any] = lambda columns, size: 1.0
    """Functions of columns and size: centimetres, and factors on the scatter and on the odds of a short reading."""
    false: Callable[[Columns, float], tuple[Any, Any]] = lambda columns, size: (0.0, 0.0)
    """Function of columns and size: share of the echoes that are another one, and where that is [cm]."""
    signed: bool = False


def _air(columns: Columns, share: float) -> Floats:
    ratio = sound_m_s(CALIBRATED_C) / sound_m_s(columns["air_temperature_c"])
    found: Floats = share * columns["true_range_cm"] * (ratio - 1.0)
    return found


def _wrong_thermometer(columns: Columns, off_c: float) -> Floats:
    shown = columns["air_temperature_c"]
    found: Floats = columns["true_range_cm"] * (sound_m_s(shown) / sound_m_s(shown - off_c) - 1.0)
    return found


def _colder_far_end(columns: Columns, share: float) -> Floats:
    near, far = sound_m_s(columns["air_temperature_c"]), sound_m_s(columns["target_temperature_c"])
    slowness = sound_m_s(CALIBRATED_C) * (2.0 / (near + far) - 1.0 / near)
    found: Floats = share * columns["true_range_cm"] * slowness
    return found


def _moves_meanwhile(columns: Columns, share: float) -> Floats:
    one_way_s = columns["true_range_cm"] / (100.0 * sound_m_s(columns["air_temperature_c"]))
    found: Floats = share * columns["range_rate_cm_s"] * one_way_s
    return found


def _neighbours_echo(columns: Columns, share: float) -> tuple[Floats, Floats]:
    """The ping of a neighbour was sent earlier, so that its echo seems nearer by the way of that time."""
    lag_s = np.asarray(columns.get("neighbour_lag_ms", np.nan)) / 1000.0
    range_cm = np.asarray(columns["neighbour_range_cm" if "neighbour_range_cm" in columns else "true_range_cm"])
    seen_cm = range_cm - 100.0 * sound_m_s(CALIBRATED_C) * lag_s / 2.0
    return np.where(seen_cm > 20.0, share, 0.0), seen_cm


def _fixed_object(columns: Columns, share: float) -> tuple[Floats, Floats]:
    """A strut at the edge of the beam, seen where nothing is nearer."""
    return np.where(columns["true_range_cm"] > STRUT_CM, share, 0.0), np.full(
        np.shape(columns["true_range_cm"]), STRUT_CM
    )


SCALE = Hidden("range_scale", 1.0, 3.0, lambda c, size: size / 100.0 * c["true_range_cm"], signed=True)
AIR = Hidden("air_temperature", 0.5, 1.1, _air)
THERMOMETER = Hidden("thermometer_offset", 6.0, 15.0, _wrong_thermometer, signed=True)
GRADIENT = Hidden("temperature_gradient", 0.7, 1.3, _colder_far_end)
LATE = Hidden("latency", 15.0, 40.0, lambda c, size: -size / 1000.0 * c["range_rate_cm_s"])
MOVES = Hidden("motion_during_ping", 1.0, 1.9, _moves_meanwhile)
LOUD = Hidden("rotor_noise", 1.0, 2.5, spread=lambda c, size: 1.0 + size * c["throttle"])
TILTED = Hidden("spread_with_incidence", 0.5, 1.2, spread=lambda c, size: 1.0 + size * np.abs(c["incidence_deg"]) / 10)
SHAKEN = Hidden("vibration", 0.4, 1.0, spread=lambda c, size: np.where(c["vibration_hz"] > 0.0, 1.0 + size, 1.0))
WIDER = Hidden("", 1.3, 1.8, spread=lambda c, size: size)

WASH = Hidden("prop_wash", 2.0, 4.0, shorts=lambda c, size: np.exp(size * c["throttle"]))
OBJECTS = Hidden("", 3.0, 6.0, shorts=lambda c, size: size)
NEIGHBOUR = Hidden("crosstalk", 0.1, 0.3, false=_neighbours_echo)
STRUT = Hidden("clutter", 0.1, 0.3, false=_fixed_object)


def _nothing_varies_much(columns: Columns, rng: Generator) -> None:
    """One day: the air has one temperature."""
    columns["air_temperature_c"] = np.full(RUNS * ROWS, float(rng.choice((3.0, 6.0, 34.0, 38.0))))


def _usual_days(columns: Columns, rng: Generator) -> None:
    """Days from cold to warm."""
    columns["air_temperature_c"] = np.repeat(rng.normal(16.0, 8.0, RUNS), ROWS)


def _ground_as_warm(columns: Columns, rng: Generator) -> None:
    """The far end is as much off what the sensor assumes as the near end, as over dark ground."""
    near = np.repeat(rng.normal(CALIBRATED_C, 8.0, RUNS), ROWS)
    columns["air_temperature_c"], columns["target_temperature_c"] = near, near + 1.0 * (near - CALIBRATED_C)


def _one_height(columns: Columns, rng: Generator) -> None:
    """Up and down by little, at one height."""
    columns["true_range_cm"] = 220.0 + 4.0 * rng.standard_normal(RUNS * ROWS)


def _throttle_with_tilt(columns: Columns, rng: Generator) -> None:
    """Fast flight: the throttle is proportional to the tilt, as both are to the speed."""
    speed = rng.uniform(0.0, 1.0, RUNS * ROWS)
    columns["throttle"], columns["incidence_deg"] = speed, 10.0 * speed


def _shaken_where_turned(columns: Columns, rng: Generator) -> None:
    """The motor that turns the sensor shakes it."""
    turned = rng.random(RUNS * ROWS) < 0.5
    columns["incidence_deg"] = np.where(turned, 10.0, 0.0)
    columns["vibration_hz"] = np.where(turned, 60.0, 0.0)


def _steady_throttle(columns: Columns, rng: Generator) -> None:
    """A hover: the throttle hardly changes."""
    columns["throttle"] = 0.5 + 0.005 * rng.standard_normal(RUNS * ROWS)


def _hover_with_neighbour(columns: Columns, rng: Generator) -> None:
    """A hover at one height, each ping after one of the neighbour."""
    columns["true_range_cm"] = HEIGHT_CM + 0.8 * rng.standard_normal(RUNS * ROWS)
    columns["neighbour_range_cm"] = columns["true_range_cm"].copy()
    columns["neighbour_lag_ms"] = np.full(RUNS * ROWS, LAG_MS)


@dataclass(frozen=True)
class Pair:
    """Two effects, the contexts in which they look alike, and what a person would vary to see them apart."""

    title: str
    effects: tuple[Hidden, Hidden]
    twist: Callable[[Columns, Generator], None]
    """As it says."""
    between: Mapping[str, tuple[float, ...]]
    """Columns that differ from run to run, with their levels."""
    within: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    """Columns that vary inside a run: in flight, or none at a bench, where each placement is a run."""


RANGES: dict[str, tuple[float, ...]] = {"true_range_cm": (60.0, 120.0, 200.0, 300.0, 400.0)}
AIRS: dict[str, tuple[float, ...]] = {"air_temperature_c": (0.0, 20.0, 40.0)}
HEIGHTS: dict[str, tuple[float, ...]] = {"true_range_cm": (100.0, 220.0, 360.0)}
THROTTLES: dict[str, tuple[float, ...]] = {"throttle": (0.2, 0.5, 0.8)}


PAIRS = (
    Pair("one temperature: air or scale", (AIR, SCALE), _nothing_varies_much, RANGES | AIRS),
    Pair("days: thermometer or scale", (THERMOMETER, SCALE), _usual_days, {"air_temperature_c": (2.0, 32.0)}, HEIGHTS),
    Pair(
        "far end with near end: gradient or air",
        (GRADIENT, AIR),
        _ground_as_warm,
        RANGES | {"air_temperature_c": (20.0, 40.0), "target_temperature_c": (20.0, 40.0)},
    ),
    Pair(
        "one height: late or moving",
        (LATE, MOVES),
        _one_height,
        {},
        HEIGHTS | {"range_rate_cm_s": (-100.0, -50.0, 0.0, 50.0, 100.0)},
    ),
    Pair(
        "throttle with tilt: rotors or tilt",
        (LOUD, TILTED),
        _throttle_with_tilt,
        {},
        THROTTLES | {"incidence_deg": (0.0, 5.0, 10.0)},
    ),
    Pair(
        "shaken where turned: vibration or tilt",
        (SHAKEN, TILTED),
        _shaken_where_turned,
        {"vibration_hz": (0.0, 50.0), "incidence_deg": (0.0, 12.0)},
    ),
    Pair("steady throttle: rotors or a worse sensor", (LOUD, WIDER), _steady_throttle, {}, THROTTLES),
    Pair("steady throttle: rotors' wash or objects", (WASH, OBJECTS), _steady_throttle, {}, THROTTLES),
    Pair("hover: a neighbour's echo or a strut", (NEIGHBOUR, STRUT), _hover_with_neighbour, RANGES),
)


def draw_case(seed: int, number: int) -> tuple[Pair, Hidden, float, Columns]:
    """A pair, which of the two is hidden and how large, and the old readings. The numbers go round the pairs."""
    rng = default_rng([seed, number])
    pair = PAIRS[number % len(PAIRS)]
    hidden = pair.effects[int(rng.integers(2))]
    size = float(rng.uniform(hidden.least, hidden.most))
    if hidden.signed and rng.random() < 0.5:
        size = -size
    index = np.arange(RUNS * ROWS)
    phase = np.repeat(rng.uniform(0.0, 6.3, RUNS), ROWS)
    time_s = 0.4 * (index % ROWS)
    columns: Columns = {
        "time_s": time_s,
        "sensor": np.full(index.size, "down"),
        "run": np.array([f"day{each:02d}" for each in index // ROWS]),
        "true_range_cm": 200.0 + 110.0 * np.sin(time_s / 4.0 + phase),
        "range_rate_cm_s": 60.0 * np.sin(time_s / 1.7 + 2.0 * phase),
        "air_temperature_c": np.full(index.size, CALIBRATED_C),
    }
    pair.twist(columns, rng)
    return pair, hidden, size, with_readings(columns, hidden, size, int(rng.integers(2**31)), 0.0)


def with_readings(columns: Mapping[str, Any], hidden: Hidden, size: float, seed: int, placed_cm: float) -> Columns:
    """The columns with readings of a sensor with this effect.

    Parameters
    ----------
    columns
        True ranges and contexts.
    hidden, size, seed
        What is drawn.
    placed_cm
        Standard deviation of an error of the true range that is common to a run: the placement of a target.
    """
    chance, rng = Random(seed), default_rng(seed)
    known = dict(columns)
    known.setdefault("throttle", np.zeros(np.size(columns["true_range_cm"])))
    known.setdefault("vibration_hz", np.zeros(np.size(columns["true_range_cm"])))
    names, unit = np.unique(np.asarray(columns["run"]), return_inverse=True)
    known["true_range_cm"] = columns["true_range_cm"] + placed_cm * rng.standard_normal(names.size)[unit]
    share, seen_cm = hidden.false(known, size)
    changes = (hidden.bias(known, size), hidden.spread(known, size), hidden.shorts(known, size), share, seen_cm)
    usual = sensor()
    readings = []
    rows = np.broadcast_arrays(known["true_range_cm"], *changes)
    for true_cm, off, times, more, false, false_cm in zip(*(each.tolist() for each in rows), strict=True):
        own = replace(usual, offset_cm=off, sigma_cm=usual.sigma_cm * times, short=usual.short * more)
        if false and chance.random() < false:
            # Another echo in place of the own one, which the sensor rounds as any other.
            true_cm, own = false_cm, replace(own, sigma_cm=FALSE_CM, hit=1.0, short=0.0, missed=0.0, random=0.0)
        readings.append(own.reading(true_cm, chance) if np.isfinite(true_cm) else float("nan"))
    return {**columns, "reading_cm": np.array(readings)}
