"""Slices of context, in which readings are compared with a model: quarters of columns of numbers, and words."""

from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

BINS = 4
"""Slices of a column of numbers, each with as many readings."""
NO_CONTEXT = frozenset({"time_s", "run", "reading_cm"})
"""Columns of which there are no slices."""
MODEL = "model_"
"""What the names of columns with the given model's predictions begin with."""


def slices_of(columns: Mapping[str, NDArray[Any]]) -> Iterator[tuple[dict[str, Any], NDArray[np.bool_]]]:
    """Each slice, as a region of a findings file, and its rows."""
    for name, column in columns.items():
        if name in NO_CONTEXT or name.startswith(MODEL):
            continue
        values = np.unique(column)
        if column.dtype.kind == "U":
            for word in values[: values.size if values.size > 1 else 0]:
                yield {"column": name, "word": str(word)}, column == word
        elif values.size > BINS:
            edges = np.nanquantile(column, np.arange(BINS + 1) / BINS)
            for low, high in pairwise(float(f"{edge:.6g}") for edge in edges):
                if high > low:
                    yield {"column": name, "low": low, "high": high}, (column >= low) & (column <= high)
