"""Pictures of many readings at the longest range: in the order in which they came, and how often each was read."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from msp_lab.characterise.estimates import Z
from msp_lab.characterise.page.picture_data import Absent, Drawn, Entry, PictureData
from msp_lab.characterise.page.text import counted, interval
from msp_range.arrays import Array, Flags
from msp_range.reading_model.mixture import ReadingModel
from msp_sim.page.style import BARS, DOTS, GREY, INK, ORANGE, OURS, REFERENCE, label, legend_below, new_axes, note

PEAK_RANGE_CM = 1.0
"""A reference's peak is marked where its true range is this near to the one of the readings [cm]."""


def entries(rows: PictureData) -> Iterator[Entry]:
    """Yield the pictures in the page's order."""
    for masked in (False, True):
        without = ", without codes for no echo" if masked else ""
        end = "_masked" if masked else ""
        for name, title, draw in (("in_order", "in order", in_order), ("histogram", "histogram", histogram)):
            title = f"Readings at the longest range, {title}{without}"
            yield f"longest_range_{name}{end}", title, partial(draw, masked=masked)


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

    @cached_property
    def codes(self) -> list[tuple[float, Array]]:
        """Codes for no echo [cm], and the numbers of the readings that are one."""
        found = np.unique(self.reading_cm[self.missed & np.isfinite(self.reading_cm)]).tolist()
        return [(code, _numbers(self.missed & (self.reading_cm == code))) for code in found]

    @cached_property
    def limits_cm(self) -> tuple[float, float]:
        """Limits about the bulk of the distances and the true range [cm]; single ones far off do not count."""
        low, middle, high = np.nanquantile(self.distance_cm, [0.1, 0.5, 0.9]).tolist()
        reach = max(3.0 * (high - low), 8.0)
        return min(middle - reach, self.true_range_cm - 3.0), max(middle + reach, self.true_range_cm + 3.0)

    @cached_property
    def inside(self) -> Flags:
        """Which distances are within the limits."""
        low, high = self.limits_cm
        return np.asarray((self.distance_cm >= low) & (self.distance_cm <= high))

    @property
    def outside(self) -> int:
        """How many distances are not within the limits."""
        return int(np.count_nonzero(np.isfinite(self.distance_cm)) - np.count_nonzero(self.inside))

    @property
    def missed_percent(self) -> float:
        """Share of the readings that are codes for no echo, or no answer."""
        return 100.0 * np.count_nonzero(self.missed) / self.reading_cm.size


def _numbers(chosen: Flags) -> Array:
    """Numbers of the readings that are chosen, from 1 on."""
    return np.flatnonzero(chosen).astype(np.float64) + 1.0


def _readings(rows: PictureData, masked: bool) -> _FixedRange:
    try:
        found = rows.of("maximum_range")
    except Absent as absent:
        raise Absent(f"{absent} It takes many readings of a large target at one long range.") from None
    ranges, counts = np.unique(rows.true_cm[found], return_counts=True)
    # Of several long ranges the one with the most readings, and of equal ones the longest.
    best = float(ranges[np.lexsort((ranges, counts))[-1]])
    chosen = found & (rows.true_cm == best)
    fixed = _FixedRange(best, rows.reading_cm[chosen], rows.missed[chosen])
    if masked and not np.any(np.isfinite(fixed.distance_cm)):
        raise Absent(f"All {fixed.reading_cm.size:,} readings at {best:g} cm are codes for no echo.")
    if not np.any(np.isfinite(fixed.reading_cm)):
        raise Absent(f"None of the {fixed.reading_cm.size:,} pings at {best:g} cm was answered.")
    return fixed


def in_order(rows: PictureData, masked: bool) -> Drawn:
    """Draw the readings in order, with or without (``masked``) codes for no echo."""
    fixed = _readings(rows, masked)
    caption = f"{fixed.reading_cm.size:,} readings at {fixed.true_range_cm:g} cm"
    left_out = ", left out here" if masked else ""
    caption += f", of which {fixed.missed_percent:.2g} % are codes for no echo{left_out}."
    alternative = "Readings at the longest range in the order in which they came."
    return Drawn(_draw_in_order(fixed, masked), caption, alternative)


def _draw_in_order(fixed: _FixedRange, masked: bool) -> Figure:
    figure, axes = new_axes(3.3, "reading, in order", "reading [cm]")
    number = np.arange(1.0, fixed.reading_cm.size + 1.0)
    # Thousands of dots would be a bar of one colour: let the ground shine through.
    alpha = min(1.0, max(0.08, 2000.0 / number.size)) if masked else 1.0
    look: dict[str, Any] = {"markeredgewidth": 0, "color": OURS, "alpha": alpha}
    axes.plot(number, fixed.distance_cm, "o", markersize=2.2 if masked else 1.8, **look)
    axes.axhline(fixed.true_range_cm, color=REFERENCE, linestyle="--")
    handles = axes.plot([], [], "o", color=OURS, markersize=4, label="reading")
    handles += axes.plot([], [], "--", color=REFERENCE, label=f"true range, {fixed.true_range_cm:g} cm")
    if masked:
        axes.set_ylim(*fixed.limits_cm)
        if fixed.outside:
            percent = 100 * fixed.outside / np.count_nonzero(np.isfinite(fixed.distance_cm))
            note(axes, f"{fixed.outside} readings ({percent:.2g} %) lie outside of this picture")
        handles += _running_mean(axes, _numbers(fixed.inside), fixed.reading_cm[fixed.inside])
        axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    else:
        for code, where in fixed.codes:
            axes.plot(where, np.full(where.size, code), "|", markersize=9, color=ORANGE)
            words = f"{code:g} cm:\n{where.size} ({100.0 * where.size / number.size:.2g} %)"
            beyond = axes.get_yaxis_transform()
            axes.text(1.005, code, words, transform=beyond, va="center", fontsize=7.5, color=INK)
        if fixed.codes:
            handles += axes.plot([], [], "|", color=ORANGE, markersize=9, label="code for no echo")
        axes.set_ylim(bottom=0.0)
    axes.set_xlim(0, number.size + 1)
    axes.xaxis.set_major_formatter("{x:,.0f}")
    return legend_below(figure, handles)


def _running_mean(axes: Axes, number: Array, reading_cm: Array) -> list[Any]:
    """Means of a fiftieth of the readings each, which show a drift that single centimetres hide."""
    each = number.size // 50
    if each < 10:
        return []
    x, y = (column[: each * 50].reshape(50, each).mean(axis=1) for column in (number, reading_cm))
    return axes.plot(x, y, "-", color=INK, label=f"mean of {each} readings")


def histogram(rows: PictureData, masked: bool) -> Drawn:
    """Draw the histogram, with or without (``masked``) codes for no echo."""
    fixed, found = _readings(rows, masked), rows.findings.maximum_range
    has_fit = masked and rows.findings.mixture is not None
    if found is None:
        caption = f"{fixed.reading_cm.size:,} readings at {fixed.true_range_cm:g} cm, "
        caption += f"{fixed.missed_percent:.2g} % codes for no echo."
    elif masked:
        caption = f"Without the codes there {_are_peaks(len(found.peaks_after))}, at {interval(found.peak)}."
        if has_fit:
            caption += " Circles: what the mixture, fitted about these hits' own mean, expects in each centimetre."
    else:
        peaks = ", ".join(f"{peak.reading_cm:g} cm ({100.0 * peak.share:.2g} %)" for peak in found.peaks_before)
        caption = (
            f"There {_are_peaks(len(found.peaks_before))}: {peaks}. {found.no_echo:,} readings of "
            f"{rows.model.maximum_cm} and {found.saturated:,} of 255 are missed echoes."
        )
    figure, axes = new_axes(3.5, "reading [cm]", "readings" if masked else "readings (logarithmic)")
    if masked:
        _draw_bulk(axes, fixed, _probabilities(rows, fixed.true_range_cm) if has_fit else None)
    else:
        _draw_all(axes, fixed)
    words = f"true range, {fixed.true_range_cm:g} cm"
    axes.axvline(fixed.true_range_cm, color=REFERENCE, linestyle="--", label=words)
    earlier = rows.reference
    if masked and earlier is not None and abs(fixed.true_range_cm - earlier.peak_range_cm) < PEAK_RANGE_CM:
        words = f"{earlier.name}'s peak, {earlier.peak_cm:g} cm"
        axes.axvline(earlier.peak_cm, color=GREY, linestyle=":", label=words)
    axes.grid(axis="x", visible=False)
    return Drawn(legend_below(figure), caption, "How often each centimetre was read at the longest range.")


def _are_peaks(count: int) -> str:
    return f"{'is' if count == 1 else 'are'} {counted(count, 'peak')}"


def _draw_bulk(axes: Axes, fixed: _FixedRange, fitted: Array | None) -> None:
    """How often each distance was read, and of a fitted model the probabilities of the readings 0, 1, 2 ... cm."""
    distances_cm = fixed.distance_cm[np.isfinite(fixed.distance_cm)]
    words = f"{distances_cm.size:,} readings"
    axes.bar(*np.unique(distances_cm, return_counts=True), width=0.86, label=words, **BARS)
    low, high = fixed.limits_cm
    if fitted is not None:
        k = np.arange(int(np.ceil(low)), int(np.floor(high)) + 1)
        k = k[(k >= 0) & (k < fitted.size)]
        expected = fitted[k] * fixed.reading_cm.size
        half, words = Z * np.sqrt(np.maximum(expected, 0.0)), "fitted model, and 95 % of counts"
        axes.errorbar(k, expected, yerr=half, label=words, **DOTS)
    axes.set_xlim(low, high)
    axes.set_ylim(bottom=0.0)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    if fixed.outside:
        note(axes, f"{fixed.outside} readings\noutside of this picture", x=0.01)


def _draw_all(axes: Axes, fixed: _FixedRange) -> None:
    """How often each answer was read, codes too, on a logarithmic scale."""
    answers_cm = fixed.reading_cm[np.isfinite(fixed.reading_cm)]
    values, counts = np.unique(answers_cm, return_counts=True)
    is_code = np.isin(values, [code for code, _ in fixed.codes])
    axes.bar(values[~is_code], counts[~is_code], width=3.0, color=OURS, label="readings")
    axes.bar(values[is_code], counts[is_code], width=5.0, color=ORANGE, label="code for no echo")
    axes.set_xlim(0.0, 1.06 * max(float(np.max(values)), fixed.true_range_cm))
    axes.set_yscale("log")
    axes.set_ylim(0.7, float(np.max(counts)) * 4.0)
    axes.yaxis.set_major_formatter(lambda tick, _: f"{tick:,.0f}" if tick >= 1 else "")
    for value, count in zip(values[is_code].tolist(), counts[is_code].tolist(), strict=True):
        words = f"{value:g} cm\n{count} ({100.0 * count / answers_cm.size:.2g} %)"
        label(axes, words, (value, count), (0, 4), ha="center")


def _probabilities(rows: PictureData, true_cm: float) -> Array:
    """Probability of each reading from 0 cm on by the fitted model, about the range that the fit took it to be."""
    expected_cm = float(np.mean(rows.apparent_cm[rows.of("maximum_range") & (rows.true_cm == true_cm)]))
    expected_cm += rows.placement_error_cm("maximum_range", true_cm)
    readings = np.arange(0.0, rows.model.maximum_cm + 1.0)
    model = ReadingModel.of(rows.model)
    return np.exp(model.log_prob(readings, {"true_range_cm": np.full(readings.size, expected_cm)}))
