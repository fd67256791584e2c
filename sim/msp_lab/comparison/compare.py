"""Where findings agree with the report and where they differ, a line each.

Each line has the finding, the report's statement, and whether both agree.
"""

from collections.abc import Iterator

from msp_lab.characterise.findings import Findings
from msp_lab.characterise.page.answers import peaks_found, with_subject
from msp_lab.characterise.page.text import half_interval
from msp_lab.comparison.report import ANSWERS, REPORT
from msp_sim.acoustics.sonar import STEP_DEG
from msp_sim.page.table import PageTable, VerdictMark
from msp_sim.page.text import plus, sentence

ROUNDING_CM = 0.5
"""A largest error agrees with the report's where it exceeds it by no more than this: both are whole centimetres."""
ROUNDING_DEG = 0.05
"""Angles agree within one step of the report's motor (1.8 deg) and the rounding of their numbers."""
HOT_BOX = "1 to 2 cm, which it explains by a gradient; its 30 % of eq 7 would be 4.4 % (errata 4 and 11)"

Row = tuple[str, VerdictMark | str, str, str]
"""Subject, whether both agree (nothing: not decided), the finding, and the report's statement."""


def comparison_table(findings: Findings) -> PageTable:
    """All lines in the order of the report; what was not measured is left out."""
    return PageTable(
        "compared-lines",
        "",
        ("subject", "agreement", "here", "the report"),
        tuple(_lines(findings)),
        "In brackets 95 % intervals. Errors are reading minus truth: a positive one reads too far.",
        align="l",
    )


def _lines(findings: Findings) -> Iterator[Row]:
    base, longest, view = findings.baseline, findings.maximum_range, findings.field_of_view
    if base is not None:
        agrees = abs(base.largest_hit_error_cm) <= REPORT.largest_error_cm + ROUNDING_CM
        found = f"{plus(base.largest_hit_error_cm)} cm"
        yield _line("Largest error, nothing varied (4.3.1)", found, f"{REPORT.largest_error_cm:g} cm", agrees)
    if longest is not None:
        subject = f"Readings at {longest.true_range_cm:g} cm, codes masked (4.3.2)"
        where = f" near {REPORT.peak_cm:g} cm" if abs(longest.true_range_cm - REPORT.peak_range_cm) < 1.0 else ""
        yield _line(subject, peaks_found(longest), f"a single peak{where}", len(longest.peaks_after) == 1)
    if view is not None:
        for angle in view.angles:
            subject, found = f"Breakaway angle at {angle.range_cm:g} cm (4.3.3)", half_interval(angle.half_angle)
            report_deg = REPORT.half_angle_deg.get(round(angle.range_cm, 1))
            if report_deg is None:
                yield subject, VerdictMark("not in the report"), found, "–"
            else:
                agrees = abs(angle.half_angle.value - report_deg) <= STEP_DEG + ROUNDING_DEG
                yield _line(subject, found, f"{report_deg:g}°", agrees)
        yield "Reading of a tilted sensor", "", view.oblique.reason, "eq 8: along the axis"
    for subject, question in with_subject(findings.questions):
        report = sentence(ANSWERS.get(question.name, "")) if subject else ""
        yield subject, "", question.answer, report
    for box in findings.hot_boxes:
        report = HOT_BOX if box.box_c > box.room_c else "readings somewhat too far"
        yield f"Air of {box.box_c:.0f} °C at the sensor (4.3.5)", "", sentence(box.answer), report


def _line(subject: str, found: str, report: str, agrees: bool) -> Row:
    return subject, VerdictMark("agrees", "no") if agrees else VerdictMark("differs", "yes"), found, report
