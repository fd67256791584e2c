"""Forward and backward steps by a criterion: effects of the catalogue are added while the likelihood pays their price.

The likelihood is the given model's, reading after reading, with the base's own parameters free in every fit. Nothing is
held out. What differs between AIC, BIC and PASTIS is the price of a term alone.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evaluation.blind_peers.library import BASE_STEP, DAMPING, Entry, changed, entries_of, log_prob, with_previous
from msp_sim.effects.path import with_path
from msp_sim.model.model import Model

Array = NDArray[np.floating[Any]]
BASE = 6
"""Parameters of the base that are free: offset, spread, odds of short, missed and random readings, rate of the short
ones."""
ROUNDS = 40
"""Most steps of a fit."""
LEAST_NATS = 1e-2
"""A step that gains less is the last of a fit."""
TRIED = 3
"""Candidates of a step that are fitted: those that gain most by one step of Newton's."""
MOST_TERMS = 8
"""Terms after which a search ends; tables have two effects at most. AIC alone comes there."""


@dataclass(frozen=True)
class Problem:
    """Readings with their contexts and the model that is given."""

    model: Model
    contexts: Mapping[str, Any]
    reading_cm: Array

    def log_p(self, entries: Sequence[Entry], at: Array) -> Array:
        """Log probability of each reading with the base changed and these entries added, (n,)."""
        built = changed(self.model, np.append(at[:BASE], 0.0))
        for entry, value in zip(entries, at[BASE:], strict=True):
            built = entry.added_to(built, float(value))
        return log_prob(built, self.contexts, self.reading_cm)


@dataclass(frozen=True)
class Fit:
    """A maximum of the likelihood.

    Attributes
    ----------
    entries, at
        What was added, and the values: those of the base, then one of each entry.
    log_p, slopes
        Log probability of each reading, (n,), and its derivatives by the values, (n, values).
    """

    entries: tuple[Entry, ...]
    at: Array
    log_p: Array
    slopes: Array

    @property
    def total(self) -> float:
        """Log likelihood."""
        return float(self.log_p.sum())

    @property
    def errors(self) -> Array:
        """Standard errors of the entries' values, from the outer product of the slopes."""
        size = np.sqrt((self.slopes**2).sum(axis=0)) + 1e-9
        unit = self.slopes / size
        found: Array = np.sqrt(np.diag(np.linalg.inv(unit.T @ unit + 1e-9 * np.eye(size.size))))[BASE:] / size[BASE:]
        return found


def search(
    model: Model, contexts: Mapping[str, Any], reading_cm: Array, price: Callable[[int, int], float]
) -> tuple[Fit, Fit]:
    """The fit that the criterion prefers, and that of the base alone.

    Parameters
    ----------
    price
        Of a term in nats, from the number of readings and that of the entries to choose from.
    """
    problem = Problem(model, with_path(with_previous(contexts, reading_cm)), reading_cm)
    pool = tuple(entries_of(problem.contexts))
    a_term = price(reading_cm.size, len(pool))
    alone = best = fit(problem, (), np.zeros(BASE))
    while len(best.entries) < MOST_TERMS:
        ahead = sorted((_stepped(problem, best, entry) for entry in pool), key=lambda each: -each[0])[:TRIED]
        further = max((fit(problem, (*best.entries, entry), at) for _, entry, at in ahead), key=lambda each: each.total)
        if further.total - best.total <= a_term:
            break
        best = further
        while len(best.entries) > 1:
            fewer = max((_without(problem, best, k) for k in range(len(best.entries))), key=lambda each: each.total)
            if best.total - fewer.total > a_term:
                break
            best = fewer
    return best, alone


def fit(problem: Problem, entries: tuple[Entry, ...], at: Array) -> Fit:
    """Maximum of the likelihood from a start, by Levenberg and Marquardt's steps with the scores' outer product."""
    here, damping = problem.log_p(entries, at), 1e-3
    slopes = _slopes(problem, entries, at, here)
    for _ in range(ROUNDS):
        there = _bounded(entries, at + _step(slopes, damping))
        reached = problem.log_p(entries, there)
        gain = float(reached.sum() - here.sum())
        if gain > 0.0:
            at, here, damping = there, reached, max(damping / 10.0, 1e-6)
            slopes = _slopes(problem, entries, at, here)
        else:
            damping *= 10.0
        if 0.0 < gain < LEAST_NATS or damping > 1e6:
            break
    return Fit(entries, at, here, slopes)


def _stepped(problem: Problem, best: Fit, entry: Entry) -> tuple[float, Entry, Array]:
    """Log likelihood after one step of Newton's with an entry more, a whole one or a part, and where that is."""
    entries, at = (*best.entries, entry), np.append(best.at, entry.parameter.neutral or 0.0)
    slope = _slope(problem, entries, at, best.log_p, len(at) - 1)
    if not np.any(slope):
        return -np.inf, entry, at
    step = _step(np.column_stack([best.slopes, slope]), 1e-6)
    there = [_bounded(entries, at + part * step) for part in (1.0, 0.3)]
    reached = [float(problem.log_p(entries, each).sum()) for each in there]
    return max(reached), entry, there[int(np.argmax(reached))]


def _without(problem: Problem, best: Fit, k: int) -> Fit:
    entries = (*best.entries[:k], *best.entries[k + 1 :])
    return fit(problem, entries, np.delete(best.at, BASE + k))


def _step(slopes: Array, damping: float) -> Array:
    """Gauss and Newton's, each value in units in which its score has size one; the base's own stay near the start."""
    size = np.sqrt((slopes**2).sum(axis=0)) + 1e-9
    unit = slopes / size
    kept = np.append(DAMPING / size[:BASE] ** 2, np.zeros(size.size - BASE))
    found: Array = np.linalg.solve(unit.T @ unit + np.diag(kept + damping), unit.sum(axis=0)) / size
    return found


def _slopes(problem: Problem, entries: tuple[Entry, ...], at: Array, here: Array) -> Array:
    return np.column_stack([_slope(problem, entries, at, here, k) for k in range(at.size)])


def _slope(problem: Problem, entries: tuple[Entry, ...], at: Array, here: Array, k: int) -> Array:
    """Derivative of each reading's log probability by a value; backwards at its upper bound."""
    step = BASE_STEP
    if k >= BASE:
        parameter = entries[k - BASE].parameter
        step = -parameter.step if at[k] + parameter.step > parameter.high else parameter.step
    moved = at.copy()
    moved[k] += step
    found: Array = np.expm1(problem.log_p(entries, moved) - here) / step
    return found


def _bounded(entries: tuple[Entry, ...], at: Array) -> Array:
    low, high = np.array([(each.parameter.low, each.parameter.high) for each in entries]).reshape(-1, 2).T
    return np.append(at[:BASE], np.clip(at[BASE:], low, high))
