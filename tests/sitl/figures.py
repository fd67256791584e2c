"""What the flights measured: figures of one flight, and all of them as the table of docs/sitl.md."""

from typing import NamedTuple

import numpy as np

from tests.sitl.autopilot import Autopilot

ROWS: list[tuple[str, ...]] = []
"""One for each flight or part of one; conftest.py prints them."""
HEADINGS = (
    "autopilot",
    "what happens",
    "error, median",
    "error, 95 %",
    "healthy",
    "without distances",
    "what the autopilot does",
)


class Figures(NamedTuple):
    """How the autopilot's distance to the ground was, over a time.

    Attributes
    ----------
    median_m, p95_m
        Magnitude of the error of the distance that the autopilot goes by [m].
    healthy
        Share of the time in which it went by its range finder.
    """

    median_m: float
    p95_m: float
    healthy: float


def measure(autopilot: Autopilot, from_s: float, to_s: float) -> Figures:
    """Figures of a running flight between two times [s, monotonic]."""
    ranges = np.array([each for each in autopilot.ranges() if from_s <= each[0] <= to_s])
    true_s, true_m = np.array(autopilot.true_ranges()).T
    error_m = np.abs(ranges[:, 1] - np.interp(ranges[:, 0], true_s, true_m))
    healthy = [good for time_s, good in autopilot.healthy() if from_s <= time_s <= to_s]
    known_m = error_m[np.isfinite(error_m)]
    if not len(known_m):
        return Figures(np.nan, np.nan, float(np.mean(healthy)))
    return Figures(float(np.median(known_m)), float(np.percentile(known_m, 95)), float(np.mean(healthy)))


def note(
    autopilot: Autopilot, what: str, result: str, figures: Figures | None = None, outage_s: float | None = None
) -> None:
    """Add a row to the table."""
    cells = ("", "", "")
    if figures is not None:
        cells = (f"{figures.median_m:.2f} m", f"{figures.p95_m:.2f} m", f"{100 * figures.healthy:.1f} %")
    ROWS.append((autopilot.name, what, *cells, "" if outage_s is None else f"{outage_s:.2f} s", result))


def table() -> str:
    """All rows as Markdown."""
    rows = [HEADINGS, tuple("---" for _ in HEADINGS), *ROWS]
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)
