"""Context columns that follow from others, for a table that lacks what a model requires.

A table of contexts and a model enter; the table with what can be computed leaves, with the reason for each column. A
model that the gap workflow has extended may require columns that only its intake made.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msp_sim.effects.base import TRUE_RANGE
from msp_sim.model.history import History
from msp_sim.model.model import Model

_Array = NDArray[np.float64]
_Columns = Mapping[str, NDArray[Any]]

PREVIOUS = "previous_reading_cm"
CLOSEST_S = 1e-6
"""Rows of a sensor that are closer in time than this say nothing of a rate [s]; two stamps of one reading are."""


def with_derived(model: Model, contexts: _Columns) -> tuple[dict[str, NDArray[Any]], dict[str, str]]:
    """Add the columns that a model uses, that are absent or empty, and that follow from others.

    The previous reading is not among them: it is drawn (`sample_in_order`).

    Returns
    -------
    columns : dict
        The contexts with the added columns.
    added : dict
        Each added column, and from what it was computed.
    """
    columns, added = dict(contexts), {}
    for name, (required, words, compute) in _DERIVED.items():
        if name in model.columns and _is_empty(columns, name) and not any(_is_empty(columns, one) for one in required):
            columns[name] = compute(columns)
            added[name] = words
    return columns, added


def sample_in_order(model: Model, contexts: _Columns, seed: int) -> _Array:
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


def time_in_run_s(columns: _Columns) -> _Array:
    """Time since the first row of the run [s]."""
    time_s: _Array = np.asarray(columns["time_s"], dtype=np.float64)
    if "run" not in columns:
        return np.asarray(time_s - time_s.min())
    _, run = np.unique(columns["run"], return_inverse=True)
    first_s = np.full(int(run.max(initial=0)) + 1, np.inf)
    np.minimum.at(first_s, run, time_s)
    return np.asarray(time_s - first_s[run])


def _incidence_deg(columns: _Columns) -> _Array:
    """Angle between the vehicle's down axis and the vertical [deg]."""
    roll, pitch = (np.radians(columns[name]) for name in ("roll_deg", "pitch_deg"))
    return np.asarray(np.degrees(np.arccos(np.clip(np.cos(roll) * np.cos(pitch), -1.0, 1.0))))


def _range_rate_cm_s(columns: _Columns) -> _Array:
    """Slope of the true range between the rows before and after, of the same sensor and run [cm/s]."""
    history = History.of(columns, len(columns[TRUE_RANGE]), 0.0, 1.0)
    range_cm = np.asarray(columns[TRUE_RANGE], dtype=np.float64)[history.order]
    place = np.arange(range_cm.size)
    same = history.series[1:] == history.series[:-1]
    before = np.where(np.append(False, same), place - 1, place)
    after = np.where(np.append(same, False), place + 1, place)
    apart_s = history.time_s[after] - history.time_s[before]
    rate = np.full(range_cm.size, math.nan)
    apart = apart_s > CLOSEST_S
    rate[history.order[apart]] = ((range_cm[after] - range_cm[before])[apart]) / apart_s[apart]
    return rate


def _neighbour_lag_ms(columns: _Columns) -> _Array:
    """Time since the last row of another sensor in the same run [ms]; NaN where there is none."""
    time_s, sensor = np.asarray(columns["time_s"], dtype=np.float64), columns["sensor"]
    run = columns["run"] if "run" in columns else np.full(time_s.size, "")
    order = np.lexsort((time_s, run))
    lag_ms = np.full(time_s.size, math.nan)
    last_s: dict[str, float] = {}
    here = None
    for row in order.tolist():
        if run[row] != here:
            here, last_s = run[row], {}
        others_s = [each for name, each in last_s.items() if name != sensor[row]]
        if others_s:
            lag_ms[row] = 1e3 * (time_s[row] - max(others_s))
        last_s[str(sensor[row])] = float(time_s[row])
    return lag_ms


_DERIVED: dict[str, tuple[tuple[str, ...], str, Callable[[_Columns], _Array]]] = {
    "time_in_run_s": (("time_s",), "time_s since the run's first row", time_in_run_s),
    "range_rate_cm_s": ((TRUE_RANGE, "time_s"), "true_range_cm over time_s", _range_rate_cm_s),
    "incidence_deg": (("roll_deg", "pitch_deg"), "roll_deg and pitch_deg, over level ground", _incidence_deg),
    "neighbour_lag_ms": (("time_s", "sensor"), "time_s of the other sensors' rows", _neighbour_lag_ms),
}
"""Column -> the columns from which it follows, in words, and how."""
