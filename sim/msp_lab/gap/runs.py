"""How far readings of a run depend on each other, which reading came before which, and which ones are a sample of all.

A measure of dependence is computed from scores: with any dependence the unit of evidence is the run and not the
reading. The rows of a sample are chosen by their contexts.

Up to ten different splits by whole runs are drawn from the contexts before anything is looked at. Runs of similar
contexts are put into different parts: of two cold days none has both.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.special import chdtrc, ndtri, stdtrit

from msp_lab.gap import rules
from msp_lab.readings.intake import PREVIOUS
from msp_range.arrays import Array, Column, Flags, Indices, Texts
from msp_sim.effects.base import WORD_COLUMNS
from msp_sim.model.history import History

NO_CONTEXT = frozenset({"time_s", "reading_cm", PREVIOUS})
"""Columns that are no context of a reading."""
NO_STRATA = NO_CONTEXT | {"run"}
"""Columns by which runs are not compared."""


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
        if name not in NO_CONTEXT:
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


@dataclass(frozen=True)
class Splits:
    """Splits of the runs into parts, and the half on which the gap is measured."""

    runs: Texts
    """Name of each reading's run, or of its block where runs are few, (n,)."""
    names: Texts
    """Names of the runs, (runs,), sorted."""
    part: Indices
    """Number of each run's part, (splits, runs)."""
    measured: Flags
    """Whether the gap is measured on a run, (runs,)."""
    messages: tuple[str, ...]
    """What a reader has to know about them."""
    of_blocks: bool
    """Blocks of readings stand in for runs."""

    def __len__(self) -> int:
        return len(self.part)

    def take(self, rows: Flags) -> "Splits":
        """The splits of some of the readings."""
        return replace(self, runs=self.runs[rows])

    @cached_property
    def unit(self) -> Indices:
        """Number of each reading's run, (n,)."""
        return np.searchsorted(self.names, self.runs).astype(np.intp)

    @cached_property
    def held_out(self) -> Flags:
        """Readings on which the gap is measured, (n,)."""
        mask: Flags = self.measured[self.unit]
        return mask

    @property
    def training(self) -> Flags:
        """The other readings, (n,): what is left of the gap is measured with a fit of them alone."""
        return ~self.held_out

    @property
    def training_runs(self) -> tuple[str, ...]:
        """Names of the runs of the training readings."""
        return tuple(self.names[~self.measured].tolist())

    @property
    def held_out_runs(self) -> tuple[str, ...]:
        """Names of the other runs."""
        return tuple(self.names[self.measured].tolist())


def draw_splits(contexts: Mapping[str, Any], rng: np.random.Generator) -> Splits:
    """Draw splits of whole runs into parts that are alike.

    Parameters
    ----------
    contexts
        Columns; without runs, or with too few, consecutive readings are cut into blocks of equal length.
    rng
        Random generator.
    """
    n = contexts["true_range_cm"].size
    messages: list[str] = []
    runs = contexts["run"].astype(str) if "run" in contexts else np.full(n, "")
    names, unit = np.unique(runs, return_inverse=True)
    of_blocks = names.size < rules.MIN_RUNS
    if of_blocks:
        runs = _blocks(contexts, unit, names, n)
        messages.append(
            f"There {'is only 1 run' if names.size == 1 else f'are only {names.size} runs'}: blocks of consecutive "
            "readings are split instead, so what is constant within a run cannot be judged. Record four runs or more."
        )
        names, unit = np.unique(runs, return_inverse=True)
    means = _means_of_runs(contexts, unit, names.size)
    part = np.array(list(_different(_alike(means, rules.PARTS), names.size, rng)))
    (half,) = _different(_alike(means, 2), names.size, rng, most=1)
    if names.size < rules.WARN_RUNS and not of_blocks:
        messages.append(
            f"{names.size} runs are few: what is named is validated in {len(part)} split{'s' * (len(part) > 1)} of "
            f"them, and what differs from run to run is known from {names.size} numbers. An effect of it has to be "
            f"about {_dearer(names.size):.1f} times as large as with many runs. Record {rules.WARN_RUNS} runs or more."
        )
    return Splits(runs, names, part, half == 0, tuple(messages), of_blocks)


def _dearer(runs: int) -> float:
    """By how much more standard errors an effect between so few runs needs for the p-value of `rules.DEPENDENT_P`."""
    return float(stdtrit(max(runs - 2, 1), rules.DEPENDENT_P) / ndtri(rules.DEPENDENT_P))


def _blocks(contexts: Mapping[str, Any], unit: Indices, names: Texts, n: int) -> Texts:
    order = np.lexsort((contexts.get("time_s", np.arange(n)), unit))
    block = np.empty(n, dtype=np.int64)
    block[order] = np.arange(n) * min(rules.SPLIT_BLOCKS, max(n // 2, 1)) // max(n, 1)
    return np.array([f"{names[u] or 'all'}#{b:02d}" for u, b in zip(unit.tolist(), block.tolist(), strict=True)])


def _means_of_runs(contexts: Mapping[str, Any], unit: Indices, runs: int) -> Array:
    """Mean of each column in each run in standard deviations of its readings, and the logarithm of their number.

    What varies inside runs has nearly the same mean in each, so that what differs between runs decides who is alike.
    """
    counts = np.bincount(unit, minlength=runs)
    columns = [np.log(counts)]
    for name, values in contexts.items():
        if name in NO_STRATA:
            continue
        if name in WORD_COLUMNS:
            words = np.unique(values)[: rules.MAX_WORDS]
            columns += [np.bincount(unit, values == word, runs) / counts for word in words]
        elif values.dtype.kind == "f":
            known = np.isfinite(values)
            spread = float(values[known].std()) if known.any() else 0.0
            if spread > 0.0:
                about_mean = np.where(known, values - values[known].mean(), 0.0)
                columns.append(np.bincount(unit, about_mean, runs) / counts / spread)
    return np.stack(columns, axis=1)


def _alike(means: Array, most: int) -> list[Indices]:
    """Groups of so many runs that are alike, and one of those that are left; the most unusual run chooses first."""
    left = np.argsort(-((means - means.mean(axis=0)) ** 2).sum(axis=1), kind="stable")
    groups = []
    while left.size:
        apart = ((means[left] - means[left[0]]) ** 2).sum(axis=1)
        apart[0] = -1.0
        nearest = np.argsort(apart, kind="stable")
        groups.append(left[nearest[:most]])
        left = left[np.sort(nearest[most:])]
    return groups


def _different(
    groups: list[Indices], runs: int, rng: np.random.Generator, most: int = rules.SPLITS
) -> Iterator[Indices]:
    """The part of each run, for up to so many different splits that put the runs of a group into different parts."""
    parts, seen = groups[0].size, set()
    # Few runs allow few splits, each of which is drawn in so many turns all but certainly.
    for _ in range(rules.SPLITS**2):
        part = np.empty(runs, dtype=np.intp)
        for group in groups:
            part[group] = rng.permutation(parts)[: group.size]
        # Which part is called the first makes no difference.
        _, first, of_run = np.unique(part, return_index=True, return_inverse=True)
        key = tuple(np.argsort(np.argsort(first))[of_run].tolist())
        if key not in seen:
            seen.add(key)
            yield part
        if len(seen) == most:
            return
