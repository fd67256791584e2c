"""The fleet in one picture: every vehicle's number with its interval, next to the fleet's mean and spread."""

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from msp_lab.fleet.findings import FleetEffect, FleetFindings, SessionEstimate, UnitEstimate
from msp_lab.gap.labels import name_of
from msp_sim.page.style import BLUE, GREY, VERMILION, intervals, new_panels, shaded

MAX_PANELS = 3
"""Numbers in the picture: more are too narrow to read. The table has all."""
MAX_ROWS = 60
"""Sensors that are drawn with their names; of a larger fleet the odd ones and the first others."""
ROW_IN = 0.19
"""Height of a row [in]."""


def draw_fleet(findings: FleetFindings) -> Figure:
    """A panel for each number, a row for each sensor; of a change its sessions."""
    effects = findings.shown[:MAX_PANELS]
    rows = max(min(len(effect.estimates), MAX_ROWS) for effect in effects)
    figure, panels = new_panels(max(1.1 + ROW_IN * rows, 3.0), 1, len(effects))
    for axes, effect in zip(panels, effects, strict=True):
        if effect.sessions:
            _draw_sessions(axes, effect)
        else:
            _draw_sensors(axes, effect, findings.sensors > findings.vehicles)
    return figure


def _draw_sensors(axes: Axes, effect: FleetEffect, several: bool) -> None:
    shown = sorted(effect.estimates, key=lambda estimate: not estimate.odd)[:MAX_ROWS]
    shown = [estimate for estimate in effect.estimates if estimate in shown]
    if effect.mean is not None:
        axes.axvspan(effect.mean - 2.0 * effect.tau, effect.mean + 2.0 * effect.tau, **shaded())
        axes.axvline(effect.mean, color=GREY)
    for row, one in enumerate(shown):
        look = {"color": VERMILION, "marker": "s"} if one.odd else {"color": BLUE}
        axes.plot(_own(one), [row, row], color=look["color"], linewidth=0.8, alpha=0.5)
        intervals(axes, row, one.shrunk, (one.low, one.high), across=True, capsize=0, elinewidth=2.0, **look)
    names = [f"{estimate.vehicle} {estimate.sensor}" if several else estimate.vehicle for estimate in shown]
    axes.set_yticks(range(len(shown)), names)
    name = effect.name if effect.parameter == "value" else f"{effect.name}, {effect.parameter}"
    axes.set(ylim=(len(shown) - 0.5, -0.5), xlabel=f"{name_of(name)}{effect.unit_label}")
    axes.set_title(
        {"odd": "odd ones out", "group": effect.group, "shared": "the whole fleet"}.get(effect.kind, "all sensors")
    )


def _own(one: UnitEstimate | SessionEstimate) -> tuple[float, float]:
    """The interval of its own readings."""
    return one.value - 2.0 * one.error, one.value + 2.0 * one.error


def _draw_sessions(axes: Axes, effect: FleetEffect) -> None:
    for place, one in enumerate(effect.sessions, start=1):
        intervals(axes, place, one.value, _own(one), color=BLUE)
        if one.session == effect.since:
            axes.axvline(place - 0.5, color=VERMILION)
    title = f"{effect.estimates[0].vehicle}: {name_of(effect.name)}{effect.unit_label}"
    axes.set(xlabel="session", title=title)
