"""A sensor's filters in order, after the gate that rejects readings without a range."""

from collections.abc import Sequence
from typing import NamedTuple

from msp_range.filters.base import Estimate, Filter
from msp_range.reading import Reading

MEMORY_S = 1.5
"""Time without an accepted reading after which the filters restart [s], unless the polling cycle requires longer."""
CONFIRM_M, CONFIRM_M_S = 0.20, 5.0
"""After a restart two readings must agree before there is an output: within slope and noise [m] plus the largest change
of range in between [m/s]. Without this a single outlier after a long time without an echo would be sent."""
FASTEST_M_S = 5.0
"""Largest range rate with which a suspect reading is predicted [m/s]."""
SUSPECT_MARGIN_M = 0.15
SUSPECT_MARGIN_M_S = 0.2
"""Largest distance of a suspect reading from its prediction [m], and its growth with time [m/s]. With more, a vehicle
that hovers over ground without an echo would soon get a distance of 255 cm."""


UNCONFIRMED = "unconfirmed"
"""Reason of rejection while a second reading has to agree first."""
UNEXPECTED = "unexpected"
"""Reason of rejection by a filter: an outlier."""


class Filtered(NamedTuple):
    """The chain's result for a reading: an estimate, or the reason of rejection."""

    estimate: Estimate | None
    rejected: str | None = None


class Chain:
    """The status gate, then every filter in turn.

    Only readings whose status has a range pass the gate. A suspect value (255) passes only if it lies between the last
    output and its extrapolation at the last rate, within the margin. After a start, and after a time without readings,
    two readings must agree before the filters get any.

    Parameters
    ----------
    filters
        Filters in order.
    memory_s
        Time without an accepted reading after which the filters restart [s].
    """

    def __init__(self, filters: Sequence[Filter], memory_s: float = MEMORY_S) -> None:
        self._filters = filters
        self._memory_s = memory_s
        self._first: tuple[Reading, float] | None = None
        self._last: Estimate | None = None
        self._last_s = float("-inf")
        self._rate_m_s = 0.0
        self._accepted_s = float("-inf")

    def update(self, reading: Reading) -> Filtered:
        """Filter one reading; readings must be in order of time."""
        time_s, range_m = reading.time_s, reading.range_m
        if range_m is None:
            return Filtered(None, reading.status.value)
        if reading.suspect and not self._contains(time_s, range_m):
            return Filtered(None, "suspect")
        if time_s - self._accepted_s > self._memory_s:
            first, self._first = self._first, (reading, range_m)
            if first is None:
                return Filtered(None, UNCONFIRMED)
            elapsed_s, apart_m = time_s - first[0].time_s, abs(range_m - first[1])
            if elapsed_s > self._memory_s or apart_m > CONFIRM_M + CONFIRM_M_S * elapsed_s:
                return Filtered(None, UNCONFIRMED)
            self._last, self._rate_m_s = None, 0.0
            for stage in self._filters:
                stage.reset()
            self._filter(*first)
        self._first, self._accepted_s = None, time_s
        return self._filter(reading, range_m)

    def _filter(self, reading: Reading, range_m: float) -> Filtered:
        time_s = reading.time_s
        estimate = Estimate(range_m, reading.variance_m2)
        for stage in self._filters:
            outcome = stage.update(time_s, estimate)
            if outcome is None:
                return Filtered(None, UNEXPECTED)
            estimate = outcome
        if self._last is not None and time_s > self._last_s:
            rate_m_s = (estimate.range_m - self._last.range_m) / (time_s - self._last_s)
            self._rate_m_s = min(max(rate_m_s, -FASTEST_M_S), FASTEST_M_S)
        self._last, self._last_s = estimate, time_s
        return Filtered(estimate)

    def _contains(self, time_s: float, range_m: float) -> bool:
        if self._last is None or time_s - self._last_s > self._memory_s:
            return False
        elapsed_s = time_s - self._last_s
        margin_m = SUSPECT_MARGIN_M + SUSPECT_MARGIN_M_S * elapsed_s
        before_m = self._last.range_m
        moved_m = before_m + self._rate_m_s * elapsed_s
        return min(before_m, moved_m) - margin_m <= range_m <= max(before_m, moved_m) + margin_m
