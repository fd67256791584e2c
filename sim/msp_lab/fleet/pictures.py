"""The fleet in one picture: every vehicle's number with its interval, next to the fleet's mean and spread.

Findings enter, a figure leaves. Nothing is decided here.
"""

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from msp_lab.fleet.findings import FleetEffect, FleetFindings
from msp_lab.gap.labels import name_of
from msp_sim.page.style import BLUE, GREY, VERMILION, new_figure, shaded

MAX_PANELS = 3
"""Numbers in the picture: more are too narrow to read. The table has all."""
MAX_ROWS = 60
"""Sensors that are drawn with their names; of a larger fleet the odd ones and the first others."""
ROW_IN = 0.19
"""Height of a row [in]."""


def draw_fleet(findings: FleetFindings) -> Figure:
    """A panel for each number, a row for each sensor; of a change its sessions."""
    panels = findings.effects[:MAX_PANELS]
    rows = max(min(len(effect.estimates), MAX_ROWS) for effect in panels)
    figure = new_figure(max(1.1 + ROW_IN * rows, 3.0))
    for k, effect in enumerate(panels):
        axes = figure.add_subplot(1, len(panels), k + 1)
        if effect.sessions:
            _draw_sessions(axes, effect)
        else:
            _draw_sensors(axes, effect, findings.sensors > findings.vehicles)
        label = effect.name if effect.parameter == "value" else f"{effect.name}, {effect.parameter}"
        axes.set_xlabel(f"{name_of(label)}{effect.unit_label}" if not effect.sessions else "session")
    return figure


def _draw_sensors(axes: Axes, effect: FleetEffect, several: bool) -> None:
    shown = sorted(effect.estimates, key=lambda estimate: not estimate.odd)[:MAX_ROWS]
    shown = [estimate for estimate in effect.estimates if estimate in shown]
    if effect.mean is not None:
        axes.axvspan(effect.mean - 2.0 * effect.tau, effect.mean + 2.0 * effect.tau, **shaded())
        axes.axvline(effect.mean, color=GREY)
    for row, estimate in enumerate(shown):
        colour = VERMILION if estimate.odd else BLUE
        axes.errorbar(
            estimate.value, row, xerr=2.0 * estimate.error, fmt="none", ecolor=colour, elinewidth=0.8, alpha=0.5
        )
        axes.plot([estimate.low, estimate.high], [row, row], color=colour, linewidth=2.0)
        axes.plot(estimate.shrunk, row, marker="s" if estimate.odd else "o", color=colour, markersize=4.0)
    names = [f"{estimate.vehicle} {estimate.sensor}" if several else estimate.vehicle for estimate in shown]
    axes.set_yticks(range(len(shown)), names)
    axes.set_ylim(len(shown) - 0.5, -0.5)
    axes.grid(visible=False, axis="y")
    axes.set_title({"odd": "odd ones out", "shared": "the whole fleet"}.get(effect.kind, "all sensors"))


def _draw_sessions(axes: Axes, effect: FleetEffect) -> None:
    one = effect.estimates[0]
    for k, estimate in enumerate(effect.sessions):
        axes.errorbar(k + 1, estimate.value, yerr=2.0 * estimate.error, fmt="o", color=BLUE, markersize=4.0)
    if effect.since:
        first = [estimate.session for estimate in effect.sessions].index(effect.since)
        axes.axvline(first + 0.5, color=VERMILION)
    axes.set_title(f"{one.vehicle}: {name_of(effect.name)}{effect.unit_label}")
