"""Context columns that follow from others, for tables of other people and models that require more than a table has.

Columns that can be computed are added to a table of contexts, with what each follows from.
"""

import math
from collections.abc import Callable, Collection, Mapping

import numpy as np

from msp_range.arrays import Array, Column, angle_deg, numbered
from msp_range.recording.export import neighbour_lags_ms
from msp_sim.effects.base import TRUE_RANGE
from msp_sim.effects.path import ReferencePath
from msp_sim.model.history import History
from msp_sim.model.model import Model

_Columns = Mapping[str, Column]

TIME_OF_DAY = "time_of_day_h"
PREVIOUS = "previous_reading_cm"
"""Column of the reading of the same sensor and run before this one [cm], which the intake of readings adds."""
LEAST_KNOWN = 0.5
"""A column is added that more than this share of the rows would have: ranges in random order have no rate, and a log
of one sensor has no neighbours. Lower: an effect that needs it is judged by few rows."""
DAY_S = 86_400.0
SHORTEST_DAYS = 1.5
"""Times over which a time of day is added [days]: within one day what comes with the hour is a drift. Longer leaves out
tables of two days."""


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
    time_s = columns["time_s"]
    if "run" not in columns:
        return np.asarray(time_s - time_s.min())
    run = numbered(columns["run"])
    first_s = np.full(int(run.max(initial=0)) + 1, np.inf)
    np.minimum.at(first_s, run, time_s)
    return np.asarray(time_s - first_s[run])


def _time_of_day_h(columns: _Columns) -> Array:
    """Hours since the last midnight of the table's clock, of which the zone is not known; NaN in tables of a day."""
    time_s = columns["time_s"]
    known = np.ptp(time_s[np.isfinite(time_s)]) >= SHORTEST_DAYS * DAY_S
    return time_s % DAY_S / 3600.0 if known else np.full(time_s.size, math.nan)


def _incidence_deg(columns: _Columns) -> Array:
    """Angle between the vehicle's down axis and the vertical [deg]."""
    return tilt_deg(np.radians(columns["roll_deg"]), np.radians(columns["pitch_deg"]))


def tilt_deg(roll_rad: Array, pitch_rad: Array) -> Array:
    """Angle between the vehicle's down axis and straight down: its cosine is cos(roll) cos(pitch)."""
    return angle_deg(np.cos(roll_rad) * np.cos(pitch_rad))


def _range_rate_cm_s(columns: _Columns) -> Array:
    """Rate of the true range along its path [cm/s]; NaN where it is on none."""
    path = ReferencePath.of(columns)
    return np.full(columns[TRUE_RANGE].size, math.nan) if path is None else path.rate


def _neighbour_lag_ms(columns: _Columns) -> Array:
    time_s = columns["time_s"]
    runs = columns["run"] if "run" in columns else np.zeros(time_s.size)
    return neighbour_lags_ms(time_s, columns["sensor"].tolist(), runs)


DERIVED: dict[str, tuple[tuple[str, ...], str, Callable[[_Columns], Array]]] = {
    "time_in_run_s": (("time_s",), "time_s since the run's first row", time_in_run_s),
    TIME_OF_DAY: (("time_s",), "time_s, whose first midnight is at 0", _time_of_day_h),
    "range_rate_cm_s": ((TRUE_RANGE, "time_s"), "true_range_cm over time_s", _range_rate_cm_s),
    "incidence_deg": (("roll_deg", "pitch_deg"), "roll_deg and pitch_deg, over level ground", _incidence_deg),
    "neighbour_lag_ms": (("time_s", "sensor"), "time_s of the other sensors' rows", _neighbour_lag_ms),
}
"""Column -> the columns from which it follows, in words, and how."""
