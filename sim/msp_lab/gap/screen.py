"""The efficient-score screen: every candidate at once, at the present fit.

From sums of scores by run and their information follow a z for each candidate and a p-value for the largest. The null
is the model's own (information from simulated replicates) where readings are independent, and sign flips of whole runs
where they are not.

A score that rests on a few improbable readings promises too much: of what mixes into the probability, and of odds, the
largest gain in log-likelihood is computed along the score and at values of its number, all else held.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from msp_lab.gap import rules
from msp_lab.gap.candidates import CandidateEffect, score_of
from msp_lab.gap.prepared import BASE, ChannelSlopes, Prepared, templates
from msp_lab.gap.refit import JointFit, inverse, sums_by
from msp_lab.gap.runs import sample, taken
from msp_range.arrays import Array, Flags, Indices
from msp_range.reading_model.rows import Base
from msp_sim.effects.base import Scene
from msp_sim.model.history import History
from msp_sim.model.model import Model, Term, applies
from msp_sim.model.streams import RandomStreams

COPY_S = 1e7
"""Copies of the same contexts are so far apart in time [s] that the noise of one says nothing about the next."""
BLOCK_ROWS = 100
"""Replicates of correlated readings keep so many neighbours together."""
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


@dataclass(frozen=True)
class ScoreSums:
    """Scores of base and candidates over the readings."""

    by_unit: Array
    """Sums of the scores over each unit of evidence, (units, 8 + candidates)."""
    products: Array
    """Sums of products of the scores with each other, over single readings, (8 + candidates, 8 + candidates)."""
    rows: int
    """Number of readings."""
    profile: Callable[[Indices], Gains]
    """Computes the largest gain of a reading's probability for some candidates (`largest_gains`)."""


def score_sums(
    prepared: Prepared,
    base: Base,
    here: ChannelSlopes,
    candidates: Sequence[CandidateEffect],
    unit: Indices,
    information: Array,
    prior: Array | float = 0.0,
) -> ScoreSums:
    """Sums of scores by unit, at a fit with this base and these slopes.

    `prior` is the precision of the base's prior for each reading, (8,). Its slope is part of the base's scores: where
    only the prior holds a number, that one's scores do not sum to zero without it, and a projection on them would
    remove what other scores show.
    """
    units, nb = int(unit.max()) + 1, len(BASE)
    scores = score_matrix(prepared, here, candidates)
    total = sums_by(unit, scores, units)
    total[:, :nb] -= prior * np.array(base) * len(prepared) / units

    def profile(asked: Indices) -> Gains:
        places = np.append(np.arange(nb), nb + asked)
        some, of_some = [candidates[j] for j in asked], information[np.ix_(places, places)]
        return largest_gains(prepared, here, some, scores[:, nb + asked], of_some, total.sum(axis=0)[places])

    return ScoreSums(total, scores.T @ scores, len(prepared), profile)


def score_matrix(prepared: Prepared, here: ChannelSlopes, candidates: Sequence[CandidateEffect]) -> Array:
    """Scores of base and candidates at slopes, (n, 8 + candidates)."""
    # By columns, as they are filled.
    matrix = np.empty((len(prepared), len(BASE) + len(candidates)), order="F")
    matrix[:, : len(BASE)] = here.by
    for j, candidate in enumerate(candidates):
        matrix[:, len(BASE) + j] = score_of(candidate, prepared, here)
    return matrix


def replicate(
    model: Model,
    base: Base,
    effects: Sequence[Term],
    contexts: Mapping[str, Any],
    rng: np.random.Generator,
    rows: int = rules.REPLICATE_ROWS,
    spacing_s: float | None = None,
) -> Prepared:
    """Readings simulated by the present fit at the measured contexts, the contexts repeated or a sample of them."""
    n = contexts["true_range_cm"].size
    at = np.tile(np.arange(n), -(-rows // n))
    if n >= rows:
        at = sample(contexts, np.arange(n), rows, rng, rules.STRETCH if spacing_s is None else BLOCK_ROWS)
    drawn = taken(contexts, at)
    prepared = Prepared.of(model, drawn, np.zeros(at.size), spacing_s)
    if prepared.rows.history is not None and at.size > n and "time_s" in drawn:
        # Each copy of the contexts is a series of its own.
        later = {**drawn, "time_s": drawn["time_s"] + COPY_S * (np.arange(at.size) // n)}
        history = History.of(later, at.size, prepared.rows.history.correlation, prepared.rows.history.spacing_s)
        prepared = replace(prepared, rows=replace(prepared.rows, history=history))
    reading_cm = prepared.at(base, effects).sample(RandomStreams(rng))
    return replace(prepared, reading_cm=reading_cm)


def information_of(
    prepared: Prepared, base: Base, effects: Sequence[Term], candidates: Sequence[CandidateEffect]
) -> Array:
    """Information per reading, (8 + candidates, 8 + candidates), from simulated readings."""
    scores = score_matrix(prepared, prepared.slopes(base, effects), candidates)
    information: Array = scores.T @ scores / len(prepared)
    return information


@dataclass(frozen=True)
class Screen:
    """A z for each candidate."""

    z: Array
    """Each candidate's z, (candidates,); 0 where base and accepted terms leave nothing."""
    gain: Array
    """Half the square of z [nat]."""
    deviation: Array
    """Standard error of each candidate's number if it were fitted alone."""
    largest: float
    critical: float
    """The largest |z|, and the value that it passes with probability alpha where nothing is missing."""
    p_value: float
    """p-value of the largest of those that are no numbers of the base."""
    best: Array
    """Numbers at which a candidate gains most, of those that were asked; NaN for the others."""

    @property
    def needed_nats(self) -> float:
        """What a term has to gain to come in [nat]."""
        return 0.5 * self.critical**2


def screen(
    measured: ScoreSums,
    information: Array,
    candidates: Sequence[CandidateEffect],
    nuisance: Indices,
    by_run: bool,
    alpha: float,
    rng: np.random.Generator,
) -> Screen:
    """Efficient scores, and the p-value of the largest.

    Parameters
    ----------
    measured
        Score sums of the readings.
    information
        Per reading, (8 + candidates, 8 + candidates), from `information_of`.
    candidates
        What is tested.
    nuisance
        Places in the information of what the model has: the base's numbers that are free at the fit, and candidates.
        A number that is held at a bound has a score sum that is not 0, so that projecting on it would remove evidence.
    by_run
        Whether the unit is the run.
    alpha, rng
        Of the critical value.
    """
    nb, count = len(BASE), len(candidates)
    others = np.arange(nb, nb + count)
    cross = information[np.ix_(others, nuisance)] @ inverse(information[np.ix_(nuisance, nuisance)])
    efficient = information[np.ix_(others, others)] - cross @ information[np.ix_(nuisance, others)]
    own, left = np.diag(information)[others], np.diag(efficient)
    testable = (own > 0.0) & (left > rules.COLLINEAR * own)
    left = np.where(testable, left, 1.0)
    variance = left * measured.rows
    by_unit = measured.by_unit[:, others] - measured.by_unit[:, nuisance] @ cross.T
    # Score sums of what is fitted are zero in total, and not by unit.
    total = by_unit.sum(axis=0)
    turned = np.concatenate([-cross, np.eye(count)], axis=1)
    some = np.concatenate([nuisance, others])
    single = np.einsum("ij,jk,ik->i", turned, measured.products[np.ix_(some, some)], turned)
    # Against single readings as they are, not as the model has them: what is large is not dependent for it.
    beyond_model = np.maximum(variance, single)
    inflation = np.maximum(_scatter(by_unit) / beyond_model, 1.0) if by_run else np.ones(count)
    z = np.where(testable, total / np.sqrt(variance * inflation), 0.0)
    one_sided = np.array([candidate.one_sided for candidate in candidates], dtype=bool)
    z = np.where(one_sided & (z < 0.0), 0.0, z)
    # What rests on a few improbable readings is far from normal: it is worth no more than it gains.
    rare = np.array([candidate.is_rare for candidate in candidates], dtype=bool)
    asked = np.flatnonzero(rare & (np.abs(z) > rules.PROFILED_Z))
    gains, best = np.full(count, np.inf), np.full(count, np.nan)
    gains[asked], best[asked] = measured.profile(asked)
    z = np.sign(z) * np.minimum(np.abs(z), np.sqrt(2.0 * gains / inflation))
    null = _flipped(by_unit, variance, rng) if by_run else _drawn(efficient, testable, rng)
    null = np.where(testable & ~(one_sided & (null < 0.0)), null, 0.0)
    critical = float(np.quantile(np.abs(null).max(axis=1, initial=0.0), 1.0 - alpha))
    # Noise with tails makes every score scatter more than the model's own; what is rare is worth what it gains beyond
    # the search for its shape.
    squares = z**2 * np.where(rare, 1.0, variance / beyond_model)
    squares -= np.where(rare, 2.0 * np.array([candidate.cost_nats for candidate in candidates]), 0.0)
    deviation = np.where(testable, np.sqrt(inflation / variance), np.inf)
    largest = float(np.abs(z).max(initial=0.0))
    return Screen(z, 0.5 * z**2, deviation, largest, critical, _p_value(squares, null, candidates), best)


def _scatter(by_unit: Array) -> Array:
    """Variance of each sum over the units, by how these scatter, (candidates,)."""
    units = by_unit.shape[0]
    off = by_unit - by_unit.sum(axis=0) / units
    scatter: Array = (off**2).sum(axis=0) * units / max(units - 1, 1)
    return scatter


def _drawn(efficient: Array, testable: Flags, rng: np.random.Generator) -> Array:
    """Scores of tables in which nothing is missing, as the model correlates them, (draws, candidates)."""
    left = np.where(testable, np.diag(efficient), 1.0)
    correlation = np.where(np.outer(testable, testable), efficient / np.sqrt(np.outer(left, left)), 0.0)
    values, vectors = np.linalg.eigh(correlation)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    drawn: Array = rng.standard_normal((rules.SCREEN_DRAWS, root.shape[1])) @ root.T
    return drawn


def _p_value(squares: Array, null: Array, candidates: Sequence[CandidateEffect]) -> float:
    """How often a table without an effect has so large a score; a number of the base is calibration, and none."""
    missing = np.array([not candidate.is_base for candidate in candidates], dtype=bool)
    largest = np.sqrt(max(float(squares[missing].max(initial=0.0)), 0.0))
    beyond = np.abs(null[:, missing]).max(axis=1, initial=0.0) >= largest
    return float((1 + np.sum(beyond)) / (1 + rules.SCREEN_DRAWS))


def _flipped(by_unit: Array, variance: Array, rng: np.random.Generator) -> Array:
    """z of sums whose runs have random signs, (draws, candidates)."""
    units = by_unit.shape[0]
    signs = rng.choice((-1.0, 1.0), (rules.SCREEN_DRAWS, units))
    sums = signs @ by_unit
    # A flip keeps the sum of squares, so the spread is that of the flipped sums about their own mean.
    squares = np.maximum((by_unit**2).sum(axis=0) - sums**2 / units, 1e-300)
    null: Array = sums / np.sqrt(np.maximum(squares * units / max(units - 1, 1), variance))
    return null


def best_by_score(prepared: Prepared, fit: JointFit, placed: Sequence[CandidateEffect]) -> Term:
    """The shape of a candidate that gains most by one Newton step, in which the fit's own numbers move too.

    A bend turns what is beyond it, and most of that is the scale's and the offset's to take back.
    """
    scores = [score_of(candidate, prepared, fit.here) for candidate in placed]
    own, others = fit.at.scores[:, ~fit.at.held], np.column_stack(scores)
    left = others - own @ np.linalg.lstsq(own, others, rcond=1e-8)[0]
    information = np.maximum((left**2).sum(axis=0), 1e-12)
    steps = others.sum(axis=0) / information
    if placed[0].one_sided:
        steps = np.maximum(steps, 0.0)
    best = int(np.argmax(steps**2 * information))
    return placed[best].at(placed[best].from_score(float(steps[best])))


def largest_gains(
    prepared: Prepared,
    here: ChannelSlopes,
    candidates: Sequence[CandidateEffect],
    scores: Array,
    information: Array,
    total: Array,
) -> Gains:
    """The largest gain of each candidate.

    Parameters
    ----------
    prepared, here
        Readings, and their slopes at the fit.
    candidates, scores
        All of them `is_rare`, and their scores, (n, candidates).
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
    efficient = scores - here.by[:, ODDS] @ cross.T
    found, best = np.zeros(len(candidates)), np.zeros(len(candidates))
    for j, (candidate, slope) in enumerate(zip(candidates, scores.T, strict=True)):
        along = _log_gain(efficient[:, j] * steps[:, j, None]).sum(axis=1)
        if candidate.linear:
            numbers = SHARES
            gains = np.log1p(SHARES[:, None] * np.maximum(slope, -1.0 / 0.31)).sum(axis=1)
        else:
            numbers, gains = _odds_gains(candidate, prepared.scene, here)
        possible = (numbers >= candidate.parameter.low) & (numbers <= candidate.parameter.high)
        gains = np.where(possible, gains, 0.0)
        found[j] = max(float(along.max()), float(gains.max()), 0.0)
        best[j] = numbers[gains.argmax()]
    return found, best


def _log_gain(change: Array) -> Array:
    """log(1 + change), and below -0.9 its tangent: to make a reading impossible must cost, whatever the step."""
    gain: Array = np.log1p(np.maximum(change, -0.9)) + 10.0 * np.minimum(change + 0.9, 0.0)
    return gain


def _odds_gains(candidate: CandidateEffect, scene: Scene, here: ChannelSlopes) -> tuple[Array, Array]:
    """Numbers that change odds by some steps where they act most, and the gain of each about the mean change.

    All else is held, so that it is exact in the posterior share of the class.
    """
    active = candidate.at(candidate.neutral + candidate.parameter.step)
    known, template = applies(scene, active), np.zeros(np.shape(scene.range_cm))
    if known is not False:
        # It is the only channel that the candidate moves.
        (moved,) = templates(known, active.change(scene)).values()
        template = np.broadcast_to(moved / candidate.parameter.step, template.shape)
    which = candidate.odds or 1
    numbers = np.concatenate([ODDS_STEPS, -ODDS_STEPS]) / (float(np.abs(template).max(initial=0.0)) or 1.0)
    share = here.shares[:, which - 1]
    posterior = np.clip(here.by[:, 1 + which] + share, 0.0, 1.0)
    factor = np.expm1(np.clip(numbers[:, None] * (template - template.mean()), -30.0, 30.0))
    gains: Array = (np.log1p(posterior * factor) - np.log1p(share * factor)).sum(axis=1)
    return numbers, gains
