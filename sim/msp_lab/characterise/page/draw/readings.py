"""Many readings at one range: in the order in which they came, and how often each was read."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from msp_lab.characterise.estimates import Z
from msp_range.arrays import Array, Flags
from msp_sim.page.style import DOTS, GREY, INK, ORANGE, OURS, REFERENCE, legend_below, new_figure, note


@dataclass(frozen=True)
class FixedRange:
    """Readings at a fixed true range, in order."""

    true_range_cm: float
    """Where the target was [cm]."""
    reading_cm: Array
    """What was read [cm], shape (n,); NaN: no answer."""
    missed: Flags
    """Which readings are codes for no echo, shape (n,)."""

    @property
    def kept_cm(self) -> Array:
        """The readings that are a distance [cm]."""
        return self.reading_cm[~self.missed & np.isfinite(self.reading_cm)]


def draw_in_order(fixed: FixedRange, masked: bool) -> Figure:
    """Readings over their number; the codes for no echo in another colour, or left out (4.5 and 4.7)."""
    figure = new_figure(3.3)
    axes = figure.subplots()
    number = np.arange(1.0, fixed.reading_cm.size + 1.0)
    echoes = ~fixed.missed & np.isfinite(fixed.reading_cm)
    # Thousands of dots would be a bar of one colour: let the ground shine through.
    alpha = min(1.0, max(0.08, 2000.0 / number.size)) if masked else 1.0
    size = 2.2 if masked else 1.8
    look: dict[str, Any] = {"markersize": size, "markeredgewidth": 0, "color": OURS, "alpha": alpha, "zorder": 3}
    axes.plot(number[echoes], fixed.reading_cm[echoes], "o", **look)
    axes.axhline(fixed.true_range_cm, color=REFERENCE, linestyle="--", linewidth=1.1, zorder=4)
    handles = [
        axes.plot([], [], "o", color=OURS, markersize=4, label="reading")[0],
        axes.plot([], [], "--", color=REFERENCE, label=f"true range, {fixed.true_range_cm:g} cm")[0],
    ]
    if masked:
        low, high = _core_limits_cm(fixed)
        axes.set_ylim(low, high)
        outside = np.count_nonzero((fixed.kept_cm < low) | (fixed.kept_cm > high))
        if outside:
            note(axes, f"{outside} readings ({100 * outside / fixed.kept_cm.size:.2g} %) lie outside of this picture")
        inside = echoes & (fixed.reading_cm >= low) & (fixed.reading_cm <= high)
        handles += _running_mean(axes, number[inside], fixed.reading_cm[inside])
        axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    else:
        codes = [(code, number[fixed.missed & (fixed.reading_cm == code)]) for code in _codes(fixed)]
        for code, where in codes:
            axes.plot(where, np.full(where.size, code), "|", markersize=9, color=ORANGE, zorder=3)
            share = 100.0 * where.size / number.size
            axes.text(
                1.005,
                code,
                f"{code:g} cm:\n{where.size} ({share:.2g} %)",
                transform=axes.get_yaxis_transform(),
                va="center",
                fontsize=7.5,
                color=INK,
            )
        if codes:
            handles.append(axes.plot([], [], "|", color=ORANGE, markersize=9, label="code for no echo")[0])
        axes.set_ylim(bottom=0.0)
    axes.set_xlim(0, number.size + 1)
    axes.set_xlabel("reading, in order")
    axes.set_ylabel("reading [cm]")
    axes.xaxis.set_major_formatter("{x:,.0f}")
    legend_below(figure, handles)
    return figure


def draw_histogram(
    fixed: FixedRange, masked: bool, fitted: Array | None = None, reference: tuple[str, float] | None = None
) -> Figure:
    """How often each whole centimetre was read; with a logarithmic scale where the codes are in it.

    Parameters
    ----------
    fixed
        Readings.
    masked
        Leave out the codes for no echo.
    fitted
        Probabilities of the readings 0, 1, 2 ... cm by a fitted model, or None.
    reference
        Who found the peak where before [cm], or None.
    """
    figure = new_figure(3.5)
    axes = figure.subplots()
    readings = fixed.kept_cm if masked else fixed.reading_cm[np.isfinite(fixed.reading_cm)]
    values, counts = np.unique(readings, return_counts=True)
    if masked:
        low, high = _core_limits_cm(fixed)
        axes.bar(values, counts, width=0.86, color=OURS, alpha=0.75, label=f"{readings.size:,} readings", zorder=2)
        if fitted is not None:
            k = np.arange(int(np.ceil(low)), int(np.floor(high)) + 1)
            k = k[(k >= 0) & (k < fitted.size)]
            expected = fitted[k] * fixed.reading_cm.size
            band = Z * np.sqrt(np.maximum(expected, 0.0))
            label = "fitted model, and 95 % of counts"
            axes.errorbar(k, expected, yerr=band, label=label, **DOTS | {"markersize": 4})
        axes.set_xlim(low, high)
        axes.set_ylim(bottom=0.0)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        outside = np.count_nonzero((readings < low) | (readings > high))
        if outside:
            note(axes, f"{outside} readings\noutside of this picture", x=0.01)
    else:
        codes = _codes(fixed)
        is_code = np.isin(values, codes)
        axes.bar(values[~is_code], counts[~is_code], width=3.0, color=OURS, label="readings", zorder=2)
        axes.bar(values[is_code], counts[is_code], width=5.0, color=ORANGE, label="code for no echo", zorder=3)
        axes.set_xlim(0.0, 1.06 * max(float(np.max(values)), fixed.true_range_cm))
        axes.set_yscale("log")
        axes.set_ylim(0.7, float(np.max(counts)) * 4.0)
        axes.yaxis.set_major_formatter(lambda tick, _: f"{tick:,.0f}" if tick >= 1 else "")
        for value, count in zip(values[is_code].tolist(), counts[is_code].tolist(), strict=True):
            axes.annotate(
                f"{value:g} cm\n{count} ({100.0 * count / readings.size:.2g} %)",
                (value, count),
                xytext=(0, 4),
                textcoords="offset points",
                ha="center",
                fontsize=7.5,
                color=INK,
            )
    axes.axvline(
        fixed.true_range_cm, color=REFERENCE, linestyle="--", label=f"true range, {fixed.true_range_cm:g} cm", zorder=4
    )
    if masked and reference is not None:
        name, peak_cm = reference
        axes.axvline(peak_cm, color=GREY, linestyle=":", label=f"{name}'s peak, {peak_cm:g} cm", zorder=4)
    axes.set_xlabel("reading [cm]")
    axes.set_ylabel("readings" if masked else "readings (logarithmic)")
    axes.grid(axis="x", visible=False)
    legend_below(figure)
    return figure


def _running_mean(axes: Axes, number: Array, reading_cm: Array) -> list[Any]:
    """Means of a fiftieth of the readings each, which show a drift that single centimetres hide."""
    each = number.size // 50
    if each < 10:
        return []
    ends = each * 50
    x, y = (column[:ends].reshape(50, each).mean(axis=1) for column in (number, reading_cm))
    return axes.plot(x, y, "-", color=INK, linewidth=1.2, zorder=5, label=f"mean of {each} readings")


def _codes(fixed: FixedRange) -> list[float]:
    return [float(code) for code in np.unique(fixed.reading_cm[fixed.missed]) if np.isfinite(code)]


def _core_limits_cm(fixed: FixedRange) -> tuple[float, float]:
    """Limits about the bulk of the readings and the true range [cm]; single ones far off do not count."""
    if not fixed.kept_cm.size:
        return fixed.true_range_cm - 10.0, fixed.true_range_cm + 10.0
    low, middle, high = np.quantile(fixed.kept_cm, [0.1, 0.5, 0.9]).tolist()
    reach = max(3.0 * (high - low), 8.0)
    return min(middle - reach, fixed.true_range_cm - 3.0), max(middle + reach, fixed.true_range_cm + 3.0)
