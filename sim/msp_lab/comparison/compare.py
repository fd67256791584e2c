"""Where findings agree with the report and where they differ, a line each.

Findings enter, lines leave: the finding, the report's statement, and whether both agree.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from msp_lab.characterise.findings import Findings
from msp_lab.characterise.page.text import half_interval, interval, plus, sentence
from msp_lab.comparison.report import REPORT
from msp_range.acoustics.sonar import STEP_DEG

ROUNDING_CM = 0.5
"""A largest error agrees with the report's where it exceeds it by no more than this: both are whole centimetres."""
ROUNDING_DEG = 0.05
"""Angles agree within one step of the report's motor (1.8 deg) and the rounding of their numbers."""
HOT_BOX = "1 to 2 cm, which it explains by a gradient; its 30 % of eq 7 would be 4.4 % (errata 4 and 11)"

Agreement = Literal["agrees", "differs", "not in the report"]


@dataclass(frozen=True)
class ComparisonLine:
    """A subject, the finding, the report's statement, and whether they agree; None: not decided."""

    subject: str
    found: str
    report: str
    agreement: Agreement | None


def compare_with_report(findings: Findings) -> list[ComparisonLine]:
    """Return all lines in the order of the report; what was not measured is left out."""
    return [*_accuracy(findings), *_longest_range(findings), *_beam(findings), *_questions(findings), *_air(findings)]


def _accuracy(findings: Findings) -> Iterator[ComparisonLine]:
    base = findings.baseline
    if base is not None:
        agrees = abs(base.largest_hit_error_cm) <= REPORT.largest_error_cm + ROUNDING_CM
        yield ComparisonLine(
            "Largest error, nothing varied (4.3.1)",
            f"{plus(base.largest_hit_error_cm)} cm",
            f"{REPORT.largest_error_cm:g} cm",
            _agreement(agrees),
        )


def _longest_range(findings: Findings) -> Iterator[ComparisonLine]:
    longest = findings.maximum_range
    if longest is None:
        return
    count = len(longest.peaks_after)
    at_same_range = abs(longest.true_range_cm - REPORT.peak_range_cm) < 1.0
    yield ComparisonLine(
        f"Readings at {longest.true_range_cm:g} cm, codes masked (4.3.2)",
        f"{'one peak' if count == 1 else f'{count} peaks'}, at {interval(longest.peak)}",
        f"a single peak{f' near {REPORT.peak_cm:g} cm' if at_same_range else ''}",
        _agreement(count == 1),
    )


def _beam(findings: Findings) -> Iterator[ComparisonLine]:
    view = findings.field_of_view
    for angle in view.angles if view is not None else ():
        report_deg = REPORT.half_angle_deg.get(round(angle.range_cm, 1))
        agreement: Agreement = "not in the report"
        if report_deg is not None:
            agreement = _agreement(abs(angle.half_angle.value - report_deg) <= STEP_DEG + ROUNDING_DEG)
        yield ComparisonLine(
            f"Breakaway angle at {angle.range_cm:g} cm (4.3.3)",
            half_interval(angle.half_angle),
            "–" if report_deg is None else f"{report_deg:g}°",
            agreement,
        )
    if view is not None:
        yield ComparisonLine("Reading of a tilted sensor", view.oblique.reason, "eq 8: along the axis", None)


def _questions(findings: Findings) -> Iterator[ComparisonLine]:
    before = ""
    for question in findings.questions:
        is_first = question.name != before
        before = question.name
        yield ComparisonLine(
            question.question if is_first else "",
            question.answer,
            sentence(REPORT.answers.get(question.name, "")) if is_first else "",
            None,
        )


def _air(findings: Findings) -> Iterator[ComparisonLine]:
    for box in findings.hot_boxes:
        report = HOT_BOX if box.box_c > box.room_c else "readings somewhat too far"
        yield ComparisonLine(f"Air of {box.box_c:.0f} °C at the sensor (4.3.5)", sentence(box.answer), report, None)


def _agreement(agrees: bool) -> Agreement:
    return "agrees" if agrees else "differs"
