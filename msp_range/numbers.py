"""Numbers without importing numpy at run time: a limit, and the type of what is computed alike for one or an array."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Numbers = TypeVar("Numbers", float, "NDArray[np.float64]")
"""A number or an array; arguments of one type give a result of that type."""


def limited(value: float, least: float, most: float) -> float:
    """A number, but no less than ``least`` and no more than ``most``.

    A flight needs some hundreds of these a second, and two comparisons are cheaper than calls of `min` and `max`.

    Examples
    --------
    >>> [limited(value, 0.0, 1.0) for value in (-0.5, 0.5, 1.5)]
    [0.0, 0.5, 1.0]
    """
    at_least = least if value < least else value
    return most if at_least > most else at_least
