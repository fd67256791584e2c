"""Pictures of the field of view: readings over angle at each range, and the sonar equation through the angles."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from msp_lab.characterise.findings import Findings
from msp_lab.characterise.page.draw.beam import Sweep, draw_beam, draw_sweep
from msp_lab.characterise.page.picture_data import Absent, Drawn, Entry, PictureData, needed
from msp_lab.characterise.page.text import half_interval, sentence
from msp_range.arrays import Array

MAX_SWEEPS = 8
"""Pictures of the field of view that the page has at most; a bench has four ranges, a flight may have hundreds."""


def entries(rows: PictureData) -> Iterator[Entry]:
    """Yield a picture for each range at which angles were tried, and the sonar equation."""
    for range_cm in measured_ranges_cm(rows)[:MAX_SWEEPS]:
        name = f"field_of_view_{range_cm:g}cm".replace(".", "_")
        yield name, f"Field of view at {range_cm:g} cm", partial(sweep, range_cm=range_cm)
    yield "sonar_equation", "Sonar equation through the breakaway angles", _sonar


def measured_ranges_cm(rows: PictureData) -> list[float]:
    """Return the ranges at which angles were tried [cm]; none where there are no such readings."""
    try:
        return [float(each) for each in _sweep_ranges(rows)]
    except Absent:
        return []


def _sweep_ranges(rows: PictureData) -> Array:
    found = rows.of("field_of_view")
    incidence = rows.data.column("incidence_deg")
    if not np.any(np.isfinite(incidence[found])):
        raise Absent("The readings of the field of view have no angle (column incidence_deg).")
    return np.unique(rows.true_cm[found])


def sweep(findings: Findings, rows: PictureData, range_cm: float) -> Drawn:
    """Draw the readings over angle at a range [cm]."""
    ranges = _sweep_ranges(rows)
    if range_cm not in ranges:
        there = ", ".join(f"{each:g}" for each in ranges[:12])
        raise Absent(f"The field of view was not measured at {range_cm:g} cm, but at {there} cm.")
    incidence, found = rows.data.column("incidence_deg"), rows.of("field_of_view")
    chosen = found & (rows.true_cm == range_cm) & np.isfinite(incidence)
    if np.unique(incidence[chosen]).size < 2:
        raise Absent(f"At {range_cm:g} cm only one angle was measured.")
    view = needed(findings.field_of_view, findings, "field_of_view")
    points = [point for point in view.points if point.range_cm == range_cm]
    angle = next((each for each in view.angles if each.range_cm == range_cm), None)
    shown = Sweep(range_cm, incidence[chosen], rows.reading_cm[chosen], rows.missed[chosen])
    caption = f"{np.count_nonzero(chosen):,} readings at {len(points)} angles. "
    if angle is None:
        caption += "No breakaway angle could be found."
    elif angle.half_angle.value:
        caption += f"Breakaway at {half_interval(angle.half_angle)}."
    else:
        caption += "Breakaway not found: no angle is reliable to both sides."
    caption += f" Reliable: {view.criterion}."
    return Drawn(
        draw_sweep(shown, points, angle, rows.reference),
        caption,
        f"Readings over the sensor's angle at {range_cm:g} cm, with the breakaway marked.",
    )


def _sonar(findings: Findings, rows: PictureData) -> Drawn:
    found = needed(findings.sonar, findings, "sonar")
    angles = findings.field_of_view.angles if findings.field_of_view is not None else ()
    fitted = [abs(row.fitted_deg - row.measured_deg) for row in found.rows if row.fitted_deg is not None]
    left_out = [abs(row.left_out_deg - row.measured_deg) for row in found.rows if row.left_out_deg is not None]
    caption = (
        f"The equation misses the measured angles by at most {max(fitted):.1f}°" if fitted else "No angle is predicted"
    )
    caption += f", and predicts each from the others to {max(left_out):.1f}°. " if left_out else ". "
    caption += (
        f"Equivalent piston {1000.0 * found.piston_diameter_m:.1f} mm, gain {found.gain_db_per_m:.1f} dB/m. "
        f"{sentence(found.note)} Beyond the measured ranges the angle never grows."
    )
    return Drawn(
        draw_beam(found, angles, rows.model.frequency_hz, rows.reference),
        caption,
        "Half angle of the beam over range: measured and by the sonar equation.",
    )
