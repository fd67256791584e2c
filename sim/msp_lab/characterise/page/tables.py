"""The tables of the page: every effect, temperature compensation, the mixture's parameters, and every set-up."""

from msp_lab.characterise.findings import NAMES, CompensationRow, FactorEffect, Findings
from msp_lab.characterise.page.text import interval
from msp_lab.characterise.point_findings import PointResult
from msp_lab.characterise.questions import SHARE_BOUND
from msp_lab.mixture_fit.parameters import PARAMETERS
from msp_sim.page.table import PageTable
from msp_sim.page.text import number, p_text, sentence

MAX_POINTS = 400
"""Set-ups that the page lists at most; the others are in findings.json."""


def effects_table(findings: Findings) -> PageTable:
    """Every effect of every question."""
    rows = []
    for question in findings.questions:
        subject = f"{question.name.replace('_', ' ')}: {question.compared}"
        if question.sensor:
            subject += f" ({question.sensor})"
        for effect in question.effects:
            rows.append((subject, NAMES[effect.metric], effect.verdict, *_numbers(effect)))
            subject = ""
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
        align="lllr",
    )


def _numbers(effect: FactorEffect) -> tuple[str, ...]:
    bound, smallest = effect.bound, effect.smallest_detectable
    return (
        interval(effect.estimate),
        f"{effect.mirrored(bound):.2g} to {bound:.3g}" if effect.is_ratio else f"±{bound:.2g} cm",
        "–" if smallest is None else f"{smallest:.2g}" if effect.is_ratio else f"±{smallest:.2g} cm",
        "–" if effect.p_adjusted is None else p_text(effect.p_adjusted),
    )


def compensation_table(findings: Findings) -> PageTable:
    """The mean errors by range without and with temperature compensation."""
    rows = findings.temperature_compensation
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
        align="r",
    )


def compensation_cells(row: CompensationRow) -> tuple[str, str, str]:
    """Range, and mean error without and with compensation."""
    return f"{row.range_cm:g}", interval(row.uncompensated), interval(row.compensated)


def mixture_table(findings: Findings) -> PageTable:
    """The fitted parameters with intervals, and the starting model's values."""
    mixture = findings.mixture
    fitted = (
        f"Maximum likelihood from {mixture.readings if mixture else 0:,} readings, names as in the sensor model file."
    )
    return PageTable(
        name="mixture_parameters",
        title="Parameters of the mixture",
        header=("parameter", "Thrun", "fitted, 95 % interval", "before"),
        rows=tuple(
            (
                parameter.name,
                PARAMETERS[parameter.name.removeprefix("weights.")].symbol,
                interval(parameter.fitted) + (" at its bound" if parameter.at_bound else ""),
                "–" if parameter.before is None else f"{parameter.before:.4g}",
            )
            for parameter in (mixture.parameters if mixture else ())
        ),
        align="llr",
        caption=" ".join([fitted, *map(sentence, mixture.notes if mixture else ())]),
    )


def points_table(findings: Findings) -> PageTable:
    """All set-ups and their readings."""
    left_out = len(findings.points) - MAX_POINTS
    counts = ("readings", "hits", "short", "long", "no echo", "255", "no answer")
    return PageTable(
        name="points",
        title="Every set-up",
        header=("condition", "sensor", "level", "range [cm]", "angle [deg]", *counts, "mean error [cm]", "spread [cm]"),
        rows=tuple(_point(point) for point in findings.points[:MAX_POINTS]),
        caption=f"{left_out:,} more are left out here." if left_out > 0 else "",
        align="lllr",
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
        *("–" if estimate is None else number(estimate.value, 2) for estimate in (point.error, point.spread)),
    )


def sources_table(findings: Findings) -> PageTable:
    """The files that the readings are from."""
    rows = tuple((source.name, f"{source.rows:,}", source.sha256) for source in findings.sources)
    return PageTable("sources", "", ("file", "rows", "SHA-256"), rows, align="lrl")


TABLES = (effects_table, compensation_table, mixture_table, points_table, sources_table)
"""All of them but the conclusions."""
