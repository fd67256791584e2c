"""Derivatives of readings' log probabilities by what the mixture is made of, all of them in one pass.

Rows and readings enter; log probabilities and their slopes leave, for fits and scores. Everything after the mixture
(saturation, faults of the code) is linear in the probability, so what is derived once at the mixture is carried through
as the probability itself is.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from msp_range.reading_model.sensor_model import SATURATED_CM
from msp_sim.effects.codes import CodeFault
from msp_sim.effects.component import Component, Hits, hit_prob, hit_slopes, unexpected_slopes
from msp_sim.model.rows import Added, Faulty, Rows

_Array = NDArray[np.float64]

FREE = ("offset_cm", "log_sigma", "log_odds_short", "log_odds_missed", "log_odds_random", "log_rate", "saturated")
"""By what is derived; the first five are the channels through which effects act."""
LEAST = 1e-12
"""A reading that the model cannot give counts as this improbable, and not as ever so improbable."""


def slopes(rows: Rows, reading_cm: _Array) -> tuple[_Array, _Array]:
    """Log probabilities and their derivatives.

    Parameters
    ----------
    rows
        The distribution of n readings.
    reading_cm
        The readings [cm], (n,).

    Returns
    -------
    log_p : ndarray, shape (n,)
        Not below that of `LEAST`, where the derivatives are 0.
    by : ndarray, shape (n, 7)
        In the order of `FREE`: by the centre of the hits [1/cm], the logarithm of their spread within runs, the log
        odds of short, missed and random readings, the logarithm of the rate of the short ones, and the saturated share.
    """
    parts = _behind(rows, reading_cm, _mixture)
    p = np.maximum(parts[0], LEAST)
    by = np.where(parts[0] > LEAST, parts[1:] / p, 0.0)
    if rows.run_offsets:
        by[1] *= 1.0 - rows.between_cm2 / rows.sigma_cm**2
    return np.log(p), np.ascontiguousarray(by.T)


def log_prob(rows: Rows, reading_cm: _Array) -> _Array:
    """Log probabilities alone, (n,): as `Rows.log_prob` and several times as fast, but not below that of `LEAST`."""
    return np.asarray(np.log(np.maximum(_behind(rows, reading_cm, _probability)[0], LEAST)))


def score_of_component(rows: Rows, reading_cm: _Array, component: Component, log_p: _Array) -> _Array:
    """Derivative of the log probabilities by the odds of one more component, where it has none, (n,)."""
    others = 1.0 + sum(np.asarray(each.odds) for each in rows.added)
    own = _behind(replace(rows, added=(Added(1.0, component, ""),)), reading_cm, _last_added)[0]
    return _ratio(own, log_p) / others


def score_of_fault(rows: Rows, reading_cm: _Array, fault: CodeFault, log_p: _Array) -> _Array:
    """Derivative of the log probabilities by the share of one more fault, where it has none, (n,)."""
    faults = sorted((*rows.faults, Faulty(1.0, fault, "")), key=lambda each: each.fault.order)
    own = _behind(replace(rows, faults=tuple(faults)), reading_cm, _probability)[0]
    return _ratio(own, log_p)


def _ratio(own: _Array, log_p: _Array) -> _Array:
    """Of what is mixed in to what is there, less 1; what is impossible cannot become less probable."""
    p = np.exp(log_p)
    score: _Array = np.maximum(own / p - 1.0, np.where(p > LEAST * (1.0 + 1e-9), -1.0, 0.0))
    return score


Part: TypeAlias = Callable[[Rows, _Array, _Array], _Array]
"""Of codes from first to last before saturation and faults: probabilities of whatever kind, (m, n)."""


def _behind(rows: Rows, reading_cm: _Array, part: Part) -> _Array:
    """Something linear in the mixture's probability, as it is of the readings that arrive."""
    code = np.where(np.rint(reading_cm) == reading_cm, reading_cm, -1.0)
    return _after(rows, rows.faults, code, code, part)


def _after(rows: Rows, faults: Sequence[Faulty], first: _Array, last: _Array, part: Part) -> _Array:
    """The same of the codes from first to last behind these faults."""
    if not faults:
        return _saturated(rows, first, last, part)
    share, fault, _ = faults[-1]
    befallen = sum(_after(rows, faults[:-1], *origin, part) for origin in fault.origins(first, last))
    if np.ndim(share) == 0 and share == 1.0:
        return np.asarray(befallen)
    return np.asarray((1.0 - share) * _after(rows, faults[:-1], first, last, part) + share * befallen)


def _saturated(rows: Rows, first: _Array, last: _Array, part: Part) -> _Array:
    """The mixture, of whose no-echo readings some arrive as 255."""
    first, last = np.maximum(first, rows.minimum_cm), np.minimum(last, rows.maximum_cm)
    inside = np.flatnonzero(first <= last)
    if inside.size < first.size:
        some = _saturated(rows.take(inside), first[inside], last[inside], part)
        parts = np.zeros((some.shape[0], first.size))
        parts[:, inside] = some
        return parts
    parts = part(rows, first, last)
    has_max = last == rows.maximum_cm
    moves = np.flatnonzero(has_max != ((first <= SATURATED_CM) & (last >= SATURATED_CM)))
    if moves.size:
        top = np.full(moves.size, float(rows.maximum_cm))
        moved = part(rows.take(moves), top, top) * np.where(has_max[moves], -1.0, 1.0)
        parts[:, moves] += rows.saturated_fraction * moved
        if len(parts) > len(FREE):
            parts[-1, moves] = moved[0]
    return parts


def _last_added(rows: Rows, first: _Array, last: _Array) -> _Array:
    """The last component alone."""
    hits = Hits(rows.centre_cm, rows.sigma_cm, rows.minimum_cm, rows.maximum_cm)
    with np.errstate(invalid="ignore"):
        found = rows.added[-1].component.prob(first, last, hits)
    # Where it has no share, its parameters may be unknown.
    return np.nan_to_num(found)[None]


def _probability(rows: Rows, first: _Array, last: _Array) -> _Array:
    """The mixture without derivatives."""
    lowest, highest = rows.minimum_cm, rows.maximum_cm
    hits = Hits(rows.centre_cm, rows.sigma_cm, lowest, highest)
    hit, short, missed, random = (np.exp(each) for each in rows.log_weights)
    total = hit + short + missed + random
    p = hit * hit_prob(first, last, hits.centre_cm, hits.sigma_cm, lowest, highest)
    p += missed * (last == highest) + random * (last - first + 1.0) / (highest - lowest + 1.0)
    if np.any(short > 0.0):
        p += short * unexpected_slopes(first, last, hits.centre_cm, rows.rate_per_m, lowest, highest)[0]
    odds = np.zeros(first.size)
    for each, component, _ in rows.added:
        odds += each
        with np.errstate(invalid="ignore"):
            own = component.prob(first, last, hits)
        p += np.where(each > 0.0, total * each * own, 0.0)
    return np.asarray(p / (total * (1.0 + odds)))[None]


def _mixture(rows: Rows, first: _Array, last: _Array) -> _Array:
    """The mixture of the codes from first to last, all within the limits, and its derivatives but the last."""
    lowest, highest = rows.minimum_cm, rows.maximum_cm
    hits = Hits(rows.centre_cm, rows.sigma_cm, lowest, highest)
    hit, short, missed, random = (np.exp(each) for each in rows.log_weights)
    total = hit + short + missed + random
    of_hit = hit_slopes(first, last, hits.centre_cm, hits.sigma_cm, lowest, highest)
    of_missed = (last == highest).astype(float)
    of_random = (last - first + 1.0) / (highest - lowest + 1.0)
    of_short, by_rate = np.zeros((3, first.size)), np.zeros(first.size)
    if np.any(short > 0.0):
        of_short = unexpected_slopes(first, last, hits.centre_cm, rows.rate_per_m, lowest, highest)
        by_rate, of_short[2] = of_short[2].copy(), 0.0
    odds, added = np.zeros(first.size), np.zeros((3, first.size))
    for each, component, _ in rows.added:
        odds += each
        with np.errstate(invalid="ignore"):
            own = component.slopes(first, last, hits)
        # Where it has no share, its parameters may be unknown.
        added += np.where(each > 0.0, each * own, 0.0)
    norm = total * (1.0 + odds)
    parts = np.zeros((1 + len(FREE), first.size))
    parts[:3] = (hit * of_hit + short * of_short + total * added) / norm
    parts[0] += (missed * of_missed + random * of_random) / norm
    for place, weight, own in ((3, short, of_short[0]), (4, missed, of_missed), (5, random, of_random)):
        parts[place] = weight * ((own + added[0]) / norm - parts[0] / total)
    parts[6] = short * by_rate / norm
    return parts
