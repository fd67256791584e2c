"""The tables of the page: every effect, temperature compensation, the mixture's parameters, and every set-up."""

from msp_lab.characterise.findings import CompensationRow, FactorEffect, Findings, Metric
from msp_lab.characterise.page.text import interval
from msp_lab.characterise.point_findings import IntervalEstimate, PointResult
from msp_lab.characterise.questions import SHARE_BOUND
from msp_sim.page.page import PageTable
from msp_sim.page.text import number, p_text, sentence

METRICS: dict[Metric, str] = {
    "bias": "mean error, difference",
    "spread": "spread, ratio",
    "missed": "missed, odds ratio",
    "outliers": "outliers, odds ratio",
}
MAX_POINTS = 400
"""Set-ups that the page lists at most; the others are in findings.json."""
_SYMBOLS = {
    "weights.hit": "z_hit",
    "weights.short": "z_short",
    "weights.missed": "z_max",
    "weights.random": "z_rand",
    "sigma_cm": "σ_hit",
    "short_rate_per_m": "λ_short",
}
"""Parameter -> its symbol in Probabilistic Robotics (Thrun, Burgard & Fox 2005, section 6.3)."""


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


def _numbers(effect: FactorEffect) -> tuple[str, ...]:
    bound = effect.bound
    smallest = "–" if effect.smallest_detectable is None else f"{effect.smallest_detectable:.2g}"
    return (
        interval_or_dash(effect.estimate),
        f"{effect.mirrored(bound):.2g} to {bound:.3g}" if effect.is_ratio else f"±{bound:.2g} cm",
        smallest if effect.is_ratio or smallest == "–" else f"±{smallest} cm",
        "–" if effect.p_adjusted is None else p_text(effect.p_adjusted),
    )


def interval_or_dash(estimate: IntervalEstimate | None) -> str:
    """A number with its interval, or a dash where there is none."""
    return "–" if estimate is None else interval(estimate)


def compensation_table(findings: Findings) -> PageTable | None:
    """The mean errors by range without and with temperature compensation; None without rows."""
    rows = findings.temperature_compensation
    if not rows:
        return None
    notes = " ".join(f"{row.range_cm:g} cm: {row.note}." for row in rows if row.note)
    return PageTable(
        name="compensation_table",
        title="Mean range error without and with temperature compensation",
        header=("range [cm]", "uncompensated [cm]", "compensated [cm]", "thermometer [°C]", "implied air [°C]"),
        rows=tuple(
            (*compensation_cells(row), number(row.thermometer_c, 1), number(row.implied_c.value, 1)) for row in rows
        ),
        caption=(
            "In brackets 95 % intervals. Implied air: the one air temperature that would bring the mean error to 0. "
            f"{notes}"
        ),
        words=0,
    )


def compensation_cells(row: CompensationRow) -> tuple[str, str, str]:
    """Range, and mean error without and with compensation."""
    return f"{row.range_cm:g}", interval(row.uncompensated), interval_or_dash(row.compensated)


def mixture_table(findings: Findings) -> PageTable | None:
    """The fitted parameters with intervals, and the starting model's values; None without a fit."""
    mixture = findings.mixture
    if mixture is None:
        return None
    fitted = f"Maximum likelihood from {mixture.readings:,} readings, names as in the sensor model file."
    return PageTable(
        name="mixture_parameters",
        title="Parameters of the mixture",
        header=("parameter", "Thrun", "fitted, 95 % interval", "before"),
        rows=tuple(
            (
                each.name,
                _SYMBOLS.get(each.name, "–"),
                interval(each.fitted) + (" at its bound" if each.at_bound else ""),
                "–" if each.before is None else f"{each.before:.4g}",
            )
            for each in mixture.parameters
        ),
        caption=" ".join([fitted, *map(sentence, mixture.notes)]),
    )


def points_table(findings: Findings) -> PageTable | None:
    """All set-ups and their readings; None without any."""
    if not findings.points:
        return None
    left_out = len(findings.points) - MAX_POINTS
    counts = ("readings", "hits", "short", "long", "no echo", "255", "no answer")
    return PageTable(
        name="points",
        title="Every set-up",
        header=(
            "condition",
            "sensor",
            "level",
            "range [cm]",
            "angle [deg]",
            *counts,
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
        "" if point.incidence_deg is None else number(point.incidence_deg, 1),
        *(f"{count:,}" for count in counts),
        *("–" if each is None else number(each.value, 2) for each in (point.error, point.spread)),
    )
