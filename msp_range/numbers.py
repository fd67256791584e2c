"""The type of what is computed alike for one number and for an array of them, without importing numpy at run time."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Numbers = TypeVar("Numbers", float, "NDArray[np.float64]")
"""A number or an array; arguments of one type give a result of that type."""
