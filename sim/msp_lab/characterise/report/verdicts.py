"""What the campaign found, in a table that comes first: each conclusion here beside the report's.

Findings enter, rows leave. The verdicts are those of the findings; what is added is only whether the report's number
lies in our interval.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from msp_lab.characterise.findings import Estimate, Findings, Question, Verdict
from msp_lab.characterise.report.chapter4 import REPORT_SENSOR, half_interval, interval
from msp_lab.characterise.report.rows import minus, plus, sentence
from msp_lab.characterise.temperature import REPORT_TABLE
from msp_range.acoustics.sonar import STEP_DEG
from msp_sim.page.style import p_text

Kind = Literal["yes", "no", "open"]
"""Of a mark: something to look at, nothing to look at, not known."""

_NAMES = {
    "bias": "mean error",
    "spread": "spread ×",
    "missed": "odds of a missed echo ×",
    "outliers": "odds of an outlier ×",
}

_AIR = {"none": "no shift seen", "uniform": "all the way", "gradient": "gradient", "confined": "in the box only"}

_MARKS: dict[Verdict, Kind] = {"matters": "yes", "does not matter": "no", "cannot tell": "open"}


@dataclass(frozen=True)
class Conclusion:
    """One line of the table: what was asked, the answer here, the report's, and a mark of a word or two."""

    subject: str
    here: str
    report: str
    kind: Kind
    mark: str


def conclusions(findings: Findings) -> list[Conclusion]:
    """All conclusions in the order of the report; what was not measured is left out."""
    return [
        *_accuracy(findings),
        *_maximum_range(findings),
        *_beam(findings),
        *_questions(findings),
        *_boxes(findings),
        *_compensation(findings),
        *_mixture(findings),
    ]


def _accuracy(findings: Findings) -> Iterator[Conclusion]:
    found = findings.baseline
    if found is not None:
        is_theirs = findings.sensor == REPORT_SENSOR
        within = abs(found.largest_hit_error_cm) <= found.report_largest_error_cm + 0.5
        yield Conclusion(
            "Accuracy, nothing varied",
            f"largest error of a hit {plus(found.largest_hit_error_cm)} cm; mean {interval(found.bias)}; standard "
            f"deviation {interval(found.spread)}",
            f"largest error {found.report_largest_error_cm:g} cm",
            "open" if not is_theirs else "no" if within else "yes",
            "another sensor" if not is_theirs else "as the report" if within else "more than the report",
        )
    calibration = findings.calibration
    if calibration is not None:
        kept = calibration.form != "none"
        yield Conclusion(
            "Calibration",
            sentence(calibration.reason),
            "–",
            "yes" if kept else "no",
            "kept" if kept else "none needed",
        )


def _maximum_range(findings: Findings) -> Iterator[Conclusion]:
    found = findings.maximum_range
    if found is None:
        return
    single = len(found.peaks_after) == 1
    codes = found.no_echo + found.saturated
    at_500 = abs(found.true_range_cm - 500.0) < 1.0
    yield Conclusion(
        f"Maximum range, {found.true_range_cm:g} cm",
        f"{codes:,} of {found.readings:,} readings are 765 or 255; without them "
        f"{'one peak' if single else f'{len(found.peaks_after)} peaks'}, at {interval(found.peak)}",
        f"765 and 255 masked: a single peak{f' near {found.report_peak_cm:g} cm' if at_500 else ''}",
        "no" if single else "yes",
        "one peak" if single else "several peaks",
    )


def _beam(findings: Findings) -> Iterator[Conclusion]:
    view = findings.field_of_view
    if view is None:
        return
    for angle in view.angles:
        if angle.report_deg is None:
            kind, mark = "open", "not in the report"
        elif abs(angle.half_angle.value - angle.report_deg) <= STEP_DEG + 0.05:
            kind, mark = "no", "within a step"
        else:
            kind, mark = "yes", "differs"
        report = "–" if angle.report_deg is None else f"{angle.report_deg:g}°"
        yield Conclusion(
            f"Breakaway angle at {angle.range_cm:g} cm", half_interval(angle.half_angle), report, _kind(kind), mark
        )
    sonar = findings.sonar
    if sonar is not None:
        misses = [
            abs(row.fitted_deg - row.measured_deg) if row.fitted_deg is not None else row.measured_deg
            for row in sonar.rows
        ]
        yield Conclusion(
            "Sonar equation",
            f"misses the measured angles by at most {max(misses):.1f}°; {minus(sonar.note)}",
            "–",
            "no" if sonar.within_a_step else "yes",
            "within a step" if sonar.within_a_step else "does not fit",
        )
    slant = view.oblique
    yield Conclusion(
        "Reading of a tilted sensor",
        slant.reason,
        "eq 8: along the axis",
        "open" if slant.verdict == "unknown" else "no",
        slant.verdict,
    )


def _kind(word: str) -> Kind:
    return "yes" if word == "yes" else "no" if word == "no" else "open"


def _questions(findings: Findings) -> Iterator[Conclusion]:
    """A line each; what several have in common is said in the first."""
    before = ""
    for question in findings.questions:
        is_first = question.name != before
        before = question.name
        yield Conclusion(
            question.question if is_first else "",
            _sizes(question),
            sentence(question.report) if is_first else "",
            _MARKS[question.verdict],
            question.verdict,
        )


def _sizes(question: Question) -> str:
    """The mean error's effect, the others that matter, and for an open question what would have been seen."""
    sensor = f", {question.sensor}" if question.sensor else ""
    parts = []
    for effect in question.effects:
        if effect.estimate is None or (effect.metric != "bias" and effect.verdict == "does not matter"):
            continue
        part = f"{_NAMES[effect.metric]} {interval(effect.estimate)}"
        if effect.verdict == "cannot tell" and effect.smallest_detectable is not None:
            unit = " cm" if effect.metric == "bias" else ""
            part += f", could have seen {effect.smallest_detectable:.2g}{unit}"
        parts.append(part)
    compared = f"{question.level} against {question.reference}{sensor}"
    return f"{compared}: {'; '.join(parts)}" if parts else compared


def _boxes(findings: Findings) -> Iterator[Conclusion]:
    for box in findings.hot_boxes:
        shifts = [row.shift.value for row in box.rows]
        is_hot = box.box_c > box.room_c
        yield Conclusion(
            f"Air of {box.box_c:.0f} °C at the sensor",
            f"mean errors move by {plus(min(shifts))} to {plus(max(shifts))} cm: they call for a correction of "
            f"{interval(box.per_cent)} of range, and not of the {plus(box.uniform_per_cent)} % of such air all over; "
            f"{interval(box.depth)} of it explain them",
            "1 to 2 cm, and not 4.4 % of the range (which it took for 30 %)" if is_hot else "readings somewhat too far",
            "open" if box.best == "none" else "yes",
            _AIR[box.best],
        )


def _compensation(findings: Findings) -> Iterator[Conclusion]:
    rows = [row for row in findings.temperature_compensation if row.compensated is not None]
    if not rows:
        return
    before = _mean_size([row.uncompensated for row in rows])
    after = _mean_size([row.compensated for row in rows if row.compensated is not None])
    report = list(REPORT_TABLE.values())
    yield Conclusion(
        "Temperature compensation (Table 5.1)",
        f"mean error of the ranges {before:.2f} cm without, {after:.2f} cm with it",
        f"{sum(each[0] for each in report) / len(report):.2f} cm without, "
        f"{sum(each[1] for each in report) / len(report):.2f} cm with it (its first row was not compensated)",
        "no" if after < before else "yes",
        "helps" if after < before else "does not help",
    )


def _mean_size(estimates: list[Estimate]) -> float:
    return sum(abs(each.value) for each in estimates) / len(estimates)


def _mixture(findings: Findings) -> Iterator[Conclusion]:
    found = findings.mixture
    if found is None:
        return
    weights = [each for each in found.parameters if each.name.startswith("weights.")]
    shown = ", ".join(f"{each.name.removeprefix('weights.')} {100.0 * each.fitted.value:.3g} %" for each in weights)
    sigma = next((f"; σ {interval(each.fitted)}" for each in found.parameters if each.name == "sigma_cm"), "")
    fits = found.pit_p_value >= 0.05
    yield Conclusion(
        "Mixture of the readings",
        f"{shown}{sigma}; of the fit, p: {p_text(found.pit_p_value)}",
        "not fitted: its quiet room showed hits and missed echoes only",
        "no" if fits else "yes",
        "fits" if fits else "does not fit",
    )
