"""The questions (does it matter?) as a forest plot: size, interval, what would be small enough, what could be seen."""

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from msp_sim.page.style import GREEN, GREY, INK, PALE, REFERENCE, legend_below, new_figure

METRICS = {
    "bias": "mean error,\ndifference [cm]",
    "spread": "spread,\nratio",
    "missed": "missed,\nodds ratio",
    "outliers": "outliers,\nodds ratio",
}
"""Metric -> heading of its panel; all but the first are ratios, where 1 is no effect."""

LABEL_LETTERS = 30
"""Letters in a line of a row's words: the panels need the rest of the width."""

VERDICTS = {
    "matters": (REFERENCE, "s", "full"),
    "does not matter": (GREEN, "o", "full"),
    "cannot tell": (GREY, "D", "none"),
}


@dataclass(frozen=True)
class Size:
    """One effect: `low` and `high` None where the data give no end, `detectable` None where it is not known."""

    metric: str
    value: float
    low: float | None
    high: float | None
    bound: float
    detectable: float | None
    verdict: str


@dataclass(frozen=True)
class ForestRow:
    """A question: its words at the left, and the effects that were estimated."""

    label: str
    sizes: Sequence[Size]


def draw_questions(rows: Sequence[ForestRow]) -> Figure:
    """A row a question, a panel a metric.

    Parameters
    ----------
    rows
        At least one; drawn from the top.
    """
    metrics = [metric for metric in METRICS if any(size.metric == metric for row in rows for size in row.sizes)]
    labels = ["\n".join(textwrap.fill(line, LABEL_LETTERS) for line in row.label.splitlines()) for row in rows]
    lines = [max(label.count("\n") + 1, 2) for label in labels]
    # Rows as high as their words; y counts lines from the bottom.
    tops = np.cumsum([0, *lines])
    middles = [float(tops[-1] - tops[i] - lines[i] / 2.0) for i in range(len(rows))]
    figure = new_figure(1.4 + 0.19 * float(tops[-1]))
    panels = figure.subplots(1, len(metrics), sharey=True, squeeze=False)[0]
    for metric, axes in zip(metrics, panels, strict=True):
        sizes = [
            (middle, size)
            for middle, row in zip(middles, rows, strict=True)
            for size in row.sizes
            if size.metric == metric
        ]
        _panel(axes, metric, sizes, float(tops[-1]))
    panels[0].set_yticks(middles, labels, fontsize=7.5)
    for axes in panels:
        axes.tick_params(axis="y", length=0)
    handles = [
        panels[0].plot([], [], marker, color=colour, fillstyle=fill, markersize=6, label=verdict)[0]
        for verdict, (colour, marker, fill) in VERDICTS.items()
    ]
    handles += [
        panels[0].fill_between([], [], [], color=PALE, alpha=0.8, linewidth=0, label="too small to matter"),
        panels[0].plot(
            [], [], "|", color=INK, markersize=9, markeredgewidth=1.2, label="smallest that these data show"
        )[0],
    ]
    legend_below(figure, handles)
    return figure


def _panel(axes: Axes, metric: str, sizes: Sequence[tuple[float, Size]], height: float) -> None:
    is_ratio = metric != "bias"
    none = 1.0 if is_ratio else 0.0
    reach = _reach([size for _, size in sizes], is_ratio)
    if is_ratio:
        axes.set_xscale("log")
        axes.set_xlim(1.0 / reach, reach)
        step = next((each for each in (100.0, 10.0, 2.0) if each <= reach), 1.2)
        axes.xaxis.set_major_locator(FixedLocator([1.0 / step, 1.0, step]))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.xaxis.set_major_formatter(FuncFormatter(lambda tick, _: f"{tick:g}"))
    else:
        far = 6.0 * max([size.bound for _, size in sizes])
        if reach > 2.0 * far:
            # One large effect would hide the small ones: to scale up to here, compressed beyond.
            axes.set_xscale("symlog", linthresh=far / 3.0, linscale=0.9)
            reach *= 1.3
            step = next(each for each in (100, 10, 5, 1) if each <= reach)
            ticks = [-step, *((-1, 0, 1) if step > 1 else (0,)), step]
            axes.xaxis.set_major_locator(FixedLocator(ticks))
            axes.xaxis.set_minor_locator(NullLocator())
        axes.set_xlim(-reach, reach)
        axes.xaxis.set_major_formatter(FuncFormatter(lambda tick, _: f"{tick:g}".replace("-", "−")))
    left, right = axes.get_xlim()
    axes.axvline(none, color=GREY, linewidth=1.0, zorder=1)
    for y, size in sizes:
        colour, marker, fill = VERDICTS[size.verdict]
        low_bound = 1.0 / size.bound if is_ratio else -size.bound
        axes.fill_between([low_bound, size.bound], y - 0.8, y + 0.8, color=PALE, alpha=0.8, linewidth=0, zorder=0)
        if size.detectable is not None:
            other = 1.0 / size.detectable if is_ratio else -size.detectable
            for edge in (size.detectable, other):
                if left <= edge <= right:
                    axes.vlines(edge, y - 0.7, y + 0.7, color=INK, linewidth=1.1, zorder=2)
        low = left if size.low is None else max(size.low, left)
        high = right if size.high is None else min(size.high, right)
        axes.plot([low, high], [y, y], color=colour, linewidth=1.6, zorder=3)
        for edge, end, arrow in ((left, size.low, "<"), (right, size.high, ">")):
            if end is None or (arrow == "<" and end < left) or (arrow == ">" and end > right):
                axes.plot([edge], [y], marker=arrow, color=colour, markersize=5, clip_on=False, zorder=4)
        if not left <= size.value <= right:
            axes.plot(
                [left if size.value < left else right],
                [y],
                marker="<" if size.value < left else ">",
                color=colour,
                markersize=7,
                clip_on=False,
                zorder=5,
            )
        else:
            axes.plot(
                [size.value],
                [y],
                marker=marker,
                color=colour,
                fillstyle=fill,
                markersize=6,
                zorder=5,
                markerfacecolor="white" if fill == "none" else colour,
            )
    axes.set_ylim(0.0, height)
    axes.set_title(METRICS[metric], fontsize=8.5)
    axes.grid(axis="y", visible=False)
    axes.spines["left"].set_visible(False)


def _reach(sizes: Sequence[Size], is_ratio: bool) -> float:
    """How far the axis goes to either side: past values and bounds and, within reason, past intervals."""
    if is_ratio:
        far = [abs(np.log(each)) for size in sizes for each in (size.value, size.bound) if each and each > 0.0]
        ends = [
            abs(np.log(each))
            for size in sizes
            for each in (size.low, size.high, size.detectable)
            if each is not None and each > 0.0 and np.isfinite(each)
        ]
        limit = max([*far, np.log(2.0)])
        return float(np.exp(1.15 * min(max([limit, *ends]), np.log(100.0))))
    far = [abs(each) for size in sizes for each in (size.value, size.bound)]
    ends = [abs(each) for size in sizes for each in (size.low, size.high, size.detectable) if each is not None]
    return 1.15 * float(min(max([*far, *ends]), 3.0 * max(far)))
