"""The interface of a filter: one estimate in, one estimate out, or None if it rejects the reading."""

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
