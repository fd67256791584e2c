"""Pictures of the air's temperature: compensation by range, and hot or cold air at the sensor only."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from msp_lab.characterise.findings import Findings
from msp_lab.characterise.page.draw.accuracy import draw_boxes, draw_compensated
from msp_lab.characterise.page.draw.errors import ErrorAxes, Line, draw_errors, shared_limits_cm
from msp_lab.characterise.page.picture_data import Absent, Drawn, Entry, PictureData, needed, summary
from msp_lab.characterise.page.text import interval, number, sentence
from msp_lab.characterise.question_findings import CompensationRow
from msp_range.acoustics.air import compensate_range
from msp_range.arrays import Array
from msp_sim.page.page import PageTable

MAX_BOXES = 3
"""Panels that the picture of hot and cold air has room for."""


def entries() -> Iterator[Entry]:
    """Yield the pictures in the page's order."""
    yield "uncompensated", "Range error without temperature compensation", partial(range_errors, after=False)
    yield "compensated", "Range error with temperature compensation", partial(range_errors, after=True)
    yield "compensation", "What temperature compensation takes away", compensation
    yield "hot_boxes", "Where the hot and the cold air was", _boxes


def range_errors(findings: Findings, rows: PictureData, after: bool) -> Drawn:
    """Draw range errors without or with (``after``) compensation."""
    found = rows.of("temperature_compensation")
    air_c = rows.data.column("air_temperature_c")
    known = found & np.isfinite(air_c)
    if after and not np.any(known):
        raise Absent("The readings have no air temperature (column air_temperature_c), and nothing can be compensated.")
    both = [rows.errors(found)]
    if np.any(known):
        compensated_cm = compensate_range(rows.reading_cm / 100.0, air_c, rows.model.calibration_temperature_c) * 100.0
        both.append(rows.errors(known, reading_cm=compensated_cm))
    errors = both[int(after)]
    marked = _reference_errors(rows, np.unique(both[0].true_range_cm), after)
    figure = draw_errors([errors], ErrorAxes(limits_cm=shared_limits_cm(both, marked), points=marked))
    caption = summary(errors)
    if np.any(known):
        temperatures = air_c[known]
        caption += (
            f" Air {np.min(temperatures):.1f} to {np.max(temperatures):.1f} °C; the sensor assumes "
            f"{rows.model.calibration_temperature_c:g} °C."
        )
    return Drawn(
        figure, caption, f"Range error over true range {'with' if after else 'without'} temperature compensation."
    )


def _reference_errors(rows: PictureData, tested_cm: Array, after: bool) -> list[Line]:
    """A reference's mean errors where they can be compared: next to a range that was measured."""
    earlier = rows.reference
    if earlier is None:
        return []
    near = [each for each in sorted(earlier.mean_error_cm) if np.min(np.abs(tested_cm - each)) <= 2.0]
    errors_cm = [earlier.mean_error_cm[each][int(after)] for each in near]
    return [Line(f"{earlier.name}'s mean error", np.array(near), np.array(errors_cm))] if near else []


def compensation(findings: Findings, rows: PictureData) -> Drawn:
    """Draw the mean errors by range, without and with compensation."""
    table = needed(findings.temperature_compensation, findings, "temperature_compensation")
    before_cm = np.array([row.uncompensated.value for row in table])
    after_cm = np.array([row.compensated.value for row in table if row.compensated is not None])
    caption = f"Mean size of the error of the ranges: {np.mean(np.abs(before_cm)):.2f} cm without compensation"
    caption += f", {np.mean(np.abs(after_cm)):.2f} cm with it." if after_cm.size else "."
    return Drawn(
        draw_compensated(table, rows.reference), caption, "Mean errors by range, without and with compensation."
    )


def compensation_table(findings: Findings) -> PageTable | None:
    """Return the mean errors by range as a table; None without rows."""
    rows = findings.temperature_compensation
    if not rows:
        return None

    def cells(row: CompensationRow) -> tuple[str, ...]:
        return (
            f"{row.range_cm:g}",
            interval(row.uncompensated),
            "–" if row.compensated is None else interval(row.compensated),
            number(row.thermometer_c, 1),
            number(row.implied_c.value, 1),
        )

    notes = " ".join(f"{row.range_cm:g} cm: {row.note}." for row in rows if row.note)
    return PageTable(
        name="compensation_table",
        title="Mean range error without and with temperature compensation",
        header=("range [cm]", "uncompensated [cm]", "compensated [cm]", "thermometer [°C]", "implied air [°C]"),
        rows=tuple(cells(row) for row in rows),
        caption=(
            "In brackets 95 % intervals. Implied air: the one air temperature that would bring the mean error to 0. "
            f"{notes}"
        ),
        words=0,
    )


def _boxes(findings: Findings, rows: PictureData) -> Drawn:
    boxes = needed(findings.hot_boxes, findings, "hot_boxes")
    return Drawn(
        draw_boxes(boxes[:MAX_BOXES]),
        " ".join(sentence(box.answer) for box in boxes),
        "Shift of the mean error with hot or cold air at the sensor, by range.",
    )
