"""Draw the range error over range.

At a fixed range the errors of a sensor with whole centimetres take few values, so each range shows how often each was
read, as a bar whose width is its share. Ranges that change all the time are drawn as a cloud.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from msp_lab.estimates import IntervalEstimate, Z
from msp_range.arrays import Array, Flags
from msp_sim.page.style import (
    BARS,
    DOTS,
    GREY,
    OURS,
    REFERENCE,
    edges_between,
    label,
    line_at_zero,
    new_figure,
    shaded,
    signed,
)

MOST_RANGES = 45
"""With more ranges than this they are taken as continuous and binned."""
MOST_TICKS, MOST_COUNTS = 16, 30
"""Ranges that have room for a tick each with their counts in full, and for a count of 0."""
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


def draw_errors(
    panels: Sequence[Errors],
    scale: Scale | None = None,
    band: tuple[float, str] | None = None,
) -> Figure:
    """Draw one panel for each of these, at least one, each with at least one reading; one above the other.

    `scale` is that of the error axis (None: what the errors need); errors between plus and minus the first of `band`
    are shaded [cm], and the second says what they are.
    """
    scale = scale or scale_of(panels)
    figure = new_figure(3.5 if len(panels) == 1 else max(6.1, 1.1 + 1.7 * len(panels)))
    rows = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    # One axis of ranges for all panels, also where some have fewer of them.
    ranges_cm = np.unique(np.concatenate([panel.true_range_cm for panel in panels]))
    for each, row in zip(panels, rows, strict=True):
        if scale.is_compressed:
            row.set_yscale("symlog", linthresh=LINEAR_CM, linscale=0.8)
            row.set_yticks([tick for tick in TICKS_CM if scale.low <= tick <= scale.high])
            row.set_yticks([], minor=True)
        row.yaxis.set_major_formatter(signed)
        row.set_ylim(scale.low, scale.high)
        line_at_zero(row)
        if band is not None:
            half_cm, words = band
            row.axhspan(-half_cm, half_cm, label=words, **shaded(REFERENCE))
        draw = _bars if ranges_cm.size <= MOST_RANGES else _cloud
        draw(row, each, ranges_cm, scale)
        if len(panels) > 1:
            row.set_title(each.label)
    figure.supylabel("reading − true range [cm]", fontsize=9.0)
    rows[-1].set_xlabel("true range [cm]")
    return figure


def scale_of(panels: Sequence[Errors], marked_cm: Iterable[float] = ()) -> Scale:
    """Return the scale that shows nearly all readings of all panels and every marked error."""
    errors = np.concatenate([panel.error_cm[~panel.missed] for panel in panels])
    # One reading in 400 at either end may be outside, where it is marked: one or two outliers would hide the rest.
    shown = [-2.4, 2.4, *marked_cm]
    shown += [*np.quantile(errors, [0.0025, 0.9975])] if errors.size else []
    scale = Scale(min(shown) - 0.8, max(shown) + 0.8)
    return Scale(min(scale.low, -LINEAR_CM), max(scale.high, LINEAR_CM)) if scale.is_compressed else scale


def with_reach(estimates: Sequence[IntervalEstimate]) -> tuple[Array, Array]:
    """Values, (n,), and how far their intervals reach below and above them, (2, n); 0 where an end is unknown."""
    values = np.array([estimate.value for estimate in estimates])
    ends = [[estimate.value if end is None else end for end in (estimate.low, estimate.high)] for estimate in estimates]
    return values, np.abs(np.array(ends).reshape(-1, 2).T - values)


def share_bars(axes: Axes, at: float, reading_cm: Array, of: int, room: float, thinnest: float = 0.0) -> None:
    """Draw a histogram on its side about a place: a bar of a centimetre for each reading, as wide as its share.

    `of` so many readings in all; one that all of them gave fills the room, and none is thinner than the thinnest.
    """
    if reading_cm.size:
        readings, counts = np.unique(reading_cm, return_counts=True)
        width, words = np.maximum(counts / of * room, thinnest), "readings: width is the share"
        axes.bar(at - width / 2.0, 0.88, width, readings - 0.44, align="edge", label=words, **BARS)


def _bars(row: Axes, each: Errors, ranges_cm: Array, scale: Scale) -> None:
    """Draw each range's errors as a histogram on its side with its middle; counts of what it leaves out are above."""
    edges = edges_between(ranges_cm.tolist())
    room_cm = np.min(np.diff(edges)) * 0.82
    thinnest_cm = 0.008 * (edges[-1] - edges[0])
    middles = []
    for range_cm in np.unique(each.true_range_cm[~each.missed]):
        errors = each.error_cm[(each.true_range_cm == range_cm) & ~each.missed]
        centre_cm = _median(errors)
        middles.append((range_cm, *_middle_of(errors, scale)))
        # Bars of 1 cm, centred where this range's readings lie: half a centimetre off for a range of 304.5.
        rounded_cm, is_far = centre_cm + np.rint(errors - centre_cm), scale.is_far(errors)
        share_bars(row, range_cm, rounded_cm[~is_far], errors.size, room_cm, thinnest_cm)
        far_cm = np.unique(np.clip(rounded_cm[is_far], scale.low, scale.high))
        if far_cm.size:
            where = np.full_like(far_cm, range_cm)
            row.plot(where, far_cm, "_", color=OURS, clip_on=False, label="readings farther off")
    _middles(row, middles, "")
    _count_above(row, each, ranges_cm, scale)
    row.set_xlim(edges[0], edges[-1])
    if ranges_cm.size <= MOST_TICKS:
        row.set_xticks(ranges_cm, [f"{range_cm:g}" for range_cm in ranges_cm])
    row.grid(axis="x", visible=False)


def _count_above(row: Axes, errors: Errors, ranges_cm: Array, scale: Scale) -> None:
    """Write over each range how many of its readings are missed, and where there are any, how many are far off."""
    counted = {"missed": errors.missed}
    is_far = scale.is_far(errors.error_cm)
    if np.any(is_far):
        counted = {f"over ±{LINEAR_CM:g} cm" if scale.is_compressed else "off the axis": is_far, **counted}
    shown, words, colours = [], [], []
    for range_cm in ranges_cm:
        here = errors.true_range_cm == range_cm
        counts = [np.count_nonzero(flags[here]) for flags in counted.values()]
        if any(counts) or (np.any(here) and ranges_cm.size <= MOST_COUNTS):
            of = f"/{np.count_nonzero(here)}" if ranges_cm.size <= MOST_TICKS else ""
            shown.append(range_cm)
            words.append("\n".join(f"{count}{of}" if count else "0" for count in counts))
            colours.append(REFERENCE if any(counts) else GREY)
    above = row.secondary_xaxis("top")
    above.set_xticks(shown, words, fontsize=6.5)
    above.tick_params(length=0)
    above.spines["top"].set_visible(False)
    for text, colour in zip(above.get_xticklabels(), colours, strict=True):
        text.set_color(colour)
    look: dict[str, Any] = {"xycoords": "axes fraction", "ha": "right", "va": "bottom", "fontsize": 6.5, "color": GREY}
    label(row, "\n".join(counted), (0.0, 1.0), (-4, 4), **look)


def _cloud(row: Axes, errors: Errors, _: Array, scale: Scale) -> None:
    """Draw every reading as a dot, and their middle in bins of range."""
    x, y = errors.true_range_cm[~errors.missed], errors.error_cm[~errors.missed]
    look: dict[str, Any] = {"color": OURS, "markersize": 2, "alpha": 0.35, "rasterized": True}
    row.plot(x, np.clip(y, scale.low, scale.high), ".", label="readings", **look)
    if x.size:
        index = np.digitize(x, np.linspace(x.min(), x.max() + 1e-9, 25))
        bins = [here for here in index == np.arange(1, 25)[:, None] if np.count_nonzero(here) >= 5]
        middles = [(np.mean(x[here]), *_middle_of(y[here], scale)) for here in bins]
        _middles(row, middles, " in bins", linestyle="-")
    missed = np.count_nonzero(errors.missed)
    words, colour = f"missed {missed} of {errors.missed.size}", REFERENCE if missed else GREY
    row.text(1.0, 1.01, words, transform=row.transAxes, ha="right", va="bottom", fontsize=7, color=colour)


def _median(errors: Array) -> float:
    """The median, an error that occurs: between two clusters, half of the readings each, there is none."""
    return float(np.quantile(errors, 0.5, method="nearest"))


def _middle_of(errors: Array, scale: Scale) -> tuple[float, float]:
    """The mean of the errors near their median, and half of its 95 % interval."""
    near = errors[np.abs(errors - _median(errors)) <= scale.linear_cm]
    return near.mean(), Z * near.std() / math.sqrt(near.size)


def _middles(row: Axes, middles: Sequence[tuple[float, float, float]], where: str, **look: Any) -> None:
    """Draw the middles of errors with their intervals."""
    if middles:
        x, y, halves = np.array(middles).T
        row.errorbar(x, y, yerr=halves, label=f"mean{where} near the median, 95 % interval", **DOTS | look)
