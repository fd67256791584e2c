"""Values and ends of intervals that may be unknown, where a test needs them known."""

from typing import Protocol, TypeVar

Value = TypeVar("Value")


class Interval(Protocol):
    """An estimate with its interval, of the characterisation or of the gap workflow."""

    @property
    def low(self) -> float | None: ...
    @property
    def high(self) -> float | None: ...


def known(value: Value | None) -> Value:
    """The value; the test fails if it is None."""
    assert value is not None, "expected a value, found None"
    return value


def contains(interval: Interval, value: float) -> bool:
    """Whether a value lies in an interval, both ends of which are known."""
    return known(interval.low) <= value <= known(interval.high)


def width(interval: Interval) -> float:
    """Upper less lower end of an interval, both of which are known."""
    return known(interval.high) - known(interval.low)
