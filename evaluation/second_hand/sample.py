"""Draws readings from a `Law`."""

import numpy as np
from numpy.random import Generator
from scipy import special

from evaluation.second_hand.base import MAXIMUM_CM, MINIMUM_CM, SATURATED_CM, Base
from evaluation.second_hand.density import Drawn, Law, steps_between, t_unit
from evaluation.second_hand.rows import Floats, Rows

HIT, SHORT, MISSED, RANDOM = range(4)


def draw(rows: Rows, base: Base, law: Law, rng: Generator) -> Drawn:
    """Draw one reading per row."""
    count = len(rows)
    before = rows.previous()
    position = _positions(rows)
    scores = _correlated(rows, base, steps_between(rows, base, before, position), before, rng)
    noise = _student(scores, base.degrees)
    kind = _kinds(law, rng)
    hit = law.centre_cm + law.sigma_cm * noise
    is_hit = kind == HIT
    value = hit.copy()
    pick, below = rng.random(count), np.zeros(count)
    for part in law.components:
        taken = is_hit & (pick >= below) & (pick < below + part.share)
        below = below + part.share
        moved = part.place_cm + part.scatter_cm * rng.standard_normal(count) if not part.slip_cm else hit + part.slip_cm
        value = np.where(taken, moved, value)
    own = is_hit & (pick >= below)
    if law.coarse:
        rounded = own & (rng.random(count) < law.coarse)
        value = np.where(rounded, np.rint(value / law.coarse_step_cm) * law.coarse_step_cm, value)
    value = np.clip(np.rint(value), MINIMUM_CM, MAXIMUM_CM)
    value = np.where(kind == SHORT, _short(rows.true_cm, base, rng), value)
    missed = np.where(rng.random(count) < base.saturated, SATURATED_CM, MAXIMUM_CM)
    value = np.where(kind == MISSED, missed, value)
    value = np.where(kind == RANDOM, rng.integers(MINIMUM_CM, MAXIMUM_CM + 1, count), value)
    repeat = (rng.random(count) < law.repeated) & (before >= 0)
    for index in np.flatnonzero(repeat):
        value[index] = value[before[index]]
    previous = np.where(before >= 0, value[np.maximum(before, 0)], np.nan)
    usable = own & ~repeat
    history = _last(usable, before)
    return Drawn(value, hit, kind, history, steps_between(rows, base, history, position), previous)


def _positions(rows: Rows) -> np.ndarray:
    seen: dict[int, int] = {}
    position = np.empty(len(rows), dtype=np.int64)
    for index, block in enumerate(rows.block.tolist()):
        position[index] = seen.get(block, 0)
        seen[block] = position[index] + 1
    return position


def _correlated(rows: Rows, base: Base, steps: Floats, before: np.ndarray, rng: Generator) -> Floats:
    """Normal scores with a first-order autoregression in each block, and a slow wander on top where there is one."""
    scores = _autoregression(np.power(base.correlation, steps), before, rng)
    if base.wander:
        seconds = rows.time_s - rows.time_s[np.maximum(before, 0)]
        slow = _autoregression(np.exp(-seconds / base.wander_s), before, rng)
        scores = (scores + base.wander * slow) / np.sqrt(1 + base.wander**2)
    return scores


def _autoregression(link: Floats, before: np.ndarray, rng: Generator) -> Floats:
    scores = rng.standard_normal(len(link))
    for index, earlier in enumerate(before.tolist()):
        if earlier >= 0:
            rho = link[index]
            scores[index] = rho * scores[earlier] + np.sqrt(1 - rho * rho) * scores[index]
    return scores


def _student(scores: Floats, degrees: float) -> Floats:
    tail = special.stdtrit(degrees, special.ndtr(-np.abs(scores)))
    found: Floats = -np.sign(scores) * tail * t_unit(degrees)
    return found


def _kinds(law: Law, rng: Generator) -> np.ndarray:
    weights = np.concatenate([np.ones((1, law.odds.shape[1])), np.exp(law.odds)])
    edges = np.cumsum(weights / weights.sum(axis=0), axis=0)
    found: np.ndarray = np.minimum((rng.random(law.odds.shape[1]) > edges).sum(axis=0), RANDOM)
    return found


def _short(true_cm: Floats, base: Base, rng: Generator) -> Floats:
    length = np.maximum(np.floor(true_cm) - MINIMUM_CM, 1.0)
    rate = base.short_rate_per_m / 100
    depth = -np.log1p(-rng.random(len(true_cm)) * (1 - np.exp(-rate * length))) / rate
    found: Floats = MINIMUM_CM + np.minimum(np.floor(depth), length - 1)
    return found


def _last(usable: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Index of the last usable row of the block before each row; -1: none."""
    last = np.full(len(usable), -1)
    for index, earlier in enumerate(before.tolist()):
        if earlier >= 0:
            last[index] = earlier if usable[earlier] else last[earlier]
    return last
