"""The largest gain of what mixes into the probability of readings, and of their odds, with all else held.

It is the gain of each of some candidates in log-likelihood over a fit, along its score and at values of its number. A
score that rests on a few improbable readings promises more than that.
"""

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np

from msp_lab.gap.candidates import CandidateEffect, score_of
from msp_lab.gap.prepared import BASE, ChannelSlopes, Prepared, ReadingsAtFit, templates
from msp_range.arrays import Array
from msp_sim.effects.base import Scene
from msp_sim.model.model import applies

Gains: TypeAlias = tuple[Array, Array]
"""Largest gain of each candidate [nat], and its number there, each (candidates,)."""
SHARES = np.array([1e-4, 3e-4, 1e-3, 3e-3, 0.01, 0.03, 0.1, 0.3])
"""Shares at which the gain of what is mixed into the probability is computed."""
SCORE_STEPS = np.array([0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6])
"""Steps along an efficient score at which its gain is computed, in its standard deviations."""
ODDS_STEPS = np.array([0.1, 0.3, 0.6, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0])
"""Log odds, where an effect acts most, at which its gain is computed."""
ODDS = np.array([2, 3, 4])
"""Places of the three odds in `BASE`."""


def largest_gains(
    readings: ReadingsAtFit, candidates: Sequence[CandidateEffect], information: Array, total: Array
) -> Gains:
    """The largest gain of each candidate.

    Parameters
    ----------
    readings
        At the fit.
    candidates
        All of them `is_rare`.
    information, total
        Of the scores of base and candidates, per reading, and their sums.
    """
    if not candidates:
        return np.zeros(0), np.zeros(0)
    own = np.arange(len(BASE), len(BASE) + len(candidates))
    inner = np.linalg.pinv(information[np.ix_(ODDS, ODDS)], rcond=1e-8, hermitian=True)
    cross = information[np.ix_(own, ODDS)] @ inner
    left = np.diag(information)[own] - np.einsum("ij,ij->i", cross, information[np.ix_(own, ODDS)])
    # The gain along a score is concave: it is below nothing on the side to which the score does not point.
    forward = np.where(total[own] - cross @ total[ODDS] > 0.0, 1.0, -1.0)
    steps = SCORE_STEPS[:, None] * forward / np.sqrt(np.maximum(left, 1e-12))
    sizes, means = _odds_scales(readings.readings, candidates)
    gains = np.zeros((len(candidates), 2 * ODDS_STEPS.size))
    along = np.zeros(steps.shape)
    for _, prepared, here in readings.parts():
        scores = np.stack([score_of(each, prepared, here) for each in candidates])
        efficient = scores - cross @ here.by[:, ODDS].T
        for i, step in enumerate(steps):
            along[i] += _log_gain(efficient * step[:, None]).sum(axis=1)
        for j, candidate in enumerate(candidates):
            if candidate.linear:
                slope = np.maximum(scores[j], -1.0 / 0.31)
                gains[j, : SHARES.size] += np.log1p(SHARES[:, None] * slope[None, :]).sum(axis=1)
            else:
                gains[j] += _odds_gains(candidate, prepared.scene, here, sizes[j], means[j])
    linear = np.array([each.linear for each in candidates], dtype=bool)
    numbers = np.concatenate([ODDS_STEPS, -ODDS_STEPS]) * sizes[:, None]
    numbers[linear] = 0.0
    numbers[linear, : SHARES.size] = SHARES
    low = np.array([each.parameter.low for each in candidates])
    high = np.array([each.parameter.high for each in candidates])
    gains = np.where((numbers < low[:, None]) | (numbers > high[:, None]) | (numbers == 0.0), 0.0, gains)
    best = numbers[np.arange(len(candidates)), gains.argmax(axis=1)]
    return np.maximum(along.max(axis=0, initial=0.0), gains.max(axis=1)), best


def _log_gain(change: Array) -> Array:
    """log(1 + change), and below -0.9 its tangent: to make a reading impossible must cost, whatever the step."""
    gain: Array = np.log1p(np.maximum(change, -0.9)) + 10.0 * np.minimum(change + 0.9, 0.0)
    return gain


def _odds_template(candidate: CandidateEffect, scene: Scene) -> Array:
    """Change of the log odds by a number of 1, (n,)."""
    active = candidate.at(candidate.neutral + candidate.parameter.step)
    known, shape = applies(scene, active), np.shape(scene.range_cm)
    if known is False:
        return np.zeros(shape)
    # It is the only channel that the candidate moves.
    (template,) = templates(known, active.change(scene)).values()
    return np.broadcast_to(template / candidate.parameter.step, shape)


def _odds_scales(readings: Prepared, candidates: Sequence[CandidateEffect]) -> tuple[Array, Array]:
    """For odds, the number that changes them by one where it acts most, and its mean template."""
    scene = Scene(readings.model.sensor, readings.contexts)
    sizes, means = np.ones(len(candidates)), np.zeros(len(candidates))
    for j, candidate in enumerate(candidates):
        if candidate.odds is not None:
            template = _odds_template(candidate, scene)
            largest = float(np.abs(template).max(initial=0.0))
            sizes[j] = 1.0 / largest if largest > 0.0 else 1.0
            means[j] = float(template.mean())
    return sizes, means


def _odds_gains(candidate: CandidateEffect, scene: Scene, here: ChannelSlopes, size: float, mean: float) -> Array:
    """Gain of changed odds about their mean, all else held: exact in the posterior share of the class."""
    which = candidate.odds or 1
    template = _odds_template(candidate, scene) - mean
    share = here.shares[:, which - 1]
    posterior = np.clip(here.by[:, 1 + which] + share, 0.0, 1.0)
    steps = np.concatenate([ODDS_STEPS, -ODDS_STEPS])
    factor = np.expm1(np.clip(steps[:, None] * size * template, -30.0, 30.0))
    gains: Array = (np.log1p(posterior * factor) - np.log1p(share * factor)).sum(axis=1)
    return gains
