"""What was found: a few sentences, and a table of conclusions with the findings' verdict on each."""

from collections.abc import Iterator, Sequence

from msp_lab.characterise.experiments import EXPERIMENTS
from msp_lab.characterise.findings import NAMES, Findings, Form, MaximumRange, Question, Verdict
from msp_lab.characterise.page.text import half_interval, interval
from msp_lab.estimates import IntervalEstimate
from msp_sim.page.table import MarkKind, PageTable, VerdictMark
from msp_sim.page.text import counted, minus, p_text, plus, sentence

_AIR = {"none": "no shift seen", "uniform": "all the way", "gradient": "gradient", "confined": "in the box only"}
_MARKS: dict[Verdict, MarkKind] = {"matters": "yes", "does not matter": "no", "cannot tell": "open"}
_CALIBRATION: dict[Form, str] = {
    "none": "that a calibration improves them is not shown",
    "offset and scale": "a straight line corrects them",
    "piecewise linear": "a calibration of straight pieces corrects them",
}

Row = tuple[str, VerdictMark, str]
"""A line of the table: what was asked, a verdict of a word or two, and the answer."""

MEASURED = VerdictMark("measured")


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
        silent = sum(point.no_answer for point in base.points)
        pings = f" ({silent:,} pings have no answer, so they are in no kind of readings)" if silent else ""
        parts.append(
            f"With nothing varied {100.0 * base.missed.value:.2g} % of the echoes are missed{pings} and "
            f"{100.0 * base.outliers.value:.2g} % of the readings are of something else."
        )
    verdicts: dict[str, set[Verdict]] = {}
    for question in findings.questions:
        verdicts.setdefault(question.name, set()).add(question.verdict)
    matters = [name for name, found in verdicts.items() if "matters" in found]
    open_ = [name for name, found in verdicts.items() if "cannot tell" in found and name not in matters]
    for words, names in (("What changes the readings", matters), ("What may, which these data cannot decide", open_)):
        parts += [f"{words}: {', '.join(EXPERIMENTS[name].matters for name in names)}."] if names else []
    return minus(" ".join(parts))


def conclusions_table(findings: Findings) -> PageTable:
    """Return all conclusions; what was not measured is left out."""
    parts = (_accuracy, _maximum_range, _beam, _questions, _air, _mixture)
    rows = tuple(row for part in parts for row in part(findings))
    return PageTable("conclusions", "", ("subject", "verdict", "found (95 % interval)"), rows, align="l")


def _accuracy(findings: Findings) -> Iterator[Row]:
    base, calibration = findings.baseline, findings.calibration
    if base is not None:
        answer = f"largest error of a hit {plus(base.largest_hit_error_cm)} cm; mean {interval(base.bias)}; "
        answer += f"standard deviation {interval(base.spread)}; missed echoes {interval(base.missed)}"
        yield "Accuracy, nothing varied", MEASURED, answer
    if calibration is not None:
        none = VerdictMark("none shown to help", "no") if calibration.held_out else VerdictMark("cannot tell")
        yield (
            "Calibration",
            none if calibration.form == "none" else VerdictMark("kept", "yes"),
            sentence(calibration.reason),
        )
        if calibration.offset:
            answer = f"offset {interval(calibration.offset)}, scale {interval(calibration.scale)}"
            yield "Straight line", MEASURED, answer
        if calibration.set_up_offset is not None:
            yield "Between set-ups", MEASURED, interval(calibration.set_up_offset)


def peaks_found(found: MaximumRange) -> str:
    """How many peaks there are without the codes, and where."""
    return f"{counted(len(found.peaks_after), 'peak')}, at {interval(found.peak)}"


def _maximum_range(findings: Findings) -> Iterator[Row]:
    found = findings.maximum_range
    if found is not None:
        codes = found.no_echo + found.saturated
        answer = f"{codes:,} of {found.readings:,} readings are codes for no echo; without them {peaks_found(found)}"
        mark = _mark(len(found.peaks_after) == 1, "one peak", "several peaks")
        yield f"Maximum range, {found.true_range_cm:g} cm", mark, answer


def _mark(is_good: bool, good: str, bad: str) -> VerdictMark:
    return VerdictMark(good, "no") if is_good else VerdictMark(bad, "yes")


def _beam(findings: Findings) -> Iterator[Row]:
    view, sonar = findings.field_of_view, findings.sonar
    if view is None:
        return
    for angle in view.angles:
        yield f"Breakaway angle at {angle.range_cm:g} cm", MEASURED, half_interval(angle.half_angle)
    if sonar is not None:
        worst_deg = max(abs((row.fitted_deg or 0.0) - row.measured_deg) for row in sonar.rows)
        answer = f"misses the measured angles by at most {worst_deg:.1f}°; {minus(sonar.note)}"
        yield "Sonar equation", _mark(sonar.within_a_step, "within a step", "does not fit"), answer
    slant = view.oblique
    mark = VerdictMark(slant.verdict, "open" if slant.verdict == "unknown" else "no")
    yield "Reading of a tilted sensor", mark, slant.reason


def with_subject(questions: Sequence[Question]) -> Iterator[tuple[str, Question]]:
    """Each question with its words, which several about one thing have in common: only the first has them."""
    before = ""
    for question in questions:
        yield question.question if question.name != before else "", question
        before = question.name


def _questions(findings: Findings) -> Iterator[Row]:
    for subject, question in with_subject(findings.questions):
        yield subject, VerdictMark(question.verdict, _MARKS[question.verdict]), _sizes(question)


def _sizes(question: Question) -> str:
    """The mean error's effect, the others that matter, and for an open question what would have been seen."""
    sensor = f", {question.sensor}" if question.sensor else ""
    parts = []
    for effect in question.effects:
        if effect.estimate is None or (effect.is_ratio and effect.verdict == "does not matter"):
            continue
        part = f"{NAMES[effect.metric]}{' ×' if effect.is_ratio else ''} {interval(effect.estimate)}"
        if effect.verdict == "cannot tell" and effect.smallest_detectable is not None:
            part += f", could have seen {effect.smallest_detectable:.2g}{'' if effect.is_ratio else ' cm'}"
        parts.append(part)
    compared = f"{question.compared}{sensor}"
    return f"{compared}: {'; '.join(parts)}" if parts else compared


def _air(findings: Findings) -> Iterator[Row]:
    for box in findings.hot_boxes:
        shifts = [row.shift.value for row in box.rows]
        yield (
            f"Air of {box.box_c:.0f} °C at the sensor",
            VerdictMark(_AIR[box.best], "open" if box.best == "none" else "yes"),
            f"mean errors move by {plus(min(shifts))} to {plus(max(shifts))} cm: they call for a correction of "
            f"{interval(box.per_cent)} of range, {box.compared} the {plus(box.uniform_per_cent)} % of such air "
            f"all over; {interval(box.depth)} of it explain them",
        )
    both = [(row.uncompensated, row.compensated) for row in findings.temperature_compensation if row.compensated]
    if both:
        before, after = (sum(abs(error.value) for error in column) / len(both) for column in zip(*both, strict=True))
        answer = f"mean error of the ranges {before:.2f} cm without, {after:.2f} cm with it"
        yield "Temperature compensation", _mark(after < before, "helps", "does not help"), answer


def _mixture(findings: Findings) -> Iterator[Row]:
    found = findings.mixture
    if found is None:
        return
    fitted: dict[str, IntervalEstimate] = {parameter.name: parameter.fitted for parameter in found.parameters}
    shown = f"of {found.readings:,} answers "
    shown += ", ".join(f"{name} {100.0 * share:.3g} %" for name, share in found.shares.items())
    shown += f"; σ {interval(fitted['sigma_cm'])}" if "sigma_cm" in fitted else ""
    if found.pit_p_value is None:
        yield "Kinds of readings", VerdictMark("too few to test"), shown
    else:
        answer = f"{shown}; of the fit, p: {p_text(found.pit_p_value)}"
        yield "Kinds of readings", _mark(found.pit_p_value >= 0.05, "fits", "does not fit"), answer
