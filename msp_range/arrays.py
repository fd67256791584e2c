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
