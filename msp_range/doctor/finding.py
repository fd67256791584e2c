"""What one step found: right, wrong or unknown, in a sentence, and what to do about it.

A step is a table of rows (test, text, remedy), of which the first that applies is its finding.
"""

from collections.abc import Generator, Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any


class Verdict(StrEnum):
    """Outcome of a step. Unknown: it could not be tried, or what it saw has a harmless explanation too."""

    RIGHT = "right"
    WRONG = "wrong"
    UNKNOWN = "unknown"


RIGHT, WRONG, UNKNOWN = Verdict


@dataclass(frozen=True)
class Finding:
    """Outcome of one step."""

    step: str
    """What was looked at, in a few words."""
    verdict: Verdict
    """Right, wrong or unknown."""
    text: str
    """What was found, for the user."""
    remedy: str | None = None
    """What to do about it; None if nothing has to be done."""


Row = tuple[object, str] | tuple[object, str, str] | tuple[object, str, str | None, Verdict]
"""Test, text, remedy, verdict: what has a remedy is wrong unless it says otherwise, and what has none is right."""


def first_of(step: str, *rows: Row) -> Finding:
    """The finding of the first row whose test holds; that of the last one always does.

    Examples
    --------
    >>> first_of("air", (90.0 > 85.0, "90 C", "cool it"), (True, "90 C"))
    Finding(step='air', verdict=<Verdict.WRONG: 'wrong'>, text='90 C', remedy='cool it')
    """
    row: tuple[Any, ...] = next(row for row in rows if row[0])
    _, text, remedy, verdict = row + ((None, RIGHT) if len(row) == 2 else (WRONG,))[: 4 - len(row)]
    return Finding(step, verdict, text, remedy)


def while_right(findings: Iterable[Finding]) -> Generator[Finding, None, bool]:
    """Findings up to the first one that is not right; returns whether all were."""
    for finding in findings:
        yield finding
        if finding.verdict is not RIGHT:
            return False
    return True


def right(step: str, text: str) -> Finding:
    """All is as it should be."""
    return Finding(step, RIGHT, text)


def wrong(step: str, text: str, remedy: str) -> Finding:
    """Something has to be changed."""
    return Finding(step, WRONG, text, remedy)


def unknown(step: str, text: str, remedy: str | None = None) -> Finding:
    """It is not known whether something has to be changed."""
    return Finding(step, UNKNOWN, text, remedy)
