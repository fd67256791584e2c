"""Pictures that the report does not have: calibration, goodness of fit, beam, boxes of air, and the questions."""

from collections.abc import Iterator

import numpy as np

from msp_lab.characterise.findings import Findings, Question
from msp_lab.characterise.questions import SHARE_BOUND
from msp_lab.characterise.report.chapter4 import Entry, interval
from msp_lab.characterise.report.chapter5 import draw_whole_mixture
from msp_lab.characterise.report.draw.accuracy import BoxOfAir, Linearity, draw_boxes, draw_linearity
from msp_lab.characterise.report.draw.beam import Beam, BeamRow, draw_beam
from msp_lab.characterise.report.draw.mixture import draw_pit
from msp_lab.characterise.report.draw.questions import Row, Size, draw_questions
from msp_lab.characterise.report.rows import Absent, Drawn, Rows, sentence
from msp_range.acoustics.sonar import STEP_DEG, Sonar
from msp_sim.page.style import p_text

QUESTION_NAMES = {
    "material": "material",
    "temperature": "temperature",
    "vibration": "vibration",
    "crosstalk_simultaneous": "pings at once",
    "crosstalk_sequential": "pings in turn",
    "external_interference": "external ultrasound",
}
"""Names of the questions as a picture has room for."""


def entries() -> Iterator[Entry]:
    """The pictures in the page's order, the questions apart (`questions`)."""
    yield "calibration", "Calibration and linearity", _calibration
    yield "mixture", "The fitted mixture, all four densities", draw_whole_mixture
    yield "pit", "Goodness of fit: probability integral transform", _pit
    yield "sonar_equation", "Sonar equation through the breakaway angles", _sonar
    yield "hot_boxes", "Where the hot and the cold air was", _boxes


def questions(findings: Findings, rows: Rows) -> Drawn:
    """The questions as a forest plot."""
    shown = [
        Row(
            _label(question),
            [
                Size(
                    effect.metric,
                    effect.estimate.value,
                    effect.estimate.low,
                    effect.estimate.high,
                    effect.bound,
                    effect.smallest_detectable,
                    effect.verdict,
                )
                for effect in question.effects
                if effect.estimate is not None
            ],
        )
        for question in findings.questions
    ]
    if not any(row.sizes for row in shown):
        raise Absent(sentence(findings.absent.get("questions", "the data compare no two settings of the bench")))
    caption = (
        "Each line is an effect with its 95 % interval; grey ground is what would be too small to matter, the black "
        "bars the smallest effect that these data would have shown in 80 % of cases. Verdicts are corrected for the "
        f"number of questions (Holm). Missed readings and outliers that change by less than {SHARE_BOUND:.0%} of all "
        "readings also count as too small, whatever their odds. No bars: not known. An arrow: the interval goes on."
    )
    return Drawn(draw_questions(shown), caption, "Effect sizes of every question with their intervals.")


def _label(question: Question) -> str:
    name = QUESTION_NAMES.get(question.name, question.name)
    level = f"\n{question.level} against {question.reference}" if question.level else ""
    sensor = f", {question.sensor}" if question.sensor else ""
    return f"{name}{sensor}{level}"


def _calibration(findings: Findings, rows: Rows) -> Drawn:
    found = findings.calibration
    if found is None or not found.true_cm:
        raise Absent(sentence(findings.absent.get("calibration", "the readings were not compared with a reference")))
    linearity = Linearity(
        true_cm=np.array(found.true_cm),
        reading_cm=np.array(found.reading_cm),
        reading_std_cm=np.array(found.reading_std_cm),
        line_cm=None if found.offset is None or found.scale is None else (found.offset.value, found.scale.value),
        knots_cm=np.array([(knot.true_cm, knot.reading_cm) for knot in found.knots]).reshape(-1, 2),
        reference_std_cm=found.reference_std_cm,
        held_out=[(each.form, each.rms_cm) for each in found.held_out],
        kept=found.form,
    )
    caption = f"Mean error {interval(found.bias)}"
    if found.offset is not None and found.scale is not None:
        caption += f"; straight line: offset {interval(found.offset)}, scale {interval(found.scale)}"
    if found.linearity is not None:
        caption += f"; farthest from it {interval(found.linearity)}"
        if found.linearity_by_chance_cm is not None:
            caption += f" (by chance up to {found.linearity_by_chance_cm:.2f} cm)"
    caption += f". Spread {interval(found.spread)}; resolution {found.resolution.value:g} cm. {sentence(found.reason)}"
    return Drawn(draw_linearity(linearity), caption, "Mean error over true range with the calibration.")


def _pit(findings: Findings, rows: Rows) -> Drawn:
    found = findings.mixture
    if found is None:
        raise Absent(sentence(findings.absent.get("mixture", "the mixture was not fitted")))
    caption = (
        "Where the model is right the bars are level. A slope is a bias, a bowl too small a spread, a hump too large a "
        f"one. Of uniform, p: {p_text(found.pit_p_value)}, over {found.readings:,} readings."
    )
    return Drawn(draw_pit(np.array(found.pit_counts, dtype=np.float64), found.pit_p_value), caption, "PIT histogram.")


def _sonar(findings: Findings, rows: Rows) -> Drawn:
    found = findings.sonar
    if found is None:
        raise Absent(
            sentence(findings.absent.get("sonar", "there are too few breakaway angles for the three parameters"))
        )
    equation = Sonar(found.source_level_db, found.piston_diameter_m, found.gain_db_per_m, rows.model.frequency_hz)
    measured = {row.range_cm: row for row in found.rows}
    angles = findings.field_of_view.angles if findings.field_of_view is not None else ()
    by_range = {angle.range_cm: angle for angle in angles}
    longest_cm = max([*measured, *(range_cm for range_cm, _ in found.beyond)])
    span_cm = np.linspace(min(measured) * 0.6, longest_cm, 120)
    radians = [equation.half_angle_rad(range_cm / 100.0) for range_cm in span_cm.tolist()]
    used = [(row.range_cm, row.measured_deg) for row in found.rows] + list(found.beyond)
    beam = Beam(
        rows=tuple(
            BeamRow(
                row.range_cm,
                row.measured_deg,
                by_range[row.range_cm].half_angle.low if row.range_cm in by_range else None,
                by_range[row.range_cm].half_angle.high if row.range_cm in by_range else None,
                by_range[row.range_cm].report_deg if row.range_cm in by_range else None,
                row.left_out_deg,
            )
            for row in found.rows
        ),
        equation_cm=span_cm,
        equation_deg=np.degrees(np.array([np.nan if each is None else each for each in radians])),
        used_cm=np.array([range_cm for range_cm, _ in used]),
        used_deg=np.array([angle for _, angle in used]),
        step_deg=STEP_DEG,
    )
    fitted = [abs(row.fitted_deg - row.measured_deg) for row in found.rows if row.fitted_deg is not None]
    left_out = [abs(row.left_out_deg - row.measured_deg) for row in found.rows if row.left_out_deg is not None]
    caption = (
        f"The equation misses the measured angles by at most {max(fitted):.1f}°" if fitted else "No angle is predicted"
    )
    caption += f", and predicts each from the others to {max(left_out):.1f}°. " if left_out else ". "
    caption += (
        f"Equivalent piston {1000.0 * found.piston_diameter_m:.1f} mm, gain {found.gain_db_per_m:.1f} dB/m. "
        f"{sentence(found.note)} Beyond the measured ranges the angle never grows."
    )
    return Drawn(draw_beam(beam), caption, "Half angle of the beam over range: measured and by the sonar equation.")


def _boxes(findings: Findings, rows: Rows) -> Drawn:
    if not findings.hot_boxes:
        raise Absent(
            sentence(findings.absent.get("hot_boxes", "there are no readings with hot or cold air at the sensor only"))
        )
    boxes = []
    for box in findings.hot_boxes[:3]:
        shifts = [row.shift for row in box.rows]
        assumed = " (assumed)" if box.room_is_assumed else ""
        boxes.append(
            BoxOfAir(
                label=f"{box.box_c:.0f} °C at the sensor, {box.room_c:.0f} °C{assumed} beyond",
                range_cm=np.array([row.range_cm for row in box.rows]),
                shift_cm=np.array([each.value for each in shifts]),
                low_cm=np.array([each.value if each.low is None else each.low for each in shifts]),
                high_cm=np.array([each.value if each.high is None else each.high for each in shifts]),
                uniform_cm=np.array([row.uniform_cm for row in box.rows]),
                gradient_cm=np.array([row.gradient_cm for row in box.rows]),
                confined_cm=np.array([row.confined_cm for row in box.rows]),
                depth_cm=box.depth.value,
            )
        )
    caption = " ".join(sentence(box.answer) for box in findings.hot_boxes)
    caption += (
        " The report takes eq 7 with 115 °F for 30 % (it is 4.4 %), measured 1 to 2 cm and explained it by a gradient; "
        "a linear one would err by 0.9 cm at 40 cm and 5.9 cm at 260 (errata 4 and 11)."
    )
    return Drawn(draw_boxes(boxes), caption, "Shift of the mean error with hot or cold air at the sensor, by range.")
