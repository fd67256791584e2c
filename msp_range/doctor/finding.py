"""What one step found: right, wrong or unknown, in a sentence, and what to do about it."""

from dataclasses import dataclass
from enum import StrEnum


class Verdict(StrEnum):
    """Outcome of a step. Unknown: it could not be tried, or what it saw has a harmless explanation too."""

    RIGHT = "right"
    WRONG = "wrong"
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class Finding:
    """Outcome of one step."""

    step: str
    """What was looked at, in a few words."""
    verdict: Verdict
    """The outcome."""
    text: str
    """What was seen."""
    remedy: str | None = None
    """What to do; None where nothing is to be done."""


def right(step: str, text: str) -> Finding:
    """All is as it should be."""
    return Finding(step, Verdict.RIGHT, text)


def wrong(step: str, text: str, remedy: str) -> Finding:
    """Something has to be changed."""
    return Finding(step, Verdict.WRONG, text, remedy)


def unknown(step: str, text: str, remedy: str | None = None) -> Finding:
    """It is not known whether something has to be changed."""
    return Finding(step, Verdict.UNKNOWN, text, remedy)
