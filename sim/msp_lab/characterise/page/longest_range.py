"""Pictures of many readings at the longest range: in the order in which they came, and how often each was read."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from matplotlib.axes import Axes

from msp_lab.characterise.page.mixture import densities, longest_range_cm
from msp_lab.characterise.page.picture_data import PictureData, in_order
from msp_lab.characterise.page.text import interval
from msp_lab.estimates import Z
from msp_lab.readings.resolution import to_step
from msp_range.arrays import Array, Flags
from msp_sim.page.page import Absent, Drawn, Entry
from msp_sim.page.style import BARS, GREY, INK, ORANGE, OURS, REFERENCE, intervals, label, new_axes, note
from msp_sim.page.text import counted

PEAK_RANGE_CM = 1.0
"""A reference's peak is marked where its true range is this near to the one of the readings [cm]."""


def entries(rows: PictureData) -> Iterator[Entry]:
    """Yield the pictures in the page's order."""
    for masked, end, without in ((False, "", ""), (True, "_masked", ", without codes for no echo")):
        for name, draw in (("in_order", one_by_one), ("histogram", histogram)):
            title = f"Readings at the longest range, {name.replace('_', ' ')}{without}"
            yield f"longest_range_{name}{end}", title, partial(draw, rows, masked)


@dataclass(frozen=True)
class _FixedRange:
    """Readings at a fixed true range, in order; of each whether it is a code for no echo."""

    true_range_cm: float
    reading_cm: Array
    missed: Flags

    @cached_property
    def distance_cm(self) -> Array:
        """The readings, NaN where one is no distance [cm]."""
        return np.where(self.missed, np.nan, self.reading_cm)

    @property
    def codes_cm(self) -> Array:
        return np.unique(self.reading_cm[self.missed & np.isfinite(self.reading_cm)])

    @property
    def caption(self) -> str:
        readings = f"{self.reading_cm.size:,} readings at {self.true_range_cm:g} cm"
        return f"{readings}, of which {100.0 * np.mean(self.missed):.2g} % are codes for no echo"

    @cached_property
    def limits_cm(self) -> tuple[float, float]:
        """Limits about the bulk of the distances and the true range [cm]; single ones far off do not count."""
        low, middle, high = np.nanquantile(self.distance_cm, [0.1, 0.5, 0.9])
        reach = max(3.0 * (high - low), 8.0)
        return min(middle - reach, self.true_range_cm - 3.0), max(middle + reach, self.true_range_cm + 3.0)

    @property
    def is_outside(self) -> Flags:
        """Which distances are beyond the limits of the picture."""
        low, high = self.limits_cm
        return np.asarray((self.distance_cm < low) | (self.distance_cm > high))

    def percent(self, count: int) -> str:
        """A count, and which share of all readings it is."""
        return f"{count:,} ({100.0 * count / self.reading_cm.size:.2g} %)"

    def note_outside(self, axes: Axes, x: float) -> None:
        """Write how many distances are beyond the limits."""
        if np.any(self.is_outside):
            note(axes, f"{self.percent(int(np.sum(self.is_outside)))} readings\nlie outside of this picture", x=x)


def _readings(rows: PictureData, masked: bool) -> _FixedRange:
    try:
        points = rows.of("maximum_range")
    except Absent as absent:
        raise Absent(f"{absent} It takes many readings of a large target at one long range.") from None
    true_cm = longest_range_cm(points)
    here = in_order(points, lambda point: point.true_range_cm) == true_cm
    reading_cm, echo = in_order(points, lambda point: point.reading_cm), in_order(points, lambda point: point.is_echo)
    fixed = _FixedRange(true_cm, reading_cm[here], ~echo[here])
    if masked and not np.any(np.isfinite(fixed.distance_cm)):
        raise Absent(f"All {fixed.reading_cm.size:,} readings at {true_cm:g} cm are codes for no echo.")
    if not np.any(np.isfinite(fixed.reading_cm)):
        raise Absent(f"None of the {fixed.reading_cm.size:,} pings at {true_cm:g} cm was answered.")
    return fixed


def one_by_one(rows: PictureData, masked: bool) -> Drawn:
    """Draw the readings in order, with or without (``masked``) codes for no echo."""
    fixed = _readings(rows, masked)
    figure, axes = new_axes(3.3, "reading, in order", "reading [cm]")
    number = np.arange(1.0, fixed.reading_cm.size + 1.0)
    # Thousands of dots would be a bar of one colour: let the ground shine through.
    axes.plot(number, fixed.distance_cm, ".", markersize=3, color=OURS, alpha=0.2 if masked else 1.0)
    axes.axhline(fixed.true_range_cm, color=REFERENCE, linestyle="--", label=f"true range, {fixed.true_range_cm:g} cm")
    if masked:
        axes.set_ylim(*fixed.limits_cm)
        fixed.note_outside(axes, 0.99)
        inside = np.flatnonzero(~fixed.is_outside & ~fixed.missed)
        # Means of a fiftieth of the readings each show a drift that single centimetres hide.
        if (each := inside.size // 50) >= 10:
            parts = inside[: each * 50].reshape(50, each)
            means = number[parts].mean(axis=1), fixed.reading_cm[parts].mean(axis=1)
            axes.plot(*means, color=INK, label=f"mean of {each} readings")
        axes.locator_params(axis="y", integer=True)
    else:
        for code_cm in fixed.codes_cm:
            here = number[fixed.reading_cm == code_cm]
            axes.plot(here, here * 0.0 + code_cm, "|", markersize=9, color=ORANGE, label="code for no echo")
            words = f"{code_cm:g} cm:\n{fixed.percent(here.size)}"
            axes.text(1.005, code_cm, words, transform=axes.get_yaxis_transform(), va="center", fontsize=7.5)
        axes.set_ylim(bottom=0.0)
    axes.set_xlim(0, number.size + 1)
    axes.xaxis.set_major_formatter("{x:,.0f}")
    return figure, f"{fixed.caption}{', left out here' if masked else ''}."


def histogram(rows: PictureData, masked: bool) -> Drawn:
    """Draw the histogram, with or without (``masked``) codes for no echo."""
    fixed, found = _readings(rows, masked), rows.findings.maximum_range
    figure, axes = new_axes(3.5, "reading [cm]", "readings" if masked else "readings (logarithmic)")
    words = f"true range, {fixed.true_range_cm:g} cm"
    axes.axvline(fixed.true_range_cm, color=REFERENCE, linestyle="--", label=words)
    distances_cm = to_step(fixed.distance_cm[np.isfinite(fixed.distance_cm)], 1.0)
    values, counts = np.unique(distances_cm, return_counts=True)
    axes.bar(values, counts, 0.86 if masked else 3.0, label=f"{distances_cm.size:,} readings", **BARS)
    caption = f"{fixed.caption}."
    if not masked:
        highest = max(counts.tolist(), default=1)
        for code_cm in fixed.codes_cm:
            count = int(np.sum(fixed.reading_cm == code_cm))
            axes.bar(code_cm, count, 5.0, color=ORANGE, label="code for no echo")
            label(axes, f"{code_cm:g} cm\n{fixed.percent(count)}", (code_cm, count), (0, 4), ha="center")
            highest = max(highest, count)
        right_cm = np.nanmax([*fixed.reading_cm, fixed.true_range_cm])
        axes.set(yscale="log", ylim=(0.7, 4.0 * highest), xlim=(0.0, 1.06 * right_cm))
        axes.yaxis.set_major_formatter("{x:,.0f}")
        if found is not None:
            peaks = ", ".join(f"{peak.reading_cm:g} cm ({100.0 * peak.share:.2g} %)" for peak in found.peaks_before)
            caption = (
                f"There {_are_peaks(len(found.peaks_before))}: {peaks}. {found.no_echo:,} readings of "
                f"{rows.model.maximum_cm} and {found.saturated:,} of 255 are missed echoes."
            )
        return figure, caption
    fixed.note_outside(axes, 0.01)
    if found is not None:
        caption = f"Without the codes there {_are_peaks(len(found.peaks_after))}, at {interval(found.peak)}."
    if rows.findings.mixture is not None:
        # About the range that the fit took it to be.
        fitted = densities(rows)
        expected = fitted.total * fixed.reading_cm.size
        half, words = Z * np.sqrt(expected), "fitted model, and 95 % of counts"
        intervals(axes, fitted.reading_cm, expected, [expected - half, expected + half], label=words)
        caption += " Circles: what the mixture, fitted about these hits' own mean, expects in each centimetre."
    earlier = rows.reference
    if abs(fixed.true_range_cm - earlier.peak_range_cm) < PEAK_RANGE_CM:
        words = f"{earlier.name}'s peak, {earlier.peak_cm:g} cm"
        axes.axvline(earlier.peak_cm, color=GREY, linestyle=":", label=words)
    axes.set(xlim=fixed.limits_cm)
    axes.set_ylim(bottom=0.0)
    axes.locator_params(axis="x", integer=True)
    return figure, caption


def _are_peaks(count: int) -> str:
    return f"{'is' if count == 1 else 'are'} {counted(count, 'peak')}"
