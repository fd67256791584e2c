"""Draw the range error over range.

At a fixed range the errors of a sensor with whole centimetres take few values, so each range shows how often each was
read, as a bar whose width is its share. Ranges that change all the time are drawn as a cloud.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator
from numpy.typing import ArrayLike

from msp_lab.characterise.estimates import Z
from msp_lab.characterise.point_findings import IntervalEstimate
from msp_range.arrays import Array, Flags
from msp_sim.page.style import (
    BARS,
    DOTS,
    GREY,
    MARKED,
    OURS,
    REFERENCE,
    edges_between,
    label,
    legend_below,
    line_at_zero,
    new_figure,
    shaded,
    signed,
)

ERROR_LABEL = "reading − true range [cm]"
MOST_RANGES = 45
"""With more ranges than this they are taken as continuous and binned."""
LINEAR_CM = 5.0
"""Errors within this are to scale where the axis has to be compressed [cm]."""
TICKS_CM = (-500, -200, -100, -50, -20, -10, -5, 0, 5, 10, 20, 50, 100, 200, 500)


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


class Line(NamedTuple):
    """Mean errors of a reference, to compare with."""

    label: str
    range_cm: Array
    error_cm: Array


class Scale(NamedTuple):
    """Lowest and highest error of an axis [cm], which several pictures share to be compared."""

    low: float
    high: float

    @property
    def compressed(self) -> bool:
        """Whether only errors within `LINEAR_CM` are to scale."""
        return max(-self.low, self.high) > 6.0 * LINEAR_CM

    def middle_of(self, errors: Array) -> tuple[float, float]:
        """The mean of errors, and half of its 95 % interval; the median where they have several peaks."""
        if self.compressed:
            return float(np.median(errors)), 0.0
        return float(np.mean(errors)), Z * float(np.std(errors)) / np.sqrt(errors.size)


def draw_errors(
    panels: Sequence[Errors],
    scale: Scale | None = None,
    marked: Line | None = None,
    band: tuple[float, str] | None = None,
) -> Figure:
    """Draw one panel a sensor, one above the other.

    Parameters
    ----------
    panels
        At least one, each with at least one reading.
    scale
        Of the error axis; None: what the errors need.
    marked
        Errors to compare with.
    band
        Errors between plus and minus this are shaded [cm], and what they are.
    """
    scale = scale or scale_of(panels, marked)
    figure = new_figure(3.5 if len(panels) == 1 else 6.1 if len(panels) == 2 else 1.1 + 1.7 * len(panels))
    rows = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    # One axis of ranges for all panels, also where some have fewer of them.
    ranges_cm = np.unique(np.concatenate([each.true_range_cm for each in panels]))
    for each, row in zip(panels, rows, strict=True):
        _set_up(row, scale)
        if band is not None:
            half_cm, words = band
            row.axhspan(-half_cm, half_cm, label=words, **shaded(REFERENCE))
        draw = _bars if ranges_cm.size <= MOST_RANGES else _cloud
        draw(row, each, ranges_cm, scale)
        if marked is not None:
            row.plot(marked.range_cm, marked.error_cm, label=marked.label, **MARKED)
        if len(panels) > 1:
            row.set_title(each.label, pad=24.0)
    if len(panels) > 1:
        figure.supylabel(ERROR_LABEL, fontsize=9.0)
    else:
        rows[0].set_ylabel(ERROR_LABEL)
    rows[-1].set_xlabel("true range [cm]")
    # Of equal labels the last: a kind of mark that one panel lacks is explained by another.
    handles = {str(handle.get_label()): handle for row in rows for handle in row.get_legend_handles_labels()[0]}
    return legend_below(figure, list(handles.values()))


def scale_of(panels: Sequence[Errors], marked: Line | None = None) -> Scale:
    """Return the scale that shows nearly all readings of all panels and every marked error."""
    errors = np.concatenate([each.error_cm[~each.missed] for each in panels] or [np.zeros(1)])
    low, high = -3.2, 3.2
    if errors.size:
        # One reading in 400 at either end may be outside, where it is marked: one or two outliers would hide the rest.
        shown = np.quantile(errors, [0.0025, 0.9975])
        low, high = min(low, float(shown[0]) - 0.8), max(high, float(shown[1]) + 0.8)
    if marked is not None:
        low, high = min(low, float(np.min(marked.error_cm)) - 0.8), max(high, float(np.max(marked.error_cm)) + 0.8)
    return Scale(low, high)


def with_reach(estimates: Sequence[IntervalEstimate]) -> tuple[Array, Array]:
    """Values, (n,), and how far their intervals reach below and above them, (2, n); 0 where an end is unknown."""
    values = np.array([each.value for each in estimates])
    ends = [[each.value if end is None else end for end in (each.low, each.high)] for each in estimates]
    return values, np.abs(np.array(ends).reshape(-1, 2).T - values)


def share_bars(axes: Axes, left: ArrayLike, reading_cm: ArrayLike, width: ArrayLike) -> None:
    """Draw histograms on their side: a bar of a centimetre for each reading, as wide as its share."""
    words = "readings: width is the share"
    axes.bar(left, 0.88, width, np.asarray(reading_cm) - 0.44, align="edge", label=words, **BARS)


def _set_up(row: Axes, scale: Scale) -> None:
    if scale.compressed:
        row.set_yscale("symlog", linthresh=LINEAR_CM, linscale=0.8)
        row.yaxis.set_major_locator(FixedLocator([tick for tick in TICKS_CM if scale.low <= tick <= scale.high]))
        row.yaxis.set_minor_locator(NullLocator())
    row.yaxis.set_major_formatter(signed)
    row.set_ylim(scale.low, scale.high)
    line_at_zero(row)


def _bars(row: Axes, each: Errors, ranges_cm: Array, scale: Scale) -> None:
    """Draw each range's errors as a histogram on its side with its middle, and how many were missed above.

    Where the axis is compressed, what lies beyond the part that is to scale is drawn as ticks and counted.
    """
    low, high = scale
    edges = edges_between(ranges_cm.tolist())
    room_cm = float(np.min(np.diff(edges))) * 0.82
    thinnest_cm = 0.008 * (edges[-1] - edges[0])
    bars, far, middles = [], [], []
    for range_cm in np.unique(each.true_range_cm).tolist():
        here = each.true_range_cm == range_cm
        errors = each.error_cm[here & ~each.missed]
        counted = [each.missed[here], *([np.abs(errors) > LINEAR_CM] if scale.compressed else [])]
        for line, flags in enumerate(counted):
            _count_above(row, range_cm, int(np.count_nonzero(flags)), int(np.count_nonzero(here)), ranges_cm.size, line)
        if not errors.size:
            continue
        near = errors if scale.compressed else errors[(errors > low) & (errors < high)]
        if near.size:
            middles.append((range_cm, *scale.middle_of(near)))
        # Bars of 1 cm, centred where this range's readings lie: half a centimetre off for a range of 304.5.
        centre_cm = float(np.quantile(errors, 0.5, method="nearest"))
        steps, counts = np.unique(np.rint(errors - centre_cm), return_counts=True)
        for error_cm, count in zip((centre_cm + steps).tolist(), counts.tolist(), strict=True):
            if (scale.compressed and abs(error_cm) > LINEAR_CM) or not low < error_cm < high:
                far.append((range_cm, min(max(error_cm, low), high)))
            else:
                bars.append((range_cm, error_cm, max(count / errors.size * room_cm, thinnest_cm)))
    if bars:
        x, y, width = np.array(bars).T
        share_bars(row, x - width / 2.0, y, width)
    if far:
        words = "readings farther off" if scale.compressed else "readings outside"
        row.plot(*np.array(far).T, "_", color=OURS, clip_on=False, label=words)
    words = "median" if scale.compressed else "mean of those not outside, 95 % interval"
    _middles(row, middles, scale, words)
    for line, words in enumerate(("missed ", f"over ±{LINEAR_CM:g} cm ") if scale.compressed else ("missed ",)):
        _write_above(row, words, 0.0, "axes fraction", line, ha="right", fontsize=6.5, color=GREY)
    row.set_xlim(edges[0], edges[-1])
    if ranges_cm.size <= 16:
        row.set_xticks(ranges_cm)
        row.xaxis.set_major_formatter("{x:g}")
    row.grid(axis="x", visible=False)


def _cloud(row: Axes, each: Errors, _: Array, scale: Scale) -> None:
    """Draw every reading as a dot, and their middle in bins of range."""
    low, high = scale
    x, y = each.true_range_cm[~each.missed], each.error_cm[~each.missed]
    row.plot(x, np.clip(y, low, high), ".", color=OURS, markersize=2, alpha=0.35, label="readings", rasterized=True)
    inside = (y >= low) & (y <= high)
    x, y = x[inside], y[inside]
    if x.size:
        index = np.digitize(x, np.linspace(x.min(), x.max() + 1e-9, 25)) - 1
        bins = [index == i for i in range(24) if np.count_nonzero(index == i) >= 5]
        middles = [(float(np.mean(x[here])), *scale.middle_of(y[here])) for here in bins]
        words = "median in bins" if scale.compressed else "mean in bins and its 95 % interval"
        _middles(row, middles, scale, words, linestyle="-")
    missed = int(np.count_nonzero(each.missed))
    words, colour = f"missed {missed} of {each.missed.size}", REFERENCE if missed else GREY
    row.text(1.0, 1.01, words, transform=row.transAxes, ha="right", va="bottom", fontsize=7, color=colour)


def _middles(row: Axes, middles: Sequence[tuple[float, float, float]], scale: Scale, words: str, **look: Any) -> None:
    """Draw the middles of errors with their intervals."""
    if middles:
        x, y, halves = np.array(middles).T
        row.errorbar(x, y, yerr=None if scale.compressed else halves, label=words, **DOTS | look)


def _count_above(row: Axes, range_cm: float, count: int, of: int, ranges: int, line: int) -> None:
    """Write a count over the axes at a range, on the first or second line."""
    if count or ranges <= 30:
        words = f"{count}/{of}" if count and ranges <= 16 else str(count)
        look = {"fontsize": 6.5 if ranges <= 16 else 5.5, "color": REFERENCE if count else GREY}
        _write_above(row, words, range_cm, row.get_xaxis_transform(), line, ha="center", **look)


def _write_above(row: Axes, words: str, x: float, coordinates: Any, line: int, **look: Any) -> None:
    label(row, words, (x, 1.0), (0, 2 + 9 * line), xycoords=coordinates, va="bottom", annotation_clip=False, **look)
