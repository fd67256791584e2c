"""The interface of a filter: one estimate in, one estimate out, or None if it rejects the reading."""

from collections import deque
from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol


class Estimate(NamedTuple):
    """A range [m] and the variance of its error [m^2]; infinite if unknown."""

    range_m: float
    variance_m2: float


class Filter(Protocol):
    """One stage of a sensor's chain, with its own state."""

    def update(self, time_s: float, measured: Estimate) -> Estimate | None:
        """Update with a reading made at ``time_s`` [s]; None if the reading is rejected."""

    def reset(self) -> None:
        """Forget everything, as after a long gap."""


class Windowed:
    """A filter that combines the last ``window`` readings; fewer until there are as many.

    ``combined`` makes the estimate, from the ranges [m] and the variance of their mean [m^2].
    """

    def __init__(self, window: int, combined: Callable[[Sequence[float], float], Estimate]) -> None:
        self._recent: deque[Estimate] = deque(maxlen=window)
        self._combined = combined

    def update(self, time_s: float, measured: Estimate) -> Estimate:
        """Update with a reading; the mean of M independent ones has the variance (sum of their variances) / M^2."""
        self._recent.append(measured)
        mean_variance_m2 = sum([estimate.variance_m2 for estimate in self._recent]) / len(self._recent) ** 2
        return self._combined([estimate.range_m for estimate in self._recent], mean_variance_m2)

    def reset(self) -> None:
        """Forget all readings."""
        self._recent.clear()
