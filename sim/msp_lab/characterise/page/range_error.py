"""Pictures of the range error over range: the calibration, nothing varied, and each experiment of a campaign."""

import re
from collections.abc import Iterator
from functools import partial

import numpy as np

from msp_lab.characterise.findings import Findings
from msp_lab.characterise.page.draw.accuracy import draw_linearity
from msp_lab.characterise.page.draw.errors import ErrorAxes, Errors, draw_errors, shared_limits_cm
from msp_lab.characterise.page.picture_data import Absent, Drawn, Entry, PictureData, needed, summary
from msp_lab.characterise.page.text import file_word, interval, plus, sentence, span
from msp_lab.characterise.temperature import ROOM_C

MAX_LEVELS = 5
"""Panels that a picture has room for."""
NEAR_ROOM_C = 5.0
"""Air this near to `ROOM_C` counts as room temperature [deg C]; a box that is called cold or hot is farther from it."""


def entries(rows: PictureData) -> Iterator[Entry]:
    """Yield the pictures in the page's order, a material each."""
    yield "calibration", "Calibration and linearity", calibration
    yield "range_error", "Range error, nothing varied", baseline
    for name in materials(rows):
        yield f"material_{file_word(name)}", f"Range error, target of {name}", partial(material, name=name)
    for kind in ("room", "hot", "cold"):
        yield f"temperature_{kind}", f"Range error, {kind} air at the sensor", partial(temperature, kind=kind)
    yield "vibration", "Range error while the housing vibrates", vibration
    for condition, how in (("crosstalk_simultaneous", "at once"), ("crosstalk_sequential", "in turn")):
        yield condition, f"Range error, two sensors that ping {how}", partial(crosstalk, condition=condition)
    yield "external_interference", "Range error with external ultrasound", external


def calibration(findings: Findings, rows: PictureData) -> Drawn:
    """Draw the calibration and its linearity."""
    found = needed(findings.calibration, findings, "calibration")
    caption = f"Mean error {interval(found.bias)}"
    if found.offset is not None and found.scale is not None:
        caption += f"; straight line: offset {interval(found.offset)}, scale {interval(found.scale)}"
    if found.linearity is not None:
        caption += f"; farthest from it {interval(found.linearity)}"
        if found.linearity_noise_floor_cm is not None:
            caption += f" (noise floor {found.linearity_noise_floor_cm:.2f} cm)"
    caption += f". Spread {interval(found.spread)}; resolution {found.resolution.value:g} cm. {sentence(found.reason)}"
    by_sound = findings.calibration_temperature_c is not None
    return Drawn(draw_linearity(found, by_sound), caption, "Mean error over true range with the calibration.")


def baseline(findings: Findings, rows: PictureData) -> Drawn:
    """Draw the range error with nothing varied."""
    errors = rows.errors(rows.of("baseline"))
    axes = None
    if rows.reference is not None:
        largest_cm = rows.reference.largest_error_cm
        axes = ErrorAxes(band_cm=largest_cm, band_label=f"{rows.reference.name}'s largest error, ±{largest_cm:g} cm")
    caption = summary(errors)
    if findings.baseline is not None:
        found = findings.baseline
        caption += f" Mean error {interval(found.bias)}; largest error of a hit {plus(found.largest_hit_error_cm)} cm."
    return Drawn(draw_errors([errors], axes), caption, "Range error over true range without anything varied.")


def materials(rows: PictureData) -> list[str]:
    """Return the targets of the material experiment; none where it was not done."""
    try:
        found = rows.of("material")
    except Absent:
        return []
    return [str(each) for each in np.unique(rows.data.column("target")[found]) if each]


def material(findings: Findings, rows: PictureData, name: str) -> Drawn:
    """Draw the range error on a material."""
    found = rows.of("material")
    there = materials(rows)
    if name not in there:
        raise Absent(f"No readings of {name}; the targets are {', '.join(there) or 'not named (column target)'}.")
    target = rows.data.column("target")
    errors = rows.errors(found & (target == name))
    limits = shared_limits_cm([rows.errors(found & (target == each)) for each in there])
    caption = summary(errors) + _answers(findings, "material", name)
    return Drawn(
        draw_errors([errors], ErrorAxes(limits_cm=limits)),
        caption,
        f"Range error over true range, target of {name}.",
    )


def temperature(findings: Findings, rows: PictureData, kind: str) -> Drawn:
    """Draw the range error in room, hot or cold air."""
    found = rows.of("temperature")
    air_c = rows.data.column("air_temperature_c")
    if not np.any(np.isfinite(air_c[found])):
        raise Absent("The readings of the temperature have no air temperature (column air_temperature_c).")
    kinds = {
        "cold": found & (air_c <= ROOM_C - NEAR_ROOM_C),
        "room": found & (np.abs(air_c - ROOM_C) < NEAR_ROOM_C),
        "hot": found & (air_c >= ROOM_C + NEAR_ROOM_C),
    }
    if not np.any(kinds[kind]):
        there = ", ".join(f"{each:.0f}" for each in np.unique(np.rint(air_c[found & np.isfinite(air_c)]))[:8])
        raise Absent(f"No readings at {kind} temperature; the air was at {there} °C.")
    errors = rows.errors(kinds[kind])
    limits = shared_limits_cm([rows.errors(each) for each in kinds.values() if np.any(each)])
    caption = f"Air at the sensor {span(air_c[kinds[kind]])} °C"
    far_c = rows.data.column("target_temperature_c")[kinds[kind]]
    caption += f", at the target {span(far_c)} °C. " if np.any(np.isfinite(far_c)) else ". "
    caption += summary(errors)
    for box in findings.hot_boxes:
        if kind != "room" and (box.box_c > ROOM_C) == (kind == "hot"):
            caption += f" {sentence(box.answer)}"
    return Drawn(
        draw_errors([errors], ErrorAxes(limits_cm=limits)),
        caption,
        f"Range error over true range, {kind} air at the sensor.",
    )


def vibration(findings: Findings, rows: PictureData) -> Drawn:
    """Draw the range error at each frequency of vibration."""
    found = rows.of("vibration")
    vibration_hz = rows.data.column("vibration_hz")
    shaken = found & (vibration_hz > 0.0)
    if not np.any(shaken):
        raise Absent("No readings with vibration (column vibration_hz above 0).")
    panels = [
        rows.errors(found & (vibration_hz == each), f"{each:g} Hz") for each in np.unique(vibration_hz[shaken]).tolist()
    ]
    caption = f"Vibration of {span(vibration_hz[shaken])} Hz. {summary(rows.errors(shaken))}"
    caption += _answers(findings, "vibration", None)
    return Drawn(draw_errors(panels), caption, "Range error over true range while the sensor's housing vibrates.")


def crosstalk(findings: Findings, rows: PictureData, condition: str) -> Drawn:
    """Draw the range error of two sensors that ping at once or in turn."""
    found = rows.of(condition)
    names = np.unique(rows.sensor[found]).tolist()
    panels: list[Errors] = [
        rows.errors(found & (rows.sensor == name), name if name.startswith("sensor") else f"sensor {number}, {name}")
        for number, name in enumerate(names, start=1)
    ]
    caption = " ".join(sentence(f"{each.label}: {summary(each)}") for each in panels)
    caption += _answers(findings, condition, None)
    return Drawn(draw_errors(panels), caption, "Range error over true range of two sensors next to each other.")


def external(findings: Findings, rows: PictureData) -> Drawn:
    """Draw the range error at each level of external ultrasound."""
    found = rows.of("external_interference")
    levels = [str(each) for each in np.unique(rows.level[found])]
    levels.sort(key=lambda level: (level != "quiet", "frequency" in level, float(re.sub(r"\D.*", "", level) or "0")))
    panels = [rows.errors(found & (rows.level == level), level or "level unknown") for level in levels[:MAX_LEVELS]]
    caption = f"{summary(rows.errors(found))} {_answers(findings, 'external_interference', None)}".strip()
    left_out = len(levels) - len(panels)
    caption += f" Not drawn: {left_out} more level{'s'[: left_out - 1]}." if left_out else ""
    return Drawn(draw_errors(panels), caption, "Range error over true range next to an external ultrasonic source.")


def _answers(findings: Findings, name: str, level: str | None) -> str:
    """What the questions of an experiment were answered, one sentence each."""
    answers = [
        each.answer for each in findings.questions if each.name == name and (level is None or each.level == level)
    ]
    return "".join(f" {sentence(answer)}" for answer in answers)
