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
from msp_sim.page.style import GREEN, GREY, INK, REFERENCE, intervals, new_panels, shaded

LABEL_LETTERS, TITLE_LETTERS = 30, 18
"""Letters in a line of a row's words, and of a panel's title: more run into the next panel."""
VERDICTS: dict[str, dict[str, Any]] = {
    "matters": {"color": REFERENCE, "marker": "s", "markersize": 6},
    "does not matter": {"color": GREEN, "marker": "o", "markersize": 6},
    "cannot tell": {"color": GREY, "marker": "D", "markersize": 6, "markerfacecolor": "white"},
}
"""How an effect with a verdict is drawn."""

Row = tuple[float, FactorEffect, IntervalEstimate]
"""Height, and an effect with its estimate."""


def entries(rows: PictureData) -> list[Entry]:
    """The picture of all questions."""
    return [("questions", "The questions in one picture", partial(_forest, rows))]


def _label(question: Question) -> str:
    sensor = f", {question.sensor}" if question.sensor else ""
    lines = f"{EXPERIMENTS[question.name].short}{sensor}", question.compared
    return "\n".join(textwrap.fill(line, LABEL_LETTERS) for line in lines)


def _forest(rows: PictureData) -> Drawn:
    """Draw a row a question, from the top, a panel a metric."""
    questions = rows.findings.questions
    labels = [_label(question) for question in questions]
    # Rows as high as their words; y counts lines from the top.
    heights = np.array([max(label.count("\n") + 1, 2) for label in labels])
    middles = np.cumsum(heights) - heights / 2.0
    drawn: dict[str, list[Row]] = {metric: [] for metric in NAMES}
    for middle, question in zip(middles, questions, strict=True):
        for effect in question.effects:
            if effect.estimate is not None:
                drawn[effect.metric].append((middle, effect, effect.estimate))
    metrics = [metric for metric in NAMES if drawn[metric]]
    if not metrics:
        raise Absent("The data compare no two settings of the bench.")
    figure, panels = new_panels(1.4 + 0.19 * np.sum(heights), 1, len(metrics), sharey=True)
    for metric, axes in zip(metrics, panels, strict=True):
        _panel(axes, drawn[metric])
        unit = "difference [cm]" if metric == "bias" else "ratio"
        axes.set_title(textwrap.fill(f"{NAMES[metric]}, {unit}", TITLE_LETTERS))
    panels[0].set_ylim(np.sum(heights), 0.0)
    panels[0].set_yticks(middles, labels, fontsize=7.5)
    return figure, (
        "Each line is an effect with its 95 % interval; grey ground is what would be too small to matter, the black "
        "bars the smallest effect that these data would have shown in 80 % of cases. Verdicts are corrected for the "
        f"number of questions (Holm). Missed readings and outliers that change by less than {SHARE_BOUND:.0%} of all "
        "readings also count as too small, whatever their odds. No bars: unknown. An interval that reaches the edge "
        "is longer."
    )


def _panel(axes: Axes, rows: Sequence[Row]) -> None:
    """Every effect on one property of the readings."""
    is_ratio = rows[0][1].is_ratio
    _set_scale(axes, rows, is_ratio)
    axes.axvline(1.0 if is_ratio else 0.0, color=GREY)
    for y, effect, size in rows:
        small = effect.mirrored(effect.bound), effect.bound
        axes.fill_between(small, y - 0.8, y + 0.8, label="too small to matter", **shaded())
        if (least := effect.smallest_detectable) is not None:
            words = "smallest that these data show"
            axes.plot([least, effect.mirrored(least)], [y, y], "|", color=INK, markersize=14, label=words)
        ends, verdict = np.clip(size.ends, *axes.get_xlim()), effect.verdict
        intervals(axes, y, size.value, ends, across=True, capsize=0, label=verdict, **VERDICTS[verdict])


def _set_scale(axes: Axes, rows: Sequence[Row], is_ratio: bool) -> None:
    """Let the axis reach past values and bounds and, within reason, past intervals."""
    ends = [(size.value, effect.bound, *size.ends, effect.smallest_detectable) for _, effect, size in rows]
    sizes = np.array(ends, dtype=float)
    sizes = np.abs(np.log(sizes) if is_ratio else sizes)
    past = np.max(sizes[:, :2])
    least, most = (np.log(2.0), max(np.log(100.0), past)) if is_ratio else (0.0, 3.0 * past)
    reach = 1.15 * float(np.clip(np.max(sizes[np.isfinite(sizes)]), least, most))
    ticks = []
    if is_ratio:
        reach = math.exp(reach)
        step = next((each for each in (100.0, 10.0, 2.0) if each <= reach), 1.2)
        axes.set(xscale="log", xlim=(1.0 / reach, reach))
        ticks = [1.0 / step, 1.0, step]
    else:
        far = 6.0 * max(effect.bound for _, effect, _ in rows)
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
