"""The free model of a gap: in each cell of context the model gets five numbers of its own.

For each cell a shift of the hits, a factor of their spread and odds of short, missed and random readings are fitted by
maximum likelihood to the distribution of readings, with what they gain and how much of that is random variation. The
errors are those of the units: the runs or blocks of readings that depend on each other.

Where readings of a run depend on each other, scores are summed by unit, and their totals drawn again by a multiplier
bootstrap over units (Chernozhukov, Chetverikov & Kato 2013, Annals of Statistics 41). Tables that a model draws show no
dependence.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from msp_lab.gap import rules
from msp_lab.gap.cells import Stack
from msp_lab.gap.prepared import CHANNELS
from msp_lab.gap.refit import sums_by
from msp_range.arrays import Array, Flags, Indices, numbered
from msp_range.reading_model.rows import Base
from msp_sim.model.rows import ModelRows

PRIOR = np.diag(1.0 / np.square(rules.CELL_PRIOR_DEVIATION))
ROUNDS = 12
"""Newton steps at most."""
SHORTER = (1.0, 0.3, 0.05)
"""A step that makes the fit worse is tried again at these lengths."""
ENOUGH_NATS = 0.005
"""A cell that gains less in a step is done: the smallest gap that counts, of one reading."""


@dataclass(frozen=True)
class CellFits:
    """The five numbers of each of K cells, and what they gain."""

    counts: Indices
    """Readings in each cell, (K,)."""
    values: Array
    errors: Array
    """Values and their standard errors by units, (K, 5): bias [cm], logarithms of spread and odds."""
    gain_nats: Array
    noise_nats: Array
    """Gain in log-likelihood, and how much of it is random variation, both sums over a cell, (K,)."""

    @property
    def nats(self) -> float:
        """Gain per reading, less random variation."""
        return float((self.gain_nats - self.noise_nats).sum() / max(self.counts.sum(), 1))

    @property
    def nats_error(self) -> float:
        """Its standard error, as that of a sum of squares of normal numbers."""
        excess = np.maximum(self.gain_nats - self.noise_nats, 0.0)
        per_number = self.noise_nats / len(CHANNELS) * 2.0
        variance = (len(CHANNELS) / 2.0) * per_number**2 + 2.0 * per_number * excess
        return float(np.sqrt(variance.sum()) / max(self.counts.sum(), 1))

    def mean_square(self, channel: str) -> tuple[float, float]:
        """Mean over the cells of a number's square, less random variation; and its standard error."""
        i = CHANNELS.index(channel)
        values, variance = self.values[:, i], self.errors[:, i] ** 2
        known = np.isfinite(values) & (variance > 0.0)
        if channel not in ("bias", "spread"):
            known &= variance < rules.CELL_MAX_LOG_ODDS_VARIANCE
        if known.sum() < rules.CELL_KNOWN_SHARE * values.size:
            return 0.0, np.inf
        values, variance = values[known], variance[known]
        # Odds of rare outliers are known much better in some cells than in others.
        weight = self.counts[known] if channel in ("bias", "spread") else 1.0 / variance
        weight = weight / weight.sum()
        square = float((weight * (values**2 - variance)).sum())
        error = float(np.sqrt((weight**2 * (2.0 * variance**2 + 4.0 * variance * values**2)).sum()))
        return square, error

    def take(self, cells: slice) -> "CellFits":
        """Some of the cells."""
        return CellFits(
            self.counts[cells], self.values[cells], self.errors[cells], self.gain_nats[cells], self.noise_nats[cells]
        )


def scores_of(rows: ModelRows, reading_cm: Array, numbers: Array | None = None) -> tuple[Array, Array]:
    """Log probability of each reading (n,), and its derivatives by the five numbers (n, 5).

    Parameters
    ----------
    rows, reading_cm
        The model can give all readings.
    numbers
        The five numbers of each reading (n, 5), the bias in standard deviations of a hit; None: all 0.
    """
    there = rows
    if numbers is not None:
        shift, *others = numbers.T
        there = rows.changed(Base(shift * rows.sigma_cm, *others))
    log_p, by = there.scores(reading_cm)
    scores = by[:, : len(CHANNELS)]
    scores[:, 0] *= rows.sigma_cm
    return log_p, scores


def outer_sums(scores: Array, counts: Indices) -> Array:
    """Sums of the products of the scores with each other in each cell, (K, m, m).

    Parameters
    ----------
    scores
        Cell by cell, (N, m).
    counts
        Readings of each cell, (K,).
    """
    ends = np.cumsum(counts).tolist()
    return np.array([scores[start:end].T @ scores[start:end] for start, end in itertools.pairwise([0, *ends])])


def one_step(total: Array, information: Array, stack: Stack, sigma_cm: Array, by_unit: Array | None = None) -> CellFits:
    """The free fit by one step of Fisher's scoring from the model: right where the gap is small, and quick.

    Parameters
    ----------
    total
        Sums of the scores, (K, 5).
    information
        Of each cell (K, 5, 5), from replicates: readings with few outliers say little about them.
    stack, sigma_cm
        Cells, and the standard deviation of each reading's hit [cm], (n,).
    by_unit
        Variance of the sums over units, (K, 5, 5); None: readings are independent.
    """
    inverse = np.asarray(np.linalg.inv(information + PRIOR), dtype=np.float64)
    step = np.einsum("kij,kj->ki", inverse, total)
    variance, determined = _of_units(inverse, information, by_unit)
    scale = scale_of(stack, sigma_cm)
    gain = 0.5 * np.einsum("ki,ki->k", step, total)
    return CellFits(stack.counts, step * scale, np.sqrt(variance) * scale, gain, 0.5 * determined)


def _of_units(inverse: Array, information: Array, by_unit: Array | None) -> tuple[Array, Array]:
    """Variances of the five numbers (K, 5), and how many numbers the data determine (K,)."""
    variance = np.diagonal(inverse, axis1=1, axis2=2)
    determined = np.einsum("kij,kji->k", inverse, information)
    if by_unit is None:
        return variance, determined
    # At least what independent readings would have.
    variance = np.maximum(np.diagonal(inverse @ by_unit @ inverse, axis1=1, axis2=2), variance)
    return variance, np.maximum(np.einsum("kij,kji->k", inverse, by_unit), determined)


def free_fit(rows: ModelRows, reading_cm: Array, unit: Indices, stack: Stack) -> CellFits:
    """The free fit by as many steps as each cell needs, from a robust start.

    Parameters
    ----------
    rows, reading_cm
        Readings that the model can give.
    unit
        Readings of the same number depend on each other, (n,).
    stack
        The cells.
    """
    cells = _Cells(rows.take(stack.readings), reading_cm[stack.readings], stack.counts)
    nothing = np.zeros((len(stack), len(CHANNELS)))
    base = cells.at(nothing).posterior
    numbers, most = _robust_start(cells)
    numbers[cells.at(numbers).posterior < base] = 0.0
    best = cells.at(numbers)
    active = np.arange(len(stack))
    for _ in range(ROUNDS):
        before = best.posterior[active]
        step = np.linalg.solve(best.information[active], best.slope[active][..., None])[..., 0]
        step *= np.minimum(1.0, 2.0 / np.maximum(np.abs(step).max(axis=1, keepdims=True), 1e-12))
        left, todo = active, np.arange(active.size)
        for shorter in SHORTER:
            tried = numbers[left] + shorter * step[todo]
            tried[:, 0] = np.clip(tried[:, 0], -most[left], most[left])
            value = cells.some(left).at(tried)
            better = value.posterior > best.posterior[left]
            numbers[left[better]] = tried[better]
            for own, new in zip(best, value, strict=True):
                own[left[better]] = new[better]
            left, todo = left[~better], todo[~better]
            if not left.size:
                break
        active = active[best.posterior[active] - before >= ENOUGH_NATS]
        if not active.size:
            break
    _, scores = scores_of(cells.rows, cells.reading_cm, np.repeat(numbers, stack.counts, axis=0))
    prior = 0.5 * np.einsum("ki,ij,kj->k", numbers, PRIOR, numbers)
    inverse = np.asarray(np.linalg.inv(best.information), dtype=np.float64)
    _, given = scores_of(rows, reading_cm)
    by_unit, few = unit_variance(scores, unit, stack, given)
    variance, determined = _of_units(inverse, best.information - PRIOR, by_unit)
    # What is borrowed from other cells may fit badly: no cell is noisier than those that speak for themselves.
    if not few.all():
        determined = np.where(few, np.minimum(determined, determined[~few].max()), determined)
    scale = scale_of(stack, rows.sigma_cm)
    gain = best.posterior + prior - base
    return CellFits(stack.counts, numbers * scale, np.sqrt(variance) * scale, gain, 0.5 * determined)


class _Posterior(NamedTuple):
    """The logarithm of each cell's posterior, and its first and second derivatives by the five numbers."""

    posterior: Array
    slope: Array
    information: Array


@dataclass(frozen=True)
class _Cells:
    """Readings cell by cell, and how many each cell has."""

    rows: ModelRows
    reading_cm: Array
    counts: Indices

    def some(self, cells: Indices) -> "_Cells":
        """Some of the cells; they are in their order."""
        if cells.size == self.counts.size:
            return self
        wanted = np.zeros(self.counts.size, dtype=bool)
        wanted[cells] = True
        rows = np.flatnonzero(np.repeat(wanted, self.counts))
        return _Cells(self.rows.take(rows), self.reading_cm[rows], self.counts[cells])

    def at(self, numbers: Array) -> _Posterior:
        """The posterior with these numbers, (K, 5)."""
        log_p, scores = scores_of(self.rows, self.reading_cm, np.repeat(numbers, self.counts, axis=0))
        log_sum, total, information = self._sums(log_p), self._sums(scores), outer_sums(scores, self.counts)
        prior = numbers @ PRIOR
        return _Posterior(log_sum - 0.5 * np.einsum("ki,ki->k", numbers, prior), total - prior, information + PRIOR)

    def _sums(self, values: Array) -> Array:
        found = np.zeros((self.counts.size, *values.shape[1:]))
        there = self.counts > 0
        if there.any():
            found[there] = np.add.reduceat(values, (np.cumsum(self.counts) - self.counts)[there])
        return found


def _robust_start(cells: _Cells) -> tuple[Array, Array]:
    """Median and spread of what looks like hits, cell by cell: a gap of many sigma has no slope to follow; and the most
    that is a bias, in standard deviations."""
    rows = cells.rows
    usual = (cells.reading_cm < rows.maximum_cm) & np.isfinite(rows.centre_cm)
    off = (cells.reading_cm - rows.centre_cm)[usual] / rows.sigma_cm[usual]
    cell = np.repeat(np.arange(cells.counts.size), cells.counts)
    hits = np.bincount(cell[usual], minlength=cells.counts.size)
    low, middle, high = quantiles_of(off, hits, (0.25, 0.5, 0.75))
    (usual_cm,) = quantiles_of(rows.centre_cm[usual], hits, (0.5,))
    sigma_cm = np.bincount(cell, rows.sigma_cm, cells.counts.size) / np.maximum(cells.counts, 1)
    window_cm, window_share = rules.HIT_WINDOW
    most = (window_cm + window_share * np.maximum(usual_cm, 0.0)) / np.maximum(sigma_cm, 1e-9)
    known = (hits >= rules.CELL_MIN_HITS) & (np.abs(middle) <= most)
    numbers = np.zeros((cells.counts.size, len(CHANNELS)))
    numbers[known, 0] = middle[known]
    spread = np.maximum((high[known] - low[known]) / 1.349, 0.05)
    numbers[known, 1] = np.clip(np.log(spread), -2.0, 3.0)
    return numbers, most


def quantiles_of(values: Array, counts: Indices, shares: Sequence[float], of_none: float = 0.0) -> Array:
    """Quantiles of the values cell by cell, of which each has so many, (len(shares), cells); NaN are left out."""
    of_cells = np.split(values, np.cumsum(counts)[:-1])
    return np.transpose([np.nanquantile(cell, shares) if cell.size else [of_none] * len(shares) for cell in of_cells])


def scale_of(stack: Stack, sigma_cm: Array) -> Array:
    """From standard deviations of a hit to centimetres, (K, 5)."""
    scale = np.ones((len(stack), len(CHANNELS)))
    scale[:, 0] = stack.sums(sigma_cm) / np.maximum(stack.counts, 1)
    return scale


def unit_sums(scores: Array, unit: Indices, stack: Stack) -> tuple[Array, Array, Indices]:
    """Sums of the scores of each cell's units (K, U, m); the same about their mean; units that are in a cell (K,).

    Parameters
    ----------
    scores
        Cell by cell, (N, m).
    unit
        Readings of the same number depend on each other, (n,).
    stack
        The cells.
    """
    unit = _pooled(unit)
    cells, units = len(stack), int(unit.max()) + 1
    key = np.repeat(np.arange(cells), stack.counts) * units + unit[stack.readings]
    per_cell = sums_by(key, scores, cells * units).reshape(cells, units, scores.shape[1])
    size = np.bincount(key, minlength=cells * units).reshape(cells, units)
    there = (size > 0.0).sum(axis=1).astype(np.intp)
    mean = per_cell.sum(axis=1) / np.maximum(stack.counts, 1)[:, None]
    # A gap must not look like scatter.
    return per_cell, per_cell - size[:, :, None] * mean[:, None, :], there


def unit_variance(scores: Array, unit: Indices, stack: Stack, given: Array) -> tuple[Array, Flags]:
    """Variance of each cell's sum of scores by units, (K, m, m), and which cells have too few units of their own, (K,).

    Parameters
    ----------
    scores, unit, stack
        As for `unit_sums`.
    given
        Scores of each reading at the model as it is, (n, m), for where all cells have few units. What few units share
        is taken to be as in the other cells.
    """
    _, about_mean, there = unit_sums(scores, unit, stack)
    found = np.einsum("kui,kuj->kij", about_mean, about_mean, optimize=True)
    found *= (there / np.maximum(there - 1, 1))[:, None, None]
    few = there < rules.MIN_CELL_UNITS
    if few.all():
        sums = sums_by(numbered(unit), given - given.mean(axis=0))
        usual = sums.T @ sums * (len(sums) / max(len(sums) - 1, 1) / len(given))
    else:
        # Of scores at the free fit: at the model as it is, the gap itself would look like scatter.
        usual = found[~few].sum(axis=0) / stack.counts[~few].sum()
    found[few] = stack.counts[few, None, None] * usual
    return np.asarray(found, dtype=np.float64), few


def inflation_of_units(about_mean: Array, there: Indices, squares: Array) -> Array:
    """How many times units inflate the variance of a sum of scores, (m,), from the cells that have enough of them.

    Parameters
    ----------
    about_mean, there
        From `unit_sums`.
    squares
        Sums of each cell's squared scores, (K, m).
    """
    enough = there >= rules.MIN_CELL_UNITS
    if not enough.any():
        # Nothing is known of it: nothing is certain.
        return np.full(squares.shape[1], np.inf)
    of_units = (about_mean[enough] ** 2).sum(axis=(0, 1))
    inflation: Array = np.maximum(of_units / np.maximum(squares[enough].sum(axis=0), 1e-12), 1.0)
    return inflation


def drawn_sums(about_mean: Array, there: Indices, draws: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Totals of the scores as they might be with nothing missing (draws, K, m); their variance by units, as it is seen.

    Parameters
    ----------
    about_mean, there
        From `unit_sums`. Cells with few units show nothing.
    draws, rng
        How many, and the random generator.
    """
    cells, units, numbers = about_mean.shape
    correction = np.where(there < rules.MIN_CELL_UNITS, 0.0, there / np.maximum(there - 1, 1))
    about_mean = about_mean * np.sqrt(correction)[:, None, None]
    by_unit = np.moveaxis(about_mean, 1, 0)
    weight = rng.standard_normal((draws, units))
    totals = weight @ by_unit.reshape(units, -1)
    # Of normal numbers the mean says nothing of the scatter.
    weight = rng.standard_normal((draws, units))
    weight -= weight.mean(axis=1, keepdims=True)
    squares = weight**2 @ (by_unit[:, :, :, None] * by_unit[:, :, None, :]).reshape(units, -1)
    return totals.reshape(draws, cells, numbers), squares.reshape(draws, cells, numbers, numbers)


def _pooled(unit: Indices) -> Indices:
    index = numbered(unit)
    count = int(index.max()) + 1
    return index if count <= rules.MAX_UNITS else index * rules.MAX_UNITS // count
