"""What the flights measured: figures of one flight, and all of them as the tables of docs/sitl.md."""

from typing import NamedTuple

import numpy as np

from tests.sitl.autopilot import Autopilot
from tests.sitl.course import SILENCE_S, Followed, Leg

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
COURSE_ROWS: list[tuple[str, ...]] = []
"""One for each section of the course in each direction; conftest.py prints them."""
COURSE_HEADINGS = (
    "autopilot",
    "distances from",
    "speed",
    "ground",
    "error of its height, rms",
    "unhealthy",
    "longest gap",
    f"gaps over {SILENCE_S} s",
    "failsafes",
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


def note_followed(
    autopilot: Autopilot, distances: str, leg: Leg, sections: dict[str, Followed], failsafes: list[str]
) -> None:
    """Add a leg over the course to its table."""
    for section, each in sections.items():
        cells = (f"{each.rms_m:.2f} m", f"{each.unhealthy_s:.1f} s", f"{each.gap_s:.2f} s", f"{each.silences}")
        row = (autopilot.name, distances, f"{leg.speed_m_s:g} m/s", section, *cells, ", ".join(failsafes) or "none")
        COURSE_ROWS.append(row)


def table(headings: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """All rows as Markdown."""
    lines = [headings, tuple("---" for _ in headings), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
