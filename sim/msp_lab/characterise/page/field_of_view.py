"""Pictures of the field of view: readings over angle at each range, and the sonar equation through the angles."""

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from msp_lab.characterise.findings import AnglePoint, BreakawayAngle
from msp_lab.characterise.page.errors import share_bars
from msp_lab.characterise.page.picture_data import PictureData, ReferenceNumbers
from msp_lab.characterise.page.text import half_interval
from msp_lab.characterise.points import PointReadings, grouped
from msp_sim.acoustics.sonar import STEP_DEG, Sonar
from msp_sim.page.page import Absent, Drawn, Entry
from msp_sim.page.style import (
    BARS,
    GREEN,
    GREY,
    INK,
    MARKED,
    ORANGE,
    OURS,
    PALE,
    REFERENCE,
    edges_between,
    intervals,
    label,
    new_axes,
    new_panels,
    shaded,
)
from msp_sim.page.text import sentence

MAX_SWEEPS = 8
"""Pictures of the field of view that the page has at most; a bench has four ranges, a flight may have hundreds."""


def entries(rows: PictureData) -> Iterator[Entry]:
    """Yield a picture for each range at which angles were tried, and the sonar equation."""
    view = rows.findings.field_of_view
    for angle in () if view is None else view.angles[:MAX_SWEEPS]:
        name = f"field_of_view_{angle.range_cm:g}cm".replace(".", "_")
        yield name, f"Field of view at {angle.range_cm:g} cm", partial(sweep, rows, angle.range_cm)
    yield "sonar_equation", "Sonar equation through the breakaway angles", partial(_sonar, rows)


def sweep(rows: PictureData, range_cm: float) -> Drawn:
    """Draw the readings over angle at a range [cm]."""
    found = rows.of("field_of_view")
    view = rows.needed(rows.findings.field_of_view, "field_of_view")
    angle = next((candidate for candidate in view.angles if candidate.range_cm == range_cm), None)
    if angle is None:
        there = ", ".join(f"{candidate.range_cm:g}" for candidate in view.angles[:12])
        raise Absent(f"The field of view was not measured at {range_cm:g} cm at several angles, but at {there} cm.")
    breakaway = "Breakaway not found: no angle is reliable to both sides"
    if angle.half_angle.value:
        breakaway = f"Breakaway at {half_interval(angle.half_angle)}"
    points = [point for point in view.points if point.range_cm == range_cm]
    angles = {point.incidence_deg for point in points}
    readings = f"{sum(point.readings for point in points):,} readings at {len(angles)} angles"
    here = [point for point in found if round(point.range_cm, 3) == range_cm]
    figure = _draw_sweep(here, points, angle, rows.reference)
    return figure, f"{readings}. {breakaway}. Reliable: {view.criterion}."


def _draw_sweep(
    readings: Sequence[PointReadings],
    points: Sequence[AnglePoint],
    breakaway: BreakawayAngle,
    reference: ReferenceNumbers,
) -> Figure:
    """Readings over angle with the two ranges that a tilted sensor may report; below, how many are reliable."""
    range_cm, half_deg = breakaway.range_cm, breakaway.half_angle.value
    figure, (top, bottom) = new_panels(4.5, 2, sharex=True, height_ratios=(3.2, 1.0))
    # Several sensors or sessions may have been at an angle.
    angle_deg, at = np.unique([point.incidence_deg for point in points], return_inverse=True)
    edges = edges_between(angle_deg)
    width = 0.86 * np.min(np.diff(edges))

    span_deg = np.linspace(-1.0, 1.0, 241) * np.max(np.abs(angle_deg))
    # As calibration and air stretch what is read straight ahead.
    base_cm = min(points, key=lambda point: abs(point.incidence_deg)).nearest_cm
    slant_cm = base_cm / np.cos(np.radians(span_deg))
    low, high = min(base_cm, range_cm) - 4.0, max(np.max(slant_cm), range_cm) + 5.0
    for angle, here in grouped(readings, lambda point: round(point.incidence_deg, 3)).items():
        echo_cm = np.concatenate([point.reading_cm[point.is_echo] for point in here])
        of = sum(point.reading_cm.size for point in here)
        share_bars(top, angle, echo_cm[(echo_cm > low) & (echo_cm < high)], of, width)
    top.plot(span_deg, slant_cm, "--", color=REFERENCE, label="along the axis, r₀ / cos θ")
    if half_deg > 0.0:
        nearest_cm = base_cm / np.cos(np.radians(np.maximum(np.abs(span_deg) - half_deg, 0.0)))
        top.plot(span_deg, nearest_cm, color=GREEN, label=f"nearest point in a beam of ±{half_deg:.1f}°")
    top.set(ylim=(low, high), ylabel="reading [cm]")

    of_wall = np.bincount(at, [point.reliable.value * point.readings for point in points])
    reliable = 100.0 * of_wall / np.bincount(at, [point.readings for point in points])
    bottom.bar(angle_deg, reliable, width, **BARS)
    bottom.bar(angle_deg, 100.0 - reliable, width, reliable, color=PALE)
    bottom.set(ylim=(0.0, 100.0), yticks=[0, 50, 100], ylabel="reliable [%]")
    reference_deg = reference.half_angle_deg.get(range_cm)
    for axes in (top, bottom):
        _mark_breakaway(axes, breakaway)
        for edge_deg in () if reference_deg is None else (-reference_deg, reference_deg):
            words = f"{reference.name}'s ±{reference_deg:g}°"
            axes.axvline(edge_deg, color=REFERENCE, linestyle=":", label=words)
    bottom.set(xlim=(edges[0], edges[-1]), xlabel="angle between the axis and the wall's normal [deg]")
    return figure


def _mark_breakaway(axes: Axes, breakaway: BreakawayAngle) -> None:
    """Each side's last reliable angle, and the stretch up to the next one that was tried."""
    for sign, side in ((-1.0, breakaway.negative), (1.0, breakaway.positive)):
        # 0 stands for a side on which no angle is reliable.
        if side is None or not side.value:
            continue
        if side.high is not None and side.high > side.value:
            words = "up to the next angle tried"
            axes.axvspan(sign * side.value, sign * side.high, label=words, **shaded(ORANGE))
        axes.axvline(sign * side.value, color=INK, label=f"breakaway: last reliable angle, {side.value:.1f}°")


def _sonar(rows: PictureData) -> Drawn:
    """Half angle over range: measured, as the sonar equation has it, as the other rows predict it, as it is used."""
    sonar = rows.needed(rows.findings.sonar, "sonar")
    view = rows.needed(rows.findings.field_of_view, "field_of_view")
    measured = [(row.range_cm, row.measured_deg) for row in sonar.rows]
    used_cm, used_deg = np.transpose([*measured, *sonar.beyond])
    equation = Sonar(sonar.source_level_db, sonar.piston_diameter_m, sonar.gain_db_per_m, rows.model.frequency_hz)
    span_cm = np.linspace(0.6 * np.min(used_cm), np.max(used_cm), 120)
    # Where there is no echo, None becomes NaN.
    span_deg = np.array([equation.half_angle_deg(at_cm / 100.0) for at_cm in span_cm.tolist()], dtype=float)
    figure, axes = new_axes(4.0, "perpendicular range [cm]", "half angle of the beam [deg]")
    words = f"± one step of the motor, {STEP_DEG:g}°"
    axes.fill_between(span_cm, span_deg - STEP_DEG, span_deg + STEP_DEG, label=words, **shaded())
    axes.plot(span_cm, span_deg, color=GREEN, label="sonar equation, fitted")
    axes.plot(used_cm, used_deg, "--", color=INK, label="what the bridge uses")
    ends_deg = {angle.range_cm: angle.half_angle.ends for angle in view.angles}
    missed_deg = [abs(row.fitted_deg - row.measured_deg) for row in sonar.rows if row.fitted_deg is not None]
    others_deg = {row.range_cm: row.left_out_deg for row in sonar.rows if row.left_out_deg is not None}
    highest_deg = max([*used_deg, *others_deg.values()])
    for at_cm, angle_deg in measured:
        words = "measured, up to the next angle tried"
        intervals(axes, at_cm, angle_deg, ends_deg[at_cm], color=OURS, markersize=9, label=words)
        if earlier_deg := rows.reference.half_angle_deg.get(at_cm):
            axes.plot(at_cm, earlier_deg, label=f"{rows.reference.name}'s", **MARKED)
            highest_deg = max(highest_deg, earlier_deg)
        if others_deg and at_cm not in others_deg:
            label(axes, "the others predict\nno echo here", (at_cm, 0.0), (0, 6), ha="center", color=GREY)
    axes.set(xlim=(0.0, np.max(used_cm)), ylim=(0.0, 1.2 * highest_deg))
    caption = "No angle is predicted"
    if missed_deg:
        caption = f"The equation misses the measured angles by at most {max(missed_deg):.1f}°"
    if others_deg:
        marks, words = (list(others_deg), list(others_deg.values())), "predicted from the others"
        axes.plot(*marks, "D", color=ORANGE, fillstyle="none", markersize=9, zorder=7, label=words)
        worst_deg = max(abs(others_deg[at_cm] - angle_deg) for at_cm, angle_deg in measured if at_cm in others_deg)
        caption += f", and predicts each from the others to {worst_deg:.1f}°"
    return figure, (
        f"{caption}. Equivalent piston {1000.0 * sonar.piston_diameter_m:.1f} mm, gain {sonar.gain_db_per_m:.1f} dB/m. "
        f"{sentence(sonar.note)} Beyond the measured ranges the angle never grows."
    )
