"""Pairs of effects that look alike in confounded contexts, and readings with one of them.

A seed enters, columns with readings leave; what is hidden is worked out from its physics here, without the product.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from random import Random
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.support.measured import sensor

Floats = NDArray[np.float64]
Columns = dict[str, Any]
RUNS, ROWS = 10, 120
"""Of the old readings."""
CALIBRATED_C, ZERO_K = 22.5, 273.15


def sound_m_s(celsius: Floats | float) -> Floats:
    """Speed of sound in dry air [m/s]."""
    return np.asarray(331.3 * np.sqrt(1.0 + np.asarray(celsius) / ZERO_K))


@dataclass(frozen=True)
class Hidden:
    """An effect: its name in the catalogue (empty: none of it), its size, and what it does.

    Attributes
    ----------
    bias, spread
        Functions of columns and size: centimetres, and a factor on the scatter.
    least, most
        Sizes are drawn between; the sign too where it may be negative.
    """

    name: str
    least: float
    most: float
    bias: Callable[[Columns, float], Any] = lambda columns, size: 0.0
    spread: Callable[[Columns, float], Any] = lambda columns, size: 1.0
    signed: bool = False


def _air(columns: Columns, share: float) -> Floats:
    ratio = sound_m_s(CALIBRATED_C) / sound_m_s(columns["air_temperature_c"])
    return np.asarray(share * columns["true_range_cm"] * (ratio - 1.0))


def _wrong_thermometer(columns: Columns, off_c: float) -> Floats:
    shown = columns["air_temperature_c"]
    return np.asarray(columns["true_range_cm"] * (sound_m_s(shown) / sound_m_s(shown - off_c) - 1.0))


def _colder_far_end(columns: Columns, share: float) -> Floats:
    near, far = sound_m_s(columns["air_temperature_c"]), sound_m_s(columns["target_temperature_c"])
    slowness = sound_m_s(CALIBRATED_C) * (2.0 / (near + far) - 1.0 / near)
    return np.asarray(share * columns["true_range_cm"] * slowness)


def _moves_meanwhile(columns: Columns, share: float) -> Floats:
    one_way_s = columns["true_range_cm"] / (100.0 * sound_m_s(columns["air_temperature_c"]))
    return np.asarray(share * columns["range_rate_cm_s"] * one_way_s)


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


def _nothing_varies_much(columns: Columns, rng: np.random.Generator) -> None:
    """One day: the air has one temperature."""
    columns["air_temperature_c"] = np.full(RUNS * ROWS, float(rng.choice((3.0, 6.0, 34.0, 38.0))))


def _usual_days(columns: Columns, rng: np.random.Generator) -> None:
    """Days from cold to warm."""
    columns["air_temperature_c"] = np.repeat(rng.normal(16.0, 8.0, RUNS), ROWS)


def _ground_as_warm(columns: Columns, rng: np.random.Generator) -> None:
    """The far end is as much off what the sensor assumes as the near end, as over dark ground."""
    near = np.repeat(rng.normal(CALIBRATED_C, 8.0, RUNS), ROWS)
    columns["air_temperature_c"], columns["target_temperature_c"] = near, near + 1.0 * (near - CALIBRATED_C)


def _one_height(columns: Columns, rng: np.random.Generator) -> None:
    """Up and down by little, at one height."""
    columns["true_range_cm"] = 220.0 + 4.0 * rng.standard_normal(RUNS * ROWS)


def _throttle_with_tilt(columns: Columns, rng: np.random.Generator) -> None:
    """Fast flight: the throttle is proportional to the tilt, as both are to the speed."""
    speed = rng.uniform(0.0, 1.0, RUNS * ROWS)
    columns["throttle"], columns["incidence_deg"] = speed, 10.0 * speed


def _shaken_where_turned(columns: Columns, rng: np.random.Generator) -> None:
    """The motor that turns the sensor shakes it."""
    turned = rng.random(RUNS * ROWS) < 0.5
    columns["incidence_deg"] = np.where(turned, 10.0, 0.0)
    columns["vibration_hz"] = np.where(turned, 60.0, 0.0)


def _steady_throttle(columns: Columns, rng: np.random.Generator) -> None:
    """A hover: the throttle hardly changes."""
    columns["throttle"] = 0.5 + 0.005 * rng.standard_normal(RUNS * ROWS)


@dataclass(frozen=True)
class Pair:
    """Two effects, and the contexts in which they look alike."""

    title: str
    effects: tuple[Hidden, Hidden]
    twist: Callable[[Columns, np.random.Generator], None]


PAIRS = (
    Pair("one temperature: air or scale", (AIR, SCALE), _nothing_varies_much),
    Pair("days: thermometer or scale", (THERMOMETER, SCALE), _usual_days),
    Pair("far end with near end: gradient or air", (GRADIENT, AIR), _ground_as_warm),
    Pair("one height: late or moving", (LATE, MOVES), _one_height),
    Pair("throttle with tilt: rotors or tilt", (LOUD, TILTED), _throttle_with_tilt),
    Pair("shaken where turned: vibration or tilt", (SHAKEN, TILTED), _shaken_where_turned),
    Pair("steady throttle: rotors or a worse sensor", (LOUD, WIDER), _steady_throttle),
)


def draw_case(seed: int, number: int) -> tuple[Pair, Hidden, float, Columns]:
    """A pair, which of the two is hidden and how large, and the old readings. The numbers go round the pairs."""
    rng = np.random.default_rng([seed, number])
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
    chance, rng = Random(seed), np.random.default_rng(seed)
    known = dict(columns)
    known.setdefault("throttle", np.zeros(np.size(columns["true_range_cm"])))
    known.setdefault("vibration_hz", np.zeros(np.size(columns["true_range_cm"])))
    names, unit = np.unique(np.asarray(columns["run"]), return_inverse=True)
    known["true_range_cm"] = columns["true_range_cm"] + placed_cm * rng.standard_normal(names.size)[unit]
    size_of = np.broadcast_to
    bias = size_of(hidden.bias(known, size), unit.shape)
    spread = size_of(hidden.spread(known, size), unit.shape)
    usual = sensor()
    readings = [
        replace(usual, offset_cm=float(off), sigma_cm=usual.sigma_cm * float(times)).reading(float(true_cm), chance)
        if np.isfinite(true_cm)
        else float("nan")
        for true_cm, off, times in zip(known["true_range_cm"], bias, spread, strict=True)
    ]
    return {**columns, "reading_cm": np.array(readings)}
