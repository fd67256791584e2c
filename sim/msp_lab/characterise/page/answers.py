"""What was found: a few sentences, and a table of conclusions with a verdict each.

Findings enter, text leaves. The verdicts are those of the findings.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from msp_lab.characterise.findings import Findings, Form
from msp_lab.characterise.page.text import half_interval, interval, minus, plus, sentence
from msp_lab.characterise.point_findings import IntervalEstimate
from msp_lab.characterise.question_findings import Question, Verdict
from msp_lab.characterise.questions import TOPICS
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


_CALIBRATION: dict[Form, str] = {
    "none": "that a calibration improves them is not shown",
    "offset and scale": "a straight line corrects them",
    "piecewise linear": "a calibration of straight pieces corrects them",
}


@dataclass(frozen=True)
class Conclusion:
    """One line of the table: what was asked, the answer, and a mark of a word or two."""

    subject: str
    answer: str
    kind: Kind
    mark: str


def summarise(findings: Findings) -> str:
    """Return what these readings are worth, in a few sentences: error, spread, missed echoes, and what matters.

    Examples
    --------
    >>> summarise(Findings("HC-SR04", "2026-10-05", 20.0, (), ()))
    'These data do not say how accurate the HC-SR04 is.'
    """
    calibration, base = findings.calibration, findings.baseline
    if calibration is None:
        parts = [f"These data do not say how accurate the {findings.sensor} is."]
    else:
        bias = plus((calibration if base is None else base).bias.value, 2)
        in_air = plus(calibration.bias.value, 2)
        # What a calibration corrects is the error that is left when the air's temperature is compensated.
        air_c = findings.calibration_temperature_c
        compensated = "" if in_air == bias or air_c is None else f" ({in_air} cm in air of {air_c:g} °C)"
        form = _CALIBRATION[calibration.form] if calibration.held_out else "there are too few ranges for a calibration"
        parts = [
            f"Hits of the {findings.sensor} are off by {bias} cm on average{compensated} and scatter by "
            f"{calibration.spread.value:.2g} cm; {form}."
        ]
    if base is not None:
        parts.append(
            f"With nothing varied {100.0 * base.missed.value:.2g} % of the echoes are missed and "
            f"{100.0 * base.outliers.value:.2g} % of the readings are of something else."
        )
    names = dict.fromkeys(each.name for each in findings.questions)
    verdicts = {name: {each.verdict for each in findings.questions if each.name == name} for name in names}
    matters = [TOPICS[name].matters for name in names if "matters" in verdicts[name]]
    open_ = [
        TOPICS[name].matters for name in names if "matters" not in verdicts[name] and "cannot tell" in verdicts[name]
    ]
    parts += [f"What changes the readings: {', '.join(matters)}."] if matters else []
    parts += [f"What may, which these data cannot decide: {', '.join(open_)}."] if open_ else []
    return minus(" ".join(parts))


def conclusions(findings: Findings) -> list[Conclusion]:
    """Return all conclusions; what was not measured is left out."""
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
        yield Conclusion(
            "Accuracy, nothing varied",
            f"largest error of a hit {plus(found.largest_hit_error_cm)} cm; mean {interval(found.bias)}; standard "
            f"deviation {interval(found.spread)}",
            "open",
            "measured",
        )
    calibration = findings.calibration
    if calibration is not None:
        kept = calibration.form != "none"
        yield Conclusion(
            "Calibration",
            sentence(calibration.reason),
            "yes" if kept else "no" if calibration.held_out else "open",
            "kept" if kept else "none shown to help" if calibration.held_out else "cannot tell",
        )
        if calibration.set_up_offset is not None:
            yield Conclusion("Between set-ups", interval(calibration.set_up_offset), "open", "measured")


def _maximum_range(findings: Findings) -> Iterator[Conclusion]:
    found = findings.maximum_range
    if found is None:
        return
    single = len(found.peaks_after) == 1
    codes = found.no_echo + found.saturated
    yield Conclusion(
        f"Maximum range, {found.true_range_cm:g} cm",
        f"{codes:,} of {found.readings:,} readings are codes for no echo; without them "
        f"{'one peak' if single else f'{len(found.peaks_after)} peaks'}, at {interval(found.peak)}",
        "no" if single else "yes",
        "one peak" if single else "several peaks",
    )


def _beam(findings: Findings) -> Iterator[Conclusion]:
    view = findings.field_of_view
    if view is None:
        return
    for angle in view.angles:
        yield Conclusion(
            f"Breakaway angle at {angle.range_cm:g} cm", half_interval(angle.half_angle), "open", "measured"
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
            "no" if sonar.within_a_step else "yes",
            "within a step" if sonar.within_a_step else "does not fit",
        )
    slant = view.oblique
    yield Conclusion(
        "Reading of a tilted sensor",
        slant.reason,
        "open" if slant.verdict == "unknown" else "no",
        slant.verdict,
    )


def _questions(findings: Findings) -> Iterator[Conclusion]:
    """One line per question; what several have in common is only in the first."""
    before = ""
    for question in findings.questions:
        is_first = question.name != before
        before = question.name
        yield Conclusion(
            question.question if is_first else "",
            _sizes(question),
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
        yield Conclusion(
            f"Air of {box.box_c:.0f} °C at the sensor",
            f"mean errors move by {plus(min(shifts))} to {plus(max(shifts))} cm: they call for a correction of "
            f"{interval(box.per_cent)} of range, {box.compared} the {plus(box.uniform_per_cent)} % of such air "
            f"all over; {interval(box.depth)} of it explain them",
            "open" if box.best == "none" else "yes",
            _AIR[box.best],
        )


def _compensation(findings: Findings) -> Iterator[Conclusion]:
    rows = [row for row in findings.temperature_compensation if row.compensated is not None]
    if not rows:
        return
    before = _mean_size([row.uncompensated for row in rows])
    after = _mean_size([row.compensated for row in rows if row.compensated is not None])
    yield Conclusion(
        "Temperature compensation",
        f"mean error of the ranges {before:.2f} cm without, {after:.2f} cm with it",
        "no" if after < before else "yes",
        "helps" if after < before else "does not help",
    )


def _mean_size(estimates: list[IntervalEstimate]) -> float:
    return sum(abs(each.value) for each in estimates) / len(estimates)


def _mixture(findings: Findings) -> Iterator[Conclusion]:
    found = findings.mixture
    if found is None:
        return
    weights = [each for each in found.parameters if each.name.startswith("weights.")]
    shown = ", ".join(f"{each.name.removeprefix('weights.')} {100.0 * each.fitted.value:.3g} %" for each in weights)
    sigma = next((f"; σ {interval(each.fitted)}" for each in found.parameters if each.name == "sigma_cm"), "")
    if found.pit_p_value is None:
        yield Conclusion("Kinds of readings", f"{shown}{sigma}", "open", "too few to test")
        return
    fits = found.pit_p_value >= 0.05
    yield Conclusion(
        "Kinds of readings",
        f"{shown}{sigma}; of the fit, p: {p_text(found.pit_p_value)}",
        "no" if fits else "yes",
        "fits" if fits else "does not fit",
    )
