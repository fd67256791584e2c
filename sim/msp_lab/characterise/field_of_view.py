"""Breakaway angles, what a tilted sensor reads, and the sonar equation through the angles.

An angle to a wall is reliable by a stated share of readings that are of the wall; the breakaway lies between the last
reliable angle and the next that was tried.
"""

import math
from collections.abc import Iterator, Sequence
from itertools import accumulate
from typing import Literal

import numpy as np
from scipy.special import xlogy

from msp_lab.characterise.findings import AnglePoint, BreakawayAngle, FieldOfView, Oblique, SonarFit, SonarRow
from msp_lab.characterise.points import GATE_CM, PointReadings, grouped
from msp_lab.estimates import IntervalEstimate, fit_points, half_of_mean, share
from msp_range.arrays import Array
from msp_range.correction.calibration import Calibration
from msp_range.reading_model.sensor_model import SensorModel
from msp_sim.acoustics.slant import slant_range
from msp_sim.acoustics.sonar import PARAMETERS, fit_beam, leave_one_out
from msp_sim.intervals import LIKELIHOOD_DROP

RELIABLE_SHARE = 0.8
"""Smallest share of readings of the wall at a reliable angle. Echoes end within about one step of 1.8 deg, so that any
value from 0.5 to 0.9 gives the same angle or its neighbour."""
CRITERION = (
    f"at least {RELIABLE_SHARE:.0%} of the readings are of the wall: from {GATE_CM:g} cm before the perpendicular "
    f"distance to {GATE_CM:g} cm behind the slant range; and so at all smaller angles to that side"
)
BEYOND_CM = (250.0, 300.0, 400.0, 500.0, 600.0, 765.0)
"""Ranges beyond the measured ones at which the findings give the half angle [cm]."""
MIN_DIFFERENCE_CM = 1.0
"""Slant and perpendicular that differ by less at every angle are not distinguishable in whole centimetres [cm]."""


def find_field_of_view(points: Sequence[PointReadings], calibration: Calibration) -> FieldOfView | None:
    """Breakaway angles of each range; None where no range was tried at more than one angle.

    Points at 90 deg, or of an unknown angle, are left out.
    """
    found = sorted(
        (_angle_point(point, calibration) for point in points if abs(point.incidence_deg) < 90.0),
        key=lambda each: (each.range_cm, each.incidence_deg),
    )
    by_range = grouped(found, lambda each: each.range_cm)
    angles = tuple(angle for range_cm, here in by_range.items() for angle in _breakaway(range_cm, here))
    return FieldOfView(CRITERION, tuple(found), angles, _oblique(found)) if angles else None


def breakaway_rows(angles: Sequence[BreakawayAngle]) -> list[tuple[float, float]]:
    """Range [cm] and half angle [deg] for the model file: where there is an angle, and never wider with range."""
    seen = [angle for angle in angles if angle.half_angle.value > 0.0]
    narrowest_deg = accumulate((angle.half_angle.value for angle in seen), min)
    return [(angle.range_cm, half_deg) for angle, half_deg in zip(seen, narrowest_deg, strict=True)]


def sonar_through(
    rows: Sequence[tuple[float, float]], sensor: SensorModel, on_axis_cm: float | None
) -> SonarFit | None:
    """The sonar equation through breakaway angles, and each angle as the others predict it.

    Arguments as for `fit_beam`. None with fewer rows than the equation has parameters, and for light and radio.
    """
    if len(rows) < PARAMETERS or sensor.medium != "sound":
        return None
    table, sonar, beam = fit_beam(rows, sensor, on_axis_cm)
    left_out: Sequence[float | None] = [None] * len(rows)
    if len(rows) > PARAMETERS:
        left_out = leave_one_out(table, sensor.frequency_hz, (on_axis_cm or 0.0) / 100.0)
    fitted = map(sonar.half_angle_deg, table.ranges_m)
    known_to_cm = round(100.0 * beam.ranges_m[-1], 6)
    return SonarFit(
        source_level_db=sonar.source_level_db,
        piston_diameter_m=sonar.piston_diameter_m,
        gain_db_per_m=sonar.gain_db_per_m,
        rows=tuple(SonarRow(*row, *angles) for row, *angles in zip(rows, fitted, left_out, strict=True)),
        beyond=tuple(
            (r, math.degrees(beam.half_angle_rad(r / 100.0))) for r in BEYOND_CM if rows[-1][0] < r <= known_to_cm
        ),
        within_a_step=sonar.fits(table),
        note=(
            f"{PARAMETERS} parameters for {len(rows)} angles: that the equation passes near them is hardly evidence; "
            "what the other rows predict is, and beyond the table its shape is assumed"
        ),
    )


def _angle_point(point: PointReadings, calibration: Calibration) -> AnglePoint:
    incidence_rad = math.radians(abs(point.incidence_deg))
    # Ranges as the sensor sees them through this air.
    perpendicular_cm = float(point.apparent_cm.mean())
    nearest_cm = calibration.forward(perpendicular_cm)
    slant_cm = calibration.forward(slant_range(perpendicular_cm, incidence_rad))
    of_wall = point.reading_cm[
        point.is_echo & (point.reading_cm >= nearest_cm - GATE_CM) & (point.reading_cm <= slant_cm + GATE_CM)
    ]
    reliable = share(of_wall.size, point.reading_cm.size)
    reading = None
    if of_wall.size > 1:
        half = half_of_mean(of_wall, point.step_cm)
        reading = IntervalEstimate.about(float(of_wall.mean()), half, of_wall.size)
    return AnglePoint(
        range_cm=round(point.range_cm, 3),
        incidence_deg=round(point.incidence_deg, 3),
        readings=point.reading_cm.size,
        reliable=reliable,
        is_reliable=reliable.value >= RELIABLE_SHARE,
        reading=reading,
        slant_cm=slant_cm,
        nearest_cm=nearest_cm,
    )


def _breakaway(range_cm: float, points: Sequence[AnglePoint]) -> Iterator[BreakawayAngle]:
    """Yield the breakaway angle at a range that was tried at two angles."""
    negative = _side([point for point in points if point.incidence_deg <= 0.0])
    positive = _side([point for point in points if point.incidence_deg >= 0.0])
    sides = [side for side in (negative, positive) if side is not None]
    if sides:
        yield BreakawayAngle(range_cm, negative, positive, min(sides, key=lambda each: each.value))


def _side(points: Sequence[AnglePoint]) -> IntervalEstimate | None:
    """Last reliable angle of one side; between the ends of its interval echoes stop coming."""
    angles, which = np.unique([abs(point.incidence_deg) for point in points], return_inverse=True)
    if angles.size < 2:
        return None
    readings = np.bincount(which, [point.readings for point in points])
    of_wall = np.bincount(which, [point.reliable.value * point.readings for point in points])
    is_reliable = of_wall / readings >= RELIABLE_SHARE
    last = angles.size if is_reliable.all() else int(is_reliable.argmin())
    steps = _likely_steps(np.rint(of_wall), readings.astype(np.float64))
    first, after = min(last, steps[0]), max(last, steps[-1])
    below, above = [0.0, *angles.tolist()], [*angles.tolist(), None]
    return IntervalEstimate(below[last], below[first], above[after], "deg", int(readings.sum()))


def _likely_steps(of_wall: Array, readings: Array) -> list[int]:
    """Numbers of angles after which the share of readings of the wall may drop from reliable to not reliable.

    Those whose binomial likelihood, with one share before and one behind, is not significantly below the best.
    """
    seen, tried = (np.append(0.0, np.cumsum(each)) for each in (of_wall, readings))
    before = _log_likelihood(seen, tried, RELIABLE_SHARE, 1.0)
    total = before + _log_likelihood(seen[-1] - seen, tried[-1] - tried, 0.0, RELIABLE_SHARE)
    return np.flatnonzero(total >= total.max() - LIKELIHOOD_DROP).tolist()


def _log_likelihood(count: Array, of: Array, least: float, most: float) -> Array:
    """Binomial log likelihood of counts by their own share, which is between these limits."""
    share = np.clip(count / np.maximum(of, 1.0), least, most)
    return np.asarray(xlogy(count, share) + xlogy(of - count, 1.0 - share))


def _oblique(points: Sequence[AnglePoint]) -> Oblique:
    """Slope of what the reading grows by over what the slant range does, each range with its own start."""
    used = [(point, point.reading) for point in points if point.is_reliable and point.reading is not None]
    growth = np.array([point.slant_cm - point.nearest_cm for point, _ in used])
    if len(used) < 4 or np.ptp(growth) < MIN_DIFFERENCE_CM:
        reason = f"slant and perpendicular differ by less than {MIN_DIFFERENCE_CM:g} cm at the reliable angles"
        return Oblique("unknown", None, None, None, reason)
    excess = np.array([reading.value - point.nearest_cm for point, reading in used])
    ranges, at = np.unique([point.range_cm for point, _ in used], return_inverse=True)
    # Each range with a start of its own: how well its distance was set drops out.
    starts = at[:, None] == np.arange(ranges.size)
    design = np.column_stack([growth, starts])
    if len(used) <= design.shape[1] or np.linalg.matrix_rank(design) < design.shape[1]:
        return Oblique("unknown", None, None, None, "too few reliable angles")
    slope = fit_points(design, excess, 0.0).estimate(0, "")

    def rms_cm(share: float) -> float:
        left = excess - share * growth
        return float(np.std(left - starts @ (left @ starts / starts.sum(axis=0))))

    low, high = slope.ends
    reason = f"readings grow by {slope} of what the slant range does"
    verdict: Literal["slant", "nearest", "unknown"] = "slant" if low > 0.5 else "nearest" if high < 0.5 else "unknown"
    reason += ", which may be nearer to either" if verdict == "unknown" else ""
    return Oblique(verdict, slope, rms_cm(1.0), rms_cm(0.0), reason)
