"""Sums over the readings of the weights of curves' knots, from which those of every curve follow.

Columns and the knots that are asked of them enter; sums of values times weights, by run and two by two, leave. A curve
is linear between all knots of its column too, so the sums are made once for all curves over the same columns.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from msp_sim.effects.curve import between, hats

_Array = NDArray[np.float64]
Variables: TypeAlias = tuple[str, ...]


@dataclass(frozen=True)
class ColumnWeights:
    """Weights of all knots over one column, of which a reading has two at most.

    Attributes
    ----------
    knots
        Numbers or words, in order.
    left, right
        Places of the knots next to each reading, (n,).
    low, high
        Their weights, (n,); 0 where the column is unknown.
    matrix
        The same as a matrix, (knots, n).
    """

    knots: NDArray[Any]
    left: NDArray[np.intp]
    right: NDArray[np.intp]
    low: _Array
    high: _Array
    matrix: csr_matrix

    @classmethod
    def of(cls, column: NDArray[Any], asked: Iterable[tuple[Any, ...]]) -> "ColumnWeights":
        """A column with all of these knots."""
        knots = np.unique([place for each in asked for place in each])
        if column.dtype.kind == "U":
            left = np.minimum(np.searchsorted(knots, column), knots.size - 1).astype(np.intp)
            right, share, known = left, np.zeros(column.size), knots[left] == column
        else:
            left, share = between(column, knots)
            right, known = left + 1, np.isfinite(column)
        low, high, readings = (1.0 - share) * known, share * known, np.arange(column.size)
        at = np.append(left, right), np.append(readings, readings)
        return cls(knots, left, right, low, high, csr_matrix((np.append(low, high), at), (knots.size, column.size)))

    def curve(self, knots: tuple[Any, ...]) -> _Array:
        """Weights of a curve's knots at all knots of the column."""
        return hats({"knots": self.knots}, ["knots"], [knots])


class KnotWeights(Protocol):
    """Weights of the knots over columns or over pairs of them; sums are by those variables."""

    def sums(self, values: _Array) -> Mapping[Variables, _Array]:
        """Sums of values (n, m) times weights, (knots, m)."""

    def products(self, values: _Array, there: Any = ...) -> Mapping[Variables, _Array]:
        """Sums of values (n,) times two weights, the second one of the reading there, (knots, knots)."""

    def by_unit(self, values: _Array, unit: NDArray[np.intp]) -> Mapping[Variables, _Array]:
        """Sums of values (n,) times weights over units, (units, knots)."""


@dataclass(frozen=True)
class KnotsOfColumns:
    """Weights of the knots over single columns, by their names."""

    columns: Mapping[str, ColumnWeights]

    def sums(self, values: _Array) -> dict[Variables, _Array]:
        return {(name,): np.asarray(each.matrix @ values) for name, each in self.columns.items()}

    def products(self, values: _Array, there: Any = slice(None)) -> dict[Variables, _Array]:
        found: dict[Variables, _Array] = {}
        for name, each in self.columns.items():
            k, total = each.knots.size, np.zeros(1)
            for place, weight in ((each.left, values * each.low), (each.right, values * each.high)):
                for other, weight_there in ((each.left, each.low), (each.right, each.high)):
                    total = total + np.bincount(place * k + other[there], weight * weight_there[there], k * k)
            found[name,] = total.reshape(k, k)
        return found

    def by_unit(self, values: _Array, unit: NDArray[np.intp]) -> dict[Variables, _Array]:
        units = int(unit.max()) + 1
        found: dict[Variables, _Array] = {}
        for name, each in self.columns.items():
            k = each.knots.size
            low = np.bincount(unit * k + each.left, values * each.low, units * k)
            high = np.bincount(unit * k + each.right, values * each.high, units * k)
            found[name,] = np.reshape(low + high, (units, k))
        return found


@dataclass(frozen=True)
class KnotsOfPairs:
    """Weights of the knots over columns of which curves over two are asked, the columns next to each other.

    They have single precision, as a sum takes as long as it takes to read them: sums of 20,000 are then off by less
    than a thousandth of their standard error.

    Attributes
    ----------
    place
        Which of the weights are a column's.
    weights
        (n, knots of all columns).
    """

    place: dict[str, slice]
    weights: NDArray[np.float32]

    @classmethod
    def of(cls, columns: Mapping[str, ColumnWeights], readings: int) -> "KnotsOfPairs":
        """All pairs of these columns of so many readings."""
        place = _side_by_side({name: each.knots.size for name, each in columns.items()})
        weights = [np.zeros((readings, 0)), *(each.matrix.toarray().T for each in columns.values())]
        return cls(place, np.hstack(weights, dtype=np.float32))

    def sums(self, values: _Array) -> dict[Variables, _Array]:
        found = [self.weights.T @ (self.weights * each[:, None]) for each in values.T.astype(np.float32)]
        whole = np.stack(found, axis=2, dtype=np.float64)
        return {
            (a, b): whole[one, other].reshape(-1, values.shape[1])
            for (a, one), (b, other) in combinations(self.place.items(), 2)
        }

    def products(self, values: _Array, there: Any = slice(None)) -> dict[Variables, _Array]:
        sizes = {name: own.stop - own.start for name, own in self.place.items()}
        place = _side_by_side({name: size**2 for name, size in sizes.items()})
        both = np.hstack(
            [
                (self.weights[:, own, None] * self.weights[there, None, own]).reshape(values.size, -1)
                for own in self.place.values()
            ]
        )
        whole = (both.T @ (both * values[:, None].astype(np.float32))).astype(np.float64)
        found: dict[Variables, _Array] = {}
        for (a, one), (b, other) in combinations(place.items(), 2):
            # From the knots of each column two by two to the knots of both.
            blocks = whole[one, other].reshape(sizes[a], sizes[a], sizes[b], sizes[b]).swapaxes(1, 2)
            found[a, b] = blocks.reshape(sizes[a] * sizes[b], -1)
        return found

    def by_unit(self, values: _Array, unit: NDArray[np.intp]) -> dict[Variables, _Array]:
        order = np.argsort(unit, kind="stable")
        weights, valued = self.weights[order], (self.weights * values[:, None].astype(np.float32))[order]
        ends = np.cumsum([0, *np.bincount(unit)]).tolist()
        whole = np.array([weights[a:b].T @ valued[a:b] for a, b in pairwise(ends)], dtype=np.float64)
        return {
            (a, b): whole[:, one, other].reshape(whole.shape[0], -1)
            for (a, one), (b, other) in combinations(self.place.items(), 2)
        }


def _side_by_side(sizes: Mapping[str, int]) -> dict[str, slice]:
    """Places of so many numbers each, one after another."""
    ends = np.cumsum([0, *sizes.values()]).tolist()
    return {name: slice(*each) for name, each in zip(sizes, pairwise(ends), strict=True)}
