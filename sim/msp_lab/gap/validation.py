"""Whether what was selected holds in splits of the runs: each part scores better for it by a fit of the others.

Of a state that was fitted to all readings, the terms that nearly all splits agree on stay. Each part of a split is left
out once, so that each reading is scored by a fit that it had no part in.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.special import stdtr

from msp_lab.gap import rules
from msp_lab.gap.candidates import Key, SelectedTerm
from msp_lab.gap.cross_fit import CrossScore, Parts, SumsByRun, recalibrated
from msp_lab.gap.problem import Problem, State, without
from msp_lab.gap.refit import JointFit
from msp_lab.gap.splits import Splits
from msp_range.arrays import Array, Column, Flags, Indices


@dataclass(frozen=True)
class Gain:
    """A gain in log score."""

    nats_per_reading: float
    se: float
    """Gain, and its standard error over runs."""
    p_value: float
    """p-value of no gain, one-sided."""
    runs: int
    readings: int
    """Numbers of runs and of readings."""

    @property
    def nats(self) -> float:
        """In total."""
        return self.nats_per_reading * self.readings

    @property
    def z(self) -> float:
        """Gain over its standard error."""
        return self.nats_per_reading / self.se if self.se > 0.0 else 0.0


def gain(after: Array, before: Array, unit: Indices) -> Gain:
    """Gain of one log score over another, with errors of whole runs.

    Parameters
    ----------
    after, before
        Log probability of each held-out reading, (n,).
    unit
        Its run, numbered.

    Examples
    --------
    >>> better = gain(np.full(4, -1.0), np.full(4, -1.5), np.array([0, 0, 1, 1]))
    >>> print(better.nats_per_reading, better.runs)
    0.5 2
    """
    return gain_of_runs(np.bincount(unit, after - before), np.bincount(unit))


def gain_of_runs(sums: Column, counts: Column) -> Gain:
    """Gain from its sum over each run, (runs,), and each run's number of readings."""
    sums, counts = sums[counts > 0], counts[counts > 0]
    runs, n = sums.size, float(counts.sum())
    if runs == 0:
        return Gain(0.0, 0.0, 1.0, 0, 0)
    mean = float(sums.sum() / n)
    se = float(np.sqrt(((sums - mean * counts) ** 2).sum() * runs / max(runs - 1, 1)) / n)
    p_value = float(stdtr(max(runs - 1, 1), -mean / se)) if se > 0.0 else (0.0 if mean > 0.0 else 1.0)
    return Gain(mean, se, p_value, runs, round(n))


class Dropped(NamedTuple):
    """A term that does not hold, and why."""

    term: SelectedTerm
    why: str


@dataclass(frozen=True)
class Validated:
    """Terms that hold in nearly all splits."""

    state: State
    """The state with these terms alone."""
    gains: dict[Key, Gain]
    """Gain of each term on the part that it was not fitted on, the mean of the splits, by its key."""
    agree: dict[Key, float]
    """In which share of the splits each of them holds."""
    dropped: tuple[Dropped, ...] = ()
    """The other terms."""


@dataclass(frozen=True)
class _Agreement:
    """What the splits say of one term: in which of them it holds, and its gain there."""

    holds: Flags
    gain: Gain
    recalibrated_nats: float

    @property
    def share(self) -> float:
        return float(self.holds.mean())


def validated(problem: Problem, state: State, splits: Splits) -> Validated:
    """Keep the terms that nearly all splits agree on; the worst is taken out first."""
    parts = Parts(problem, splits)
    dropped: list[Dropped] = []
    crossed = _Crossed.of(parts, state)
    while state.terms:
        smaller = [without(problem, state, k) for k in range(len(state.terms))]
        before = [_Crossed.of(parts, each) for each in smaller]
        found = [_agreement(parts, k, crossed, each) for k, each in enumerate(before)]
        worst = min(range(len(found)), key=lambda k: (found[k].share, found[k].gain.z))
        lost = found[worst]
        if lost.share >= rules.SPLITS_AGREE:
            keys = [term.key for term in state.terms]
            return Validated(
                state,
                {key: each.gain for key, each in zip(keys, found, strict=True)},
                {key: each.share for key, each in zip(keys, found, strict=True)},
                tuple(dropped),
            )
        dropped.append(Dropped(state.terms[worst], _why(lost)))
        state, crossed = smaller[worst].logging(f"not validated: {state.terms[worst].label}"), before[worst]
    return Validated(state, {}, {}, tuple(dropped))


@dataclass(frozen=True)
class _Crossed:
    """A state's fit, and what fits without each part say of that part, worked out once."""

    parts: Parts
    sums: SumsByRun
    kept: dict[tuple[int, int, bool], CrossScore] = field(default_factory=dict)

    @classmethod
    def of(cls, parts: Parts, state: State) -> "_Crossed":
        return cls(parts, SumsByRun(state.fit, parts.problem.unit, parts.splits.names.size))

    @cached_property
    def steps(self) -> dict[tuple[int, int], Array]:
        """From the fit of all runs to that without a part."""
        return {way: self.sums.step(~self.parts.runs(*way)) for way in self.parts.ways}

    def tells(self, way: tuple[int, int]) -> bool:
        """Whether a quadratic is enough."""
        return self.sums.tells(self.parts.runs(*way), self.steps[way])

    def score(self, way: tuple[int, int], exact: bool) -> CrossScore:
        """Score of a part, by the quadratic or by a fit."""
        if (*way, exact) not in self.kept:
            self.kept[*way, exact] = (
                self.sums.along(self.parts, *way) if exact else self.sums.crossed(self.parts, *way, self.steps[way])
            )
        return self.kept[*way, exact]


def _agreement(parts: Parts, k: int, crossed: _Crossed, smaller: _Crossed) -> _Agreement:
    """In which splits a term holds: by the fits of the others the parts gain, recalibrated or not."""
    whole = crossed.sums
    if whole.fit.effects[k].effect.per == "run":
        return _inside_its_run(parts, k, whole, smaller.sums)
    counts = np.bincount(whole.unit, minlength=whole.runs)
    numbers = _strength(whole.fit, k)
    fits_left = rules.SPLITS_FITTED
    holds: list[bool] = []
    of_runs, recalibrated_of_splits = [], []
    for split in range(len(parts.splits)):
        if sum(not each for each in holds) > (1.0 - rules.SPLITS_AGREE) * len(parts.splits) + 1e-9:
            # Dropped, whatever the others say, unless another term is worse.
            break
        # What both are off by in the same way cancels: neither is fitted if the other is not.
        fitted = {way: not (crossed.tells(way) and smaller.tells(way)) for way in parts.ways if way[0] == split}
        if any(fitted.values()):
            fits_left -= 1
            if fits_left < 0:
                continue
        gained, known = np.zeros(whole.runs), np.zeros(whole.runs)
        after, before = [], []
        for way, exact in fitted.items():
            more, less = crossed.score(way, exact), smaller.score(way, exact)
            left_out = parts.runs(*way)
            # Of a run that differs from all others in the cause, a fit of the others knows nothing.
            left_out &= whole.learnt(left_out, numbers) >= rules.LEARNT_SHARE
            known += left_out
            gained += left_out * (more.by_run - less.by_run)
            after.append(more)
            before.append(less)
        runs = known > 0.0
        recalibrated_nats = recalibrated(after, runs) - recalibrated(before, runs)
        found = gain_of_runs(gained, counts)
        ahead = min(found.nats, recalibrated_nats)
        holds.append(ahead >= rules.VALIDATED_NATS and found.z >= rules.VALIDATED_Z)
        of_runs.append(gained)
        recalibrated_of_splits.append(recalibrated_nats)
    return _Agreement(
        np.array(holds),
        gain_of_runs(np.mean(of_runs, axis=0), counts),
        float(np.mean(recalibrated_of_splits)),
    )


def _inside_its_run(parts: Parts, k: int, whole: SumsByRun, smaller: SumsByRun) -> _Agreement:
    """The same of an effect of one run, of which the others say nothing: parts are stretches of that run.

    Its strength without a stretch is that of all less one step of Newton.
    """
    fit = whole.fit
    (name,) = _strength(fit, k)
    score = fit.at.scores[:, fit.names.index(name)]
    rows = np.flatnonzero(score)
    score, difference = score[rows], (fit.here.log_p - smaller.fit.here.log_p)[rows]
    found = []
    for split in range(rules.SPLITS):
        # Each split has its stretches begin elsewhere.
        place = np.arange(rows.size) / max(rows.size, 1) + split / (rules.SPLITS * rules.PARTS)
        part = (place * rules.PARTS).astype(np.intp) % rules.PARTS
        slope, information = (np.bincount(part, each, rules.PARTS) for each in (score, score**2))
        step = -slope / np.maximum(information.sum() - information, 1e-300)
        gained = np.bincount(part, difference, rules.PARTS) + slope * step - 0.5 * information * step**2
        found.append(gain_of_runs(gained, np.bincount(part, minlength=rules.PARTS)))
    holds = [each.nats >= rules.VALIDATED_NATS and each.z >= rules.VALIDATED_Z for each in found]
    least = min(found, key=lambda each: each.nats)
    return _Agreement(np.array(holds), least, least.nats)


def _strength(fit: JointFit, k: int) -> list[str]:
    """Numbers of the k-th term that say how strong it is: of an effect the one that is neutral while it is absent."""
    effect = fit.effects[k]
    names = [each.name for each in effect.effect.parameters if each.neutral is not None or effect.shape is not None]
    return [f"{k}.{name}" for name in (names if effect.shape is not None else names[:1])]


def _why(lost: _Agreement) -> str:
    if lost.gain.nats >= rules.VALIDATED_NATS and lost.recalibrated_nats < rules.VALIDATED_NATS:
        return (
            "the runs on which it was not fitted fit as well without it once the model is calibrated to them "
            f"({lost.recalibrated_nats:+.2g} nats), so its cause hardly varies there"
        )
    return (
        f"it holds in {int(lost.holds.sum())} of {lost.holds.size} splits of the runs; where it was not fitted they "
        f"score {lost.gain.nats_per_reading:+.2g} nats per reading (standard error {lost.gain.se:.2g})"
    )
