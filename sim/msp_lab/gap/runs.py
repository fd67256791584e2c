"""How far readings of a run depend on each other, which reading came before which, and which ones are a sample of all.

A measure of dependence is computed from scores: with any dependence the unit of evidence is the run and not the
reading. The rows of a sample are chosen by their contexts.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import chdtrc

from msp_lab.gap import rules
from msp_lab.readings.intake import PREVIOUS
from msp_range.arrays import Array, Column, Flags, Indices
from msp_sim.model.history import History

NO_PARTS = frozenset({"time_s", "reading_cm", PREVIOUS})
"""Columns that do not say where one part of a run ends and another begins."""


def places_in(unit: Indices) -> Indices:
    """Place of each reading among those of its unit, from 0, (n,)."""
    counts = np.bincount(unit)
    place = np.empty(unit.size, dtype=np.intp)
    place[np.argsort(unit, kind="stable")] = np.arange(unit.size) - np.repeat(np.cumsum(counts) - counts, counts)
    return place


def taken(columns: Mapping[str, Any], rows: Any) -> dict[str, Column]:
    """Some rows of all columns."""
    return {name: column[rows] for name, column in columns.items()}


def known_values(column: Column) -> Column:
    """The numbers or words of a column that are known."""
    return np.asarray(column[is_known(column)])


def is_known(column: Column) -> Flags:
    """Which numbers or words of a column are known, (n,)."""
    known: Flags = column != "" if column.dtype.kind == "U" else np.isfinite(column)
    return known


def share_between(values: Array, unit: Indices) -> float:
    """Share of the values' variance that lies between units; 0 where all are the same."""
    off = values - values.mean()
    whole = float((off**2).sum())
    counts = np.maximum(np.bincount(unit), 1)
    return float((np.bincount(unit, off) ** 2 / counts).sum()) / whole if whole > 0.0 else 0.0


@dataclass(frozen=True)
class Dependence:
    """How far readings of a run depend on each other."""

    lag_correlation: float
    """Correlation of the residual with the one before it, inside runs, about each run's mean."""
    between_run_share: float
    """Variance between runs beyond what independent readings show, as a share of the residuals' variance."""
    effective_readings: float
    """How many independent readings would say as much about a constant."""
    p_between: float
    """p-value of the variance between runs."""
    lag_z: float
    """The lag correlation in its standard errors."""

    @property
    def dependent(self) -> bool:
        """Readings depend on each other beyond random variation."""
        return self.p_between < rules.DEPENDENT_P or self.lag_z > rules.DEPENDENT_LAG_Z

    @property
    def independent(self) -> bool:
        """Nothing speaks against independent readings."""
        return self.p_between > rules.INDEPENDENT_P and self.lag_z < rules.INDEPENDENT_LAG_Z


def dependence(residual: Array, unit: Indices, time_s: Array | None = None) -> Dependence:
    """Measure dependence inside runs.

    Parameters
    ----------
    residual
        One number per reading with mean 0 and about equal variance: the score of the bias.
    unit
        Run of each reading, numbered.
    time_s
        Order inside runs; as they come where it is not known.
    """
    n = residual.size
    order = np.lexsort((np.arange(n) if time_s is None else time_s, unit))
    value, run = residual[order] - residual.mean(), unit[order]
    counts = np.maximum(np.bincount(run), 1)
    variance = float(np.mean(value**2)) or 1.0
    sums = np.bincount(run, value)
    statistic = float((sums**2 / (counts * variance)).sum())
    runs = np.unique(run).size
    p_between = float(chdtrc(max(runs - 1, 1), statistic))
    centred = value - (sums / counts)[run]
    same = run[1:] == run[:-1]
    pairs = max(int(same.sum()), 1)
    lag = float((centred[1:] * centred[:-1])[same].sum() / max(float((centred**2).sum()), 1e-12) * n / pairs)
    expected = -runs / max(n, 1)
    lag_z = float((lag - expected) * np.sqrt(pairs))
    mean_square = statistic / max(runs, 1)
    share = max(mean_square - 1.0, 0.0) / max(n / max(runs, 1), 1.0)
    return Dependence(lag, share, n / max(mean_square, 1.0), p_between, lag_z)


def reading_before(contexts: Mapping[str, Any], n: int) -> tuple[Indices, Array]:
    """Place of the reading before each of n, of the same sensor in the same run, and how long before, as `History`."""
    return History.of(contexts, n, 0.0, 1.0).before(np.ones(n, dtype=bool))


def previous(contexts: Mapping[str, Any], reading_cm: Array) -> Array:
    """The reading before each, of the same sensor in the same run; NaN for the first [cm]."""
    before, _ = reading_before(contexts, reading_cm.size)
    return np.where(before >= 0, reading_cm[before], np.nan)


def sample(
    contexts: Mapping[str, Any],
    rows: Indices,
    most: int,
    rng: np.random.Generator,
    stretch: int = rules.STRETCH,
) -> Indices:
    """At most so many of these rows: neighbours, from a place drawn at random in every part of every run.

    Every k-th reading would be no sample: what changes with a period of k is always the same in it. Stretches of
    neighbours keep what a reading shares with the one before. The parts are of equal length, and also end where a run,
    a sensor or a context that stays as it is for as long as a stretch ends, so that each has its share.
    """
    n = rows.size
    if n <= most:
        return rows
    columns = taken(contexts, rows)
    history = History.of(columns, n, 0.0, 1.0)
    starts = np.diff(history.series, prepend=-1) != 0
    starts[np.linspace(0, n, most // stretch, endpoint=False).astype(np.intp)] = True
    for name, column in columns.items():
        if name not in NO_PARTS:
            ordered = column[history.order]
            changes = np.flatnonzero(ordered[1:] != ordered[:-1]) + 1
            stays = np.diff(changes, prepend=0, append=n) >= stretch
            starts[changes[stays[1:] & stays[:-1]]] = True
    first = np.flatnonzero(starts)
    size = np.diff(first, append=n)
    drawn = np.diff(np.cumsum(size) * most // n, prepend=0)
    first += rng.integers(0, size - drawn, endpoint=True)
    some = np.repeat(first - np.cumsum(drawn) + drawn, drawn) + np.arange(drawn.sum())
    return np.sort(rows[history.order[some]])


def spacing_s(contexts: Mapping[str, Any]) -> float:
    """Median time between neighbouring readings of a sensor in a run [s]."""
    _, age_s = reading_before(contexts, contexts["true_range_cm"].size)
    steps_s = age_s[np.isfinite(age_s) & (age_s > 0.0)]
    return float(np.median(steps_s)) if steps_s.size else 1.0
