"""Context columns that follow from others, for tables of other people and models that require more than a table has.

A table of contexts enters; what can be computed leaves, with what it follows from.
"""

import math
from collections.abc import Callable, Collection, Mapping

import numpy as np

from msp_range.arrays import Array, Column, Indices, angle_deg, numbered
from msp_range.recording.export import neighbour_lags_ms
from msp_sim.effects.base import TRUE_RANGE
from msp_sim.model.history import History
from msp_sim.model.model import Model

_Columns = Mapping[str, Column]

PREVIOUS = "previous_reading_cm"
"""Column of the reading of the same sensor and run before this one [cm], which the intake of readings adds."""
CLOSEST_S = 1e-6
"""Rows of a sensor that are closer in time than this say nothing of a rate [s]; two stamps of one reading are."""
SLOPE_S = 0.1
"""Rows so long before and after one give the slope of the true range there [s]. Shorter, and the noise of the truth is
taken for motion: of 2 cm, 50 times a second, +-70 cm/s from neighbouring rows and +-14 from these. Longer flattens how
a vehicle moves up and down: sin(x)/x with x = 2 pi f 0.1 s, which is 2 % less at 0.5 Hz and 6 % at 1 Hz."""
FARTHEST_S = 1.0
"""A row without another one so near in time has no rate [s]: a vehicle turns round meanwhile, and in a campaign at a
bench the next place begins."""
LEAST_KNOWN = 0.5
"""A column is added that more than this share of the rows would have: ranges in random order have no rate, and a log
of one sensor has no neighbours. Lower: an effect that needs it is judged by few rows."""
LARGEST_CM_S2 = 2000.0
"""A range whose rate changes more quickly has jumped, at an edge of the ground or to the next place of a campaign, and
has no rate there. Vehicles reach half of it."""


def derived_columns(names: Collection[str], contexts: _Columns) -> tuple[dict[str, Column], dict[str, str]]:
    """Columns of these names that are absent or empty, and follow from others in most rows.

    The previous reading is not among them: it is drawn (`sample_in_order`).

    Returns
    -------
    columns : dict
        The columns to add to the contexts.
    sources : dict
        From what each was computed, in words.
    """
    columns, sources = {}, {}
    for name, (required, words, compute) in DERIVED.items():
        if name in names and _is_empty(contexts, name) and not any(_is_empty(contexts, one) for one in required):
            column = compute(contexts)
            if np.isfinite(column).mean() > LEAST_KNOWN:
                columns[name], sources[name] = column, words
    return columns, sources


def sample_in_order(model: Model, contexts: _Columns, seed: int) -> Array:
    """Draw one reading for each context, each after the one before it of the same sensor and run.

    Where a model uses the previous reading and the contexts lack it, it is the one that was drawn. The same random
    numbers are drawn again until no reading changes: a chain of repeated readings is complete after as many rounds as
    it is long.

    Parameters
    ----------
    model, contexts
        As for `Model.sample`.
    seed
        Random seed.
    """
    reading_cm = model.sample(contexts, np.random.default_rng(seed))
    if PREVIOUS not in model.columns or not _is_empty(contexts, PREVIOUS):
        return reading_cm
    before, _ = History.of(contexts, reading_cm.size, 0.0, 1.0).before(np.ones(reading_cm.size, dtype=bool))
    for _ in range(reading_cm.size):
        previous_cm = np.where(before >= 0, reading_cm[before], np.nan)
        drawn_cm = model.sample({**contexts, PREVIOUS: previous_cm}, np.random.default_rng(seed))
        if np.array_equal(drawn_cm, reading_cm):
            break
        reading_cm = drawn_cm
    return reading_cm


def _is_empty(columns: _Columns, name: str) -> bool:
    if name not in columns:
        return True
    column = columns[name]
    return not (np.isfinite(column) if column.dtype.kind == "f" else column != "").any()


def time_in_run_s(columns: _Columns) -> Array:
    """Time since the first row of the run [s]."""
    time_s: Array = np.asarray(columns["time_s"], dtype=np.float64)
    if "run" not in columns:
        return np.asarray(time_s - time_s.min())
    run = numbered(columns["run"])
    first_s = np.full(int(run.max(initial=0)) + 1, np.inf)
    np.minimum.at(first_s, run, time_s)
    return np.asarray(time_s - first_s[run])


def _incidence_deg(columns: _Columns) -> Array:
    """Angle between the vehicle's down axis and the vertical [deg]."""
    return tilt_deg(np.radians(columns["roll_deg"]), np.radians(columns["pitch_deg"]))


def tilt_deg(roll_rad: Array, pitch_rad: Array) -> Array:
    """Angle between the vehicle's down axis and straight down: its cosine is cos(roll) cos(pitch)."""
    return angle_deg(np.cos(roll_rad) * np.cos(pitch_rad))


def _range_rate_cm_s(columns: _Columns) -> Array:
    """Slope of the true range over the rows near in time, of the same sensor and run [cm/s]; NaN where it jumps."""
    range_cm, time_s = (np.asarray(columns[name], dtype=np.float64) for name in (TRUE_RANGE, "time_s"))
    words = [numbered(columns[name]) for name in ("run", "sensor") if name in columns]
    order = np.lexsort((time_s, *words))
    order = order[np.isfinite(range_cm[order])]
    starts = np.diff(time_s[order], prepend=-math.inf) > FARTHEST_S
    for each in words:
        starts[1:] |= np.diff(each[order]) != 0
    rate = np.full(range_cm.size, math.nan)
    for rows in np.split(order, np.flatnonzero(starts[1:]) + 1):
        rate[rows] = _slope_cm_s(time_s[rows], range_cm[rows])
    return rate


def _slope_cm_s(time_s: Array, range_cm: Array) -> Array:
    """Slope at each row between two rows as many before as after it, within `SLOPE_S` where there are such; at the ends
    between what there is."""
    place, last = np.arange(time_s.size), time_s.size - 1
    before = np.minimum(np.searchsorted(time_s, time_s - SLOPE_S - CLOSEST_S), np.maximum(place - 1, 0))
    after = np.maximum(np.searchsorted(time_s, time_s + SLOPE_S + CLOSEST_S) - 1, np.minimum(place + 1, last))
    rows = np.minimum(place - before, after - place)
    inner = (before > 0) & (after < last)
    before, after = np.where(inner, place - rows, before), np.where(inner, place + rows, after)

    def between(first: Indices, last: Indices) -> Array:
        apart_s = time_s[last] - time_s[first]
        return np.where(apart_s > CLOSEST_S, range_cm[last] - range_cm[first], math.nan) / np.maximum(
            apart_s, CLOSEST_S
        )

    half_s = (time_s[after] - time_s[before]) / 2.0
    jumps = np.abs(between(place, after) - between(before, place)) > LARGEST_CM_S2 * half_s
    return np.where(jumps, math.nan, between(before, after))


def _neighbour_lag_ms(columns: _Columns) -> Array:
    time_s = np.asarray(columns["time_s"], dtype=np.float64)
    runs = columns["run"] if "run" in columns else np.zeros(time_s.size)
    return neighbour_lags_ms(time_s, columns["sensor"].tolist(), runs)


DERIVED: dict[str, tuple[tuple[str, ...], str, Callable[[_Columns], Array]]] = {
    "time_in_run_s": (("time_s",), "time_s since the run's first row", time_in_run_s),
    "range_rate_cm_s": ((TRUE_RANGE, "time_s"), "true_range_cm over time_s", _range_rate_cm_s),
    "incidence_deg": (("roll_deg", "pitch_deg"), "roll_deg and pitch_deg, over level ground", _incidence_deg),
    "neighbour_lag_ms": (("time_s", "sensor"), "time_s of the other sensors' rows", _neighbour_lag_ms),
}
"""Column -> the columns from which it follows, in words, and how."""
