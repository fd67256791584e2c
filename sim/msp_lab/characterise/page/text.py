"""Numbers and sentences as the page writes them: intervals, signs, full stops."""

import re

import numpy as np

from msp_lab.characterise.point_findings import IntervalEstimate
from msp_range.arrays import Array


def interval(estimate: IntervalEstimate) -> str:
    """Return a number with its 95 % interval and unit.

    Examples
    --------
    >>> interval(IntervalEstimate(-1.387, -1.57, -1.2, "cm", 12))
    '−1.39 (−1.57 to −1.20) cm'
    >>> interval(IntervalEstimate(503.0, 503.0, 503.0, "cm", 9))
    '503 cm'
    """
    ends = [end for end in (estimate.low, estimate.high) if end is not None]
    reach = max([abs(end - estimate.value) for end in ends], default=0.0)
    unit = f" {estimate.unit}" if estimate.unit else ""
    if reach == 0.0:
        return minus(f"{estimate.value:.6g}{unit}")
    digits = int(min(max(1 - np.floor(np.log10(reach)), 0), 6))
    if ends and 0.0 < abs(estimate.value) < 0.1 * reach:
        # With a wide interval the value itself needs more digits than the interval.
        digits = int(min(max(digits, 1 - np.floor(np.log10(abs(estimate.value)))), 6))
    low = "?" if estimate.low is None else f"{estimate.low:.{digits}f}"
    high = "?" if estimate.high is None else f"{estimate.high:.{digits}f}"
    return minus(f"{estimate.value:.{digits}f} ({low} to {high}){unit}")


def half_interval(estimate: IntervalEstimate) -> str:
    """Return a breakaway angle, and up to where it may lie."""
    if estimate.high is None:
        return f"{estimate.value:.1f}° or more (no larger angle was tried)"
    return f"{estimate.value:.1f}° (up to {estimate.high:.1f}°)"


def span(values: Array) -> str:
    """Return the smallest and the largest known value, or one of them where they are the same."""
    known = values[np.isfinite(values)]
    if not known.size:
        return "unknown"
    low, high = float(np.min(known)), float(np.max(known))
    return f"{low:.1f}" if high - low < 0.05 else f"{low:.1f} to {high:.1f}"


def are(count: int, noun: str) -> str:
    """Return 'is one peak' or 'are 3 peaks'."""
    return f"is one {noun}" if count == 1 else f"are {count} {noun}s"


def number(value: float | None, digits: int) -> str:
    """Return a number with so many digits, and a dash where there is none."""
    return "–" if value is None else minus(f"{value:.{digits}f}")


def sentence(text: str) -> str:
    """Return a text that begins with a capital and ends with a full stop, its minus signs as long as its plus signs.

    Examples
    --------
    >>> sentence("nothing grows with range"), sentence("Said."), sentence("")
    ('Nothing grows with range.', 'Said.', '')
    """
    text = minus(text.strip())
    return text[:1].upper() + text[1:] + ("" if not text or text[-1] in ".?!" else ".")


def minus(text: str) -> str:
    """Return a text whose hyphens before numbers are minus signs.

    Examples
    --------
    >>> minus("-1.39 cm (-1.57 to -1.20), 40-60 cm")
    '−1.39 cm (−1.57 to −1.20), 40-60 cm'
    """
    return re.sub(r"(?<![\w.])-(?=\d)", "−", text)


def plus(number: float, digits: int = 1) -> str:
    """Return a signed number with a true minus sign; no sign for what rounds to 0.

    Examples
    --------
    >>> plus(-1.26), plus(0.04), plus(3.0)
    ('−1.3', '0.0', '+3.0')
    """
    text = f"{number:+.{digits}f}"
    if float(text) == 0.0:
        return text[1:]
    return text.replace("-", "−")


def file_word(word: str) -> str:
    """Return a word of the data as a part of a file's name."""
    return "".join(letter if letter.isascii() and letter.isalnum() else "_" for letter in word.lower())
