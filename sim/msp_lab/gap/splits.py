"""Splits of the runs into parts, each of which validates what a fit of the others says.

Up to ten different splits by whole runs are drawn from the contexts before anything is looked at. Runs of similar
contexts are put into different parts: of two cold days none has both.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from msp_lab.gap import rules
from msp_range.arrays import Array, Flags, Indices, Texts
from msp_sim.effects.base import WORD_COLUMNS

NO_STRATA = frozenset({"time_s", "reading_cm", "previous_reading_cm", "run"})
"""Columns by which runs are not compared."""


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
    messages: tuple[str, ...] = ()
    """What a reader has to know about them."""
    of_blocks: bool = False
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
    from scipy.special import ndtri, stdtrit

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
