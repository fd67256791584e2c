"""What a fit without one part of the runs says of that part, from sums by run.

Log-likelihood, scores and information are summed by run once; the fit without a part, and what it says of that part,
then follow by one Newton step and a quadratic, so that a split costs no pass over the readings. Where the step is too
large for a quadratic, the other runs are fitted, and the likelihood is taken as it is.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from msp_lab.gap import rules
from msp_lab.gap.prepared import BASE, Prepared
from msp_lab.gap.problem import Problem
from msp_lab.gap.refit import JointFit, inverse, refit
from msp_lab.gap.splits import Splits
from msp_range.arrays import Array, Flags, Indices
from msp_range.reading_model.rows import Base


@dataclass(frozen=True)
class Parts:
    """The readings that are refitted, part by part."""

    problem: Problem
    """The problem with these readings."""
    splits: Splits
    """Splits of their runs."""
    prepared: dict[tuple[int, int, bool], Prepared] = field(default_factory=dict)
    """Readings of a part, as far as they have been asked for."""

    @property
    def ways(self) -> list[tuple[int, int]]:
        """Each split, and which of its parts is left out of the fit."""
        return [(k, part) for k, parts in enumerate(self.splits.part) for part in range(int(parts.max()) + 1)]

    def runs(self, split: int, part: int) -> Flags:
        """Runs of a part, (runs,)."""
        mask: Flags = self.splits.part[split] == part
        return mask

    def readings(self, split: int, part: int, fitted: bool) -> Prepared:
        """Readings of a part, or those that are fitted without it."""
        if (split, part, fitted) not in self.prepared:
            mask = (self.runs(split, part) ^ fitted)[self.problem.unit]
            self.prepared[split, part, fitted] = self.problem.readings.take(mask)
        return self.prepared[split, part, fitted]


@dataclass(frozen=True)
class CrossScore:
    """What a fit without one part says of that part's readings."""

    by_run: Array
    """Log-likelihood of each run of the part, (runs,); 0 for the others."""
    base: Base
    """Changes of the base that were fitted."""
    slope: Array
    information: Array
    """Slope and information of the log-likelihood of each run by the base's numbers, (runs, 8) and (runs, 8, 8); 0 for
    the others, and for numbers that cannot move."""


def recalibrated(parts: Sequence[CrossScore], runs: Flags) -> float:
    """Log-likelihood of runs of these parts, if one base is fitted to all of them and the effects stay as they are."""
    prior = 1.0 / np.square(rules.BASE_DEVIATION)
    information = np.array([each.information[runs].sum(axis=0) for each in parts])
    slope = np.array([each.slope[runs].sum(axis=0) for each in parts])
    fitted = np.array([each.base for each in parts])
    whole = information.sum(axis=0)
    prior = np.where(np.diag(whole) > 0.0, prior, 0.0)
    base = inverse(whole + np.diag(prior)) @ (slope + np.einsum("kij,kj->ki", information, fitted)).sum(axis=0)
    moved = base - fitted
    # Without what the priors take: an effect may move the base by more than they expect.
    gained = (slope * moved).sum() - 0.5 * np.einsum("ki,kij,kj->", moved, information, moved)
    return float(sum(each.by_run[runs].sum() for each in parts) + gained)


@dataclass(frozen=True)
class SumsByRun:
    """A fit of all readings with its log-likelihood, scores and information summed by run."""

    fit: JointFit
    """The fit of all readings."""
    unit: Indices
    """Number of each reading's run."""
    runs: int
    """How many runs there are."""

    @cached_property
    def free(self) -> Indices:
        """Places of the numbers that can move; those of the base of which few readings speak stay as they are."""
        few = self._speaking < rules.MIN_SPEAKING
        few[len(BASE) :] = False
        return np.flatnonzero(~(self.fit.at.held | few))

    @cached_property
    def _speaking(self) -> Array:
        """How many readings speak of each number: the squared sum of squared scores over that of fourth powers."""
        squares = self.fit.at.scores**2
        return np.asarray(squares.sum(axis=0) ** 2 / np.maximum((squares**2).sum(axis=0), 1e-300))

    @cached_property
    def _sums(self) -> tuple[Array, Array]:
        return _sums(self.fit.at.scores[:, self.free], self.unit, self.runs)

    @property
    def score(self) -> Array:
        """(runs, numbers)."""
        return self._sums[0]

    @property
    def information(self) -> Array:
        """(runs, numbers, numbers)."""
        return self._sums[1]

    @cached_property
    def prior(self) -> tuple[Array, Array]:
        """Slope and information of the priors."""
        whole, of_readings = (
            np.diag(self.fit.at.information)[self.free],
            (self.fit.at.scores[:, self.free] ** 2).sum(axis=0),
        )
        # Rounding is no prior: a number of which the other runs say nothing would go to 0 by it.
        own = np.where(whole - of_readings > 1e-9 * whole, whole - of_readings, 0.0)
        return -own * self.fit.values[self.free], own

    def learnt(self, left_out: Flags, numbers: Sequence[str]) -> Array:
        """What a fit without these runs knows of what the numbers do in each run, as a share of what all know, (runs,).

        Variances of it with all other numbers free, on average over the readings.
        """
        own = np.isin(np.array(self.fit.names)[self.free], numbers)
        if not own.any():
            return np.ones(self.runs)
        everywhere = self._known(np.ones(self.runs, dtype=bool), own)
        least = 1e-6 * np.diag(np.diag(everywhere))
        in_runs = self.information[:, own][:, :, own]
        variances = [
            np.einsum("ij,rji->r", inverse(each + least), in_runs) for each in (everywhere, self._known(~left_out, own))
        ]
        known, without = variances
        share: Array = np.where(without > 0.0, known / np.where(without > 0.0, without, 1.0), 1.0)
        return share

    def _known(self, runs: Flags, own: Flags) -> Array:
        """Information of these runs about some of the free numbers, with all others free."""
        whole = self.information[runs].sum(axis=0) + np.diag(self.prior[1])
        cross = whole[np.ix_(own, ~own)]
        known: Array = whole[np.ix_(own, own)] - cross @ inverse(whole[np.ix_(~own, ~own)]) @ cross.T
        return known

    def step(self, runs: Flags) -> Array:
        """By how much the fit of these runs differs from that of all; what would leave its bounds stays at one."""
        slope = self.score[runs].sum(axis=0) + self.prior[0]
        information = self.information[runs].sum(axis=0) + np.diag(self.prior[1])
        least, most = (bound[self.free] - self.fit.values[self.free] for bound in self.fit.bounds)
        step: Array = inverse(information) @ slope
        beyond = (step < least) | (step > most)
        step = np.clip(step, least, most)
        if beyond.any():
            slope = slope[~beyond] - information[np.ix_(~beyond, beyond)] @ step[beyond]
            step[~beyond] = np.clip(
                inverse(information[np.ix_(~beyond, ~beyond)]) @ slope, least[~beyond], most[~beyond]
            )
        return step

    def tells(self, left_out: Flags, step: Array) -> bool:
        """Whether a quadratic about the fit of all runs says what the fit without some of them does."""
        if np.any(self._speaking[self.free] < rules.MIN_SPEAKING):
            return False
        prior = 0.5 * float(self.prior[1] @ step**2)
        lost = [0.5 * float(step @ self.information[runs].sum(axis=0) @ step) for runs in (left_out, ~left_out)]
        return max(lost[0], lost[1] + prior) < rules.EXPANSION_NATS * self.free.size

    def crossed(self, parts: Parts, split: int, part: int, step: Array) -> CrossScore:
        """What the fit without a part says of its readings, by the quadratic."""
        left_out = parts.runs(split, part)
        information = self.information[left_out]
        lost = 0.5 * np.einsum("i,rij,j->r", step, information, step)
        score = self.score[left_out]
        by_run = np.zeros(self.runs)
        by_run[left_out] = self.log_p_by_run[left_out] + score @ step - lost
        moved = self.free < len(BASE)
        base = np.array(self.fit.base)
        base[self.free[moved]] += step[moved]
        slope = (score - information @ step)[:, moved]
        return self._cross_score(left_out, by_run, Base(*base), slope, information[:, moved][:, :, moved])

    @cached_property
    def log_p_by_run(self) -> Array:
        """Log-likelihood of each run, (runs,)."""
        return np.bincount(self.unit, self.fit.here.log_p, self.runs).astype(np.float64)

    def _cross_score(self, runs: Flags, by_run: Array, base: Base, slope: Array, information: Array) -> CrossScore:
        """With slopes and information of a part's runs by those numbers of the base that can move, put in place."""
        free = self.free[self.free < len(BASE)]
        of_base, of_pairs = np.zeros((self.runs, len(BASE))), np.zeros((self.runs, len(BASE), len(BASE)))
        of_base[np.ix_(runs, free)], of_pairs[np.ix_(runs, free, free)] = slope, information
        return CrossScore(by_run, base, of_base, of_pairs)

    def along(self, parts: Parts, split: int, part: int) -> CrossScore:
        """The likelihood by a fit without the part, some rounds from that of all runs."""
        fitted, left_out = parts.readings(split, part, True), parts.readings(split, part, False)
        rows = parts.runs(split, part)[self.unit]
        fit = refit(fitted, self.fit.effects, self.fit.base, rules.PART_ROUNDS)
        here = left_out.slopes(fit.base, fit.effects)
        left_out_runs = parts.runs(split, part)
        by_run = np.bincount(self.unit[rows], here.log_p, self.runs).astype(np.float64)
        by_base = here.by[:, self.free[self.free < len(BASE)]]
        slope, information = _sums(by_base, self.unit[rows], self.runs)
        of_part = slope[left_out_runs], information[left_out_runs]
        return self._cross_score(left_out_runs, by_run, fit.base, *of_part)


def _sums(scores: Array, unit: Indices, runs: int) -> tuple[Array, Array]:
    """Sums over runs of scores (n, m) and of their products: (runs, m) and (runs, m, m)."""
    order = np.argsort(unit, kind="stable")
    of_runs = np.split(scores[order], np.cumsum(np.bincount(unit, minlength=runs))[:-1])
    return np.array([each.sum(axis=0) for each in of_runs]), np.array([each.T @ each for each in of_runs])
