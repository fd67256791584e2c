"""Estimates in words, as the page and the terminal write them."""

import numpy as np

from msp_lab.estimates import IntervalEstimate
from msp_range.arrays import Array
from msp_sim.page.text import minus


def interval(estimate: IntervalEstimate | None) -> str:
    """Return a number with its 95 % interval and unit, or a dash where there is none."""
    return "–" if estimate is None else minus(str(estimate))


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
