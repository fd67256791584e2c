"""The questions (does it matter?) as a forest plot: size, interval, what would be small enough, what could be seen."""

import math
import textwrap
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from msp_lab.characterise.experiments import EXPERIMENTS
from msp_lab.characterise.findings import NAMES, FactorEffect, Question
from msp_lab.characterise.page.picture_data import PictureData
from msp_lab.characterise.questions import SHARE_BOUND
from msp_lab.estimates import IntervalEstimate
from msp_sim.page.page import Absent, Drawn, Entry
from msp_sim.page.style import GREEN, GREY, INK, REFERENCE, new_figure, shaded

LABEL_LETTERS, TITLE_LETTERS = 30, 18
"""Letters in a line of a row's words, and of a panel's title: more run into the next panel."""
VERDICTS = {
    "matters": (REFERENCE, "s", "full"),
    "does not matter": (GREEN, "o", "full"),
    "cannot tell": (GREY, "D", "none"),
}
"""Verdict -> colour, marker, and how the marker is filled."""

Row = tuple[float, FactorEffect, IntervalEstimate]
"""Height, and an effect with its estimate."""


def entries(rows: PictureData) -> list[Entry]:
    """The only picture."""
    return [("questions", "The questions in one picture", partial(_forest, rows))]


def _label(question: Question) -> str:
    sensor = f", {question.sensor}" if question.sensor else ""
    lines = f"{EXPERIMENTS[question.name].short}{sensor}", question.compared
    return "\n".join(textwrap.fill(line, LABEL_LETTERS) for line in lines)


def _forest(rows: PictureData) -> Drawn:
    """Draw a row a question, from the top, a panel a metric."""
    questions = rows.findings.questions
    labels = [_label(question) for question in questions]
    # Rows as high as their words; y counts lines from the bottom.
    tops = np.cumsum([0, *(max(label.count("\n") + 1, 2) for label in labels)])
    height = tops[-1]
    middles = height - (tops[:-1] + tops[1:]) / 2.0
    drawn = [
        (middle, effect, effect.estimate)
        for middle, each in zip(middles, questions, strict=True)
        for effect in each.effects
        if effect.estimate is not None
    ]
    if not drawn:
        raise Absent("The data compare no two settings of the bench.")
    metrics = [metric for metric in NAMES if any(effect.metric == metric for _, effect, _ in drawn)]
    figure = new_figure(1.4 + 0.19 * height)
    panels = figure.subplots(1, len(metrics), sharey=True, squeeze=False)[0]
    for metric, axes in zip(metrics, panels, strict=True):
        _panel(axes, [row for row in drawn if row[1].metric == metric])
        axes.set_ylim(0.0, height)
        unit = "difference [cm]" if metric == "bias" else "ratio"
        axes.set_title(textwrap.fill(f"{NAMES[metric]}, {unit}", TITLE_LETTERS))
        axes.grid(axis="y", visible=False)
        axes.spines["left"].set_visible(False)
        axes.tick_params(axis="y", length=0)
    first = panels[0]
    first.set_yticks(middles, labels, fontsize=7.5)
    for verdict, (colour, marker, fill) in VERDICTS.items():
        first.plot([], [], marker, color=colour, fillstyle=fill, markersize=6, label=verdict)
    first.fill_between([], [], [], label="too small to matter", **shaded())
    first.plot([], [], "|", color=INK, markersize=9, label="smallest that these data show")
    return figure, (
        "Each line is an effect with its 95 % interval; grey ground is what would be too small to matter, the black "
        "bars the smallest effect that these data would have shown in 80 % of cases. Verdicts are corrected for the "
        f"number of questions (Holm). Missed readings and outliers that change by less than {SHARE_BOUND:.0%} of all "
        "readings also count as too small, whatever their odds. No bars: unknown. An arrow: the interval is longer."
    )


def _panel(axes: Axes, rows: Sequence[Row]) -> None:
    """Every effect on one property of the readings."""
    is_ratio = rows[0][1].is_ratio
    _set_scale(axes, rows, is_ratio)
    left, right = axes.get_xlim()
    axes.axvline(1.0 if is_ratio else 0.0, color=GREY)
    for y, effect, size in rows:
        colour, marker, fill = VERDICTS[effect.verdict]
        axes.fill_between([effect.mirrored(effect.bound), effect.bound], y - 0.8, y + 0.8, **shaded())
        smallest = effect.smallest_detectable
        for edge in () if smallest is None else (smallest, effect.mirrored(smallest)):
            if left <= edge <= right:
                axes.vlines(edge, y - 0.7, y + 0.7, color=INK)
        low, high = size.ends
        axes.plot(np.clip([low, high], left, right), [y, y], color=colour)
        for value, points in ((low, 5), (high, 5), (size.value, 7)):
            if not left <= value <= right:
                edge, arrow = (left, "<") if value < left else (right, ">")
                axes.plot([edge], [y], marker=arrow, markersize=points, color=colour, clip_on=False)
        if left <= size.value <= right:
            look: dict[str, Any] = {"fillstyle": fill, "markerfacecolor": "white" if fill == "none" else colour}
            axes.plot([size.value], [y], marker=marker, color=colour, markersize=6, **look)


def _set_scale(axes: Axes, rows: Sequence[Row], is_ratio: bool) -> None:
    reach = _reach(rows, is_ratio)
    if is_ratio:
        axes.set_xscale("log")
        axes.set_xlim(1.0 / reach, reach)
        step = next((each for each in (100.0, 10.0, 2.0) if each <= reach), 1.2)
        ticks = [1.0 / step, 1.0, step]
    else:
        far = 6.0 * max(effect.bound for _, effect, _ in rows)
        ticks = []
        if reach > 2.0 * far:
            # One large effect would hide the small ones: to scale up to here, compressed beyond.
            axes.set_xscale("symlog", linthresh=far / 3.0, linscale=0.9)
            reach *= 1.3
            step = next(each for each in (100, 10, 5, 1) if each <= reach)
            ticks = [-step, *((-1, 0, 1) if step > 1 else (0,)), step]
        axes.set_xlim(-reach, reach)
    if ticks:
        axes.set_xticks(ticks)
        axes.set_xticks([], minor=True)
    axes.xaxis.set_major_formatter("{x:g}")


def _reach(rows: Sequence[Row], is_ratio: bool) -> float:
    """How far the axis goes to either side: past values and bounds and, within reason, past intervals."""
    ends = [(size.value, effect.bound, *size.ends, effect.smallest_detectable) for _, effect, size in rows]
    sizes = np.array(ends, dtype=float)
    sizes = np.abs(np.log(sizes) if is_ratio else sizes)
    least, most = (np.log(2.0), np.log(100.0)) if is_ratio else (0.0, 3.0 * np.max(sizes[:, :2]))
    reach = 1.15 * float(np.clip(np.max(sizes[np.isfinite(sizes)]), least, most))
    return math.exp(reach) if is_ratio else reach
