"""Draw many flights: the distribution of their errors, how often something happened, and the worst ones."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from msp_sim.intervals import quantile
from msp_sim.monte_carlo.store import NUMBER, Row
from msp_sim.monte_carlo.summary import Summary
from msp_sim.page.style import DOTS, GREY, OURS, REFERENCE, label, new_figure, save, shaded, style

STEPS = 99
"""Shares for which the interval of the distribution is drawn; more are not seen."""


@style()
def draw(rows: Sequence[Row], summary: Summary, path: Path, title: str) -> None:
    """Write the picture as PNG; an older file is replaced."""
    figure = new_figure(2.0 + 0.35 * len(summary.shares) + 4.4)
    heights = [2.2, 0.35 * len(summary.shares) + 0.3, 2.2] if summary.shares else [2.2, 2.2]
    axes = figure.subplots(len(heights), 1, squeeze=False, height_ratios=heights)[:, 0]
    figure.suptitle(title, x=0.01, ha="left", fontsize=10.0)
    _draw_distribution(axes[0], [row["error_p95_cm"] for row in rows if row["error_p95_cm"] is not None])
    if summary.shares:
        _draw_shares(axes[1], summary)
    _draw_flights(axes[-1], rows, summary)
    save(figure, path)


def _draw_distribution(axes: Axes, p95_cm: Sequence[float]) -> None:
    """Share of the flights up to each error, with the 95 % interval of each quantile."""
    axes.set_title("errors: share of the flights in which 95 % of the errors are below")
    axes.set_xlabel("95 % of a flight's errors are below [cm]")
    axes.set_ylabel("share of flights")
    axes.set_ylim(0.0, 1.0)
    if not p95_cm:
        return
    shares = np.arange(1, STEPS + 1) / (STEPS + 1)
    found = [quantile(p95_cm, float(share)) for share in shares]
    least, most = min(p95_cm), max(p95_cm)
    low = [least if each[1] is None else each[1] for each in found]
    high = [most if each[2] is None else each[2] for each in found]
    axes.fill_betweenx(shares, low, high, label="95 % interval", **shaded())
    ranked = np.sort(p95_cm)
    axes.step(ranked, np.arange(1, ranked.size + 1) / ranked.size, where="post", color=OURS, label="flights")
    axes.set_xlim(left=0.0)
    axes.legend(loc="lower right")


def _draw_shares(axes: Axes, summary: Summary) -> None:
    """How often something happened, with Wilson's interval."""
    axes.set_title("share of the flights with ...")
    axes.grid(visible=False, axis="y")
    for i, share in enumerate(summary.shares):
        value = share.flights / share.of if share.of else 0.0
        axes.errorbar(value, i, xerr=[[value - share.low], [share.high - value]], **DOTS)
        label(axes, share.what, (0.0, i), (6, 5))
    axes.set_yticks([])
    axes.set_ylim(len(summary.shares) - 0.5, -0.8)
    axes.set_xlim(left=0.0)


def _draw_flights(axes: Axes, rows: Sequence[Row], summary: Summary) -> None:
    """Each flight by its errors and its longest silence; the worst with their numbers."""
    axes.set_title("each flight, the worst with their numbers")
    axes.set_xlabel("95 % of the errors are below [cm]")
    axes.set_ylabel("longest silence [s]")
    worst = {row[NUMBER] for row in summary.worst}
    for row in rows:
        if row["error_p95_cm"] is None:
            continue
        colour = REFERENCE if row[NUMBER] in worst else GREY
        place = row["error_p95_cm"], row["longest_silence_s"] or 0.0
        axes.plot(*place, ".", color=colour, markersize=5 if row[NUMBER] in worst else 3)
        if row[NUMBER] in worst:
            label(axes, str(row[NUMBER]), place, (4, 3))
