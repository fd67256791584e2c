"""The numbers of many flights: shares and quantiles with 95 % intervals, and the worst flights.

Rows of the table give a `Summary`. Flights are independent of each other, readings of one flight are not: every
interval counts flights.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from msp_sim.intervals import quantile, wilson
from msp_sim.monte_carlo.store import NUMBER, Row

QUANTILES = (0.5, 0.9, 0.99)
"""Shares of the flights for which a limit is reported."""
WORST = 5
"""Number of the worst flights that are listed."""


@dataclass(frozen=True)
class Share:
    """A share of the flights, with Wilson's interval."""

    what: str
    flights: int
    of: int
    low: float
    high: float


@dataclass(frozen=True)
class Quantile:
    """A value that a share of the flights does not exceed; an end of the interval is None if flights are too few."""

    share: float
    value: float
    low: float | None
    high: float | None


@dataclass(frozen=True)
class Distribution:
    """Quantiles of a number over the flights."""

    what: str
    column: str
    quantiles: tuple[Quantile, ...]


@dataclass(frozen=True)
class Summary:
    """The numbers of many flights."""

    flights: int
    """Number of flights."""
    shares: tuple[Share, ...]
    distributions: tuple[Distribution, ...]
    """How often each event happened, and how large the errors and silences were."""
    worst: tuple[Row, ...]
    """Rows of the worst flights, the worst first."""
    failed: Mapping[int, str]
    """Error messages of flights that could not be flown, by number."""


EVENTS = {
    "wrong_s": "a distance 50 cm off for over 0.5 s",
    "silent_s": "a time without a distance",
    "unreported_silences": "one that was not reported",
    "warnings": "a warning to the pilot",
}
"""Columns that are 0 in a flight without the event."""
SIZES = {
    "error_p95_cm": "error, 95 % [cm]",
    "error_rms_cm": "error, rms [cm]",
    "longest_silence_s": "silence [s]",
    "wrong_s": "wrong for [s]",
    "wrong_share": "wrong [%]",
    "missed_share": "missed [%]",
}
"""Columns whose distribution is reported; shares as [%]."""
BADNESS = ("wrong_s", "unreported_silences", "longest_silence_s", "wrong_share", "error_p95_cm")
"""Columns by which flights are compared, the most important first."""


def summarise(rows: Sequence[Row], failed: Mapping[int, str]) -> Summary:
    """Shares, quantiles and the worst of the flights; columns that the table lacks are left out."""
    there = rows[0].keys() if rows else ()
    return Summary(
        len(rows),
        tuple(_share(rows, column) for column in EVENTS if column in there),
        tuple(each for column in SIZES if column in there and (each := _distribution(rows, column)) is not None),
        tuple(sorted(rows, key=_badness)[:WORST]),
        dict(failed),
    )


def _share(rows: Sequence[Row], column: str) -> Share:
    known = [row[column] for row in rows if row[column] is not None]
    count = sum(value > 0 for value in known)
    return Share(EVENTS[column], count, len(known), *wilson(count, len(known)))


def _distribution(rows: Sequence[Row], column: str) -> Distribution | None:
    known = [float(row[column]) for row in rows if row[column] is not None]
    # What never happens has no distribution.
    if not known or not any(known):
        return None
    return Distribution(SIZES[column], column, tuple(Quantile(share, *quantile(known, share)) for share in QUANTILES))


def _badness(row: Row) -> tuple[Any, ...]:
    """Sort key, the worst first; equal ones by their number."""
    return (*(-abs(row.get(column) or 0.0) for column in BADNESS), row[NUMBER])
