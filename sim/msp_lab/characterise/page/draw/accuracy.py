"""Accuracy against the reference (calibration and linearity), and what the air at the sensor does to it."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from msp_lab.characterise.estimates import Z
from msp_lab.characterise.findings import CalibrationFindings
from msp_lab.characterise.page.draw.errors import with_reach
from msp_lab.characterise.point_findings import IntervalEstimate
from msp_lab.characterise.question_findings import CompensationRow, HotBox
from msp_lab.characterise.reference import ReferenceNumbers
from msp_range.correction.calibration import PiecewiseLinear
from msp_sim.page.style import DOTS, GREEN, GREY, OURS, PALE, PURPLE, REFERENCE, SERIES, legend_below, new_figure

CROWDED = 60
"""With more points than this they are drawn smaller and paler than the lines."""


def draw_linearity(found: CalibrationFindings, by_sound: bool) -> Figure:
    """Mean error over range with the forms of calibration; next to it their errors on left-out points."""
    figure = new_figure(3.7)
    if found.held_out:
        axes, side = figure.subplots(1, 2, width_ratios=(3.4, 1.0))
    else:
        axes, side = figure.subplots(), None
    true_cm, reading_cm = np.array(found.true_cm), np.array(found.reading_cm)
    span = np.linspace(float(np.min(true_cm)), float(np.max(true_cm)), 200)
    axes.axhline(0.0, color=GREY, linewidth=0.9)
    if found.reference_std_cm:
        half = 2.0 * found.reference_std_cm
        axes.axhspan(-half, half, color=PALE, alpha=0.5, linewidth=0, label="± 2 standard deviations of the reference")
    is_crowded = true_cm.size > CROWDED
    axes.errorbar(
        true_cm,
        reading_cm - true_cm,
        yerr=Z * np.array(found.reading_std_cm),
        linestyle="none",
        marker="o",
        markersize=2.0 if is_crowded else 4.0,
        color=OURS,
        alpha=0.4 if is_crowded else 1.0,
        elinewidth=0.5 if is_crowded else 0.9,
        capsize=0,
        label="mean of a point, 95 % by its readings",
        zorder=3,
    )
    if found.offset is not None and found.scale is not None:
        line_cm = found.offset.value + (found.scale.value - 1.0) * span
        axes.plot(span, line_cm, "--", color=REFERENCE, label="straight line", zorder=4)
    knots = np.array([(knot.true_cm, knot.reading_cm) for knot in found.knots]).reshape(-1, 2)
    if knots.size:
        curve = PiecewiseLinear(*map(tuple, knots.T.tolist()))(span)
        axes.plot(span, curve - span, "-", color=GREEN, label="calibration that is kept", zorder=5)
        inside = (knots[:, 0] >= span[0]) & (knots[:, 0] <= span[-1])
        axes.plot(
            knots[inside, 0],
            knots[inside, 1] - knots[inside, 0],
            linestyle="none",
            marker="s",
            markersize=5,
            color=GREEN,
            markeredgecolor="white",
            zorder=6,
        )
    axes.set_xlabel("true range [cm]" + (", in air of the calibration temperature" if by_sound else ""))
    axes.set_ylabel("mean reading − true range [cm]")
    if side is not None:
        forms = [each.form.replace(" ", "\n", 1) for each in found.held_out]
        rms = [each.rms_cm for each in found.held_out]
        bars = side.bar(
            range(len(rms)),
            rms,
            width=0.7,
            color=[GREEN if each.form == found.form else PALE for each in found.held_out],
        )
        side.bar_label(bars, [f"{value:.2f}" for value in rms], fontsize=8, padding=2)
        side.set_xticks(range(len(rms)), forms, fontsize=7)
        side.set_ylabel("rms on points left out [cm]")
        side.margins(y=0.15)
        side.grid(axis="x", visible=False)
        side.set_title("kept: " + found.form, fontsize=8)
    legend_below(figure)
    return figure


def draw_boxes(boxes: Sequence[HotBox]) -> Figure:
    """One panel a box: shift of the mean error over range, and three ideas of where the air is."""
    figure = new_figure(3.6)
    for axes, box in zip(figure.subplots(1, len(boxes), squeeze=False)[0], boxes, strict=True):
        range_cm = [row.range_cm for row in box.rows]
        axes.axhline(0.0, color=GREY, linewidth=0.9)
        uniform, gradient, confined = zip(
            *((r.uniform_cm, r.gradient_cm, r.confined_cm) for r in box.rows), strict=True
        )
        axes.plot(range_cm, uniform, ":", color=REFERENCE, linewidth=1.8, label="that air all the way")
        axes.plot(range_cm, gradient, "-.", color=PURPLE, label="linear fall to the room's at the target")
        axes.plot(range_cm, confined, "-", color=GREEN, label="that air in the box only")
        shift_cm, reach_cm = with_reach([row.shift for row in box.rows])
        axes.errorbar(range_cm, shift_cm, yerr=reach_cm, label="measured, minus room temperature", **DOTS)
        assumed = " (assumed)" if box.room_is_assumed else ""
        air = f"{box.box_c:.0f} °C at the sensor, {box.room_c:.0f} °C{assumed} beyond"
        axes.set_title(f"{air}\nair that explains it: {box.depth.value:.0f} cm", fontsize=8.5)
        axes.set_xlabel("true range [cm]")
    figure.axes[0].set_ylabel("shift of the mean error [cm]")
    legend_below(figure)
    return figure


def draw_compensated(rows: Sequence[CompensationRow], reference: ReferenceNumbers | None) -> Figure:
    """An arrow a range, from the mean error without compensation to the one with it; a reference's next to it."""
    figure = new_figure(3.6)
    axes = figure.subplots()
    axes.axhline(0.0, color=GREY, linewidth=0.9)
    range_cm = [row.range_cm for row in rows]
    aside = 0.12 * (float(np.min(np.diff(range_cm))) if len(rows) > 1 else 20.0) if reference else 0.0
    ours = [(row.range_cm - aside, row.uncompensated, row.compensated) for row in rows]
    _arrows(axes, ours, SERIES[0], "ours, " if reference else "")
    if reference is not None:
        pairs = [(each, reference.mean_errors_at(each)) for each in range_cm]
        theirs = [(each + aside, _exactly(pair[0]), _exactly(pair[1])) for each, pair in pairs if pair]
        _arrows(axes, theirs, SERIES[5], f"{reference.name}'s, ")
    axes.set_xticks(range_cm, [f"{each:g}" for each in range_cm])
    axes.set_xlabel("true range [cm]")
    axes.set_ylabel("mean error [cm]")
    legend_below(figure)
    return figure


def _exactly(value: float) -> IntervalEstimate:
    return IntervalEstimate(value, None, None, "cm", 0)


def _arrows(
    axes: Axes, rows: Sequence[tuple[float, IntervalEstimate, IntervalEstimate | None]], look: tuple[str, str], who: str
) -> None:
    """Errors before (filled) and after (white), at their places, with their intervals."""
    colour, marker = look
    marks: dict[str, Any] = {"linestyle": "none", "marker": marker, "markersize": 6, "color": colour}
    after = [(x, one, other) for x, one, other in rows if other is not None]
    axes.vlines(
        [x for x, *_ in after],
        [a.value for _, a, _ in after],
        [b.value for *_, b in after],
        color=colour,
        linewidth=1.0,
        alpha=0.6,
    )
    both: tuple[tuple[list[tuple[float, IntervalEstimate]], str, dict[str, Any]], ...] = (
        ([(x, one) for x, one, _ in rows], "uncompensated", {}),
        ([(x, other) for x, _, other in after], "compensated", {"markerfacecolor": "white", "markeredgewidth": 1.4}),
    )
    for points, what, more in both:
        x, (y, reach) = [x for x, _ in points], with_reach([each for _, each in points])
        axes.plot(x, y, label=f"{who}{what}", **marks, **more)
        if np.any(reach):
            axes.errorbar(x, y, yerr=reach, linestyle="none", color=colour, capsize=3, elinewidth=1)
