"""Whether what was selected and fitted scores better on held-out runs.

Log scores of two models on the held-out readings enter; the gain per reading, its standard error by whole runs and its
p-value leave. A selection enters `validated`, the terms that held-out runs score better for leave.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from msp_lab.gap import rules
from msp_lab.gap.candidates import Key
from msp_lab.gap.prepared import Prepared
from msp_lab.gap.problem import Problem, State, without
from msp_lab.gap.refit import JointFit, refit

_Array = NDArray[np.float64]


@dataclass(frozen=True)
class Gain:
    """A gain in log score.

    Attributes
    ----------
    nats_per_reading, se
        Gain, and its standard error over runs.
    p_value
        Of no gain, one-sided.
    runs, readings
        How many.
    """

    nats_per_reading: float
    se: float
    p_value: float
    runs: int
    readings: int

    @property
    def nats(self) -> float:
        """In total."""
        return self.nats_per_reading * self.readings

    @property
    def z(self) -> float:
        """Gain over its standard error."""
        return self.nats_per_reading / self.se if self.se > 0.0 else 0.0


def gain(after: _Array, before: _Array, unit: NDArray[np.intp], most_nats: float = np.inf) -> Gain:
    """Gain of one log score over another, with errors of whole runs.

    Parameters
    ----------
    after, before
        Log probability of each held-out reading, (n,).
    unit
        Its run, numbered.
    most_nats
        A reading counts as so much at most.

    Examples
    --------
    >>> better = gain(np.full(4, -1.0), np.full(4, -1.5), np.array([0, 0, 1, 1]))
    >>> print(better.nats_per_reading, better.runs)
    0.5 2
    """
    difference = np.clip(after - before, -most_nats, most_nats)
    n = difference.size
    present = np.unique(unit)
    runs = int(present.size)
    if n == 0:
        return Gain(0.0, 0.0, 1.0, 0, 0)
    mean = float(difference.mean())
    sums = np.bincount(unit, difference - mean)[present]
    se = float(np.sqrt((sums**2).sum() * runs / max(runs - 1, 1)) / n)
    p_value = float(student.sf(mean / se, max(runs - 1, 1))) if se > 0.0 else (0.0 if mean > 0.0 else 1.0)
    return Gain(mean, se, p_value, runs, n)


@dataclass(frozen=True)
class Validated:
    """Terms that held-out runs score better for.

    Attributes
    ----------
    state
        With these terms alone.
    gains
        Of each on the held-out runs, by its key.
    dropped
        Labels of the others, and why.
    """

    state: State
    gains: dict[Key, Gain]
    dropped: tuple[tuple[str, str], ...] = ()


def validated(problem: Problem, state: State, held_out: Prepared, unit: NDArray[np.intp]) -> Validated:
    """Keep the terms that the held-out runs score better for; the worst is taken out first."""
    dropped: list[tuple[str, str]] = []
    while state.terms:
        after = held_out.log_prob(state.fit.base, state.fit.effects)
        smaller = [without(problem, state, k) for k in range(len(state.terms))]
        before = [held_out.log_prob(each.fit.base, each.fit.effects) for each in smaller]
        limited = [gain(after, each, unit, rules.ROW_NATS) for each in before]
        worst = min(range(len(before)), key=lambda k: limited[k].z)
        lost = limited[worst]
        why = f"held-out runs score {lost.nats_per_reading:+.2g} nats per reading (standard error {lost.se:.2g})"
        if lost.nats >= rules.VALIDATED_NATS and lost.z >= rules.VALIDATED_Z:
            recalibrated = [_recalibrated_gain(state, each, held_out) for each in smaller]
            worst = min(range(len(before)), key=lambda k: recalibrated[k])
            if recalibrated[worst] >= rules.VALIDATED_NATS:
                gains = {term.key: gain(after, each, unit) for term, each in zip(state.terms, before, strict=True)}
                return Validated(state, gains, tuple(dropped))
            why = (
                "held-out runs fit as well without it once the model is calibrated to them "
                f"({recalibrated[worst]:+.2g} nats), so its cause hardly varies there"
            )
        label = state.terms[worst].label
        dropped.append((label, why))
        state = smaller[worst].logging(f"not validated: {label}")
    return Validated(state, {}, tuple(dropped))


def _recalibrated_gain(state: State, smaller: State, held_out: Prepared) -> float:
    """What a term gains on the held-out readings if the base is fitted to them, with it and without it [nat]."""

    def score(fit: JointFit) -> float:
        # Without what the priors take: an effect may move the base by more than they expect.
        base = refit(held_out, fit.effects, fit.base, fit_effects=False).base
        return float(held_out.log_prob(base, fit.effects).sum())

    return score(state.fit) - score(smaller.fit)
