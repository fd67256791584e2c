"""The questions (does it matter?) as a forest plot: size, interval, what would be small enough, what could be seen."""

import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator

from msp_lab.characterise.point_findings import IntervalEstimate
from msp_lab.characterise.question_findings import FactorEffect
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


Estimated = tuple[FactorEffect, IntervalEstimate]
"""An effect and its estimate."""


def draw_questions(rows: Sequence[tuple[str, Sequence[Estimated]]]) -> Figure:
    """A row a question, a panel a metric.

    Parameters
    ----------
    rows
        Words at the left, and the effects that were estimated; at least one row, drawn from the top.
    """
    metrics = [metric for metric in METRICS if any(effect.metric == metric for _, row in rows for effect, _ in row)]
    labels = ["\n".join(textwrap.fill(line, LABEL_LETTERS) for line in label.splitlines()) for label, _ in rows]
    lines = [max(label.count("\n") + 1, 2) for label in labels]
    # Rows as high as their words; y counts lines from the bottom.
    tops = np.cumsum([0, *lines])
    middles = [float(tops[-1] - tops[i] - lines[i] / 2.0) for i in range(len(rows))]
    figure = new_figure(1.4 + 0.19 * float(tops[-1]))
    panels = figure.subplots(1, len(metrics), sharey=True, squeeze=False)[0]
    for metric, axes in zip(metrics, panels, strict=True):
        effects = [
            (middle, (effect, estimate))
            for middle, (_, row) in zip(middles, rows, strict=True)
            for effect, estimate in row
            if effect.metric == metric
        ]
        _panel(axes, metric, effects, float(tops[-1]))
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


def _panel(axes: Axes, metric: str, effects: Sequence[tuple[float, Estimated]], height: float) -> None:
    is_ratio = metric != "bias"
    none = 1.0 if is_ratio else 0.0
    reach = _reach([each for _, each in effects], is_ratio)
    if is_ratio:
        axes.set_xscale("log")
        axes.set_xlim(1.0 / reach, reach)
        step = next((each for each in (100.0, 10.0, 2.0) if each <= reach), 1.2)
        axes.xaxis.set_major_locator(FixedLocator([1.0 / step, 1.0, step]))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.xaxis.set_major_formatter("{x:g}")
    else:
        far = 6.0 * max([effect.bound for _, (effect, _) in effects])
        if reach > 2.0 * far:
            # One large effect would hide the small ones: to scale up to here, compressed beyond.
            axes.set_xscale("symlog", linthresh=far / 3.0, linscale=0.9)
            reach *= 1.3
            step = next(each for each in (100, 10, 5, 1) if each <= reach)
            ticks = [-step, *((-1, 0, 1) if step > 1 else (0,)), step]
            axes.xaxis.set_major_locator(FixedLocator(ticks))
            axes.xaxis.set_minor_locator(NullLocator())
        axes.set_xlim(-reach, reach)
        axes.xaxis.set_major_formatter("{x:g}")
    left, right = axes.get_xlim()
    axes.axvline(none, color=GREY, linewidth=1.0, zorder=1)
    for y, (effect, size) in effects:
        colour, marker, fill = VERDICTS[effect.verdict]
        low_bound = 1.0 / effect.bound if is_ratio else -effect.bound
        axes.fill_between([low_bound, effect.bound], y - 0.8, y + 0.8, color=PALE, alpha=0.8, linewidth=0, zorder=0)
        smallest = effect.smallest_detectable
        if smallest is not None:
            for edge in (smallest, 1.0 / smallest if is_ratio else -smallest):
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


def _reach(effects: Sequence[Estimated], is_ratio: bool) -> float:
    """How far the axis goes to either side: past values and bounds and, within reason, past intervals."""
    near = [each for effect, size in effects for each in (size.value, effect.bound)]
    others = [each for effect, size in effects for each in (size.low, size.high, effect.smallest_detectable)]
    ends = [each for each in others if each is not None]
    if not is_ratio:
        far = [abs(each) for each in near]
        return 1.15 * float(min(max([*far, *map(abs, ends)]), 3.0 * max(far)))
    limit = max([*(abs(np.log(each)) for each in near if each > 0.0), np.log(2.0)])
    logs = [abs(np.log(each)) for each in ends if each > 0.0 and np.isfinite(each)]
    return float(np.exp(1.15 * min(max([limit, *logs]), np.log(100.0))))
