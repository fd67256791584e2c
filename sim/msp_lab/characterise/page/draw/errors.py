"""Range error over range.

Errors of readings at true ranges enter, a figure leaves. At a fixed range the errors of a sensor with whole
centimetres take few values, so each range shows how often each was read, as a bar whose width is its share.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator
from numpy.typing import ArrayLike

from msp_lab.characterise.estimates import Z
from msp_lab.characterise.point_findings import IntervalEstimate
from msp_range.arrays import Array, Flags
from msp_sim.page.style import DOTS, GREY, OURS, REFERENCE, edges_between, legend_below, new_figure, signed

ERROR_LABEL = "reading − true range [cm]"

MOST_RANGES = 45
"""With more ranges than this they are taken as continuous and binned."""

LINEAR_CM = 5.0
"""Errors within this are to scale where the axis has to be compressed [cm]."""


@dataclass(frozen=True)
class Errors:
    """Readings of one sensor in one condition, each with its true range."""

    label: str
    """Whose they are; on the panel where there is more than one."""
    true_range_cm: Array
    """Where the target was [cm], shape (n,)."""
    error_cm: Array
    """Reading minus true range [cm], shape (n,); positive: reads long. NaN where `missed`."""
    missed: Flags
    """Readings that are no distance (the codes for no echo) and answers that did not come, shape (n,)."""


@dataclass(frozen=True)
class Line:
    """Mean errors of a reference, to compare with."""

    label: str
    range_cm: Array
    error_cm: Array


@dataclass(frozen=True)
class ErrorAxes:
    """What the panels of several pictures share, so that they can be compared side by side."""

    limits_cm: tuple[float, float] | None = None
    """Lowest and highest error [cm]; None: what the errors need."""
    points: Sequence[Line] = ()
    """Marked points."""
    band_cm: float | None = None
    """Errors between plus and minus this are shaded [cm]."""
    band_label: str = ""
    """What the band is."""


def with_reach(estimates: Sequence[IntervalEstimate]) -> tuple[Array, Array]:
    """Values, (n,), and how far their intervals reach below and above them, (2, n); 0 where an end is unknown."""
    values = np.array([each.value for each in estimates])
    ends = [[each.value if end is None else end for end in (each.low, each.high)] for each in estimates]
    return values, np.abs(np.array(ends).reshape(-1, 2).T - values)


def draw_errors(panels: Sequence[Errors], axes: ErrorAxes | None = None) -> Figure:
    """One panel a sensor, one above the other.

    Parameters
    ----------
    panels
        At least one, each with at least one reading.
    axes
        Limits and what to compare with.
    """
    axes = axes or ErrorAxes()
    limits_cm = axes.limits_cm or shared_limits_cm(panels, axes.points)
    figure = new_figure(3.5 if len(panels) == 1 else 6.1 if len(panels) == 2 else 1.1 + 1.7 * len(panels))
    rows = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    # One axis of ranges for all panels, also where some have fewer of them.
    ranges_cm = np.unique(np.concatenate([each.true_range_cm for each in panels]))
    for each, row in zip(panels, rows, strict=True):
        _panel(row, each, axes, limits_cm, ranges_cm)
        if len(panels) > 1:
            row.set_title(each.label, pad=24.0)
    if len(panels) > 1:
        figure.supylabel(ERROR_LABEL, fontsize=9.0)
    else:
        rows[0].set_ylabel(ERROR_LABEL)
    rows[-1].set_xlabel("true range [cm]")
    # Of equal labels the last: a kind of mark that one panel lacks is explained by another.
    handles = {str(handle.get_label()): handle for row in rows for handle in row.get_legend_handles_labels()[0]}
    legend_below(figure, list(handles.values()))
    return figure


def shared_limits_cm(panels: Sequence[Errors], points: Sequence[Line] = ()) -> tuple[float, float]:
    """Limits of the error axis that show nearly all readings of all panels and every line [cm]."""
    errors = np.concatenate([each.error_cm[~each.missed] for each in panels] or [np.zeros(1)])
    low, high = -3.2, 3.2
    if errors.size:
        # One reading in 400 at either end may be outside, where it is marked: one or two outliers would hide the rest.
        shown = np.quantile(errors, [0.0025, 0.9975])
        low, high = min(low, float(shown[0]) - 0.8), max(high, float(shown[1]) + 0.8)
    for line in points:
        low, high = min(low, float(np.min(line.error_cm)) - 0.8), max(high, float(np.max(line.error_cm)) + 0.8)
    return low, high


def _panel(row: Axes, each: Errors, axes: ErrorAxes, limits_cm: tuple[float, float], ranges_cm: Array) -> None:
    low, high = limits_cm
    compressed = max(-low, high) > 6.0 * LINEAR_CM
    if compressed:
        row.set_yscale("symlog", linthresh=LINEAR_CM, linscale=0.8)
        ticks = (-500, -200, -100, -50, -20, -10, -5, 0, 5, 10, 20, 50, 100, 200, 500)
        row.yaxis.set_major_locator(FixedLocator([tick for tick in ticks if low <= tick <= high]))
        row.yaxis.set_minor_locator(NullLocator())
    row.yaxis.set_major_formatter(signed)
    row.set_ylim(low, high)
    row.axhline(0.0, color=GREY, linewidth=0.9, zorder=1)
    if axes.band_cm is not None:
        row.axhspan(
            -axes.band_cm, axes.band_cm, color=REFERENCE, alpha=0.10, linewidth=0, label=axes.band_label, zorder=0
        )
    if ranges_cm.size <= MOST_RANGES:
        _bars(row, each, ranges_cm, limits_cm, compressed)
    else:
        _cloud(row, each, limits_cm, compressed)
    for line in axes.points:
        looks: dict[str, Any] = {"marker": "X", "markersize": 7, "color": REFERENCE, "markeredgecolor": "white"}
        row.plot(line.range_cm, line.error_cm, linestyle="none", label=line.label, zorder=6, **looks)


def _bars(row: Axes, each: Errors, ranges_cm: Array, limits_cm: tuple[float, float], compressed: bool) -> None:
    """Each range's errors as a histogram on its side, its mean, and how many were missed above.

    Where the axis is compressed the errors have several peaks: there the median stands for the mean, and what lies
    beyond the part that is to scale is drawn as ticks and counted.
    """
    low, high = limits_cm
    edges = edges_between(ranges_cm.tolist())
    room_cm = float(np.min(np.diff(edges))) * 0.82
    thinnest_cm = 0.008 * (edges[-1] - edges[0])
    bars: list[tuple[float, float, float]] = []
    far: list[tuple[float, float]] = []
    middles: list[tuple[float, float, float]] = []
    for range_cm in np.unique(each.true_range_cm).tolist():
        here = each.true_range_cm == range_cm
        errors = each.error_cm[here & ~each.missed]
        _count_above(
            row, range_cm, int(np.count_nonzero(each.missed[here])), int(np.count_nonzero(here)), ranges_cm.size, 0
        )
        if compressed:
            beyond = int(np.count_nonzero(np.abs(errors) > LINEAR_CM))
            _count_above(row, range_cm, beyond, int(np.count_nonzero(here)), ranges_cm.size, 1)
        if not errors.size:
            continue
        near = errors if compressed else errors[(errors > low) & (errors < high)]
        if near.size:
            spread = 0.0 if compressed else Z * float(np.std(near)) / np.sqrt(near.size)
            middles.append((range_cm, float(np.median(near) if compressed else np.mean(near)), spread))
        # Bars of 1 cm, centred where this range's readings lie: half a centimetre off for a range of 304.5.
        centre_cm = float(np.quantile(errors, 0.5, method="nearest"))
        steps, counts = np.unique(np.rint(errors - centre_cm), return_counts=True)
        for step, count in zip(steps.tolist(), counts.tolist(), strict=True):
            error_cm = centre_cm + step
            if (compressed and abs(error_cm) > LINEAR_CM) or not low < error_cm < high:
                far.append((range_cm, min(max(error_cm, low), high)))
            else:
                bars.append((range_cm, error_cm, max(count / errors.size * room_cm, thinnest_cm)))
    if bars:
        x, y, width = np.array(bars).T
        share_bars(row, x - width / 2.0, y, width)
    if far:
        x, y = np.array(far).T
        label = "readings farther off" if compressed else "readings outside"
        row.plot(x, y, "_", markersize=6, markeredgewidth=1.0, color=OURS, zorder=2, clip_on=False, label=label)
    if middles:
        x, y, spreads = np.array(middles).T
        label = "median" if compressed else "mean of those not outside, 95 % interval"
        look = DOTS | {"markeredgewidth": 1.1, "elinewidth": 1.1, "capsize": 2}
        row.errorbar(x, y, yerr=None if compressed else spreads, label=label, **look)
    for line, text in enumerate(("missed ", f"over ±{LINEAR_CM:g} cm ") if compressed else ("missed ",)):
        row.annotate(
            text,
            (0.0, 1.0),
            xycoords="axes fraction",
            xytext=(0, 2 + 9 * line),
            textcoords="offset points",
            ha="right",
            va="bottom",
            fontsize=6.5,
            color=GREY,
            annotation_clip=False,
        )
    row.set_xlim(edges[0], edges[-1])
    if ranges_cm.size <= 16:
        row.set_xticks(ranges_cm)
        row.xaxis.set_major_formatter("{x:g}")
    row.grid(axis="x", visible=False)


def share_bars(axes: Axes, left: ArrayLike, reading_cm: ArrayLike, width: ArrayLike) -> None:
    """Histograms on their side: a bar of a centimetre for each reading, as wide as its share."""
    look: dict[str, Any] = {"align": "edge", "color": OURS, "alpha": 0.6, "linewidth": 0, "zorder": 2}
    axes.bar(left, 0.88, width, np.asarray(reading_cm) - 0.44, label="readings: width is the share", **look)


def _count_above(row: Axes, range_cm: float, count: int, of: int, ranges: int, line: int) -> None:
    """A count over the axes at a range, on the first or second line."""
    if count == 0 and ranges > 30:
        return
    row.annotate(
        f"{count}/{of}" if count and ranges <= 16 else str(count),
        (range_cm, 1.0),
        xycoords=row.get_xaxis_transform(),
        xytext=(0, 2 + 9 * line),
        textcoords="offset points",
        ha="center",
        va="bottom",
        fontsize=6.5 if ranges <= 16 else 5.5,
        color=REFERENCE if count else GREY,
        annotation_clip=False,
    )


def _cloud(row: Axes, each: Errors, limits_cm: tuple[float, float], compressed: bool) -> None:
    """Every reading as a dot, and their mean, or where the axis is compressed their median, in bins of range."""
    low, high = limits_cm
    x, y = each.true_range_cm[~each.missed], each.error_cm[~each.missed]
    row.plot(x, np.clip(y, low, high), ".", color=OURS, markersize=2, alpha=0.35, label="readings", rasterized=True)
    inside = (y >= low) & (y <= high)
    x, y = x[inside], y[inside]
    if x.size:
        edges = np.linspace(x.min(), x.max() + 1e-9, 25)
        index = np.digitize(x, edges) - 1
        kept = [i for i in range(24) if np.count_nonzero(index == i) >= 5]
        centres = [float(np.mean(x[index == i])) for i in kept]
        means = [float(np.median(y[index == i]) if compressed else np.mean(y[index == i])) for i in kept]
        spreads = [Z * float(np.std(y[index == i])) / np.sqrt(np.count_nonzero(index == i)) for i in kept]
        label = "median in bins" if compressed else "mean in bins and its 95 % interval"
        look = DOTS | {"linestyle": "-", "linewidth": 1.0, "markersize": 4, "capsize": 2}
        row.errorbar(centres, means, yerr=None if compressed else spreads, label=label, **look)
    missed = int(np.count_nonzero(each.missed))
    row.text(
        1.0,
        1.01,
        f"missed {missed} of {each.missed.size}",
        transform=row.transAxes,
        ha="right",
        va="bottom",
        fontsize=7,
        color=REFERENCE if missed else GREY,
    )
