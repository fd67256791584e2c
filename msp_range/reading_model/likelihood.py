"""The log-likelihood of readings under the base mixture, with its gradient and Hessian.

Readings enter with the range at which each is expected, counted where the same pair comes again; a vector of
parameters enters, and the sum of the logarithms of the readings' probabilities leaves, with both derivatives.
"""

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from msp_range.reading_model.densities import FAR_CM, NAMES, UNHEARD_CM, Cells, S, Terms, cells_of
from msp_range.reading_model.grid import NO_ECHO, SECOND_NO_ECHO, ReadingGrid

_Array = NDArray[np.float64]

CHUNK = 1 << 13
"""Rows worked on at a time: what they need stays in the processor's cache."""


class Likelihood:
    """Log-likelihood of readings, and its derivatives by the parameters of `NAMES`.

    Parameters
    ----------
    grid
        What the sensor can report.
    cell, expected_cm, count
        Arrays of length n: cell of the grid, expected range [cm] (infinite: nothing can be heard), and how often.
    """

    def __init__(self, grid: ReadingGrid, cell: NDArray[np.int64], expected_cm: _Array, count: _Array) -> None:
        self.grid = grid
        self.readings = float(count.sum())
        self.rows = cell.size
        self._cell, self._expected_cm, self._count = cell, expected_cm, count
        ordinary, missed, second = cell >= 0, cell == NO_ECHO, cell == SECOND_NO_ECHO
        self._ordinary = cells_of(grid, cell[ordinary], expected_cm[ordinary], count[ordinary])
        self._missed = cells_of(grid, cell[missed], expected_cm[missed], count[missed])
        of_second = cell[second]
        self._second = cells_of(grid, np.full_like(of_second, NO_ECHO), expected_cm[second], count[second])
        self._second_own: Cells | None = None
        if grid.second_cell is not None:
            own = np.full_like(of_second, grid.second_cell)
            self._second_own = cells_of(grid, own, expected_cm[second], count[second])
        self.no_echoes = float(count[missed].sum())
        self.second_codes = float(count[second].sum())

    @property
    def ranges_cm(self) -> tuple[float, float]:
        """Shortest and longest expected range of a surface that can be heard [cm]."""
        heard = self._expected_cm[self._expected_cm < np.inf]
        return float(heard.min()), float(heard.max())

    @property
    def mean_length_cm(self) -> float:
        """Mean of the ranges beyond the minimum, where the reading is one [cm]."""
        length = np.where(self._ordinary.length < FAR_CM, self._ordinary.length, 0.0)
        return max(float(np.average(length, weights=self._ordinary.count)), self.grid.resolution_cm)

    def errors(self) -> tuple[_Array, _Array]:
        """Reading less expected range, where both are ranges [cm], and how often."""
        heard = self._ordinary.centre < UNHEARD_CM
        cells = np.flatnonzero(self._cell >= 0)[heard]
        reading_cm = self.grid.minimum_cm + self.grid.resolution_cm * self._cell[cells]
        expected_cm = self._expected_cm[cells]
        return reading_cm - expected_cm, self._count[cells]

    def part(self, every: int) -> "Likelihood":
        """That of every so many-th row."""
        rows = slice(None, None, every)
        return Likelihood(self.grid, self._cell[rows], self._expected_cm[rows], self._count[rows])

    def derivatives(self, theta: _Array, free: frozenset[int]) -> tuple[float, _Array, _Array]:
        """Value, gradient (k,) and Hessian (k, k) at `theta` (k,).

        The parameters from sigma_growth on have zeros where they are not in `free`. The value is -inf, and the others
        are zero, where a reading has no probability.
        """
        value, gradient, hessian = 0.0, np.zeros(len(NAMES)), np.zeros((len(NAMES), len(NAMES)))
        with np.errstate(divide="ignore", invalid="ignore", over="ignore", under="ignore"):
            for cells in _chunks(self._ordinary):
                value += _add(Terms(cells, theta, free), cells.count, gradient, hessian)
            for cells in _chunks(self._missed):
                value += _add(Terms(cells, theta, free), cells.count, gradient, hessian)
            if self.no_echoes:
                first = 1.0 - theta[S]
                value += self.no_echoes * (math.log(first) if first > 0.0 else -math.inf)
                gradient[S] -= self.no_echoes / first if first > 0.0 else 0.0
                hessian[S, S] -= self.no_echoes / first**2 if first > 0.0 else 0.0
            for rows in _slices(len(self._second)):
                value += self._add_second_code(rows, theta, free, gradient, hessian)
        if not math.isfinite(value):
            return -math.inf, np.zeros_like(gradient), np.zeros_like(hessian)
        lower = np.tril_indices(len(NAMES), -1)
        hessian[lower] = hessian.T[lower]
        return value, gradient, hessian

    def _add_second_code(
        self, rows: slice, theta: _Array, free: frozenset[int], gradient: _Array, hessian: _Array
    ) -> float:
        """Readings of the second code: p = q(its own cell) + s q(no echo)."""
        missed = Terms(self._second.part(rows), theta, free)
        count = missed.cells.count
        p = theta[S] * missed.q
        first = {i: theta[S] * each for i, each in missed.first()}
        own = None
        if self._second_own is not None:
            own = Terms(self._second_own.part(rows), theta, free)
            p = p + own.q
            for i, each in own.first():
                first[i] = first[i] + each
        by_missed = dict(missed.first())
        first[S] = missed.q
        weight = count / p
        _add_first(list(first.items()), p, count, gradient, hessian)
        missed.add_second(hessian, theta[S] * weight)
        if own is not None:
            own.add_second(hessian, weight)
        for i, each in by_missed.items():
            hessian[min(i, S), max(i, S)] += float(np.dot(weight, each))
        return float(np.dot(count, np.log(p)))


def _add(terms: Terms, count: _Array, gradient: _Array, hessian: _Array) -> float:
    """Add the derivatives of sum count log q; return the sum."""
    _add_first(terms.first(), terms.q, count, gradient, hessian)
    terms.add_second(hessian, count / terms.q)
    return float(np.dot(count, np.log(terms.q)))


def _add_first(first: list[tuple[int, _Array]], q: _Array, count: _Array, gradient: _Array, hessian: _Array) -> None:
    """The gradient, and the part of the Hessian that has products of first derivatives (upper triangle)."""
    order = np.array([i for i, _ in first])
    rows = np.empty((len(first), q.size))
    for row, (_, each) in zip(rows, first, strict=True):
        np.divide(each, q, out=row)
    weighted = rows * count
    gradient[order] += weighted.sum(axis=1)
    products = np.zeros_like(hessian)
    products[np.ix_(order, order)] = weighted @ rows.T
    hessian -= np.triu(products)


def _slices(rows: int) -> Iterator[slice]:
    return (slice(start, start + CHUNK) for start in range(0, rows, CHUNK))


def _chunks(cells: Cells) -> Iterator[Cells]:
    return (cells.part(rows) for rows in _slices(len(cells)))
