"""A number with its 95 % interval."""

from dataclasses import dataclass


@dataclass(frozen=True)
class IntervalEstimate:
    """A number with its 95 % interval.

    Attributes
    ----------
    value
        The estimate.
    low, high
        Ends of the interval; None where the data give none on that side.
    unit
        Of all three; "" for a share or a ratio.
    n
        How many independent things it rests on, which `of` names.
    of
        What was counted: "readings" or "points" (a point is one set-up: a range, an angle, a target).
    """

    value: float
    low: float | None
    high: float | None
    unit: str
    n: int
    of: str = "readings"

    @classmethod
    def about(cls, value: float, half: float, unit: str, n: int, of: str = "readings") -> "IntervalEstimate":
        """A number with an interval that reaches as far to both sides."""
        return cls(value, value - half, value + half, unit, n, of)
