"""The efficient-score screen: every entry of the catalogue at once, at the present fit.

Sums of scores by run and their information enter, one z an entry and a p-value for the largest leave. The null is the
model's own (information from simulated twins) where readings are independent, and sign flips of whole runs where they
are not. Readings are taken in chunks, so memory does not grow with their number.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from msp_lab.gap.tangent import BASE, Channels, Entry, Prepared, channels, chunks, of_entry
from msp_sim.effects.base import Scene
from msp_sim.model.model import Active, Model, acts
from msp_sim.model.rows import Rows
from msp_sim.model.streams import Streams

_Array = NDArray[np.float64]
TWIN_ROWS = 6_000
PRODUCT_ROWS = 20_000
"""Rows whose products are taken; of more, every k-th."""
GRID = np.array([1e-4, 3e-4, 1e-3, 3e-3, 0.01, 0.03, 0.1, 0.3])
"""Of what is mixed into the probability, in units of its number."""
TANGENT = np.array([0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6])
"""Of the way along an efficient score, in its standard deviations."""
STEPS = np.array([0.1, 0.3, 0.6, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0])
"""Of log odds where an effect acts most."""
DRAWS = 2_000
COLLINEAR = 1e-3
"""An entry of which the nuisance leaves less than this share cannot be told from it."""


@dataclass(frozen=True)
class Sums:
    """Scores of base and entries over the readings.

    Attributes
    ----------
    by_unit
        (units, 7 + entries).
    products
        (7 + entries, 7 + entries): of the scores with each other, over single readings; of many from a part of them.
    profile
        (entries,): for what mixes into the probability, and for odds, twice the largest gain with all else held [nat];
        infinite for the others.
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


def sums(
    model: Model,
    base: _Array,
    effects: Sequence[Active],
    tested: Sequence[Entry],
    contexts: Mapping[str, Any],
    reading_cm: _Array,
    unit: NDArray[np.intp],
    information: _Array,
) -> Sums:
    """Sums of scores by unit, in chunks."""
    units = int(unit.max()) + 1
    total = np.zeros((units, len(BASE) + len(tested)))
    products = np.zeros((total.shape[1], total.shape[1]))
    stride = max(1, reading_cm.size // PRODUCT_ROWS)
    linear = np.array([entry.linear for entry in tested], dtype=bool)
    rare = np.array([entry.linear or entry.odds is not None for entry in tested], dtype=bool)
    classes = np.array([2, 3, 4])
    own = len(BASE) + np.flatnonzero(rare)
    inner = np.linalg.pinv(information[np.ix_(classes, classes)], rcond=1e-8, hermitian=True)
    cross = information[np.ix_(own, classes)] @ inner
    left = np.diag(information)[own] - np.einsum("ij,ij->i", cross, information[np.ix_(own, classes)])
    steps = TANGENT[:, None] / np.sqrt(np.maximum(left, 1e-12))
    sizes, means = _sizes(model, tested, contexts)
    gains = np.zeros((len(tested), 2 * STEPS.size))
    along = np.zeros((2 * TANGENT.size, own.size))
    for part, columns, reading in chunks(contexts, reading_cm):
        prepared = Prepared.of(model, columns, reading)
        rows = prepared.at(base, effects)
        here = channels(rows, reading)
        scores = _matrix(rows, prepared.scene, reading, here, tested)
        place = csr_matrix((np.ones(reading.size), (unit[part], np.arange(reading.size))), (units, reading.size))
        total += place @ scores
        some = scores[::stride]
        products += stride * (some.T @ some)
        efficient = scores[:, own] - scores[:, classes] @ cross.T
        for i, step in enumerate(steps):
            along[i] += _log_gain(efficient * step).sum(axis=0)
            along[TANGENT.size + i] += _log_gain(-efficient * step).sum(axis=0)
        for j, entry in enumerate(tested):
            if entry.linear:
                slope = np.maximum(scores[:, len(BASE) + j], -1.0 / 0.31)
                gains[j, : GRID.size] += np.log1p(GRID[:, None] * slope[None, :]).sum(axis=1)
            elif entry.odds is not None:
                gains[j] += _odds_gains(entry, prepared.scene, here, sizes[j], means[j])
    numbers = np.concatenate([STEPS, -STEPS]) * sizes[:, None]
    numbers[linear] = 0.0
    numbers[linear, : GRID.size] = GRID
    low = np.array([entry.parameter.low for entry in tested])
    high = np.array([entry.parameter.high for entry in tested])
    gains = np.where((numbers < low[:, None]) | (numbers > high[:, None]) | (numbers == 0.0), 0.0, gains)
    best = np.where(rare, numbers[np.arange(len(tested)), gains.argmax(axis=1)], np.nan)
    profile = np.full(len(tested), np.inf)
    profile[rare] = 2.0 * np.maximum(along.max(axis=0, initial=0.0), gains.max(axis=1)[rare])
    return Sums(total, products, profile, best, reading_cm.size)


def _log_gain(change: _Array) -> _Array:
    """log(1 + change), and below -0.9 its tangent: what makes a reading impossible gains nothing by being cut off."""
    gain: _Array = np.log1p(np.maximum(change, -0.9)) + 10.0 * np.minimum(change + 0.9, 0.0)
    return gain


def _template(entry: Entry, scene: Scene) -> _Array:
    """Log odds by a number of 1, where it acts."""
    active = entry.at((entry.parameter.null or 0.0) + entry.parameter.step)
    known = acts(scene, active)
    n = int(np.shape(scene.range_cm)[0])
    if known is False:
        return np.zeros(n)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        change = active.effect.act(scene, active.values)
    moved = (change.log_odds_short, change.log_odds_missed, change.log_odds_random)[(entry.odds or 1) - 1]
    return np.broadcast_to(np.nan_to_num(np.where(known, moved, 0.0)) / entry.parameter.step, (n,))


def _sizes(model: Model, tested: Sequence[Entry], contexts: Mapping[str, Any]) -> tuple[_Array, _Array]:
    """For odds, the number that changes them by one where it acts most, and its mean template, as of some rows."""
    n = np.shape(contexts["true_range_cm"])[0]
    some = {name: np.asarray(column)[:: max(1, n // 5000)] for name, column in contexts.items()}
    scene = Scene(model.sensor, some)
    sizes, means = np.ones(len(tested)), np.zeros(len(tested))
    for j, entry in enumerate(tested):
        if entry.odds is not None:
            template = _template(entry, scene)
            largest = float(np.abs(template).max(initial=0.0))
            sizes[j] = 1.0 / largest if largest > 0.0 else 1.0
            means[j] = float(template.mean())
    return sizes, means


def _odds_gains(entry: Entry, scene: Scene, here: Channels, size: float, mean: float) -> _Array:
    """Gain of changed odds beside their mean, all else held: exact in the posterior share of the class."""
    which = entry.odds or 1
    template = _template(entry, scene) - mean
    share = here.shares[:, which - 1]
    posterior = np.clip(here.by[:, 1 + which] + share, 0.0, 1.0)
    steps = np.concatenate([STEPS, -STEPS])
    factor = np.expm1(np.clip(steps[:, None] * size * template, -30.0, 30.0))
    gains: _Array = (np.log1p(posterior * factor) - np.log1p(share * factor)).sum(axis=1)
    return gains


def score_matrix(prepared: Prepared, base: _Array, effects: Sequence[Active], tested: Sequence[Entry]) -> _Array:
    """Scores of base and entries, (n, 7 + entries)."""
    rows = prepared.at(base, effects)
    here = channels(rows, prepared.reading_cm)
    return _matrix(rows, prepared.scene, prepared.reading_cm, here, tested)


def _matrix(rows: Rows, scene: Scene, reading_cm: _Array, here: Channels, tested: Sequence[Entry]) -> _Array:
    matrix = np.empty((reading_cm.size, len(BASE) + len(tested)))
    matrix[:, : len(BASE)] = here.by
    for j, entry in enumerate(tested):
        matrix[:, len(BASE) + j] = of_entry(entry, rows, scene, reading_cm, here)
    return matrix


def twin(
    model: Model,
    base: _Array,
    effects: Sequence[Active],
    contexts: Mapping[str, Any],
    rng: np.random.Generator,
    rows: int = TWIN_ROWS,
) -> Prepared:
    """Readings simulated by the present fit at the measured contexts, the contexts repeated or thinned."""
    n = np.shape(contexts["true_range_cm"])[0]
    at = np.linspace(0, n - 1, rows).astype(np.intp) if n >= rows else np.tile(np.arange(n), -(-rows // n))
    drawn = {name: np.asarray(column)[at] for name, column in contexts.items()}
    prepared = Prepared.of(model, drawn, np.zeros(at.size))
    reading_cm = prepared.at(base, effects).sample(Streams(rng))
    return Prepared(model, prepared.scene, prepared.rows, reading_cm)


@dataclass(frozen=True)
class Screen:
    """One z an entry.

    Attributes
    ----------
    z
        (entries,); 0 where the nuisance leaves nothing.
    gain
        Half the square of z [nat].
    deviation
        Standard error of each entry's number if it were fitted alone.
    correlation
        (entries, entries) of the efficient scores.
    largest, critical
        The largest |z|, and the value that it passes with probability alpha where nothing is there.
    p_value
        Of the largest of those that are no numbers of the base.
    inflation
        Variance of the sums over runs against that of independent readings; 1 where they are independent.
    best
        Numbers at which the profile is highest; NaN where there is none.
    """

    z: _Array
    gain: _Array
    deviation: _Array
    correlation: _Array
    largest: float
    critical: float
    p_value: float
    inflation: _Array
    best: _Array


def screen(
    measured: Sums,
    information: _Array,
    tested: Sequence[Entry],
    accepted: Sequence[int],
    by_run: bool,
    alpha: float,
    rng: np.random.Generator,
) -> Screen:
    """Efficient scores and the p-value of the largest.

    Parameters
    ----------
    measured
        Of the readings.
    information
        A reading's, (7 + entries, 7 + entries), from twins.
    tested
        Entries.
    accepted
        Those that the model has, nuisance for the others.
    by_run
        Whether the unit is the run.
    alpha, rng
        Of the critical value.
    """
    nb = len(BASE)
    nuisance = np.array([*range(nb), *(nb + j for j in accepted)])
    others = np.arange(nb, nb + len(tested))
    inner = information[np.ix_(nuisance, nuisance)]
    scale = np.sqrt(np.maximum(np.diag(inner), 1e-12))
    inverse = np.linalg.pinv(inner / np.outer(scale, scale), rcond=1e-8, hermitian=True) / np.outer(scale, scale)
    cross = information[np.ix_(others, nuisance)] @ inverse
    efficient = information[np.ix_(others, others)] - cross @ information[np.ix_(nuisance, others)]
    own = np.diag(information)[others]
    left = np.diag(efficient)
    testable = (own > 0.0) & (left > COLLINEAR * own)
    if accepted:
        testable[list(accepted)] = False
    variance = np.where(testable, left, 1.0) * measured.rows
    by_unit = measured.by_unit[:, others] - measured.by_unit[:, nuisance] @ cross.T
    # Score sums of what is fitted are zero in total, and not by unit.
    total = by_unit.sum(axis=0)
    correlation = efficient / np.sqrt(np.outer(np.where(testable, left, 1.0), np.where(testable, left, 1.0)))
    correlation = np.where(np.outer(testable, testable), correlation, 0.0)
    turned = np.concatenate([-cross, np.eye(others.size)], axis=1)
    some = np.concatenate([nuisance, others])
    single = np.einsum("ij,jk,ik->i", turned, measured.products[np.ix_(some, some)], turned)
    inflation = np.ones(total.size)
    if by_run:
        units = by_unit.shape[0]
        centred = by_unit - total / units
        of_runs = (centred**2).sum(axis=0) * units / max(units - 1, 1)
        # Against single readings as they are, not as the model has them: what is large is not dependent for it.
        inflation = np.maximum(of_runs / np.maximum(variance, single), 1.0)
    z = np.where(testable, total / np.sqrt(variance * inflation), 0.0)
    one_sided = np.array([entry.one_sided for entry in tested], dtype=bool)
    z = np.where(one_sided & (z < 0.0), 0.0, z)
    # What rests on a few improbable readings is far from normal: it is worth no more than it gains.
    z = np.sign(z) * np.minimum(np.abs(z), np.sqrt(measured.profile / inflation))
    largest = float(np.abs(z).max(initial=0.0))
    if by_run:
        signs = rng.choice((-1.0, 1.0), (DRAWS, by_unit.shape[0]))
        # A flip keeps the sum of squares, so the spread is that of the flipped sums about their own mean.
        units = by_unit.shape[0]
        squares = np.maximum((by_unit**2).sum(axis=0) - (signs @ by_unit) ** 2 / units, 1e-300)
        null = (signs @ by_unit) / np.sqrt(np.maximum(squares * units / max(units - 1, 1), variance))
        null = np.where(testable, null, 0.0)
    else:
        values, vectors = np.linalg.eigh(correlation)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        null = rng.standard_normal((DRAWS, root.shape[1])) @ root.T
    null = np.where(one_sided & (null < 0.0), 0.0, null)
    maxima = np.abs(null).max(axis=1, initial=0.0)
    critical = float(np.quantile(maxima, 1.0 - alpha))
    # A number of the base that is another one is calibration, and nothing missing.
    missing = np.array([entry.effect.base is None for entry in tested], dtype=bool)
    # Noise with tails makes every score scatter more than the model's own; what is rare is worth what it gains beyond
    # the search for its shape.
    rare = np.isfinite(measured.profile)
    squares = z**2 * np.where(rare, 1.0, variance / np.maximum(variance, single))
    squares -= np.where(rare, 2.0 * np.array([entry.price for entry in tested]), 0.0)
    scattered = np.sqrt(np.maximum(squares, 0.0))
    beyond = np.abs(null[:, missing]).max(axis=1, initial=0.0) >= scattered[missing].max(initial=0.0)
    p_value = float((1 + np.sum(beyond)) / (1 + DRAWS))
    deviation = np.where(testable, np.sqrt(inflation / variance), np.inf)
    return Screen(z, 0.5 * z**2, deviation, correlation, largest, critical, p_value, inflation, measured.best)


def information_of(prepared: Prepared, base: _Array, effects: Sequence[Active], tested: Sequence[Entry]) -> _Array:
    """A reading's information, from twins."""
    scores = score_matrix(prepared, base, effects, tested)
    information: _Array = scores.T @ scores / len(prepared)
    return information
