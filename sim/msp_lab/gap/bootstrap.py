"""Random variation where readings of a run depend on each other: score sums of whole runs, with random multipliers.

Scores with their cells and units are summed by unit, and their totals drawn again by a multiplier bootstrap over units
(Chernozhukov, Chetverikov & Kato 2013, Annals of Statistics 41). Tables that a model draws show no dependence.
"""

import numpy as np

from msp_lab.gap import rules
from msp_lab.gap.cells import Stack
from msp_lab.gap.refit import sums_by
from msp_range.arrays import Array, Flags, Indices, numbered


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
