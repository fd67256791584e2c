"""The efficient-score screen: every candidate at once, at the present fit.

Sums of scores by run and their information enter; a z for each candidate and a p-value for the largest leave. The null
is the model's own (information from simulated replicates) where readings are independent, and sign flips of whole runs
where they are not. Readings are processed in chunks, so memory does not grow with their number.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from msp_lab.gap import rules
from msp_lab.gap.candidates import CandidateEffect, change_of, score_of
from msp_lab.gap.prepared import BASE, ChannelSlopes, Prepared, channel_slopes, chunks
from msp_sim.effects.base import Scene
from msp_sim.model.history import History
from msp_sim.model.model import Model, Term, applies
from msp_sim.model.streams import RandomStreams

_Array = NDArray[np.float64]
SHARES = np.array([1e-4, 3e-4, 1e-3, 3e-3, 0.01, 0.03, 0.1, 0.3])
"""At which the gain of what is mixed into the probability is computed."""
SCORE_STEPS = np.array([0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6])
"""Steps along an efficient score at which its gain is computed, in its standard deviations."""
ODDS_STEPS = np.array([0.1, 0.3, 0.6, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0])
"""Log odds, where an effect acts most, at which its gain is computed."""
COPY_S = 1e7
"""Copies of the same contexts are so far apart in time [s] that the noise of one says nothing about the next."""
BLOCK_ROWS = 100
"""Of correlated readings, replicates keep so many neighbours together."""
ODDS = np.array([2, 3, 4])
"""Places of the three odds in `BASE`."""


@dataclass(frozen=True)
class ScoreSums:
    """Scores of base and candidates over the readings.

    Attributes
    ----------
    by_unit
        (units, 8 + candidates).
    products
        (8 + candidates, 8 + candidates): of the scores with each other, over single readings; of many from a part.
    profile
        (candidates,): for what mixes into the probability, and for odds, twice the largest gain with all else held
        [nat]; infinite for the others.
    best
        The number at which that is; NaN for the others.
    rows
        Readings.
    """

    by_unit: _Array
    products: _Array
    profile: _Array
    best: _Array
    rows: int


def score_sums(
    model: Model,
    base: _Array,
    effects: Sequence[Term],
    candidates: Sequence[CandidateEffect],
    contexts: Mapping[str, Any],
    reading_cm: _Array,
    unit: NDArray[np.intp],
    information: _Array,
    spacing_s: float | None = None,
) -> ScoreSums:
    """Sums of scores by unit, in chunks; with a spacing, of correlated readings."""
    units = int(unit.max()) + 1
    total = np.zeros((units, len(BASE) + len(candidates)))
    products = np.zeros((total.shape[1], total.shape[1]))
    stride = max(1, reading_cm.size // rules.PRODUCT_ROWS)
    linear = np.array([each.linear for each in candidates], dtype=bool)
    rare = np.array([each.linear or each.odds is not None for each in candidates], dtype=bool)
    own = len(BASE) + np.flatnonzero(rare)
    inner = np.linalg.pinv(information[np.ix_(ODDS, ODDS)], rcond=1e-8, hermitian=True)
    cross = information[np.ix_(own, ODDS)] @ inner
    left = np.diag(information)[own] - np.einsum("ij,ij->i", cross, information[np.ix_(own, ODDS)])
    steps = SCORE_STEPS[:, None] / np.sqrt(np.maximum(left, 1e-12))
    sizes, means = _odds_scales(model, candidates, contexts)
    gains = np.zeros((len(candidates), 2 * ODDS_STEPS.size))
    along = np.zeros((2 * SCORE_STEPS.size, own.size))
    for part, columns, reading in chunks(contexts, reading_cm):
        prepared = Prepared.of(model, columns, reading, spacing_s)
        here = channel_slopes(prepared.at(base, effects), reading)
        scores = _matrix(prepared.scene, reading, here, candidates)
        place = csr_matrix((np.ones(reading.size), (unit[part], np.arange(reading.size))), (units, reading.size))
        total += place @ scores
        some = scores[::stride]
        products += stride * (some.T @ some)
        efficient = scores[:, own] - scores[:, ODDS] @ cross.T
        for i, step in enumerate(steps):
            along[i] += _log_gain(efficient * step).sum(axis=0)
            along[SCORE_STEPS.size + i] += _log_gain(-efficient * step).sum(axis=0)
        for j, candidate in enumerate(candidates):
            if candidate.linear:
                slope = np.maximum(scores[:, len(BASE) + j], -1.0 / 0.31)
                gains[j, : SHARES.size] += np.log1p(SHARES[:, None] * slope[None, :]).sum(axis=1)
            elif candidate.odds is not None:
                gains[j] += _odds_gains(candidate, prepared.scene, here, sizes[j], means[j])
    numbers = np.concatenate([ODDS_STEPS, -ODDS_STEPS]) * sizes[:, None]
    numbers[linear] = 0.0
    numbers[linear, : SHARES.size] = SHARES
    low = np.array([each.parameter.low for each in candidates])
    high = np.array([each.parameter.high for each in candidates])
    gains = np.where((numbers < low[:, None]) | (numbers > high[:, None]) | (numbers == 0.0), 0.0, gains)
    best = np.where(rare, numbers[np.arange(len(candidates)), gains.argmax(axis=1)], np.nan)
    profile = np.full(len(candidates), np.inf)
    profile[rare] = 2.0 * np.maximum(along.max(axis=0, initial=0.0), gains.max(axis=1)[rare])
    return ScoreSums(total, products, profile, best, reading_cm.size)


def _log_gain(change: _Array) -> _Array:
    """log(1 + change), and below -0.9 its tangent: to make a reading impossible must cost, whatever the step."""
    gain: _Array = np.log1p(np.maximum(change, -0.9)) + 10.0 * np.minimum(change + 0.9, 0.0)
    return gain


def _odds_template(candidate: CandidateEffect, scene: Scene) -> _Array:
    """Change of the log odds by a number of 1, (n,)."""
    active = candidate.at(candidate.neutral + candidate.parameter.step)
    known = applies(scene, active)
    n = int(np.shape(scene.range_cm)[0])
    if known is False:
        return np.zeros(n)
    change = change_of(scene, active)
    moved = (change.log_odds_short, change.log_odds_missed, change.log_odds_random)[(candidate.odds or 1) - 1]
    return np.broadcast_to(np.nan_to_num(np.where(known, moved, 0.0)) / candidate.parameter.step, (n,))


def _odds_scales(
    model: Model, candidates: Sequence[CandidateEffect], contexts: Mapping[str, Any]
) -> tuple[_Array, _Array]:
    """For odds, the number that changes them by one where it acts most, and its mean template, from some rows."""
    n = np.shape(contexts["true_range_cm"])[0]
    some = {name: np.asarray(column)[:: max(1, n // 5000)] for name, column in contexts.items()}
    scene = Scene(model.sensor, some)
    sizes, means = np.ones(len(candidates)), np.zeros(len(candidates))
    for j, candidate in enumerate(candidates):
        if candidate.odds is not None:
            template = _odds_template(candidate, scene)
            largest = float(np.abs(template).max(initial=0.0))
            sizes[j] = 1.0 / largest if largest > 0.0 else 1.0
            means[j] = float(template.mean())
    return sizes, means


def _odds_gains(candidate: CandidateEffect, scene: Scene, here: ChannelSlopes, size: float, mean: float) -> _Array:
    """Gain of changed odds about their mean, all else held: exact in the posterior share of the class."""
    which = candidate.odds or 1
    template = _odds_template(candidate, scene) - mean
    share = here.shares[:, which - 1]
    posterior = np.clip(here.by[:, 1 + which] + share, 0.0, 1.0)
    steps = np.concatenate([ODDS_STEPS, -ODDS_STEPS])
    factor = np.expm1(np.clip(steps[:, None] * size * template, -30.0, 30.0))
    gains: _Array = (np.log1p(posterior * factor) - np.log1p(share * factor)).sum(axis=1)
    return gains


def score_matrix(
    prepared: Prepared, base: _Array, effects: Sequence[Term], candidates: Sequence[CandidateEffect]
) -> _Array:
    """Scores of base and candidates, (n, 8 + candidates)."""
    here = channel_slopes(prepared.at(base, effects), prepared.reading_cm)
    return _matrix(prepared.scene, prepared.reading_cm, here, candidates)


def _matrix(scene: Scene, reading_cm: _Array, here: ChannelSlopes, candidates: Sequence[CandidateEffect]) -> _Array:
    matrix = np.empty((reading_cm.size, len(BASE) + len(candidates)))
    matrix[:, : len(BASE)] = here.by
    for j, candidate in enumerate(candidates):
        matrix[:, len(BASE) + j] = score_of(candidate, here.rows, scene, reading_cm, here)
    return matrix


def replicate(
    model: Model,
    base: _Array,
    effects: Sequence[Term],
    contexts: Mapping[str, Any],
    rng: np.random.Generator,
    rows: int = rules.REPLICATE_ROWS,
    spacing_s: float | None = None,
) -> Prepared:
    """Readings simulated by the present fit at the measured contexts, the contexts repeated or thinned."""
    n = np.shape(contexts["true_range_cm"])[0]
    at = np.linspace(0, n - 1, rows).astype(np.intp) if n >= rows else np.tile(np.arange(n), -(-rows // n))
    if spacing_s is not None and n >= rows:
        # Neighbours stay neighbours: blocks of readings, spread over the whole.
        blocks = np.linspace(0, n - BLOCK_ROWS, -(-rows // BLOCK_ROWS)).astype(np.intp)
        at = (blocks[:, None] + np.arange(BLOCK_ROWS)).ravel()
    drawn = {name: np.asarray(column)[at] for name, column in contexts.items()}
    prepared = Prepared.of(model, drawn, np.zeros(at.size), spacing_s)
    if prepared.rows.history is not None and at.size > n and "time_s" in drawn:
        # Each copy of the contexts is a series of its own.
        later = {**drawn, "time_s": np.asarray(drawn["time_s"], float) + COPY_S * (np.arange(at.size) // n)}
        history = History.of(later, at.size, prepared.rows.history.correlation, prepared.rows.history.spacing_s)
        prepared = replace(prepared, rows=replace(prepared.rows, history=history))
    reading_cm = prepared.at(base, effects).sample(RandomStreams(rng))
    return replace(prepared, reading_cm=reading_cm)


def information_of(
    prepared: Prepared, base: _Array, effects: Sequence[Term], candidates: Sequence[CandidateEffect]
) -> _Array:
    """Information per reading, (8 + candidates, 8 + candidates), from simulated readings."""
    scores = score_matrix(prepared, base, effects, candidates)
    information: _Array = scores.T @ scores / len(prepared)
    return information


@dataclass(frozen=True)
class Screen:
    """A z for each candidate.

    Attributes
    ----------
    z
        (candidates,); 0 where base and accepted terms leave nothing.
    gain
        Half the square of z [nat].
    deviation
        Standard error of each candidate's number if it were fitted alone.
    largest, critical
        The largest |z|, and the value that it passes with probability alpha where nothing is missing.
    p_value
        Of the largest of those that are no numbers of the base.
    best
        Numbers at which the profile is highest; NaN where there is none.
    """

    z: _Array
    gain: _Array
    deviation: _Array
    largest: float
    critical: float
    p_value: float
    best: _Array

    @property
    def needed_nats(self) -> float:
        """What a term has to gain to come in [nat]."""
        return 0.5 * self.critical**2


def screen(
    measured: ScoreSums,
    information: _Array,
    candidates: Sequence[CandidateEffect],
    accepted: Sequence[int],
    free: NDArray[np.bool_],
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
    accepted
        Places of those that the model has: nuisance for the others.
    free
        Numbers of the base that are free at the fit, (7,). One that is held at a bound has a score sum that is not 0,
        so that projecting on it would remove evidence.
    by_run
        Whether the unit is the run.
    alpha, rng
        Of the critical value.
    """
    nb, count = len(BASE), len(candidates)
    nuisance = np.array([*np.flatnonzero(free), *(nb + j for j in accepted)])
    others = np.arange(nb, nb + count)
    cross = _projection(information, nuisance, others)
    efficient = information[np.ix_(others, others)] - cross @ information[np.ix_(nuisance, others)]
    own, left = np.diag(information)[others], np.diag(efficient)
    testable = (own > 0.0) & (left > rules.COLLINEAR * own)
    if accepted:
        testable[list(accepted)] = False
    left = np.where(testable, left, 1.0)
    variance = left * measured.rows
    by_unit = measured.by_unit[:, others] - measured.by_unit[:, nuisance] @ cross.T
    # Score sums of what is fitted are zero in total, and not by unit.
    total = by_unit.sum(axis=0)
    turned = np.concatenate([-cross, np.eye(count)], axis=1)
    some = np.concatenate([nuisance, others])
    single = np.einsum("ij,jk,ik->i", turned, measured.products[np.ix_(some, some)], turned)
    inflation = np.ones(count)
    if by_run:
        units = by_unit.shape[0]
        of_runs = ((by_unit - total / units) ** 2).sum(axis=0) * units / max(units - 1, 1)
        # Against single readings as they are, not as the model has them: what is large is not dependent for it.
        inflation = np.maximum(of_runs / np.maximum(variance, single), 1.0)
    z = np.where(testable, total / np.sqrt(variance * inflation), 0.0)
    one_sided = np.array([each.one_sided for each in candidates], dtype=bool)
    z = np.where(one_sided & (z < 0.0), 0.0, z)
    # What rests on a few improbable readings is far from normal: it is worth no more than it gains.
    z = np.sign(z) * np.minimum(np.abs(z), np.sqrt(measured.profile / inflation))
    if by_run:
        null = np.where(testable, _flipped(by_unit, variance, rng), 0.0)
    else:
        correlation = efficient / np.sqrt(np.outer(left, left))
        correlation = np.where(np.outer(testable, testable), correlation, 0.0)
        values, vectors = np.linalg.eigh(correlation)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        null = rng.standard_normal((rules.SCREEN_DRAWS, root.shape[1])) @ root.T
    null = np.where(one_sided & (null < 0.0), 0.0, null)
    critical = float(np.quantile(np.abs(null).max(axis=1, initial=0.0), 1.0 - alpha))
    # A number of the base that is another one is calibration, and nothing missing.
    missing = np.array([not each.is_base for each in candidates], dtype=bool)
    # Noise with tails makes every score scatter more than the model's own; what is rare is worth what it gains beyond
    # the search for its shape.
    rare = np.isfinite(measured.profile)
    squares = z**2 * np.where(rare, 1.0, variance / np.maximum(variance, single))
    squares -= np.where(rare, 2.0 * np.array([each.cost_nats for each in candidates]), 0.0)
    scattered = np.sqrt(np.maximum(squares, 0.0))
    beyond = np.abs(null[:, missing]).max(axis=1, initial=0.0) >= scattered[missing].max(initial=0.0)
    p_value = float((1 + np.sum(beyond)) / (1 + rules.SCREEN_DRAWS))
    deviation = np.where(testable, np.sqrt(inflation / variance), np.inf)
    largest = float(np.abs(z).max(initial=0.0))
    return Screen(z, 0.5 * z**2, deviation, largest, critical, p_value, measured.best)


def _projection(information: _Array, nuisance: NDArray[np.intp], others: NDArray[np.intp]) -> _Array:
    """Coefficients of the others' scores on the nuisance's, (others, nuisance)."""
    inner = information[np.ix_(nuisance, nuisance)]
    scale = np.sqrt(np.maximum(np.diag(inner), 1e-12))
    inverse = np.linalg.pinv(inner / np.outer(scale, scale), rcond=1e-8, hermitian=True) / np.outer(scale, scale)
    coefficients: _Array = information[np.ix_(others, nuisance)] @ inverse
    return coefficients


def _flipped(by_unit: _Array, variance: _Array, rng: np.random.Generator) -> _Array:
    """z of sums whose runs have random signs, (draws, candidates)."""
    units = by_unit.shape[0]
    signs = rng.choice((-1.0, 1.0), (rules.SCREEN_DRAWS, units))
    sums = signs @ by_unit
    # A flip keeps the sum of squares, so the spread is that of the flipped sums about their own mean.
    squares = np.maximum((by_unit**2).sum(axis=0) - sums**2 / units, 1e-300)
    null: _Array = sums / np.sqrt(np.maximum(squares * units / max(units - 1, 1), variance))
    return null
