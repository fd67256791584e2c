"""What was found: a few sentences, and a table of conclusions with a verdict each.

Findings enter, text leaves. The verdicts are those of the findings.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from msp_lab.characterise.experiments import EXPERIMENTS
from msp_lab.characterise.findings import NAMES, Findings, Form, MaximumRange, Question, Verdict
from msp_lab.characterise.page.text import counted, half_interval, interval
from msp_lab.characterise.point_findings import IntervalEstimate
from msp_sim.page.text import minus, p_text, plus, sentence

Kind = Literal["yes", "no", "open"]
"""Kinds of marks: something to look at, nothing to look at, not known."""

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
    kind: Kind = "open"
    mark: str = "measured"


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
    verdicts: dict[str, set[Verdict]] = {}
    for each in findings.questions:
        verdicts.setdefault(each.name, set()).add(each.verdict)
    matters = [name for name, found in verdicts.items() if "matters" in found]
    open_ = [name for name, found in verdicts.items() if "cannot tell" in found and name not in matters]
    for words, names in (("What changes the readings", matters), ("What may, which these data cannot decide", open_)):
        parts += [f"{words}: {', '.join(EXPERIMENTS[name].matters for name in names)}."] if names else []
    return minus(" ".join(parts))


def conclusions(findings: Findings) -> list[Conclusion]:
    """Return all conclusions; what was not measured is left out."""
    return [
        *_accuracy(findings),
        *_maximum_range(findings),
        *_beam(findings),
        *_questions(findings),
        *_air(findings),
        *_mixture(findings),
    ]


def _accuracy(findings: Findings) -> Iterator[Conclusion]:
    base, calibration = findings.baseline, findings.calibration
    if base is not None:
        yield Conclusion(
            "Accuracy, nothing varied",
            f"largest error of a hit {plus(base.largest_hit_error_cm)} cm; mean {interval(base.bias)}; standard "
            f"deviation {interval(base.spread)}",
        )
    if calibration is not None:
        kind: Kind = "yes" if calibration.form != "none" else "no" if calibration.held_out else "open"
        mark = {"yes": "kept", "no": "none shown to help", "open": "cannot tell"}[kind]
        yield Conclusion("Calibration", sentence(calibration.reason), kind, mark)
        if calibration.set_up_offset is not None:
            yield Conclusion("Between set-ups", interval(calibration.set_up_offset))


def peaks_found(found: MaximumRange) -> str:
    """How many peaks there are without the codes, and where."""
    return f"{counted(len(found.peaks_after), 'peak')}, at {interval(found.peak)}"


def _maximum_range(findings: Findings) -> Iterator[Conclusion]:
    found = findings.maximum_range
    if found is not None:
        codes = found.no_echo + found.saturated
        answer = f"{codes:,} of {found.readings:,} readings are codes for no echo; without them {peaks_found(found)}"
        kind, mark = _mark(len(found.peaks_after) == 1, "one peak", "several peaks")
        yield Conclusion(f"Maximum range, {found.true_range_cm:g} cm", answer, kind, mark)


def _mark(is_good: bool, good: str, bad: str) -> tuple[Kind, str]:
    return ("no", good) if is_good else ("yes", bad)


def _beam(findings: Findings) -> Iterator[Conclusion]:
    view, sonar = findings.field_of_view, findings.sonar
    if view is None:
        return
    for angle in view.angles:
        yield Conclusion(f"Breakaway angle at {angle.range_cm:g} cm", half_interval(angle.half_angle))
    if sonar is not None:
        worst_deg = max(abs((row.fitted_deg or 0.0) - row.measured_deg) for row in sonar.rows)
        answer = f"misses the measured angles by at most {worst_deg:.1f}°; {minus(sonar.note)}"
        yield Conclusion("Sonar equation", answer, *_mark(sonar.within_a_step, "within a step", "does not fit"))
    slant = view.oblique
    yield Conclusion(
        "Reading of a tilted sensor", slant.reason, "open" if slant.verdict == "unknown" else "no", slant.verdict
    )


def with_subject(questions: Sequence[Question]) -> Iterator[tuple[str, Question]]:
    """Each question with its words, which several about one thing have in common: only the first has them."""
    before = ""
    for question in questions:
        yield question.question if question.name != before else "", question
        before = question.name


def _questions(findings: Findings) -> Iterator[Conclusion]:
    for subject, question in with_subject(findings.questions):
        yield Conclusion(subject, _sizes(question), _MARKS[question.verdict], question.verdict)


def _sizes(question: Question) -> str:
    """The mean error's effect, the others that matter, and for an open question what would have been seen."""
    sensor = f", {question.sensor}" if question.sensor else ""
    parts = []
    for effect in question.effects:
        if effect.estimate is None or (effect.is_ratio and effect.verdict == "does not matter"):
            continue
        name = f"{NAMES[effect.metric]} ×" if effect.is_ratio else "mean error"
        part = f"{name} {interval(effect.estimate)}"
        if effect.verdict == "cannot tell" and effect.smallest_detectable is not None:
            part += f", could have seen {effect.smallest_detectable:.2g}{'' if effect.is_ratio else ' cm'}"
        parts.append(part)
    compared = f"{question.level} against {question.reference}{sensor}"
    return f"{compared}: {'; '.join(parts)}" if parts else compared


def _air(findings: Findings) -> Iterator[Conclusion]:
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
    both = [(row.uncompensated, row.compensated) for row in findings.temperature_compensation if row.compensated]
    if both:
        before, after = (sum(abs(each.value) for each in column) / len(both) for column in zip(*both, strict=True))
        answer = f"mean error of the ranges {before:.2f} cm without, {after:.2f} cm with it"
        yield Conclusion("Temperature compensation", answer, *_mark(after < before, "helps", "does not help"))


def _mixture(findings: Findings) -> Iterator[Conclusion]:
    found = findings.mixture
    if found is None:
        return
    fitted: dict[str, IntervalEstimate] = {each.name: each.fitted for each in found.parameters}
    shown = ", ".join(
        f"{name.removeprefix('weights.')} {100.0 * each.value:.3g} %"
        for name, each in fitted.items()
        if name.startswith("weights.")
    )
    shown += f"; σ {interval(fitted['sigma_cm'])}" if "sigma_cm" in fitted else ""
    if found.pit_p_value is None:
        yield Conclusion("Kinds of readings", shown, "open", "too few to test")
    else:
        answer = f"{shown}; of the fit, p: {p_text(found.pit_p_value)}"
        yield Conclusion("Kinds of readings", answer, *_mark(found.pit_p_value >= 0.05, "fits", "does not fit"))
