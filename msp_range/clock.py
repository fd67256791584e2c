"""Clocks: the bridge gets the time from a Clock, never from the operating system.

``SystemClock`` is the one place in msp_range that imports ``time``. The simulator passes a virtual clock instead,
and an hour of flight takes seconds.
"""

import select
import time
from collections.abc import Sequence
from typing import Protocol


class Clock(Protocol):
    """The interface of a clock."""

    def now(self) -> float:
        """Seconds on a clock that never goes backwards; its zero is arbitrary."""

    def sleep_until(self, time_s: float, files: Sequence[int] = ()) -> bool:
        """Return when ``now() >= time_s``, at once if that has passed, or True when one of the files can be read."""

    def utc(self) -> float:
        """Seconds since 1970-01-01 UTC, for file names and logs only."""


class SystemClock:
    """The operating system's monotonic clock: seconds since an arbitrary start."""

    # Without a function of its own around it: each thing that the bridge does begins with a look at the clock.
    now = staticmethod(time.monotonic)

    def sleep_until(self, time_s: float, files: Sequence[int] = ()) -> bool:
        """Sleep until ``time_s`` on this clock, or until one of the files can be read: then True."""
        delay_s = time_s - time.monotonic()
        if files:
            return bool(select.select(files, (), (), max(delay_s, 0.0))[0])
        if delay_s > 0:
            time.sleep(delay_s)
        return False

    def utc(self) -> float:
        """The operating system's UTC; wrong on a computer without a real-time clock until it has been set."""
        return time.time()


def date_of(utc_s: float) -> str:
    """The day of a time since 1970-01-01 UTC, ISO 8601.

    Examples
    --------
    >>> date_of(1.7e9)
    '2023-11-14'
    """
    return time.strftime("%Y-%m-%d", time.gmtime(utc_s))


def stamp_of(utc_s: float) -> str:
    """A time since 1970-01-01 UTC for a file's name, ISO 8601 without characters that some file systems refuse.

    Examples
    --------
    >>> stamp_of(1.7e9)
    '20231114T221320Z'
    """
    return time.strftime("%Y%m%dT%H%M%SZ", time.gmtime(utc_s))


class VirtualClock:
    """A virtual clock: sleeping takes no real time, and the same calls always give the same times."""

    def __init__(self, start_s: float = 0.0) -> None:
        self._now_s = start_s

    def now(self) -> float:
        """Seconds since the virtual start."""
        return self._now_s

    def sleep_until(self, time_s: float, files: Sequence[int] = ()) -> bool:
        """Jump to ``time_s``; time never goes back, and no file is looked at."""
        if time_s > self._now_s:
            self._now_s = time_s
        return False

    def utc(self) -> float:
        """The virtual time itself, so virtual flights always take place in 1970."""
        return self._now_s
