"""Tables of the effects and of every set-up."""

from msp_lab.characterise.findings import Effect, Estimate, Findings, Point
from msp_lab.characterise.questions import SHARE_BOUND
from msp_lab.characterise.report.chapter4 import interval
from msp_sim.page.page import PageTable
from msp_sim.page.style import p_text

METRICS = {
    "bias": "mean error, difference",
    "spread": "spread, ratio",
    "missed": "missed, odds ratio",
    "outliers": "outliers, odds ratio",
}

MOST_POINTS = 400
"""Set-ups that the page lists at most."""


def effects_table(findings: Findings) -> PageTable | None:
    """Every effect of every question; None where none was asked."""
    rows = []
    for question in findings.questions:
        subject = f"{question.name.replace('_', ' ')}: {question.level} against {question.reference}"
        if question.sensor:
            subject += f" ({question.sensor})"
        for effect in question.effects:
            rows.append((subject, METRICS[effect.metric], effect.verdict, *_numbers(effect)))
            subject = ""
    if not rows:
        return None
    return PageTable(
        name="effects",
        title="Every effect",
        header=(
            "question",
            "property",
            "verdict",
            "effect, 95 % interval",
            "small enough",
            "smallest detectable",
            "p, adjusted",
        ),
        rows=tuple(rows),
        caption=(
            "No effect is a difference of 0 or a ratio of 1. p is adjusted by Holm over all effects. 'Matters': there "
            "is an effect by it, and it may be larger than what is small enough. 'Does not matter': the 90 % interval "
            "lies within that (two one-sided tests), or missed readings and outliers change by less than "
            f"{SHARE_BOUND:.0%} of all readings. Smallest detectable: in 80 % of cases, at the adjusted level."
        ),
        words=3,
    )


def _numbers(effect: Effect) -> tuple[str, ...]:
    is_ratio = effect.metric != "bias"
    bound = f"{1.0 / effect.bound:.2g} to {effect.bound:.3g}" if is_ratio else f"±{effect.bound:.2g} cm"
    smallest = effect.smallest_detectable
    return (
        "–" if effect.estimate is None else interval(effect.estimate),
        bound,
        "–" if smallest is None else f"{smallest:.2g}" if is_ratio else f"±{smallest:.2g} cm",
        "–" if effect.p_adjusted is None else p_text(effect.p_adjusted),
    )


def points_table(findings: Findings) -> PageTable | None:
    """Every set-up and what was read there; None without any."""
    if not findings.points:
        return None
    left_out = len(findings.points) - MOST_POINTS
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
        rows=tuple(_point(point) for point in findings.points[:MOST_POINTS]),
        caption=f"{left_out:,} more are left out here." if left_out > 0 else "",
        words=3,
    )


def _point(point: Point) -> tuple[str, ...]:
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


def _value(estimate: Estimate | None) -> str:
    return "–" if estimate is None else f"{estimate.value:.2f}".replace("-", "−")
