"""Pictures of the range error over range: the calibration, nothing varied, and each experiment of a campaign."""

import re
from collections.abc import Iterator, Mapping, Sequence
from functools import partial

import numpy as np
from matplotlib.figure import Figure

from msp_lab.characterise.findings import CalibrationFindings
from msp_lab.characterise.page.errors import draw_errors, scale_of
from msp_lab.characterise.page.picture_data import PictureData, errors_of, summary
from msp_lab.characterise.page.text import interval, span
from msp_lab.characterise.points import PointReadings, grouped
from msp_lab.characterise.temperature import ROOM_C, ROOM_WITHIN_C
from msp_lab.estimates import Z
from msp_range.correction.calibration import curve_through
from msp_sim.page.page import Absent, Drawn, Entry
from msp_sim.page.style import GREEN, OURS, PALE, REFERENCE, intervals, line_at_zero, new_panels, shaded
from msp_sim.page.text import counted, number, plus, sentence

MAX_LEVELS = 5
"""Panels that a picture has room for."""
CROWDED = 60
"""With more points than this they are drawn paler than the lines."""


def entries(rows: PictureData) -> Iterator[Entry]:
    """Yield the pictures in the page's order, a material each."""
    yield "calibration", "Calibration and linearity", partial(calibration, rows)
    yield "range_error", "Range error, nothing varied", partial(baseline, rows)
    for name in _materials(rows):
        file_word = re.sub("[^a-z0-9]", "_", name.lower())
        yield f"material_{file_word}", f"Range error, target of {name}", partial(material, rows, name)
    for kind in ("room", "hot", "cold"):
        yield f"temperature_{kind}", f"Range error, {kind} air at the sensor", partial(temperature, rows, kind)
    yield "vibration", "Range error while the housing vibrates", partial(vibration, rows)
    for condition, how in (("crosstalk_simultaneous", "at once"), ("crosstalk_sequential", "in turn")):
        yield condition, f"Range error, two sensors that ping {how}", partial(crosstalk, rows, condition)
    yield "external_interference", "Range error with external ultrasound", partial(external, rows)


def calibration(rows: PictureData) -> Drawn:
    """Draw the calibration and its linearity."""
    found = rows.needed(rows.findings.calibration, "calibration")
    caption = f"Mean error {interval(found.bias)}"
    if found.offset:
        caption += f"; straight line: offset {interval(found.offset)}, scale {interval(found.scale)}"
    if found.linearity:
        noise_floor = number(found.linearity_noise_floor_cm, 2)
        caption += f"; farthest from it {interval(found.linearity)} (noise floor {noise_floor} cm)"
    caption += f". Spread {interval(found.spread)}; resolution {found.resolution.value:g} cm. {sentence(found.reason)}"
    by_sound = rows.findings.calibration_temperature_c is not None
    return _draw_linearity(found, by_sound), caption


def _draw_linearity(found: CalibrationFindings, by_sound: bool) -> Figure:
    """Mean error over range with the forms of calibration; next to it their errors on left-out points."""
    panels = 2 if found.held_out else 1
    figure, (axes, *side) = new_panels(3.7, 1, panels, width_ratios=(3.4, 1.0)[:panels])
    true_cm, reading_cm = np.array(found.true_cm), np.array(found.reading_cm)
    span_cm = np.linspace(np.min(true_cm), np.max(true_cm), 200)
    line_at_zero(axes)
    if found.reference_std_cm:
        half_cm, words = 2.0 * found.reference_std_cm, "± 2 standard deviations of the reference"
        axes.axhspan(-half_cm, half_cm, label=words, **shaded())
    error_cm, reach_cm = reading_cm - true_cm, Z * np.array(found.reading_std_cm)
    ends_cm, alpha = [error_cm - reach_cm, error_cm + reach_cm], 0.4 if true_cm.size > CROWDED else 1.0
    words = "mean of a point, 95 % by its readings"
    intervals(axes, true_cm, error_cm, ends_cm, color=OURS, alpha=alpha, zorder=2, label=words)
    if found.offset and found.scale:
        line_cm = found.offset.value + (found.scale.value - 1.0) * span_cm
        axes.plot(span_cm, line_cm, "--", color=REFERENCE, label="straight line")
    if found.knots:
        curve = curve_through(found.knots)
        axes.plot(span_cm, curve.forward(span_cm) - span_cm, color=GREEN, label="calibration that is kept")
        knots_cm = np.array([knot.true_cm for knot in found.knots if span_cm[0] <= knot.true_cm <= span_cm[-1]])
        axes.plot(knots_cm, curve.forward(knots_cm) - knots_cm, "s", color=GREEN, markeredgecolor="white")
    where = ", in air of the calibration temperature" if by_sound else ""
    axes.set(xlabel=f"true range [cm]{where}", ylabel="mean reading − true range [cm]")
    for panel in side:
        forms = [one.form.replace(" ", "\n", 1) for one in found.held_out]
        colours = [GREEN if one.form == found.form else PALE for one in found.held_out]
        bars = panel.bar(forms, [one.rms_cm for one in found.held_out], width=0.7, color=colours)
        panel.bar_label(bars, fmt="{:.2f}", fontsize=8, padding=2)
        panel.tick_params(axis="x", labelsize=7)
        panel.set_ylabel("rms on points left out [cm]")
        panel.set_title(f"kept: {found.form}", fontsize=8)
        panel.margins(y=0.15)
    return figure


def baseline(rows: PictureData) -> Drawn:
    """Draw the range error with nothing varied."""
    errors = errors_of(rows.of("baseline"))
    largest_cm = rows.reference.largest_error_cm
    figure = draw_errors([errors])
    if largest_cm > 0.0:
        words = f"{rows.reference.name}'s largest error, ±{largest_cm:g} cm"
        figure.axes[0].axhspan(-largest_cm, largest_cm, label=words, zorder=0, **shaded(REFERENCE))
    caption, found = summary(errors), rows.findings.baseline
    if found is not None:
        caption += f" Mean error {interval(found.bias)}; largest error of a hit {plus(found.largest_hit_error_cm)} cm."
    return figure, caption


def _materials(rows: PictureData) -> dict[str, list[PointReadings]]:
    """Points of the material experiment by target; none where it was not done."""
    return grouped((p for p in rows.points if p.condition == "material" and p.level), lambda point: point.level)


def material(rows: PictureData, name: str) -> Drawn:
    """Draw the range error on a material."""
    rows.of("material")
    there = _materials(rows)
    if name not in there:
        raise Absent(f"No readings of {name}; the targets are {', '.join(there) or 'not named (column target)'}.")
    figure, caption = _one_of(there, name)
    return figure, caption + _answers(rows, "material", name)


def _one_of(groups: Mapping[str, Sequence[PointReadings]], name: str) -> Drawn:
    """Draw one of several groups of points, on the scale that all of them need."""
    errors = {group: errors_of(points) for group, points in groups.items() if points}
    return draw_errors([errors[name]], scale_of(list(errors.values()))), summary(errors[name])


def temperature(rows: PictureData, kind: str) -> Drawn:
    """Draw the range error in room, hot or cold air."""
    known = [(point, air_c) for point in rows.of("temperature") if (air_c := point.found.air_temperature_c) is not None]
    if not known:
        raise Absent("The readings of the temperature have no air temperature (column air_temperature_c).")
    kinds = {
        "cold": [point for point, air_c in known if air_c <= ROOM_C - ROOM_WITHIN_C],
        "room": [point for point, air_c in known if abs(air_c - ROOM_C) < ROOM_WITHIN_C],
        "hot": [point for point, air_c in known if air_c >= ROOM_C + ROOM_WITHIN_C],
    }
    here = kinds[kind]
    if not here:
        there = ", ".join(f"{degrees_c:.0f}" for degrees_c in np.unique(np.rint([air_c for _, air_c in known]))[:8])
        raise Absent(f"No readings at {kind} temperature; the air was at {there} °C.")
    figure, counts = _one_of(kinds, kind)
    far_c = np.array([point.target_temperature_c for point in here])
    at_target = f", at the target {span(far_c)} °C" if np.any(np.isfinite(far_c)) else ""
    near_c = np.concatenate([point.air_temperature_c for point in here])
    caption = f"Air at the sensor {span(near_c)} °C{at_target}. {counts}"
    for box in rows.findings.hot_boxes:
        if kind == ("hot" if box.box_c > ROOM_C else "cold"):
            caption += f" {sentence(box.answer)}"
    return figure, caption


def vibration(rows: PictureData) -> Drawn:
    """Draw the range error at each frequency of vibration."""
    known = [point for point in rows.of("vibration") if point.level not in ("", "0 Hz")]
    shaken = grouped(known, lambda point: float(point.level.split()[0]))
    if not known:
        raise Absent("No readings with vibration (column vibration_hz above 0).")
    panels = [errors_of(points, points[0].level) for points in shaken.values()]
    counts = f"Vibration of {span(np.array([*shaken]))} Hz. {summary(errors_of(known))}"
    return draw_errors(panels), counts + _answers(rows, "vibration")


def crosstalk(rows: PictureData, condition: str) -> Drawn:
    """Draw the range error of two sensors that ping at once or in turn."""
    by_sensor = grouped(rows.of(condition), lambda point: point.sensor)
    panels = [
        errors_of(points, name if name.startswith("sensor") else f"sensor {place}, {name}")
        for place, (name, points) in enumerate(by_sensor.items(), start=1)
    ]
    counts = " ".join(sentence(f"{panel.label}: {summary(panel)}") for panel in panels)
    return draw_errors(panels), counts + _answers(rows, condition)


def external(rows: PictureData) -> Drawn:
    """Draw the range error at each level of external ultrasound."""
    found = rows.of("external_interference")
    by_level = grouped(found, lambda point: point.level)
    levels = sorted(
        by_level, key=lambda level: (level != "quiet", "frequency" in level, float(re.sub(r"\D.*", "", level) or "0"))
    )
    panels = [errors_of(by_level[level], level or "level unknown") for level in levels[:MAX_LEVELS]]
    left_out = len(levels) - len(panels)
    more = f" Not drawn: {counted(left_out, 'more level')}." if left_out else ""
    return draw_errors(panels), summary(errors_of(found)) + _answers(rows, "external_interference") + more


def _answers(rows: PictureData, name: str, level: str = "") -> str:
    """Answers to the questions of an experiment, or of one of its levels, one sentence each."""
    asked = [question for question in rows.findings.questions if question.name == name]
    return "".join(f" {sentence(question.answer)}" for question in asked if level in ("", question.level))
