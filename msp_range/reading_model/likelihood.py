"""The log-likelihood of readings under the base mixture, with its gradient and Hessian.

Readings with their expected ranges enter, with counts of equal pairs, and a vector of parameters; the sum of the log
probabilities leaves, with both derivatives.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from msp_range.arrays import Array
from msp_range.reading_model.densities import NAMES, S, Terms
from msp_range.reading_model.grid import NO_ECHO, SECOND_NO_ECHO, ReadingGrid

CHUNK = 1 << 13
"""Rows processed at a time, so that the arrays fit into the processor's cache."""


class _Kind(NamedTuple):
    """Rows of one kind."""

    cell: NDArray[np.int64]
    expected_cm: Array
    times: Array
    reference_cm2: Array

    def chunks(self) -> "Iterator[_Kind]":
        """A part of the rows at a time."""
        for start in range(0, self.cell.size, CHUNK):
            rows = slice(start, start + CHUNK)
            yield _Kind(self.cell[rows], self.expected_cm[rows], self.times[rows], self.reference_cm2[rows])


class Likelihood:
    """Log-likelihood of readings, and its derivatives by the parameters of `NAMES`.

    Parameters
    ----------
    grid
        The possible readings.
    cell, expected_cm, count
        Arrays of length n: cell of the grid, expected range [cm] (infinite: no echo), and count.
    reference_cm2
        Variance of the error of each expected range [cm^2], (n,); None: they are exact.
    """

    def __init__(
        self,
        grid: ReadingGrid,
        cell: NDArray[np.int64],
        expected_cm: Array,
        count: Array,
        reference_cm2: Array | None = None,
    ) -> None:
        self.grid = grid
        self.readings = float(count.sum())
        self.rows = cell.size
        self._cell, self._expected_cm, self._count = cell, expected_cm, count
        self._reference_cm2 = np.zeros(cell.size) if reference_cm2 is None else reference_cm2
        self._ordinary, self._missed, self._second = (
            _Kind(cell[rows], expected_cm[rows], count[rows], self._reference_cm2[rows])
            for rows in (cell >= 0, cell == NO_ECHO, cell == SECOND_NO_ECHO)
        )
        self.no_echoes = float(self._missed.times.sum())

    @property
    def ranges_cm(self) -> tuple[float, float]:
        """Shortest and longest finite expected range [cm]."""
        finite = self._expected_cm[self._expected_cm < np.inf]
        return float(finite.min()), float(finite.max())

    @property
    def mean_length_cm(self) -> float:
        """Mean of the ranges beyond the minimum of readings with a range [cm]."""
        end_cm = np.minimum(self._ordinary.expected_cm, self.grid.maximum_cm)
        length_cm = np.maximum(end_cm - self.grid.minimum_cm, 0.0)
        return max(float(np.average(length_cm, weights=self._ordinary.times)), self.grid.resolution_cm)

    def errors(self) -> tuple[Array, Array]:
        """Reading minus expected range if both are ranges [cm], and count."""
        second = -1 if self.grid.second_cell is None else self.grid.second_cell
        cell = np.where(self._cell == SECOND_NO_ECHO, second, self._cell)
        rows = (cell >= 0) & (self._expected_cm < np.inf)
        reading_cm = self.grid.minimum_cm + self.grid.resolution_cm * cell[rows]
        return reading_cm - self._expected_cm[rows], self._count[rows]

    def part(self, every: int) -> "Likelihood":
        """The likelihood of every n-th row."""
        rows = slice(None, None, every)
        columns = self._cell[rows], self._expected_cm[rows], self._count[rows], self._reference_cm2[rows]
        return Likelihood(self.grid, *columns)

    def derivatives(self, theta: Array, free: frozenset[int]) -> tuple[float, Array, Array]:
        """Value, gradient (k,) and Hessian (k, k) at `theta` (k,).

        Parameters from sigma_growth on that are not in `free` have zeros. The value is -inf, and the derivatives are
        zero, if a reading is impossible or so improbable that the derivatives overflow.
        """
        value, gradient, hessian = 0.0, np.zeros(len(NAMES)), np.zeros((len(NAMES), len(NAMES)))
        with np.errstate(divide="ignore", invalid="ignore", over="ignore", under="ignore"):
            for kind in (*self._ordinary.chunks(), *self._missed.chunks()):
                terms = Terms(self.grid, kind.cell, kind.expected_cm, theta, free, False, kind.reference_cm2)
                value += _add(terms, kind.times, gradient, hessian)
            if self.no_echoes:
                first = 1.0 - theta[S]
                value += self.no_echoes * (math.log(first) if first > 0.0 else -math.inf)
                gradient[S] -= self.no_echoes / first if first > 0.0 else 0.0
                hessian[S, S] -= self.no_echoes / first**2 if first > 0.0 else 0.0
            for kind in self._second.chunks():
                value += self._add_second_code(kind, theta, free, gradient, hessian)
        if not (math.isfinite(value) and np.isfinite(gradient).all() and np.isfinite(hessian).all()):
            return -math.inf, np.zeros_like(gradient), np.zeros_like(hessian)
        lower = np.tril_indices(len(NAMES), -1)
        hessian[lower] = hessian.T[lower]
        return value, gradient, hessian

    def _add_second_code(
        self, kind: "_Kind", theta: Array, free: frozenset[int], gradient: Array, hessian: Array
    ) -> float:
        """Readings of the second code: p = q(its own cell) + s q(no echo)."""
        cell, expected_cm, count, reference_cm2 = kind
        missed = Terms(self.grid, np.full_like(cell, NO_ECHO), expected_cm, theta, free, False, reference_cm2)
        p = theta[S] * missed.q
        by_missed = dict(missed.first())
        first = {i: theta[S] * each for i, each in by_missed.items()}
        own = None
        if self.grid.second_cell is not None:
            own_cell = np.full_like(cell, self.grid.second_cell)
            own = Terms(self.grid, own_cell, expected_cm, theta, free, False, reference_cm2)
            p = p + own.q
            for i, each in own.first():
                first[i] = first[i] + each
        first[S] = missed.q
        weight = count / p
        _add_first(list(first.items()), p, count, gradient, hessian)
        missed.add_second(hessian, theta[S] * weight)
        if own is not None:
            own.add_second(hessian, weight)
        for i, each in by_missed.items():
            hessian[min(i, S), max(i, S)] += float(np.dot(weight, each))
        return float(np.dot(count, np.log(p)))


def _add(terms: Terms, count: Array, gradient: Array, hessian: Array) -> float:
    """Add the derivatives of sum count log q; return the sum."""
    _add_first(terms.first(), terms.q, count, gradient, hessian)
    terms.add_second(hessian, count / terms.q)
    return float(np.dot(count, np.log(terms.q)))


def _add_first(first: list[tuple[int, Array]], q: Array, count: Array, gradient: Array, hessian: Array) -> None:
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
