"""Sums over the readings of the weights of curves' knots, from which those of every curve follow.

Columns and the knots that are asked of them enter; sums of values times weights, by run and two by two, leave. A curve
is linear between all knots of its columns too, so the sums are made once for all curves over the same columns.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, TypeAlias

import numpy as np
from scipy.sparse import csr_matrix

from msp_range.arrays import Array, Column, Indices
from msp_sim.effects.curve import Knots, hats

Variables: TypeAlias = tuple[str, ...]


@dataclass(frozen=True)
class KnotWeights:
    """Weights of all knots over one column or two, of which a reading has two or four at most."""

    places: tuple[Column, ...]
    """Where the knots are: the value of each column at each of them."""
    matrix: csr_matrix
    """Weights of the knots for each reading, (knots, n); 0 where a column is unknown."""

    @classmethod
    def of(cls, contexts: Mapping[str, Any], variables: Variables, asked: Sequence[tuple[Knots, ...]]) -> "KnotWeights":
        """Columns with all knots of the curves that are asked over them."""
        knots = [np.unique([place for each in own for place in each]) for own in zip(*asked, strict=True)]
        columns = [np.asarray(contexts[name]) for name in variables]
        weights = hats(contexts, variables, [tuple(own) for own in knots])
        for column in columns:
            weights *= (column != "" if column.dtype.kind == "U" else np.isfinite(column))[:, None]
        places = tuple(np.array(own) for own in zip(*product(*knots), strict=True))
        return cls(places, csr_matrix(weights.T))

    def curve(self, knots: tuple[Knots, ...]) -> Array:
        """Weights of a curve's knots at all knots of the columns."""
        names = [str(i) for i in range(len(knots))]
        return hats(dict(zip(names, self.places, strict=True)), names, knots)

    def sums(self, values: Array) -> Array:
        """Sums of values (n, m) times weights, (knots, m)."""
        return np.asarray(self.matrix @ values)

    def products(self, values: Array, there: Any = slice(None)) -> Array:
        """Sums of values (n,) times two weights, the second one of the reading there, (knots, knots)."""
        matrix = self.matrix
        weighted = csr_matrix((matrix.data * values[matrix.indices], matrix.indices, matrix.indptr), matrix.shape)
        return np.asarray(weighted @ matrix.toarray().T[there])

    def by_unit(self, values: Array, unit: Indices) -> Array:
        """Sums of values (n,) times weights over units, (units, knots)."""
        of_units = csr_matrix((values, (unit, np.arange(unit.size))))
        return np.asarray((of_units @ self.matrix.T).toarray())
