"""Draw many flights: the distribution of their errors, how often something happened, and the worst ones."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from msp_sim.intervals import quantile
from msp_sim.monte_carlo.store import NUMBER, Row
from msp_sim.monte_carlo.summary import Summary
from msp_sim.page.style import GREY, OURS, REFERENCE, intervals, label, new_panels, save, shaded, style

STEPS = 99
"""Number of shares for which the interval of the distribution is drawn; more make no visible difference."""


@style()
def draw(rows: Sequence[Row], summary: Summary, path: Path, title: str) -> None:
    """Write the picture as PNG; an older file is replaced."""
    heights = [2.2, *([0.35 * len(summary.shares) + 0.3] if summary.shares else []), 2.2]
    figure, panels = new_panels(2.0 + sum(heights), len(heights), height_ratios=heights)
    figure.suptitle(title, x=0.01, ha="left", fontsize=10.0)
    _draw_distribution(panels[0], [row["error_p95_cm"] for row in rows if row["error_p95_cm"] is not None])
    if summary.shares:
        _draw_shares(panels[1], summary)
    _draw_flights(panels[-1], rows, summary)
    save(figure, path)


def _draw_distribution(axes: Axes, p95_cm: Sequence[float]) -> None:
    """Share of the flights up to each error, with the 95 % interval of each quantile."""
    axes.set_title("errors: share of the flights in which 95 % of the errors are below")
    axes.set(xlabel="95 % of a flight's errors are below [cm]", ylabel="share of flights", ylim=(0.0, 1.0))
    if not p95_cm:
        return
    shares = np.arange(1, STEPS + 1) / (STEPS + 1)
    # None, for an end that is not known, becomes NaN: as far as there are flights.
    _, low, high = np.array([quantile(p95_cm, share) for share in shares.tolist()], dtype=float).T
    low, high = np.nan_to_num(low, nan=min(p95_cm)), np.nan_to_num(high, nan=max(p95_cm))
    axes.fill_betweenx(shares, low, high, label="95 % interval", **shaded())
    axes.ecdf(p95_cm, color=OURS, label="flights")
    axes.set_xlim(left=0.0)
    axes.legend(loc="lower right")


def _draw_shares(axes: Axes, summary: Summary) -> None:
    """How often something happened, with Wilson's interval."""
    for place, share in enumerate(summary.shares):
        intervals(axes, place, share.flights / max(share.of, 1), (share.low, share.high), across=True)
        label(axes, share.what, (0.0, place), (6, 5))
    axes.set(title="share of the flights with ...", yticks=[], ylim=(len(summary.shares) - 0.5, -0.8))
    axes.set_xlim(left=0.0)


def _draw_flights(axes: Axes, rows: Sequence[Row], summary: Summary) -> None:
    """Each flight by its errors and its longest silence; the worst with their numbers."""
    axes.set_title("each flight, the worst with their numbers")
    axes.set(xlabel="95 % of the errors are below [cm]", ylabel="longest silence [s]")
    for shown, colour in ((rows, GREY), (summary.worst, REFERENCE)):
        known = [row for row in shown if row["error_p95_cm"] is not None]
        places = [(row["error_p95_cm"], row["longest_silence_s"] or 0.0) for row in known]
        axes.plot(*np.reshape(places, (-1, 2)).T, ".", color=colour)
    for row, place in zip(known, places, strict=True):
        label(axes, str(row[NUMBER]), place, (4, 3))
