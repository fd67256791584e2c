"""The field of view at one range, and the sonar equation through the breakaway angles."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from msp_lab.characterise.beam_findings import AnglePoint, BreakawayAngle, SonarFit
from msp_lab.characterise.page.draw.errors import share_bars, with_reach
from msp_lab.characterise.point_findings import IntervalEstimate
from msp_lab.characterise.reference import ReferenceNumbers
from msp_range.acoustics.sonar import STEP_DEG, Sonar
from msp_range.arrays import Array, Flags
from msp_sim.page.style import (
    GREEN,
    GREY,
    INK,
    ORANGE,
    OURS,
    PALE,
    REFERENCE,
    edges_between,
    legend_below,
    new_figure,
)


@dataclass(frozen=True)
class Sweep:
    """Readings of a wall at one perpendicular distance, over the sensor's angle."""

    range_cm: float
    """Perpendicular distance r_0 [cm]."""
    incidence_deg: Array
    reading_cm: Array
    """Of each reading, shape (n,); NaN for a reading: no answer."""
    missed: Flags
    """Which readings are codes for no echo, shape (n,)."""


def draw_sweep(
    sweep: Sweep,
    points: Sequence[AnglePoint],
    breakaway: BreakawayAngle | None,
    reference: ReferenceNumbers | None,
) -> Figure:
    """Readings over angle with the two ranges that a tilted sensor may report; below, how many are reliable.

    Parameters
    ----------
    sweep
        The readings.
    points, breakaway
        What was found at each angle, at least two, and the breakaway angle.
    reference
        Earlier numbers to mark; None: nothing is marked.
    """
    figure = new_figure(4.5)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(3.2, 1.0))
    points = sorted(points, key=lambda point: point.incidence_deg)
    angle_deg = np.array([point.incidence_deg for point in points])
    reliable = 100.0 * np.array([point.reliable.value for point in points])
    half_deg = 0.0 if breakaway is None else breakaway.half_angle.value
    widest = float(np.max(np.abs(angle_deg)))
    theta = np.radians(np.linspace(-widest, widest, 241))
    # As calibration and air stretch what is read straight ahead.
    base_cm = min(points, key=lambda point: abs(point.incidence_deg)).nearest_cm
    slant_cm = base_cm / np.cos(theta)
    beyond = np.maximum(np.abs(theta) - np.radians(half_deg), 0.0)
    nearest_cm = base_cm / np.cos(beyond)
    low, high = min(base_cm, sweep.range_cm) - 4.0, max(float(np.max(slant_cm)), sweep.range_cm) + 5.0

    edges = edges_between(angle_deg.tolist())
    width = 0.86 * float(np.min(np.diff(edges)))
    _shares(top, sweep, angle_deg, width, low, high)
    top.plot(np.degrees(theta), slant_cm, "--", color=REFERENCE, label="along the axis, r₀ / cos θ", zorder=4)
    if half_deg > 0.0:
        label = f"nearest point in a beam of ±{half_deg:.1f}°"
        top.plot(np.degrees(theta), nearest_cm, "-", color=GREEN, linewidth=1.3, zorder=4, label=label)
    top.set_ylim(low, high)
    top.set_ylabel("reading [cm]")
    top.yaxis.set_major_locator(MaxNLocator(6, integer=True))

    bottom.bar(angle_deg, reliable, width=width, color=OURS, alpha=0.75, zorder=2)
    bottom.bar(angle_deg, 100.0 - reliable, width=width, bottom=reliable, color=PALE, zorder=2)
    bottom.set_ylim(0.0, 100.0)
    bottom.set_yticks([0, 50, 100])
    bottom.set_ylabel("reliable [%]")
    bottom.set_xlabel("angle between the axis and the wall's normal [deg]")
    _mark_breakaway(top, bottom, breakaway)
    reference_deg = None if reference is None else reference.half_angle_deg.get(sweep.range_cm)
    if reference is not None and reference_deg is not None:
        for sign in (-1, 1):
            for axes in (top, bottom):
                axes.axvline(sign * reference_deg, color=REFERENCE, linestyle=":", linewidth=2.0, zorder=5)
        top.plot([], [], ":", color=REFERENCE, linewidth=2.0, label=f"{reference.name}'s ±{reference_deg:g}°")
    ticks = angle_deg
    if ticks.size > 15:
        ticks = ticks[np.abs(np.rint(ticks / 3.6) * 3.6 - ticks) < 0.05] if np.any(ticks % 1.0) else ticks[::2]
    bottom.set_xticks(ticks if ticks.size else angle_deg)
    bottom.xaxis.set_major_formatter("{x:g}")
    bottom.set_xlim(edges[0], edges[-1])
    top.grid(axis="x", visible=False)
    bottom.grid(axis="x", visible=False)
    legend_below(figure)
    return figure


def _shares(top: Axes, sweep: Sweep, angle_deg: Array, room: float, low: float, high: float) -> None:
    """Each angle's readings as a histogram on its side, whole centimetres."""
    lefts, read_cm, widths = [], [], []
    for angle in angle_deg.tolist():
        here = np.isclose(sweep.incidence_deg, angle, atol=1e-6)
        readings = sweep.reading_cm[here & ~sweep.missed & np.isfinite(sweep.reading_cm)]
        values, counts = np.unique(readings[(readings > low) & (readings < high)], return_counts=True)
        shares = counts / max(int(np.count_nonzero(here)), 1)
        lefts.extend((angle - shares * room / 2.0).tolist())
        widths.extend((shares * room).tolist())
        read_cm.extend(values.tolist())
    share_bars(top, lefts, read_cm, widths)


def _mark_breakaway(top: Axes, bottom: Axes, breakaway: BreakawayAngle | None) -> None:
    """Each side's last reliable angle, and the stretch up to the next one that was tried."""
    sides = [] if breakaway is None else [(-1.0, breakaway.negative), (1.0, breakaway.positive)]
    labelled = ended = False
    for sign, side in sides:
        # 0 stands for a side on which no angle is reliable.
        if side is None or side.value == 0.0:
            continue
        last, end = sign * side.value, None if side.high is None or side.high <= side.value else sign * side.high
        ended |= end is not None
        for axes in (top, bottom):
            if end is not None:
                axes.axvspan(min(last, end), max(last, end), color=ORANGE, alpha=0.22, linewidth=0, zorder=1)
            axes.axvline(last, color=INK, linewidth=1.3, zorder=5)
        top.text(
            last,
            0.985,
            f" {abs(last):.1f}°",
            transform=top.get_xaxis_transform(),
            fontsize=8.5,
            weight="bold",
            ha="left" if last < 0 else "right",
            va="top",
            color=INK,
            zorder=6,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0},
        )
        labelled = True
    if labelled:
        top.plot([], [], "-", color=INK, linewidth=1.3, label="breakaway: last reliable angle")
    if ended:
        top.fill_between([], [], [], color=ORANGE, alpha=0.22, linewidth=0, label="up to the next angle tried")


def draw_beam(
    sonar: SonarFit, measured: Sequence[BreakawayAngle], frequency_hz: float, reference: ReferenceNumbers | None
) -> Figure:
    """Half angle over range: measured, as the sonar equation has it, as the other rows predict it, as it is used."""
    equation = Sonar(sonar.source_level_db, sonar.piston_diameter_m, sonar.gain_db_per_m, frequency_hz)
    used = [(row.range_cm, row.measured_deg) for row in sonar.rows] + list(sonar.beyond)
    used_cm, used_deg = (list(each) for each in zip(*used, strict=True))
    span_cm = np.linspace(min(row.range_cm for row in sonar.rows) * 0.6, max(used_cm), 120)
    radians = [equation.half_angle_rad(range_cm / 100.0) for range_cm in span_cm.tolist()]
    span_deg = np.degrees(np.array([np.nan if each is None else each for each in radians]))
    intervals = {angle.range_cm: angle.half_angle for angle in measured}
    reference_deg = {} if reference is None else reference.half_angle_deg
    figure = new_figure(4.0)
    axes = figure.subplots()
    step = f"± one step of the motor, {STEP_DEG:g}°"
    low_deg, high_deg = span_deg - STEP_DEG, span_deg + STEP_DEG
    axes.fill_between(span_cm, low_deg, high_deg, color=PALE, alpha=0.6, linewidth=0, label=step, zorder=1)
    axes.plot(span_cm, span_deg, "-", color=GREEN, label="sonar equation, fitted", zorder=3)
    axes.plot(used_cm, used_deg, "--", color=INK, linewidth=1.2, label="what the bridge uses", zorder=4)
    x = [row.range_cm for row in sonar.rows]
    exact = [IntervalEstimate(row.measured_deg, None, None, "deg", 0) for row in sonar.rows]
    y, reach = with_reach(
        [
            replace(intervals.get(row.range_cm, each), value=each.value)
            for row, each in zip(sonar.rows, exact, strict=True)
        ]
    )
    axes.errorbar(
        x,
        y,
        reach,
        fmt="o",
        markersize=9,
        color=OURS,
        capsize=4,
        zorder=6,
        label="measured, up to the next angle tried",
    )
    pairs = [(range_cm, reference_deg[range_cm]) for range_cm in x if range_cm in reference_deg]
    if pairs and reference is not None:
        look: dict[str, Any] = {"markersize": 7, "color": REFERENCE, "markeredgecolor": "white", "zorder": 7}
        axes.plot(*zip(*pairs, strict=True), "X", label=f"{reference.name}'s", **look)
    left_out = [(row.range_cm, row.left_out_deg) for row in sonar.rows if row.left_out_deg is not None]
    if left_out:
        look = {"markersize": 9, "markerfacecolor": "none", "markeredgewidth": 1.6, "color": ORANGE, "zorder": 8}
        axes.plot(*zip(*left_out, strict=True), "D", label="predicted from the others", **look)
    silent = [row.range_cm for row in sonar.rows if row.left_out_deg is None]
    for range_cm in silent if left_out else ():
        axes.annotate(
            "the others predict\nno echo here",
            (range_cm, 0.0),
            xytext=(0, 6),
            textcoords="offset points",
            ha="center",
            fontsize=7,
            color=GREY,
        )
    top = max([*y, *(angle for _, angle in pairs), *(angle for _, angle in left_out)])
    axes.set_ylim(0.0, 1.2 * top)
    axes.set_xlim(0.0, max(used_cm))
    axes.set_xlabel("perpendicular range [cm]")
    axes.set_ylabel("half angle of the beam [deg]")
    legend_below(figure)
    return figure
