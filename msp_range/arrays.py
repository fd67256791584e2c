"""Types of arrays, by what their elements are."""

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
"""Numbers: measured or computed."""
Indices: TypeAlias = NDArray[np.intp]
"""Places in another array, or numbers of groups."""
Flags: TypeAlias = NDArray[np.bool_]
"""What holds of which elements."""
Texts: TypeAlias = NDArray[np.str_]
"""Names of sensors, runs, or kinds."""
Column: TypeAlias = NDArray[Any]
"""A column of a table: numbers or texts."""


def numbered(words: Column) -> Indices:
    """Runs, or other values, as numbers from 0 in their order."""
    return np.unique(words, return_inverse=True)[1].astype(np.intp)


def angle_deg(cosine: Array) -> Array:
    """The angle of a cosine, which rounding may have put a little beyond 1 [deg]."""
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
