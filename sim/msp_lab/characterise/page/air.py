"""Pictures of the air's temperature: compensation by range, and hot or cold air at the sensor only."""

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from msp_lab.characterise.page.errors import draw_errors, scale_of
from msp_lab.characterise.page.picture_data import PictureData, errors_of, in_order, summary
from msp_lab.characterise.page.text import span
from msp_lab.estimates import IntervalEstimate
from msp_sim.page.page import Absent, Drawn, Entry
from msp_sim.page.style import GREEN, MARKED, PURPLE, REFERENCE, SERIES, intervals, line_at_zero, new_axes, new_panels
from msp_sim.page.text import sentence

MAX_BOXES = 3
"""Panels that the picture of hot and cold air has room for."""
_IDEAS = (
    ("uniform_cm", ":", REFERENCE, "that air all the way"),
    ("gradient_cm", "-.", PURPLE, "linear fall to the room's at the target"),
    ("confined_cm", "-", GREEN, "that air in the box only"),
)
"""Where the air may be: field of a `findings.BoxRow` with the shift that it causes, and how it is drawn."""


def entries(rows: PictureData) -> Iterator[Entry]:
    """Yield the pictures in the page's order; none where the air does not change the readings."""
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
    # A reference's mean errors where they can be compared: at a range that was measured.
    pairs = {at_cm: rows.reference.mean_errors_at(at_cm) for at_cm in np.unique(both[0].true_range_cm).tolist()}
    earlier = {at_cm: pair[int(after)] for at_cm, pair in pairs.items() if pair}
    figure = draw_errors([errors], scale_of(both, earlier.values()))
    if earlier:
        words = f"{rows.reference.name}'s mean error"
        figure.axes[0].plot(list(earlier), list(earlier.values()), label=words, **MARKED)
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
        pairs = [(at_cm, reference.mean_errors_at(at_cm)) for at_cm in range_cm]
        theirs = [(at_cm + aside, *map(IntervalEstimate, pair)) for at_cm, pair in pairs if pair]
        _arrows(axes, theirs, SERIES[5], f"{reference.name}'s, ")
    axes.set_xticks(range_cm, [f"{at_cm:g}" for at_cm in range_cm])
    return figure, caption


def _arrows(axes: Axes, rows: Sequence[tuple[Any, ...]], series: tuple[str, str], who: str) -> None:
    """Errors before (filled) and after (white; None: not known), at their places, with their intervals."""
    colour, marker = series
    for at, before, after in rows:
        for one, words, fill in ((before, "uncompensated", colour), (after, "compensated", "white")):
            if one is not None:
                words = f"{who}{words}"
                intervals(axes, at, one.value, one.ends, marker=marker, color=colour, markerfacecolor=fill, label=words)
        if after is not None:
            axes.vlines(at, before.value, after.value, color=colour, alpha=0.6)


def _boxes(rows: PictureData) -> Drawn:
    """Draw one panel a box: shift of the mean error over range, and three ideas of where the air is."""
    found = rows.needed(rows.findings.hot_boxes, "hot_boxes")
    boxes = found[:MAX_BOXES]
    figure, panels = new_panels(3.6, 1, len(boxes))
    for axes, box in zip(panels, boxes, strict=True):
        range_cm = [row.range_cm for row in box.rows]
        for name, look, colour, words in _IDEAS:
            shift_cm = [getattr(row, name) for row in box.rows]
            axes.plot(range_cm, shift_cm, look, color=colour, label=words)
        line_at_zero(axes)
        for row in box.rows:
            intervals(axes, row.range_cm, row.shift.value, row.shift.ends, label="measured, minus room temperature")
        assumed = " (assumed)" if box.room_is_assumed else ""
        air = f"{box.box_c:.0f} °C at the sensor, {box.room_c:.0f} °C{assumed} beyond"
        axes.set_title(f"{air}\nair that explains it: {box.depth.value:.0f} cm", fontsize=8.5)
        axes.set_xlabel("true range [cm]")
    panels[0].set_ylabel("shift of the mean error [cm]")
    return figure, " ".join(sentence(box.answer) for box in found)
