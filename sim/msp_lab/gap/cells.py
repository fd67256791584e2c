"""Parts of the readings by context: quantile bins of a number, categories of a word, and pairs of both.

Context columns are cut into partitions, each with the cell of every reading and the cells' names. Readings whose
context is unknown have a cell of their own.
"""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix

from msp_lab.gap import rules
from msp_lab.gap.runs import known_values
from msp_range.arrays import Array, Column, Indices
from msp_range.recording.columns import WORD_COLUMNS

NOT_CONTEXT = frozenset({"reading_cm"})


@dataclass(frozen=True)
class Partition:
    """A partition of n readings."""

    variables: tuple[str, ...]
    """Context columns that it is made of; none: all readings in one cell."""
    labels: tuple[str, ...]
    """Name of each of the K cells."""
    cell: Indices
    """Cell of each reading, (n,)."""
    centres: Array | None = None
    """Median of the variable in each cell, where there is one and it is a number; for drawing."""

    @property
    def counts(self) -> Indices:
        """Readings in each cell, (K,)."""
        return np.bincount(self.cell, minlength=len(self.labels))

    def take(self, rows: Column) -> "Partition":
        """The partition of some of the readings."""
        return Partition(self.variables, self.labels, self.cell[rows], self.centres)


@dataclass(frozen=True)
class Stack:
    """The cells of several partitions of the same readings, one after another."""

    parts: tuple[Partition, ...]
    """The partitions."""
    counts: Indices
    """Readings of each of all K cells, (K,)."""
    members: csr_matrix
    """Which readings are in which cell, (K, n)."""

    @classmethod
    def of(cls, parts: Sequence[Partition]) -> "Stack":
        """Put partitions one after another."""
        counts = np.concatenate([part.counts for part in parts])
        # Words of 16 bits are sorted by their digits, in linear time.
        readings = np.concatenate([np.argsort(part.cell.astype(np.int16), kind="stable") for part in parts])
        ends = np.concatenate([[0], np.cumsum(counts)])
        shape = counts.size, parts[0].cell.size
        return cls(tuple(parts), counts, csr_matrix((np.ones(readings.size), readings, ends), shape))

    def __len__(self) -> int:
        return self.counts.size

    @cached_property
    def readings(self) -> Indices:
        """Readings cell by cell, each as often as there are partitions."""
        return np.asarray(self.members.indices, dtype=np.intp)

    def sums(self, values: Array) -> Array:
        """Sums of the readings' values in each cell: (n,) or (n, m) become (K,) or (K, m)."""
        return np.asarray(self.members @ values)

    def products(self, values: Array) -> Array:
        """Sums of the products of the readings' values with each other in each cell: (n, m) become (K, m, m)."""
        n, m = values.shape
        return self.sums((values[:, :, None] * values[:, None, :]).reshape(n, m * m)).reshape(len(self), m, m)

    def each(self) -> Iterator[tuple[Partition, slice]]:
        """Each partition with the place of its cells."""
        start = 0
        for part in self.parts:
            end = start + len(part.labels)
            yield part, slice(start, end)
            start = end


def partitions(
    contexts: Mapping[str, Any], variables: Sequence[str] | None = None, pairs: bool = True
) -> list[Partition]:
    """All readings in one, one partition a variable, and one for each pair of variables.

    Parameters
    ----------
    contexts
        Columns of length n by name.
    variables
        Which; None: those that vary.
    pairs
        Whether to cross them, too.

    Examples
    --------
    >>> contexts = {"throttle": np.linspace(0.0, 1.0, 200), "target": np.array(["grass", "tile"] * 100)}
    >>> for part in partitions(contexts):
    ...     print(part.variables, part.labels[:2])
    () ('all readings',)
    ('throttle',) ('throttle 0 to 0.25', 'throttle 0.25 to 0.5')
    ('target',) ('target grass', 'target tile')
    ('throttle', 'target') ('throttle 0 to 0.5, target grass', 'throttle 0 to 0.5, target tile')
    """
    size = len(next(iter(contexts.values())))
    names = varying(contexts) if variables is None else [name for name in variables if name in contexts]
    whole = Partition((), ("all readings",), np.zeros(size, dtype=np.intp))
    bins = int(np.clip(size // (rules.MIN_CELL_READINGS + size // 50), 2, rules.KNOTS[-1]))
    single = [part for name in names if (part := _split(name, contexts[name], bins)) is not None]
    found = [whole, *single]
    if pairs:
        coarse = {name: _split(name, contexts[name], 2 if size < rules.PAIR_BINS_READINGS else 3) for name in names}
        for one, two in itertools.combinations(names, 2):
            left, right = coarse[one], coarse[two]
            if left is not None and right is not None:
                found.append(_crossed(left, right))
    return [part for part in found if len(part.labels) > 1 or not part.variables]


def varying(contexts: Mapping[str, Any]) -> list[str]:
    """Columns that have more than one known value and are a context."""
    return [name for name, column in contexts.items() if name not in NOT_CONTEXT and _varies(column)]


def _varies(column: Column) -> bool:
    known = known_values(column)
    return bool((known != known[:1]).any())


def _split(name: str, column: Column, bins: int) -> Partition | None:
    if name in WORD_COLUMNS or column.dtype.kind not in "fiub":
        return _by_word(name, column)
    known = np.isfinite(column)
    values = np.unique(column[known])
    if values.size < 2:
        return None
    if values.size <= bins:
        edges = (values[1:] + values[:-1]) / 2.0
    else:
        edges = np.unique(np.quantile(column[known], np.arange(1, bins) / bins))
        # An edge belongs above it, so that a value that is most of them has a cell alone.
        edges = edges[edges > values[0]]
    index = np.where(known, np.searchsorted(edges, column, side="right"), edges.size + 1)
    if values.size <= bins:
        labels = [f"{name} {value:.4g}" for value in values]
    else:
        ends = [float(values[0]), *edges.tolist(), float(values[-1])]
        labels = [f"{name} {_span(low, high)}" for low, high in itertools.pairwise(ends)]
    centres = [float(np.median(column[index == i])) if (index == i).any() else np.nan for i in range(edges.size + 1)]
    return _filled((name,), [*labels, f"{name} unknown"], index, np.array([*centres, np.nan]))


def _span(low: float, high: float) -> str:
    """From one number to another, with as many digits as they differ in, up to six; else one number."""
    for digits in (4, 5, 6):
        one, other = f"{low:.{digits}g}", f"{high:.{digits}g}"
        if one != other:
            return f"{one} to {other}"
    return one


def _by_word(name: str, column: Column) -> Partition | None:
    words, index, counts = np.unique(column, return_inverse=True, return_counts=True)
    if words.size > rules.MAX_WORDS:
        kept = np.argsort(-counts, kind="stable")[: rules.MAX_WORDS]
        place = np.full(words.size, rules.MAX_WORDS)
        place[kept] = np.arange(rules.MAX_WORDS)
        return _filled((name,), [*(_word(name, words[i]) for i in kept), f"{name} of the others"], place[index], None)
    return _filled((name,), [_word(name, word) for word in words], index, None)


def _word(name: str, word: str) -> str:
    return f"{name} {word}" if word else f"{name} unknown"


def _crossed(one: Partition, two: Partition) -> Partition:
    labels = [f"{left}, {right}" for left in one.labels for right in two.labels]
    return _filled((*one.variables, *two.variables), labels, one.cell * len(two.labels) + two.cell, None)


def _filled(variables: tuple[str, ...], labels: Sequence[str], index: Indices, centres: Array | None) -> Partition:
    """The partition with its small cells put together in a last one."""
    counts = np.bincount(index, minlength=len(labels))
    kept = np.flatnonzero(counts >= rules.MIN_CELL_READINGS)
    place = np.full(len(labels), kept.size)
    place[kept] = np.arange(kept.size)
    cell = place[index]
    names = [labels[i] for i in kept.tolist()]
    middle = None if centres is None else centres[kept]
    if (cell == kept.size).any():
        names.append("the rest of " + " and ".join(variables))
        middle = None if middle is None else np.append(middle, np.nan)
    return Partition(variables, tuple(names), cell.astype(np.intp), middle)
