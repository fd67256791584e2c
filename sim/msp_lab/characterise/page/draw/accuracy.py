"""Accuracy against the reference (calibration and linearity), and what the air at the sensor does to it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from msp_lab.characterise.estimates import Z
from msp_range.correction.calibration import PiecewiseLinear
from msp_sim.page.style import GREEN, GREY, INK, OURS, PALE, PURPLE, REFERENCE, SERIES, legend_below, new_figure

_Array = NDArray[np.float64]


CROWDED = 60
"""With more points than this they are drawn smaller and paler than the lines."""


@dataclass(frozen=True)
class Linearity:
    """Points' mean readings against the reference.

    Parameters
    ----------
    true_cm, reading_cm, reading_std_cm
        Of each point: true range, mean reading, standard error of that mean [cm], shape (n,).
    line_cm
        Offset [cm] and scale of the straight line reading = offset + scale * true; None: not fitted.
    knots_cm
        True range and reading at the knots of the calibration that is kept, shape (m, 2); empty: none is kept.
    reference_std_cm
        Standard deviation of the reference [cm]; None: not stated.
    held_out
        (form, rms error on points left out [cm]) of each form that was tried.
    kept
        The form that is kept.
    """

    true_cm: _Array
    reading_cm: _Array
    reading_std_cm: _Array
    line_cm: tuple[float, float] | None
    knots_cm: _Array
    reference_std_cm: float | None
    held_out: Sequence[tuple[str, float]]
    kept: str


def draw_linearity(linearity: Linearity) -> Figure:
    """Mean error over range with the forms of calibration; next to it their errors on left-out points."""
    figure = new_figure(3.7)
    if linearity.held_out:
        axes, side = figure.subplots(1, 2, width_ratios=(3.4, 1.0))
    else:
        axes, side = figure.subplots(), None
    true_cm = linearity.true_cm
    span = np.linspace(float(np.min(true_cm)), float(np.max(true_cm)), 200)
    axes.axhline(0.0, color=GREY, linewidth=0.9)
    if linearity.reference_std_cm:
        half = 2.0 * linearity.reference_std_cm
        axes.axhspan(-half, half, color=PALE, alpha=0.5, linewidth=0, label="± 2 standard deviations of the reference")
    is_crowded = true_cm.size > CROWDED
    axes.errorbar(
        true_cm,
        linearity.reading_cm - true_cm,
        yerr=Z * linearity.reading_std_cm,
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
    if linearity.line_cm is not None:
        offset_cm, scale = linearity.line_cm
        axes.plot(span, offset_cm + (scale - 1.0) * span, "--", color=REFERENCE, label="straight line", zorder=4)
    if linearity.knots_cm.size:
        knots = linearity.knots_cm
        curve = _piecewise(span, knots)
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
    axes.set_xlabel("true range [cm], in air of the calibration temperature")
    axes.set_ylabel("mean reading − true range [cm]")
    if side is not None:
        forms = [form.replace(" ", "\n", 1) for form, _ in linearity.held_out]
        rms = [rms_cm for _, rms_cm in linearity.held_out]
        bars = side.bar(
            range(len(rms)),
            rms,
            width=0.7,
            color=[GREEN if form == linearity.kept else PALE for form, _ in linearity.held_out],
        )
        side.bar_label(bars, [f"{value:.2f}" for value in rms], fontsize=8, padding=2)
        side.set_xticks(range(len(rms)), forms, fontsize=7)
        side.set_ylabel("rms on points left out [cm]")
        side.margins(y=0.15)
        side.grid(axis="x", visible=False)
        side.set_title("kept: " + linearity.kept, fontsize=8)
    legend_below(figure)
    return figure


def _piecewise(true_cm: _Array, knots_cm: _Array) -> _Array:
    """Linear between the knots, the end segments carried on."""
    x, y = knots_cm[:, 0], knots_cm[:, 1]
    if x.size == 1:
        return true_cm + float(y[0] - x[0])
    return PiecewiseLinear(tuple(x.tolist()), tuple(y.tolist()))(true_cm)


@dataclass(frozen=True)
class BoxOfAir:
    """Shift of the mean error with a box of hot or cold air at the sensor, and three ideas of where that air is.

    Parameters
    ----------
    label
        Such as "46 °C at the sensor, 21 °C beyond".
    range_cm, shift_cm, low_cm, high_cm
        Measured shift and its interval at each range, shape (n,).
    uniform_cm, gradient_cm, confined_cm
        By each idea, shape (n,).
    depth_cm
        Length of the confined air [cm].
    """

    label: str
    range_cm: _Array
    shift_cm: _Array
    low_cm: _Array
    high_cm: _Array
    uniform_cm: _Array
    gradient_cm: _Array
    confined_cm: _Array
    depth_cm: float


def draw_boxes(boxes: Sequence[BoxOfAir]) -> Figure:
    """One panel a box: shift over range and the three ideas."""
    figure = new_figure(3.6)
    for axes, box in zip(figure.subplots(1, len(boxes), squeeze=False)[0], boxes, strict=True):
        axes.axhline(0.0, color=GREY, linewidth=0.9)
        axes.plot(box.range_cm, box.uniform_cm, ":", color=REFERENCE, linewidth=1.8, label="that air all the way")
        axes.plot(box.range_cm, box.gradient_cm, "-.", color=PURPLE, label="linear fall to the room's at the target")
        axes.plot(box.range_cm, box.confined_cm, "-", color=GREEN, label="that air in the box only")
        axes.errorbar(
            box.range_cm,
            box.shift_cm,
            yerr=[box.shift_cm - box.low_cm, box.high_cm - box.shift_cm],
            linestyle="none",
            marker="o",
            markersize=4.5,
            color=INK,
            markerfacecolor="white",
            capsize=2.5,
            elinewidth=1.0,
            zorder=5,
            label="measured, minus room temperature",
        )
        axes.set_title(f"{box.label}\nair that explains it: {box.depth_cm:.0f} cm", fontsize=8.5)
        axes.set_xlabel("true range [cm]")
    figure.axes[0].set_ylabel("shift of the mean error [cm]")
    legend_below(figure)
    return figure


@dataclass(frozen=True)
class Compensated:
    """Mean errors without and with temperature compensation, and those of a reference; NaN: none."""

    range_cm: _Array
    before_cm: _Array
    before_low_cm: _Array
    before_high_cm: _Array
    after_cm: _Array
    after_low_cm: _Array
    after_high_cm: _Array
    reference_before_cm: _Array
    reference_after_cm: _Array
    reference: str = ""
    """Name of the reference; "": there is none."""


def draw_compensated(rows: Compensated) -> Figure:
    """An arrow a range, from the mean error without compensation to the one with it; the reference's next to it."""
    figure = new_figure(3.6)
    axes = figure.subplots()
    axes.axhline(0.0, color=GREY, linewidth=0.9)
    aside = (
        0.12 * (float(np.min(np.diff(rows.range_cm))) if rows.range_cm.size > 1 else 20.0) if rows.reference else 0.0
    )
    for x, before, after, low, high, colour, marker, who in (
        (
            rows.range_cm - aside,
            rows.before_cm,
            rows.after_cm,
            rows.before_low_cm,
            rows.before_high_cm,
            *SERIES[0],
            "ours, " if rows.reference else "",
        ),
        (
            rows.range_cm + aside,
            rows.reference_before_cm,
            rows.reference_after_cm,
            None,
            None,
            *SERIES[5],
            f"{rows.reference}'s, ",
        ),
    )[: 2 if rows.reference else 1]:
        axes.vlines(x, before, after, color=colour, linewidth=1.0, alpha=0.6)
        axes.plot(x, before, linestyle="none", marker=marker, color=colour, markersize=6, label=f"{who}uncompensated")
        axes.plot(
            x,
            after,
            linestyle="none",
            marker=marker,
            markersize=6,
            color=colour,
            markerfacecolor="white",
            markeredgewidth=1.4,
            label=f"{who}compensated",
        )
        if low is not None and high is not None:
            for y, bottom, top in ((before, low, high), (after, rows.after_low_cm, rows.after_high_cm)):
                axes.errorbar(x, y, yerr=[y - bottom, top - y], linestyle="none", color=colour, capsize=3, elinewidth=1)
    axes.set_xticks(rows.range_cm, [f"{each:g}" for each in rows.range_cm])
    axes.set_xlabel("true range [cm]")
    axes.set_ylabel("mean error [cm]")
    legend_below(figure)
    return figure
