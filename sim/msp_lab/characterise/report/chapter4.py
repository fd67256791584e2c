"""Pictures of the report's chapter 4: figures 4.4 to 4.21."""

import re
from collections.abc import Iterator
from functools import partial

import numpy as np
from numpy.typing import NDArray

from msp_lab.characterise.field_of_view import REPORT_DEG
from msp_lab.characterise.findings import BreakawayAngle, Estimate, Findings
from msp_lab.characterise.report.draw.beam import Sweep, draw_sweep
from msp_lab.characterise.report.draw.errors import ErrorAxes, Errors, draw_errors, shared_limits_cm
from msp_lab.characterise.report.draw.readings import FixedRange, draw_histogram, draw_in_order
from msp_lab.characterise.report.rows import (
    Absent,
    Drawn,
    Maker,
    Rows,
    minus,
    plus,
    sentence,
    set_up_error_cm,
    summary,
)
from msp_lab.characterise.temperature import REPORT_ROOM_C
from msp_range.reading_model.mixture import ReadingModel

Entry = tuple[str, str, Maker]
"""Name of the file, title, and what makes the picture."""

REPORT_SENSOR = "MB1242"
"""What the report measured: its numbers are no expectation for anything else."""

REPORT_MATERIALS = ("plywood", "asphalt", "concrete")
"""Report 4.3.4: figures 4.13 to 4.15 in this order."""

MOST_LEVELS = 5
"""Panels that a picture has room for."""

NEAR_ROOM_C = 5.0
"""Air this near to the report's room counts as room temperature; the report's cold is 8.3, its hot 46.1 [deg C]."""


def entries(rows: Rows) -> Iterator[Entry]:
    """The chapter's pictures in its order; ranges and materials that the report does not have come after its own."""
    yield "figure_4_04_range_error", "Figure 4.4: range error, all ranges", _baseline
    for number, masked, kind in (
        (5, False, "in order"),
        (6, False, "histogram"),
        (7, True, "in order"),
        (8, True, "histogram"),
    ):
        what = "maximum range measurements" if kind == "in order" else "maximum range histogram"
        without = ", missed reports masked" if masked else ""
        name = f"figure_4_{number:02d}_maximum_range"
        yield name, f"Figure 4.{number}: {what}{without}", partial(_maximum_range, masked=masked, kind=kind)
    for number, range_cm in enumerate(REPORT_DEG, start=9):
        name = f"figure_4_{number:02d}_field_of_view_{range_cm:g}cm"
        yield name, f"Figure 4.{number}: field of view at {range_cm:g} cm", partial(_field_of_view, range_cm=range_cm)
    for range_cm in _other_sweeps(rows):
        name = f"field_of_view_{range_cm:g}cm".replace(".", "_")
        yield name, f"Field of view at {range_cm:g} cm (not in the report)", partial(_field_of_view, range_cm=range_cm)
    for number, material in enumerate(REPORT_MATERIALS, start=13):
        name = f"figure_4_{number}_{material}"
        yield name, f"Figure 4.{number}: range error, {material} target", partial(_material, material=material)
    for material in _materials(rows):
        if material not in REPORT_MATERIALS:
            name = f"material_{_file_word(material)}"
            yield name, f"Range error, {material} target (not in the report)", partial(_material, material=material)
    for number, kind in ((16, "room"), (17, "hot"), (18, "cold")):
        name = f"figure_4_{number}_{kind}"
        yield name, f"Figure 4.{number}: range error, {kind} temperature", partial(_temperature, kind=kind)
    yield "figure_4_19_vibration", "Figure 4.19: range error, vibration", _vibration
    for number, condition, how in (
        (20, "crosstalk_simultaneous", "simultaneous"),
        (21, "crosstalk_sequential", "sequential"),
    ):
        title = f"Figure 4.{number}: range error, two sensors, {how} transmission"
        yield f"figure_4_{number}_{how}", title, partial(_crosstalk, condition=condition)
    yield "section_4_3_8_external", "Section 4.3.8: range error, external ultrasound", _external


def _baseline(findings: Findings, rows: Rows) -> Drawn:
    errors = rows.errors(rows.of("baseline"))
    axes = ErrorAxes(band_cm=1.0, band_label="the report's largest error, ±1 cm")
    figure = draw_errors([errors], axes if findings.sensor == REPORT_SENSOR else None)
    caption = summary(errors)
    if findings.baseline is not None:
        found = findings.baseline
        caption += (
            f" Mean error {interval(found.bias)}; largest error of a hit {plus(found.largest_hit_error_cm)} cm. "
            f"The report: largest error {found.report_largest_error_cm:g} cm apart from missed readings."
        )
    return Drawn(figure, caption, "Range error over true range without anything varied, with the report's 1 cm band.")


def _fixed_range(rows: Rows) -> FixedRange:
    try:
        found = rows.of("maximum_range")
    except Absent as absent:
        raise Absent(f"{absent} It takes many readings of a large target at one long range.") from None
    ranges, counts = np.unique(rows.true_cm[found], return_counts=True)
    # Of several long ranges the one with the most readings, and of equal ones the longest.
    best = float(ranges[np.lexsort((ranges, counts))[-1]])
    chosen = found & (rows.true_cm == best)
    return FixedRange(best, rows.reading_cm[chosen], rows.missed[chosen])


def _maximum_range(findings: Findings, rows: Rows, masked: bool, kind: str) -> Drawn:
    fixed = _fixed_range(rows)
    if masked and not fixed.kept_cm.size:
        raise Absent(f"All {fixed.reading_cm.size:,} readings at {fixed.true_range_cm:g} cm are codes for no echo.")
    if not np.any(np.isfinite(fixed.reading_cm)):
        raise Absent(f"None of the {fixed.reading_cm.size:,} pings at {fixed.true_range_cm:g} cm was answered.")
    found = findings.maximum_range
    share = 100.0 * np.count_nonzero(fixed.missed) / fixed.reading_cm.size
    if kind == "in order":
        figure = draw_in_order(fixed, masked)
        caption = f"{fixed.reading_cm.size:,} readings at {fixed.true_range_cm:g} cm"
        caption += f", of which {share:.2g} % are codes for no echo" + (", left out here." if masked else ".")
        if not masked:
            caption += " The report shows 2000 readings at 500 cm, with missed ones that read 765 and 255."
        return Drawn(figure, caption, "Readings at the longest range in the order in which they came.")
    fitted = _probabilities(findings, rows, fixed.true_range_cm) if masked and findings.mixture is not None else None
    report_cm = found.report_peak_cm if found is not None and abs(fixed.true_range_cm - 500.0) < 1.0 else None
    figure = draw_histogram(fixed, masked, fitted, report_cm)
    if found is None:
        caption = f"{fixed.reading_cm.size:,} readings at {fixed.true_range_cm:g} cm, {share:.2g} % codes for no echo."
    elif masked:
        caption = (
            f"Without the codes there {_are(len(found.peaks_after), 'peak')}, at {interval(found.peak)}. "
            f"The report: a single peak near {found.report_peak_cm:g} cm."
        )
        if fitted is not None:
            caption += " Circles: what the mixture, fitted about these hits' own mean, expects in each centimetre."
    else:
        caption = (
            f"There {_are(len(found.peaks_before), 'peak')}: "
            + ", ".join(f"{peak.reading_cm:g} cm ({100.0 * peak.share:.2g} %)" for peak in found.peaks_before)
            + f". {found.no_echo:,} readings of {rows.model.maximum_cm} and {found.saturated:,} of 255 are missed "
            "echoes. The report sees the same two codes, and the histogram multi-modal for them."
        )
    return Drawn(figure, caption, "How often each centimetre was read at the longest range.")


def _probabilities(findings: Findings, rows: Rows, true_cm: float) -> NDArray[np.float64]:
    """Probability of each reading from 0 cm on by the fitted model, about the range that the fit took it to be."""
    expected_cm = float(np.mean(rows.apparent_cm[rows.of("maximum_range") & (rows.true_cm == true_cm)]))
    expected_cm += set_up_error_cm(findings, "maximum_range", true_cm)
    readings = np.arange(0.0, rows.model.maximum_cm + 1.0)
    model = ReadingModel.of(rows.model)
    return np.exp(model.log_prob(readings, {"true_range_cm": np.full(readings.size, expected_cm)}))


def _sweep_ranges(rows: Rows) -> NDArray[np.float64]:
    found = rows.of("field_of_view")
    incidence = rows.number("incidence_deg")
    if not np.any(np.isfinite(incidence[found])):
        raise Absent("The readings of the field of view have no angle (column incidence_deg).")
    return np.unique(rows.true_cm[found])


def _other_sweeps(rows: Rows) -> list[float]:
    try:
        ranges = _sweep_ranges(rows)
    except Absent:
        return []
    return [float(each) for each in ranges if float(each) not in REPORT_DEG][:8]


def _field_of_view(findings: Findings, rows: Rows, range_cm: float) -> Drawn:
    ranges = _sweep_ranges(rows)
    if range_cm not in ranges:
        there = ", ".join(f"{each:g}" for each in ranges[:12])
        raise Absent(f"The field of view was not measured at {range_cm:g} cm, but at {there} cm.")
    incidence, found = rows.number("incidence_deg"), rows.of("field_of_view")
    chosen = found & (rows.true_cm == range_cm) & np.isfinite(incidence)
    if np.unique(incidence[chosen]).size < 2:
        raise Absent(f"At {range_cm:g} cm only one angle was measured.")
    view = findings.field_of_view
    points = [point for point in view.points if point.range_cm == range_cm] if view is not None else []
    angle = next((each for each in view.angles if each.range_cm == range_cm), None) if view is not None else None
    if not points:
        raise Absent(sentence(findings.absent.get("field_of_view", f"the readings at {range_cm:g} cm were not judged")))
    points = sorted(points, key=lambda point: point.incidence_deg)
    middle = min(points, key=lambda point: abs(point.incidence_deg))
    half_deg = angle.half_angle.value if angle is not None else 0.0
    sweep = Sweep(
        range_cm=range_cm,
        incidence_deg=incidence[chosen],
        reading_cm=rows.reading_cm[chosen],
        missed=rows.missed[chosen],
        angle_deg=np.array([point.incidence_deg for point in points]),
        reliable=np.array([point.reliable.value for point in points]),
        **_sides(angle),
        report_deg=REPORT_DEG.get(range_cm),
        nearest_half_angle_deg=half_deg,
        stretch=middle.nearest_cm / range_cm,
    )
    caption = f"{np.count_nonzero(chosen):,} readings at {len(points)} angles. "
    if angle is not None:
        none = "not found: no angle is reliable to both sides"
        caption += f"Breakaway {'at ' + half_interval(angle.half_angle) if half_deg else none}"
        caption += f"; the report: {angle.report_deg:g}°." if angle.report_deg is not None else "."
    else:
        caption += "No breakaway angle could be found."
    if view is not None:
        caption += f" Reliable: {view.criterion.rstrip('.')}."
    return Drawn(
        draw_sweep(sweep), caption, f"Readings over the sensor's angle at {range_cm:g} cm, with the breakaway marked."
    )


def _sides(angle: BreakawayAngle | None) -> dict[str, float | None]:
    """Both sides' last reliable angles, signed, and the next ones that were tried."""

    def side(estimate: Estimate | None, sign: float) -> tuple[float | None, float | None]:
        # 0 stands for a side on which no angle is reliable.
        if estimate is None or estimate.value == 0.0:
            return None, None
        end = estimate.high
        return sign * estimate.value, None if end is None or end <= estimate.value else sign * end

    negative, negative_end = side(angle.negative if angle else None, -1.0)
    positive, positive_end = side(angle.positive if angle else None, 1.0)
    return {
        "negative_deg": negative,
        "positive_deg": positive,
        "negative_end_deg": negative_end,
        "positive_end_deg": positive_end,
    }


def _materials(rows: Rows) -> list[str]:
    try:
        found = rows.of("material")
    except Absent:
        return []
    return [str(each) for each in np.unique(rows.word("target")[found]) if each]


def _material(findings: Findings, rows: Rows, material: str) -> Drawn:
    found = rows.of("material")
    there = _materials(rows)
    if material not in there:
        raise Absent(f"No readings of {material}; the targets are {', '.join(there) or 'not named (column target)'}.")
    target = rows.word("target")
    errors = rows.errors(found & (target == material))
    limits = shared_limits_cm([rows.errors(found & (target == each)) for each in there])
    caption = summary(errors) + _answers(findings, "material", material)
    if material in REPORT_MATERIALS:
        caption += " The report: plywood, asphalt and concrete cannot be told apart."
    return Drawn(
        draw_errors([errors], ErrorAxes(limits_cm=limits)),
        caption,
        f"Range error over true range, target of {material}.",
    )


def _temperature(findings: Findings, rows: Rows, kind: str) -> Drawn:
    found = rows.of("temperature")
    air_c = rows.number("air_temperature_c")
    if not np.any(np.isfinite(air_c[found])):
        raise Absent("The readings of the temperature have no air temperature (column air_temperature_c).")
    kinds = {
        "cold": found & (air_c <= REPORT_ROOM_C - NEAR_ROOM_C),
        "room": found & (np.abs(air_c - REPORT_ROOM_C) < NEAR_ROOM_C),
        "hot": found & (air_c >= REPORT_ROOM_C + NEAR_ROOM_C),
    }
    if not np.any(kinds[kind]):
        there = ", ".join(f"{each:.0f}" for each in np.unique(np.rint(air_c[found & np.isfinite(air_c)]))[:8])
        raise Absent(f"No readings at {kind} temperature; the air was at {there} °C.")
    errors = rows.errors(kinds[kind])
    limits = shared_limits_cm([rows.errors(each) for each in kinds.values() if np.any(each)])
    caption = f"Air at the sensor {_span(air_c[kinds[kind]])} °C"
    far_c = rows.number("target_temperature_c")[kinds[kind]]
    caption += f", at the target {_span(far_c)} °C. " if np.any(np.isfinite(far_c)) else ". "
    caption += summary(errors)
    for box in findings.hot_boxes:
        if kind != "room" and (box.box_c > REPORT_ROOM_C) == (kind == "hot"):
            caption += f" {sentence(box.answer)}"
    caption += {
        "room": " The report: 70 °F, no errors to speak of.",
        "hot": " The report: 115 °F in the box, errors of 1 to 2 cm.",
        "cold": " The report: 47 °F in the box, readings somewhat too far.",
    }[kind]
    return Drawn(
        draw_errors([errors], ErrorAxes(limits_cm=limits)),
        caption,
        f"Range error over true range, {kind} air at the sensor.",
    )


def _vibration(findings: Findings, rows: Rows) -> Drawn:
    found = rows.of("vibration")
    vibration_hz = rows.number("vibration_hz")
    shaken = found & (vibration_hz > 0.0)
    if not np.any(shaken):
        raise Absent("No readings with vibration (column vibration_hz above 0).")
    panels = [
        rows.errors(found & (vibration_hz == each), f"{each:g} Hz") for each in np.unique(vibration_hz[shaken]).tolist()
    ]
    caption = f"Vibration of {_span(vibration_hz[shaken])} Hz. {summary(rows.errors(shaken))}"
    caption += _answers(findings, "vibration", None)
    caption += " The report: at 60 Hz effectively the same as the baseline."
    return Drawn(draw_errors(panels), caption, "Range error over true range while the sensor's housing vibrates.")


def _crosstalk(findings: Findings, rows: Rows, condition: str) -> Drawn:
    found = rows.of(condition)
    names = np.unique(rows.sensor[found]).tolist()
    panels: list[Errors] = [
        rows.errors(found & (rows.sensor == name), name if name.startswith("sensor") else f"sensor {number}, {name}")
        for number, name in enumerate(names, start=1)
    ]
    caption = " ".join(sentence(f"{each.label}: {summary(each)}") for each in panels)
    caption += _answers(findings, condition, None)
    caption += (
        " The report: sensor 2 reads short, because it hears the earlier ping of sensor 1."
        if condition == "crosstalk_simultaneous"
        else " The report: the errors go away, at the price of the rate."
    )
    return Drawn(draw_errors(panels), caption, "Range error over true range of two sensors beside each other.")


def _external(findings: Findings, rows: Rows) -> Drawn:
    found = rows.of("external_interference")
    levels = [str(each) for each in np.unique(rows.level[found])]
    levels.sort(key=lambda level: (level != "quiet", "frequency" in level, float(re.sub(r"\D.*", "", level) or "0")))
    panels = [rows.errors(found & (rows.level == level), level or "level unknown") for level in levels[:MOST_LEVELS]]
    caption = f"{summary(rows.errors(found))} {_answers(findings, 'external_interference', None)}".strip()
    left_out = len(levels) - len(panels)
    caption += f" Not drawn: {left_out} more level{'s'[: left_out - 1]}." if left_out else ""
    caption += " The report has no figure: its test was inconclusive."
    return Drawn(draw_errors(panels), caption, "Range error over true range beside an external ultrasonic source.")


def _answers(findings: Findings, name: str, level: str | None) -> str:
    """What the questions of an experiment were answered, one sentence each."""
    answers = [
        each.answer for each in findings.questions if each.name == name and (level is None or each.level == level)
    ]
    return "".join(f" {sentence(answer)}" for answer in answers)


def _span(values: NDArray[np.float64]) -> str:
    known = values[np.isfinite(values)]
    if not known.size:
        return "unknown"
    low, high = float(np.min(known)), float(np.max(known))
    return f"{low:.1f}" if high - low < 0.05 else f"{low:.1f} to {high:.1f}"


def _are(count: int, noun: str) -> str:
    return f"is one {noun}" if count == 1 else f"are {count} {noun}s"


def _file_word(word: str) -> str:
    return "".join(letter if letter.isascii() and letter.isalnum() else "_" for letter in word.lower())


def interval(estimate: Estimate) -> str:
    """A number with its 95 % interval and unit.

    Examples
    --------
    >>> interval(Estimate(-1.387, -1.57, -1.2, "cm", 12)), interval(Estimate(503.0, 503.0, 503.0, "cm", 9))
    ('−1.39 (−1.57 to −1.20) cm', '503 cm')
    """
    ends = [end for end in (estimate.low, estimate.high) if end is not None]
    reach = max([abs(end - estimate.value) for end in ends], default=0.0)
    unit = f" {estimate.unit}" if estimate.unit else ""
    if reach == 0.0:
        return minus(f"{estimate.value:.6g}{unit}")
    digits = int(min(max(1 - np.floor(np.log10(reach)), 0), 6))
    if ends and 0.0 < abs(estimate.value) < 0.1 * reach:
        # A wide interval says that little is known, and not another number.
        digits = int(min(max(digits, 1 - np.floor(np.log10(abs(estimate.value)))), 6))
    low = "?" if estimate.low is None else f"{estimate.low:.{digits}f}"
    high = "?" if estimate.high is None else f"{estimate.high:.{digits}f}"
    return minus(f"{estimate.value:.{digits}f} ({low} to {high}){unit}")


def half_interval(estimate: Estimate) -> str:
    """A breakaway angle, and up to where it may lie."""
    if estimate.high is None:
        return f"{estimate.value:.1f}° or more (no larger angle was tried)"
    return f"{estimate.value:.1f}° (up to {estimate.high:.1f}°)"
