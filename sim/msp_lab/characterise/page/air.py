"""Pictures of the air's temperature: compensation by range, and hot or cold air at the sensor only."""

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from msp_lab.characterise.page.errors import draw_errors, scale_of, with_reach
from msp_lab.characterise.page.picture_data import PictureData, errors_of, in_order, summary
from msp_lab.characterise.page.text import span
from msp_lab.estimates import IntervalEstimate
from msp_sim.page.page import Absent, Drawn, Entry
from msp_sim.page.style import DOTS, GREEN, MARKED, PURPLE, REFERENCE, SERIES, line_at_zero, new_axes, new_figure
from msp_sim.page.text import sentence

MAX_BOXES = 3
"""Panels that the picture of hot and cold air has room for."""


def entries(rows: PictureData) -> Iterator[Entry]:
    """Yield the pictures in the page's order; none for light and radio, whose ranges are not the air's."""
    if rows.findings.calibration_temperature_c is not None:
        yield "uncompensated", "Range error without temperature compensation", partial(range_errors, rows, after=False)
        yield "compensated", "Range error with temperature compensation", partial(range_errors, rows, after=True)
        yield "compensation", "What temperature compensation takes away", partial(compensation, rows)
        yield "hot_boxes", "Where the hot and the cold air was", partial(_boxes, rows)


def range_errors(rows: PictureData, after: bool) -> Drawn:
    """Draw range errors without or with (``after``) compensation."""
    points = rows.of("temperature_compensation")
    air_c = in_order(points, lambda point: point.air_temperature_c)
    known = np.isfinite(air_c)
    if after and not np.any(known):
        raise Absent("The readings have no air temperature (column air_temperature_c), and nothing can be compensated.")
    both, air = [errors_of(points)], ""
    if np.any(known):
        compensated = errors_of(points, "", lambda point: point.reading_cm * point.compensation - point.true_range_cm)
        both.append(compensated.select(known))
        air = f" Air {span(air_c)} °C; the sensor assumes {rows.model.calibration_temperature_c:g} °C."
    errors = both[int(after)]
    # A reference's mean errors where they can be compared: next to a range that was measured.
    earlier, tested_cm = rows.reference.mean_error_cm, np.unique(both[0].true_range_cm)
    near = {each: earlier[each][int(after)] for each in sorted(earlier) if np.min(np.abs(tested_cm - each)) <= 2.0}
    figure = draw_errors([errors], scale_of(both, near.values()))
    if near:
        figure.axes[0].plot(list(near), list(near.values()), label=f"{rows.reference.name}'s mean error", **MARKED)
    return figure, summary(errors) + air


def compensation(rows: PictureData) -> Drawn:
    """Draw an arrow a range, from the mean error without compensation to the one with it; a reference's next to it."""
    table, reference = rows.needed(rows.findings.temperature_compensation, "temperature_compensation"), rows.reference
    before_cm = [abs(row.uncompensated.value) for row in table]
    after_cm = [abs(row.compensated.value) for row in table if row.compensated]
    caption = f"Mean size of the error of the ranges: {np.mean(before_cm):.2f} cm without compensation"
    caption += f", {np.mean(after_cm):.2f} cm with it." if after_cm else "."
    figure, axes = new_axes(3.6, "true range [cm]", "mean error [cm]")
    line_at_zero(axes)
    range_cm = [row.range_cm for row in table]
    aside = 0.12 * (np.min(np.diff(range_cm)) if len(table) > 1 else 20.0) if reference.mean_error_cm else 0.0
    ours = [(row.range_cm - aside, row.uncompensated, row.compensated) for row in table]
    _arrows(axes, ours, SERIES[0], "ours, " if aside else "")
    if aside:
        pairs = [(each, reference.mean_errors_at(each)) for each in range_cm]
        theirs = [(each + aside, *map(IntervalEstimate, pair)) for each, pair in pairs if pair]
        _arrows(axes, theirs, SERIES[5], f"{reference.name}'s, ")
    axes.set_xticks(range_cm, [f"{each:g}" for each in range_cm])
    return figure, caption


def _arrows(axes: Axes, rows: Sequence[tuple[Any, ...]], series: tuple[str, str], who: str) -> None:
    """Errors before (filled) and after (white; None: not known), at their places, with their intervals."""
    colour, marker = series
    after = [row for row in rows if row[2] is not None]
    for x, one, other in after:
        axes.vlines(x, one.value, other.value, color=colour, alpha=0.6)
    white: dict[str, Any] = {"markerfacecolor": "white", "markeredgewidth": 1.4}
    for points, end, words, look in ((rows, 1, "uncompensated", {}), (after, 2, "compensated", white)):
        x, (y, reach) = [x for x, *_ in points], with_reach([row[end] for row in points])
        axes.plot(x, y, marker, linestyle="none", color=colour, label=f"{who}{words}", **look)
        if np.any(reach):
            axes.errorbar(x, y, yerr=reach, linestyle="none", color=colour)


def _boxes(rows: PictureData) -> Drawn:
    """Draw one panel a box: shift of the mean error over range, and three ideas of where the air is."""
    found = rows.needed(rows.findings.hot_boxes, "hot_boxes")
    boxes = found[:MAX_BOXES]
    figure = new_figure(3.6)
    for axes, box in zip(figure.subplots(1, len(boxes), squeeze=False)[0], boxes, strict=True):
        range_cm = [row.range_cm for row in box.rows]
        uniform, gradient, confined = np.array([(r.uniform_cm, r.gradient_cm, r.confined_cm) for r in box.rows]).T
        line_at_zero(axes)
        axes.plot(range_cm, uniform, ":", color=REFERENCE, label="that air all the way")
        axes.plot(range_cm, gradient, "-.", color=PURPLE, label="linear fall to the room's at the target")
        axes.plot(range_cm, confined, "-", color=GREEN, label="that air in the box only")
        shift_cm, reach_cm = with_reach([row.shift for row in box.rows])
        axes.errorbar(range_cm, shift_cm, yerr=reach_cm, label="measured, minus room temperature", **DOTS)
        assumed = " (assumed)" if box.room_is_assumed else ""
        air = f"{box.box_c:.0f} °C at the sensor, {box.room_c:.0f} °C{assumed} beyond"
        axes.set_title(f"{air}\nair that explains it: {box.depth.value:.0f} cm", fontsize=8.5)
        axes.set_xlabel("true range [cm]")
    figure.axes[0].set_ylabel("shift of the mean error [cm]")
    return figure, " ".join(sentence(box.answer) for box in found)
