"""What a filter is: one estimate in, one estimate out, or None where it holds the reading back."""

from typing import NamedTuple, Protocol


class Estimate(NamedTuple):
    """A range [m] and the variance of its error [m^2]; infinite where unknown."""

    range_m: float
    variance_m2: float


class Filter(Protocol):
    """One stage of a sensor's chain; it keeps what it needs between readings."""

    def update(self, time_s: float, measured: Estimate) -> Estimate | None:
        """Take a reading made at ``time_s`` [s]; None where this reading is not believed."""
        ...

    def reset(self) -> None:
        """Forget everything, as after a gap too long to bridge."""
        ...
