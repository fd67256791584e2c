"""Estimates in words, as the page and the terminal write them."""

import numpy as np

from msp_lab.characterise.point_findings import IntervalEstimate
from msp_range.arrays import Array
from msp_sim.page.text import minus


def interval(estimate: IntervalEstimate | None) -> str:
    """Return a number with its 95 % interval and unit, or a dash where there is none.

    Examples
    --------
    >>> interval(IntervalEstimate(-1.387, -1.57, -1.2, "cm", 12))
    '−1.39 (−1.57 to −1.20) cm'
    >>> interval(IntervalEstimate(503.0, 503.0, 503.0, "cm", 9))
    '503 cm'
    """
    if estimate is None:
        return "–"
    ends = [end for end in (estimate.low, estimate.high) if end is not None]
    reach = max([abs(end - estimate.value) for end in ends], default=0.0)
    unit = f" {estimate.unit}" if estimate.unit else ""
    if reach == 0.0:
        return minus(f"{estimate.value:.6g}{unit}")
    digits = _digits(reach)
    if ends and 0.0 < abs(estimate.value) < 0.1 * reach:
        # With a wide interval the value itself needs more digits than the interval.
        digits = max(digits, _digits(abs(estimate.value)))
    return minus(estimate.words(f".{digits}f") + unit)


def _digits(size: float) -> int:
    """Decimals with which a number of this size has two digits."""
    return int(min(max(1 - np.floor(np.log10(size)), 0), 6))


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
    low, high = np.min(known), np.max(known)
    return f"{low:.1f}" if high - low < 0.05 else f"{low:.1f} to {high:.1f}"
