"""The results of a characterisation as a short table on the terminal, with what the data did not allow.

Findings enter, lines leave; the page has the rest.
"""

from collections.abc import Iterator

from rich.console import Console
from rich.table import Table
from rich.text import Text

from msp_lab.characterise.answer import summarise
from msp_lab.characterise.findings import FactorEffect, Findings, IntervalEstimate, Question

STYLES = {"matters": "yellow", "does not matter": "green", "cannot tell": "dim"}


def show_findings(findings: Findings, console: Console) -> None:
    """Print the results."""
    console.print(summarise(findings), highlight=False)
    rows = sum(each.readings for each in findings.points)
    table = Table(
        title=f"{findings.sensor}: {rows} readings at {len(findings.points)} points", title_justify="left", expand=False
    )
    for heading in ("what", "found (95 % interval)"):
        table.add_column(heading, overflow="fold")
    for what, found in _lines(findings):
        table.add_row(what, found)
    console.print(table)
    for why in dict.fromkeys(findings.absent.values()):
        names = ", ".join(name for name, each in findings.absent.items() if each == why)
        console.print(f"not in these data: {names}: {why}", style="dim", highlight=False)
    for warning in findings.warnings:
        console.print(f"warning: {warning}", style="yellow", highlight=False)


def _lines(findings: Findings) -> Iterator[tuple[str, str | Text]]:
    base, calibration = findings.baseline, findings.calibration
    if base is not None:
        yield "mean error", as_text(base.bias, 2)
        largest = f"{base.largest_hit_error_cm:+.3g} cm; of any reading but codes {base.largest_error_cm:+.3g} cm"
        yield "largest error of a hit", largest
        yield "missed echoes", as_text(base.missed, 4)
    if calibration is not None:
        yield "spread of hits", as_text(calibration.spread, 2)
        if calibration.scale is not None and calibration.offset is not None:
            yield "offset, scale", f"{as_text(calibration.offset, 2)}, {as_text(calibration.scale, 4)}"
        if calibration.set_up_offset is not None:
            yield "between set-ups", as_text(calibration.set_up_offset, 2)
        yield "calibration", f"{calibration.form}: {calibration.reason}"
    longest = findings.maximum_range
    if longest is not None:
        peaks = f"peaks: {len(longest.peaks_before)}, and {len(longest.peaks_after)} with codes for no echo masked"
        yield f"at {longest.true_range_cm:g} cm", f"{peaks}, at {longest.peak.value:g} cm"
    if findings.mixture is not None:
        shown = ", ".join(
            f"{each.name} {each.fitted.value:.3g}{' (at its bound)' if each.at_bound else ''}"
            for each in findings.mixture.parameters
        )
        p_value = findings.mixture.pit_p_value
        fits = "too few readings for a goodness of fit" if p_value is None else f"p of the fit {p_value:.2g}"
        yield "mixture", f"{shown}; {findings.mixture.conditional}; {fits}"
    view = findings.field_of_view
    if view is not None:
        for angle in view.angles:
            yield f"breakaway at {angle.range_cm:g} cm", as_text(angle.half_angle, 1)
        yield "a tilted sensor reads", f"{view.oblique.verdict}: {view.oblique.reason}"
    if findings.sonar is not None:
        rows = [
            f"{row.measured_deg:g}: {_or_none(row.fitted_deg)}, left out {_or_none(row.left_out_deg)}"
            for row in findings.sonar.rows
        ]
        yield "sonar equation [deg]", "; ".join(rows)
    for question in findings.questions:
        subject = f"{question.level} against {question.reference}" + (f", {question.sensor}" if question.sensor else "")
        yield question.name, Text(f"{subject}: {_verdict(question)}", style=STYLES[question.verdict])
    for box in findings.hot_boxes:
        found = f"{as_text(box.per_cent, 1)} of range, not {box.uniform_per_cent:.1f} %; depth {as_text(box.depth, 0)}"
        yield f"box at {box.box_c:.0f} C", found
    for row in findings.temperature_compensation:
        compensated = "not compensated" if row.compensated is None else f"{row.compensated.value:.2f} cm"
        found = f"{row.uncompensated.value:.2f} / {compensated}, implies {row.implied_c.value:.1f} C"
        yield f"air compensated, {row.range_cm:g} cm", found


def _verdict(question: Question) -> str:
    """The verdict, and the effects that it is about."""
    about = [each for each in question.effects if each.verdict == question.verdict and each.estimate is not None]
    if question.verdict == "does not matter":
        about = [each for each in about if each.metric == "bias"]
    return f"{question.verdict}: " + "; ".join(f"{each.metric} {_effect(each)}" for each in about)


def _effect(effect: FactorEffect) -> str:
    assert effect.estimate is not None
    if effect.metric == "bias":
        return as_text(effect.estimate, 2)
    estimate = effect.estimate
    return f"x {estimate.value:.3g} ({estimate.low:.3g} to {estimate.high:.3g})"


def as_text(estimate: IntervalEstimate, digits: int) -> str:
    """Return an estimate with its interval as text."""
    low, high = ("?" if end is None else f"{end:.{digits}f}" for end in (estimate.low, estimate.high))
    return f"{estimate.value:.{digits}f} {estimate.unit}".rstrip() + f" ({low} to {high})"


def _or_none(angle_deg: float | None) -> str:
    return "none" if angle_deg is None else f"{angle_deg:.1f}"
