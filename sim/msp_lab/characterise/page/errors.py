"""Draw the range error over range.

At a fixed range the errors of a sensor with whole centimetres take few values, so each range shows how often each was
read, as a bar whose width is its share. Ranges that change all the time are put into bins first.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from msp_lab.estimates import Z
from msp_range.arrays import Array, Flags
from msp_sim.page.style import (
    BARS,
    GREY,
    OURS,
    REFERENCE,
    edges_between,
    intervals,
    label,
    line_at_zero,
    new_panels,
)

MOST_RANGES, BINS = 45, 24
"""With more different ranges than this, ranges are treated as continuous, and put into this number of bins."""
MOST_TICKS = 16
"""Ranges that have room for a tick each, and for their counts in full."""
LINEAR_CM = 5.0
"""Errors within this are to scale where the axis has to be compressed, because there are six times as large ones [cm]:
what calibration and air explain is within 3 cm, and would be too small to see."""
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

    def select(self, rows: Flags) -> "Errors":
        """Some of the readings."""
        return Errors(self.label, self.true_range_cm[rows], self.error_cm[rows], self.missed[rows])


class Scale(NamedTuple):
    """An axis of errors, which several pictures share to be compared."""

    low: float
    high: float
    """Lowest and highest error [cm]."""

    @property
    def is_compressed(self) -> bool:
        """Whether only errors within `LINEAR_CM` are to scale."""
        return max(-self.low, self.high) > 6.0 * LINEAR_CM

    @property
    def linear_cm(self) -> float:
        """Errors within this are to scale [cm]."""
        return LINEAR_CM if self.is_compressed else math.ceil(max(-self.low, self.high))

    def is_far(self, error_cm: Array) -> Flags:
        """Which errors are not drawn to scale: those off the axis, or beyond its linear part."""
        if self.is_compressed:
            return np.abs(error_cm) > LINEAR_CM
        return (error_cm < self.low) | (error_cm > self.high)


def draw_errors(panels: Sequence[Errors], scale: Scale | None = None) -> Figure:
    """Draw one panel for each of these, at least one, each with at least one reading; one above the other.

    `scale` is that of the error axis (None: what the errors need).
    """
    scale = scale or scale_of(panels)
    # One axis of ranges for all panels, also where some have fewer of them.
    ranges_cm, words = np.unique(np.concatenate([panel.true_range_cm for panel in panels])), "true range [cm]"
    if ranges_cm.size > MOST_RANGES:
        edges_cm, words = np.linspace(ranges_cm[0], ranges_cm[-1], BINS + 1), f"true range, in {BINS} bins [cm]"
        ranges_cm = (edges_cm[1:] + edges_cm[:-1]) / 2.0
        panels = [
            replace(panel, true_range_cm=ranges_cm[np.digitize(panel.true_range_cm, edges_cm[1:-1])])
            for panel in panels
        ]
    figure, rows = new_panels(3.5 if len(panels) == 1 else max(6.1, 1.1 + 1.7 * len(panels)), len(panels), sharex=True)
    for panel, row in zip(panels, rows, strict=True):
        if scale.is_compressed:
            row.set_yscale("symlog", linthresh=LINEAR_CM, linscale=0.8)
            row.set_yticks([tick for tick in TICKS_CM if scale.low <= tick <= scale.high])
            row.set_yticks([], minor=True)
        row.yaxis.set_major_formatter("{x:g}")
        row.set_ylim(scale.low, scale.high)
        line_at_zero(row)
        _draw_panel(row, panel, ranges_cm, scale)
        if len(panels) > 1:
            row.set_title(panel.label)
    figure.supylabel("reading − true range [cm]", fontsize=9.0)
    rows[-1].set_xlabel(words)
    return figure


def scale_of(panels: Sequence[Errors], marked_cm: Iterable[float] = ()) -> Scale:
    """Return the scale that shows nearly all readings of all panels and every marked error."""
    errors = np.concatenate([panel.error_cm[~panel.missed] for panel in panels])
    # One reading in 400 at either end may be outside, where it is marked: one or two outliers would hide the rest.
    shown = [-2.4, 2.4, *marked_cm]
    shown += [*np.quantile(errors, [0.0025, 0.9975])] if errors.size else []
    scale = Scale(min(shown) - 0.8, max(shown) + 0.8)
    return Scale(min(scale.low, -LINEAR_CM), max(scale.high, LINEAR_CM)) if scale.is_compressed else scale


def share_bars(axes: Axes, at: float, reading_cm: Array, of: int, room: float, thinnest: float = 0.0) -> None:
    """Draw a histogram on its side about a place: a bar of a centimetre for each reading, as wide as its share.

    `of` so many readings in all; one that all of them gave fills the room, and none is thinner than the thinnest.
    """
    if reading_cm.size:
        readings, counts = np.unique(reading_cm, return_counts=True)
        width = np.maximum(counts / of * room, thinnest)
        axes.barh(readings, width, 0.88, at - width / 2.0, label="readings: width is the share", **BARS)


def _draw_panel(row: Axes, each: Errors, ranges_cm: Array, scale: Scale) -> None:
    """Draw each range's errors as a histogram on its side, with their mean near the median.

    Above each range is how many of its readings are missed and, where there are any, how many are far off.
    """
    edges, has_room = edges_between(ranges_cm), ranges_cm.size <= MOST_TICKS
    room_cm, thinnest_cm = np.min(np.diff(edges)) * 0.82, 0.008 * (edges[-1] - edges[0])
    counted, is_far = {"missed": each.missed}, scale.is_far(each.error_cm)
    if np.any(is_far):
        counted = {f"over ±{LINEAR_CM:g} cm" if scale.is_compressed else "off the axis": is_far, **counted}
    above = {}
    for range_cm in np.unique(each.true_range_cm).tolist():
        here = each.true_range_cm == range_cm
        counts = [np.count_nonzero(flags[here]) for flags in counted.values()]
        of = f"/{np.count_nonzero(here)}" if has_room else ""
        if has_room or any(counts):
            above[range_cm] = "\n".join(f"{count}{of}" if count else "0" for count in counts)
        errors = each.error_cm[here & ~each.missed]
        if not errors.size:
            continue
        # An error that occurs: between two clusters, half of the readings each, there is none.
        centre_cm = np.quantile(errors, 0.5, method="nearest")
        # Bars of 1 cm, centred where this range's readings lie: half a centimetre off for a range of 304.5.
        rounded_cm, off = centre_cm + np.rint(errors - centre_cm), scale.is_far(errors)
        share_bars(row, range_cm, rounded_cm[~off], errors.size, room_cm, thinnest_cm)
        far_cm = np.unique(np.clip(rounded_cm[off], scale.low, scale.high))
        if far_cm.size:
            row.plot(far_cm * 0.0 + range_cm, far_cm, "_", color=OURS, clip_on=False, label="readings farther off")
        near = errors[np.abs(errors - centre_cm) <= scale.linear_cm]
        mean_cm, half_cm = near.mean(), Z * near.std() / math.sqrt(near.size)
        ends_cm, words = (mean_cm - half_cm, mean_cm + half_cm), "mean near the median, 95 % interval"
        intervals(row, range_cm, mean_cm, ends_cm, label=words)
    row.set_xlim(edges[0], edges[-1])
    if has_room:
        row.set_xticks(ranges_cm, [f"{range_cm:g}" for range_cm in ranges_cm])
    _write_above(row, above, "\n".join(counted))


def _write_above(row: Axes, words: Mapping[float, str], heading: str) -> None:
    """Write words over places of an axes, and what they are to the left."""
    above = row.secondary_xaxis("top")
    above.set_xticks(list(words), list(words.values()), fontsize=6.5)
    above.tick_params(length=0)
    above.spines["top"].set_visible(False)
    for text in above.get_xticklabels():
        text.set_color(REFERENCE if set(text.get_text()) - {"0", "\n"} else GREY)
    look = {"xycoords": "axes fraction", "ha": "right", "va": "bottom", "fontsize": 6.5, "color": GREY}
    label(row, heading, (0.0, 1.0), (-4, 4), **look)
