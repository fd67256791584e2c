"""Table of all set-ups and their readings."""

from msp_lab.characterise.findings import Findings
from msp_lab.characterise.point_findings import IntervalEstimate, PointResult
from msp_sim.page.page import PageTable

MAX_POINTS = 400
"""Set-ups that the page lists at most; the others are in findings.json."""


def make_points_table(findings: Findings) -> PageTable | None:
    """Return all set-ups and their readings as a table; None without any."""
    if not findings.points:
        return None
    left_out = len(findings.points) - MAX_POINTS
    return PageTable(
        name="points",
        title="Every set-up",
        header=(
            "condition",
            "sensor",
            "level",
            "range [cm]",
            "angle [deg]",
            "readings",
            "hits",
            "short",
            "long",
            "no echo",
            "255",
            "no answer",
            "mean error [cm]",
            "spread [cm]",
        ),
        rows=tuple(_point(point) for point in findings.points[:MAX_POINTS]),
        caption=f"{left_out:,} more are left out here." if left_out > 0 else "",
        words=3,
    )


def _point(point: PointResult) -> tuple[str, ...]:
    counts = (point.readings, point.hits, point.short, point.long, point.no_echo, point.saturated, point.no_answer)
    return (
        point.condition.replace("_", " "),
        point.sensor,
        point.level,
        f"{point.true_range_cm:g}",
        "" if point.incidence_deg is None else f"{point.incidence_deg:.1f}".replace("-", "−"),
        *(f"{count:,}" for count in counts),
        _value(point.error),
        _value(point.spread),
    )


def _value(estimate: IntervalEstimate | None) -> str:
    return "–" if estimate is None else f"{estimate.value:.2f}".replace("-", "−")
