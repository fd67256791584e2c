"""Sums over the readings of the weights of curves' knots, from which those of every curve follow.

Columns and the knots that are asked of them enter; sums of values times weights, by run and two by two, leave. A curve
is linear between all knots of its column too, so the sums are made once for all curves over the same columns.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from msp_range.arrays import Array, Column, Indices
from msp_sim.effects.curve import hats

Variables: TypeAlias = tuple[str, ...]


@dataclass(frozen=True)
class ColumnWeights:
    """Weights of all knots over one column, of which a reading has two at most."""

    knots: Column
    """Numbers or words, in order."""
    matrix: csr_matrix
    """Weights of the knots for each reading, (knots, n); 0 where the column is unknown."""

    @classmethod
    def of(cls, column: Column, asked: Iterable[tuple[Any, ...]]) -> "ColumnWeights":
        """A column with all of these knots."""
        knots = np.unique([place for each in asked for place in each])
        known = column != "" if column.dtype.kind == "U" else np.isfinite(column)
        weights = hats({"column": column}, ["column"], [tuple(knots)])
        return cls(knots, csr_matrix((weights * known[:, None]).T))

    def curve(self, knots: tuple[Any, ...]) -> Array:
        """Weights of a curve's knots at all knots of the column."""
        return hats({"knots": self.knots}, ["knots"], [knots])


@dataclass(frozen=True)
class KnotsOfColumns:
    """Weights of the knots over single columns, by their names."""

    columns: Mapping[str, ColumnWeights]

    def sums(self, values: Array) -> dict[Variables, Array]:
        """Sums of values (n, m) times weights, (knots, m)."""
        return {(name,): np.asarray(each.matrix @ values) for name, each in self.columns.items()}

    def products(self, values: Array, there: Any = slice(None)) -> dict[Variables, Array]:
        """Sums of values (n,) times two weights, the second one of the reading there, (knots, knots)."""
        return {
            (name,): (each.matrix.multiply(values) @ each.matrix[:, there].T).toarray()
            for name, each in self.columns.items()
        }

    def by_unit(self, values: Array, unit: Indices) -> dict[Variables, Array]:
        """Sums of values (n,) times weights over units, (units, knots)."""
        of_units = csr_matrix((values, (unit, np.arange(unit.size))))
        return {(name,): (of_units @ each.matrix.T).toarray() for name, each in self.columns.items()}


@dataclass(frozen=True)
class KnotsOfPairs:
    """As `KnotsOfColumns`, over columns of which curves over two are asked, the columns next to each other.

    They have single precision, as a sum takes as long as it takes to read them: sums of 20,000 are then off by less
    than a thousandth of their standard error.
    """

    place: dict[str, slice]
    """Which of the weights belong to each column."""
    weights: NDArray[np.float32]
    """Weights of the knots of all columns, (n, knots of all columns)."""

    @classmethod
    def of(cls, columns: Mapping[str, ColumnWeights], readings: int) -> "KnotsOfPairs":
        """All pairs of these columns of so many readings."""
        place = _side_by_side({name: each.knots.size for name, each in columns.items()})
        weights = [np.zeros((readings, 0)), *(each.matrix.toarray().T for each in columns.values())]
        return cls(place, np.hstack(weights, dtype=np.float32))

    def sums(self, values: Array) -> dict[Variables, Array]:
        found = [self.weights.T @ (self.weights * each[:, None]) for each in values.T.astype(np.float32)]
        whole = np.stack(found, axis=2, dtype=np.float64)
        return {
            (a, b): whole[one, other].reshape(-1, values.shape[1])
            for (a, one), (b, other) in combinations(self.place.items(), 2)
        }

    def products(self, values: Array, there: Any = slice(None)) -> dict[Variables, Array]:
        sizes = {name: own.stop - own.start for name, own in self.place.items()}
        place = _side_by_side({name: size**2 for name, size in sizes.items()})
        both = np.hstack(
            [
                (self.weights[:, own, None] * self.weights[there, None, own]).reshape(values.size, -1)
                for own in self.place.values()
            ]
        )
        whole = (both.T @ (both * values[:, None].astype(np.float32))).astype(np.float64)
        found: dict[Variables, Array] = {}
        for (a, one), (b, other) in combinations(place.items(), 2):
            # From the knots of each column two by two to the knots of both.
            blocks = whole[one, other].reshape(sizes[a], sizes[a], sizes[b], sizes[b]).swapaxes(1, 2)
            found[a, b] = blocks.reshape(sizes[a] * sizes[b], -1)
        return found

    def by_unit(self, values: Array, unit: Indices) -> dict[Variables, Array]:
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
