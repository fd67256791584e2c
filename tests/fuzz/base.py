"""What each area of the fuzzing returns."""

from typing import NamedTuple


class FuzzResult(NamedTuple):
    """What a run of one area found."""

    area: str
    cases: int
    seconds: float
    growth_mb: float
    slowest_s: float
    failures: list[str]
