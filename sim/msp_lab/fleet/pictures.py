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
    rows = max(min(len(each.estimates), MAX_ROWS) for each in panels)
    figure = new_figure(max(1.1 + ROW_IN * rows, 3.0))
    for k, each in enumerate(panels):
        axes = figure.add_subplot(1, len(panels), k + 1)
        if each.sessions:
            _draw_sessions(axes, each)
        else:
            _draw_sensors(axes, each, findings.sensors > findings.vehicles)
        label = each.name if each.parameter == "value" else f"{each.name}, {each.parameter}"
        axes.set_xlabel(f"{name_of(label)}{each.unit_label}" if not each.sessions else "session")
    return figure


def _draw_sensors(axes: Axes, effect: FleetEffect, several: bool) -> None:
    shown = sorted(effect.estimates, key=lambda each: not each.odd)[:MAX_ROWS]
    shown = [each for each in effect.estimates if each in shown]
    if effect.mean is not None:
        axes.axvspan(effect.mean - 2.0 * effect.tau, effect.mean + 2.0 * effect.tau, **shaded())
        axes.axvline(effect.mean, color=GREY)
    for row, each in enumerate(shown):
        colour = VERMILION if each.odd else BLUE
        axes.errorbar(each.value, row, xerr=2.0 * each.error, fmt="none", ecolor=colour, elinewidth=0.8, alpha=0.5)
        axes.plot([each.low, each.high], [row, row], color=colour, linewidth=2.0)
        axes.plot(each.shrunk, row, marker="s" if each.odd else "o", color=colour, markersize=4.0)
    names = [f"{each.vehicle} {each.sensor}" if several else each.vehicle for each in shown]
    axes.set_yticks(range(len(shown)), names)
    axes.set_ylim(len(shown) - 0.5, -0.5)
    axes.grid(visible=False, axis="y")
    axes.set_title({"odd": "odd ones out", "shared": "the whole fleet"}.get(effect.kind, "all sensors"))


def _draw_sessions(axes: Axes, effect: FleetEffect) -> None:
    one = effect.estimates[0]
    for k, each in enumerate(effect.sessions):
        axes.errorbar(k + 1, each.value, yerr=2.0 * each.error, fmt="o", color=BLUE, markersize=4.0)
    if effect.since:
        first = [each.session for each in effect.sessions].index(effect.since)
        axes.axvline(first + 0.5, color=VERMILION)
    axes.set_title(f"{one.vehicle}: {name_of(effect.name)}{effect.unit_label}")
