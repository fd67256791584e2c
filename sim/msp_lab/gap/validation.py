"""Whether what was selected holds in splits of the runs: each part scores better for it by a fit of the others.

Of a state that was fitted to all readings, the terms that nearly all splits agree on stay. Each part of a split is left
out once, so that each reading is scored by a fit that it had no part in.

Log-likelihood, scores and information are summed by run once; the fit without a part, and what it says of that part,
then follow by one Newton step and a quadratic, so that a split costs no pass over the readings. Where the step is too
large for a quadratic, the other runs are fitted, and the likelihood is taken as it is.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from msp_lab.gap import rules
from msp_lab.gap.candidates import Key, SelectedTerm
from msp_lab.gap.cell_fits import outer_sums
from msp_lab.gap.evidence import offsets_of
from msp_lab.gap.prepared import BASE
from msp_lab.gap.problem import Problem, State, without
from msp_lab.gap.refit import JointFit, inverse, refit, sums_by
from msp_lab.gap.runs import Splits
from msp_range.arrays import Array, Column, Flags, Indices


class CrossScore(NamedTuple):
    """What a fit without one part says of that part's readings."""

    by_run: Array
    """Log-likelihood of each run of the part, (runs,); 0 for the others."""
    base: Array
    """The numbers of the base that can move, as they were fitted, (b,)."""
    slope: Array
    information: Array
    """Slope and information of each run's log-likelihood by these, (runs, b) and (runs, b, b)."""

    def with_offsets(self, variance_cm2: float) -> "CrossScore":
        """With a normal offset of this variance in each run, integrated out; the base's offset is the first number.

        Of a run with slope s and information i by the offset the log-likelihood grows by ``v s^2 / (1 + v i) / 2 -
        log(1 + v i) / 2``.
        """
        by_offset, slope = self.information[:, :, 0], self.slope[:, 0]
        weight = variance_cm2 / (1.0 + variance_cm2 * by_offset[:, 0])
        gained = 0.5 * (weight * slope**2 - np.log1p(variance_cm2 * by_offset[:, 0]))
        return CrossScore(
            self.by_run + gained,
            self.base,
            self.slope - (weight * slope)[:, None] * by_offset,
            self.information - weight[:, None, None] * by_offset[:, :, None] * by_offset[:, None, :],
        )


@dataclass(frozen=True)
class CrossFits:
    """A fit of all readings summed by run, and what fits without each part of the runs say of that part."""

    problem: Problem
    """The problem with these readings."""
    splits: Splits
    """Splits of their runs."""
    fit: JointFit
    """The fit of all readings."""
    by_run: bool = False
    """Whether runs may have offsets, which are integrated out of what is said of each."""
    kept: dict[tuple[int, int, bool], CrossScore] = field(default_factory=dict)
    """Scores of parts that were asked for."""

    @property
    def runs(self) -> int:
        """How many runs there are."""
        return self.splits.names.size

    def ways(self, split: int) -> list[tuple[int, int]]:
        """A split with each of its parts that is left out of the fit."""
        return [(split, part) for part in range(int(self.splits.part[split].max()) + 1)]

    def left_out(self, way: tuple[int, int]) -> Flags:
        """Runs of a part, (runs,)."""
        mask: Flags = self.splits.part[way[0]] == way[1]
        return mask

    @cached_property
    def free(self) -> Indices:
        """Places of the numbers that can move; those of the base of which few readings speak stay as they are."""
        few = self._speaking < rules.FEW_READINGS
        few[len(BASE) :] = False
        return np.flatnonzero(~(self.fit.at.held | few))

    @cached_property
    def _speaking(self) -> Array:
        """How many readings speak of each number: the squared sum of squared scores over that of fourth powers."""
        squares = self.fit.at.scores**2
        return np.asarray(squares.sum(axis=0) ** 2 / np.maximum((squares**2).sum(axis=0), 1e-300))

    @cached_property
    def of_base(self) -> Indices:
        """Those of them that are numbers of the base."""
        return self.free[self.free < len(BASE)]

    @cached_property
    def sums(self) -> tuple[Array, Array]:
        """Sums over runs of the scores by the free numbers, and of their products: (runs, m) and (runs, m, m)."""
        return _sums(self.fit.at.scores[:, self.free], self.problem.unit, self.runs)

    @cached_property
    def prior(self) -> tuple[Array, Array]:
        """Slope and information of the priors."""
        whole = np.diag(self.fit.at.information)[self.free]
        of_readings = (self.fit.at.scores[:, self.free] ** 2).sum(axis=0)
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
        in_runs = self.sums[1][:, own][:, :, own]
        known, without = (
            np.einsum("ij,rji->r", inverse(each + least), in_runs) for each in (everywhere, self._known(~left_out, own))
        )
        share: Array = np.where(without > 0.0, known / np.where(without > 0.0, without, 1.0), 1.0)
        return share

    def _known(self, runs: Flags, own: Flags) -> Array:
        """Information of these runs about some of the free numbers, with all others free."""
        whole = self.sums[1][runs].sum(axis=0) + np.diag(self.prior[1])
        cross = whole[np.ix_(own, ~own)]
        known: Array = whole[np.ix_(own, own)] - cross @ inverse(whole[np.ix_(~own, ~own)]) @ cross.T
        return known

    def step(self, runs: Flags) -> Array:
        """By how much the fit of these runs differs from that of all; what would leave its bounds stays at one."""
        score, products = self.sums
        slope = score[runs].sum(axis=0) + self.prior[0]
        information = products[runs].sum(axis=0) + np.diag(self.prior[1])
        least, most = (bound[self.free] - self.fit.values[self.free] for bound in self.fit.bounds)
        step: Array = inverse(information) @ slope
        beyond = (step < least) | (step > most)
        step = np.clip(step, least, most)
        if beyond.any():
            slope = slope[~beyond] - information[np.ix_(~beyond, beyond)] @ step[beyond]
            of_others = inverse(information[np.ix_(~beyond, ~beyond)]) @ slope
            step[~beyond] = np.clip(of_others, least[~beyond], most[~beyond])
        return step

    @cached_property
    def steps(self) -> dict[tuple[int, int], Array]:
        """From the fit of all runs to that without a part."""
        ways = [way for split in range(len(self.splits)) for way in self.ways(split)]
        return {way: self.step(~self.left_out(way)) for way in ways}

    def tells(self, way: tuple[int, int]) -> bool:
        """Whether a quadratic about the fit of all runs says what the fit without a part does."""
        if np.any(self._speaking[self.free] < rules.FEW_READINGS):
            return False
        step, left_out = self.steps[way], self.left_out(way)
        lost, kept = (0.5 * step @ self.sums[1][runs].sum(axis=0) @ step for runs in (left_out, ~left_out))
        most = max(float(lost), float(kept + 0.5 * self.prior[1] @ step**2))
        return most < rules.EXPANSION_NATS * self.free.size

    def score(self, way: tuple[int, int], exact: bool) -> CrossScore:
        """What the fit without a part says of it, by a quadratic, or by a fit, some rounds from that of all runs."""
        if (*way, exact) not in self.kept:
            score = self._by_fit(way) if exact else self._by_quadratic(way)
            variance_cm2 = self._offset_variance_cm2
            self.kept[*way, exact] = score.with_offsets(variance_cm2) if variance_cm2 > 0.0 else score
        return self.kept[*way, exact]

    @cached_property
    def _offset_variance_cm2(self) -> float:
        """Variance of the runs' offsets; 0 where they have none, or the base's offset cannot move."""
        if not self.by_run or 0 not in self.of_base:
            return 0.0
        return offsets_of(self.fit, self.problem.unit).variance_cm2

    def _by_fit(self, way: tuple[int, int]) -> CrossScore:
        unit, readings = self.problem.unit, self.problem.readings
        rows = self.left_out(way)[unit]
        fit = refit(readings.take(~rows), self.fit.effects, self.fit.base, rules.PART_ROUNDS)
        here = readings.take(rows).slopes(fit.base, fit.effects)
        by_run = np.bincount(unit[rows], here.log_p, self.runs).astype(np.float64)
        sums = _sums(here.by[:, self.of_base], unit[rows], self.runs)
        return CrossScore(by_run, np.array(fit.base)[self.of_base], *sums)

    def _by_quadratic(self, way: tuple[int, int]) -> CrossScore:
        (score, products), step, left_out = self.sums, self.steps[way], self.left_out(way)
        moved = products @ step
        whole = np.bincount(self.problem.unit, self.fit.here.log_p, self.runs)
        by_run = np.where(left_out, whole + score @ step - 0.5 * (moved @ step), 0.0)
        own = slice(0, self.of_base.size)
        base = np.array(self.fit.base)[self.of_base] + step[own]
        return CrossScore(by_run, base, (score - moved)[:, own], products[:, own, own])

    def recalibrated(self, ways: Sequence[tuple[int, int]], exact: Sequence[bool], runs: Flags) -> float:
        """Log-likelihood of some runs of these parts, if one base is fitted to all and the effects stay as they are."""
        scores = list(map(self.score, ways, exact))
        of_parts = [self.left_out(way) & runs for way in ways]
        slope, information = (
            np.array([score[place][own].sum(axis=0) for score, own in zip(scores, of_parts, strict=True)])
            for place in (2, 3)
        )
        fitted, whole = np.array([score.base for score in scores]), information.sum(axis=0)
        prior = np.where(np.diag(whole) > 0.0, 1.0 / np.square(rules.BASE_DEVIATION)[self.of_base], 0.0)
        towards = (slope + np.einsum("kij,kj->ki", information, fitted)).sum(axis=0)
        moved = inverse(whole + np.diag(prior)) @ towards - fitted
        # Without what the priors take: an effect may move the base by more than they expect.
        gained = (slope * moved).sum() - 0.5 * np.einsum("ki,kij,kj->", moved, information, moved)
        return float(sum(score.by_run[own].sum() for score, own in zip(scores, of_parts, strict=True)) + gained)


def _sums(scores: Array, unit: Indices, runs: int) -> tuple[Array, Array]:
    """Sums over runs of scores (n, m) and of their products: (runs, m) and (runs, m, m)."""
    in_order = scores[np.argsort(unit, kind="stable")]
    return sums_by(unit, scores, runs), outer_sums(in_order, np.bincount(unit, minlength=runs))


@dataclass(frozen=True)
class Gain:
    """A gain in log score."""

    nats_per_reading: float
    se: float
    """Gain, and its standard error over runs."""
    readings: int
    """Number of readings."""

    @property
    def nats(self) -> float:
        """In total."""
        return self.nats_per_reading * self.readings

    @property
    def z(self) -> float:
        """Gain over its standard error."""
        return self.nats_per_reading / self.se if self.se > 0.0 else 0.0


def gain_of_runs(sums: Column, counts: Column) -> Gain:
    """Gain from its sum over each run, (runs,), and each run's number of readings, with the error of whole runs.

    Examples
    --------
    >>> better = gain_of_runs(np.array([1.0, 1.0]), np.array([2, 2]))
    >>> print(better.nats_per_reading, better.nats)
    0.5 2.0
    """
    sums, counts = sums[counts > 0], counts[counts > 0]
    runs, n = sums.size, float(counts.sum())
    if runs == 0:
        return Gain(0.0, 0.0, 0)
    mean = float(sums.sum() / n)
    se = float(np.sqrt(((sums - mean * counts) ** 2).sum() * runs / max(runs - 1, 1)) / n)
    return Gain(mean, se, round(n))


class Dropped(NamedTuple):
    """A term that does not hold, and why."""

    term: SelectedTerm
    why: str


@dataclass(frozen=True)
class Agreement:
    """What the splits say of one term: in which of them it holds, and its gain there."""

    holds: Flags
    """In which splits it holds, (splits,)."""
    gain: Gain
    """Gain on the part that it was not fitted on, the mean of the splits."""
    recalibrated_nats: float
    """Gain if one base is fitted to the runs that are predicted, the mean of the splits."""

    @property
    def share(self) -> float:
        """In which share of the splits it holds."""
        return float(self.holds.mean())


@dataclass(frozen=True)
class Validated:
    """Terms that hold in nearly all splits."""

    state: State
    """The state with these terms alone."""
    agreement: dict[Key, Agreement]
    """What the splits say of each term, by its key."""
    dropped: tuple[Dropped, ...] = ()
    """The other terms."""


def validated(problem: Problem, state: State, splits: Splits) -> Validated:
    """Keep the terms that nearly all splits agree on; the worst is taken out first."""
    dropped: list[Dropped] = []
    crossed = CrossFits(problem, splits, state.fit, state.by_run)
    while state.terms:
        smaller = [without(problem, state, k) for k in range(len(state.terms))]
        before = [CrossFits(problem, splits, less.fit, less.by_run) for less in smaller]
        found = [_agreement(k, crossed, less) for k, less in enumerate(before)]
        worst = min(range(len(found)), key=lambda k: (found[k].share, found[k].gain.z))
        if found[worst].share >= rules.SPLITS_AGREE:
            agreement = dict(zip([term.key for term in state.terms], found, strict=True))
            return Validated(state, agreement, tuple(dropped))
        dropped.append(Dropped(state.terms[worst], _why(found[worst])))
        state, crossed = smaller[worst], before[worst]
    return Validated(state, {}, tuple(dropped))


def _agreement(k: int, crossed: CrossFits, smaller: CrossFits) -> Agreement:
    """In which splits a term holds: by the fits of the others the parts gain, recalibrated or not."""
    if crossed.fit.effects[k].effect.per == "run":
        return _inside_its_run(k, crossed, smaller)
    counts = np.bincount(crossed.problem.unit, minlength=crossed.runs)
    numbers, splits = _strength(crossed.fit, k), len(crossed.splits)
    fits_left = rules.SPLITS_FITTED
    holds: list[bool] = []
    of_runs, recalibrated_of_splits = [], []
    for split in range(splits):
        if holds.count(False) > (1.0 - rules.SPLITS_AGREE) * splits + 1e-9:
            # Dropped, whatever the others say, unless another term is worse.
            break
        # What both are off by in the same way cancels: neither is fitted if the other is not.
        fitted = {way: not (crossed.tells(way) and smaller.tells(way)) for way in crossed.ways(split)}
        if any(fitted.values()):
            fits_left -= 1
            if fits_left < 0:
                continue
        gained, known = np.zeros(crossed.runs), np.zeros(crossed.runs, dtype=bool)
        for way, exact in fitted.items():
            left_out = crossed.left_out(way)
            # Of a run that differs from all others in the cause, a fit of the others knows nothing.
            left_out &= crossed.learnt(left_out, numbers) >= rules.LEARNT_SHARE
            known |= left_out
            gained += left_out * (crossed.score(way, exact).by_run - smaller.score(way, exact).by_run)
        more, less = (fits.recalibrated([*fitted], [*fitted.values()], known) for fits in (crossed, smaller))
        found = gain_of_runs(gained, counts)
        holds.append(min(found.nats, more - less) >= rules.VALIDATED_NATS and found.z >= rules.VALIDATED_Z)
        of_runs.append(gained)
        recalibrated_of_splits.append(more - less)
    whole = gain_of_runs(np.mean(of_runs, axis=0), counts)
    return Agreement(np.array(holds), whole, float(np.mean(recalibrated_of_splits)))


def _inside_its_run(k: int, crossed: CrossFits, smaller: CrossFits) -> Agreement:
    """The same of an effect of one run, of which the others say nothing: parts are stretches of that run.

    Its strength without a stretch is that of all less one step of Newton.
    """
    fit = crossed.fit
    (name,) = _strength(fit, k)
    score = fit.at.scores[:, fit.names.index(name)]
    rows = np.flatnonzero(score)
    score, difference = score[rows], (fit.here.log_p - smaller.fit.here.log_p)[rows]
    found = []
    for split in range(rules.SPLITS):
        # Each split has its stretches begin elsewhere.
        place = np.arange(rows.size) / max(rows.size, 1) + split / (rules.SPLITS * rules.PARTS)
        part = (place * rules.PARTS).astype(np.intp) % rules.PARTS
        slope, information = (np.bincount(part, values, rules.PARTS) for values in (score, score**2))
        step = -slope / np.maximum(information.sum() - information, 1e-300)
        gained = np.bincount(part, difference, rules.PARTS) + slope * step - 0.5 * information * step**2
        found.append(gain_of_runs(gained, np.bincount(part, minlength=rules.PARTS)))
    holds = [gain.nats >= rules.VALIDATED_NATS and gain.z >= rules.VALIDATED_Z for gain in found]
    least = min(found, key=lambda gain: gain.nats)
    return Agreement(np.array(holds), least, least.nats)


def _strength(fit: JointFit, k: int) -> list[str]:
    """Numbers of the k-th term that say how strong it is: of an effect the one that is neutral while it is absent."""
    effect = fit.effects[k]
    names = [each.name for each in effect.effect.parameters if each.neutral is not None or effect.shape is not None]
    return [f"{k}.{name}" for name in (names if effect.shape is not None else names[:1])]


def _why(lost: Agreement) -> str:
    if lost.gain.nats >= rules.VALIDATED_NATS and lost.recalibrated_nats < rules.VALIDATED_NATS:
        return (
            "the runs on which it was not fitted fit as well without it once the model is calibrated to them "
            f"({lost.recalibrated_nats:+.2g} nats), so its cause hardly varies there"
        )
    return (
        f"it holds in {int(lost.holds.sum())} of {lost.holds.size} splits of the runs; where it was not fitted they "
        f"score {lost.gain.nats_per_reading:+.2g} nats per reading (standard error {lost.gain.se:.2g})"
    )
