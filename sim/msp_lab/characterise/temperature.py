"""Air at the sensor and air on the way: the hot box, and temperature compensation.

Points with air temperatures enter; how long the box's air must be to explain the errors, and mean errors with and
without compensation, leave. Speeds of sound are those of `msp_range.acoustics.air`.
"""

import math
from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np
from scipy import stats

from msp_lab.characterise.estimates import CONFIDENCE, Z, half_of_mean, standard_error, student
from msp_lab.characterise.point_findings import IntervalEstimate, PointResult
from msp_lab.characterise.points import PointReadings
from msp_lab.characterise.question_findings import AirBefore, CompensationRow, HotBox, HotBoxRow
from msp_range.acoustics.air import ZERO_CELSIUS_K, speed_of_sound
from msp_range.arrays import Array
from msp_range.correction.calibration import Calibration

ROOM_C, ROOM_WITHIN_C = 21.1, 5.0
"""Room temperature where nobody measured the air at the target: 70 deg F. It decides which readings of the temperature
experiment are those of room temperature, within so much, and what air is assumed beyond a box."""


def hot_boxes(points: Sequence[PointResult], calibration_c: float) -> tuple[HotBox, ...]:
    """One finding for each level of the temperature experiment that is not room temperature.

    Parameters
    ----------
    points
        Every set-up of the data.
    calibration_c
        Air temperature that the sensor assumes [deg C].
    """
    here = [p for p in points if p.condition == "temperature" and p.air_temperature_c is not None and p.error]
    room = [p for p in here if abs((p.air_temperature_c or 0.0) - ROOM_C) < ROOM_WITHIN_C]
    reference = room or [p for p in points if p.condition == "baseline" and p.error]
    zero = _by_range(reference)
    levels = dict.fromkeys(p.level for p in here if p not in room)
    found = [_hot_box(level, [p for p in here if p.level == level], zero, reference, calibration_c) for level in levels]
    return tuple(each for each in found if each is not None)


def _hot_box(
    level: str,
    points: Sequence[PointResult],
    zero: dict[float, PointResult],
    reference: Sequence[PointResult],
    calibration_c: float,
) -> HotBox | None:
    pairs = [(p, zero[p.place_cm]) for p in points if p.place_cm in zero]
    if len(pairs) < 3:
        return None
    box_c = float(np.mean([p.air_temperature_c for p in points]))
    far = [p.target_temperature_c for p in points if p.target_temperature_c is not None]
    near = [p.air_temperature_c for p in reference if p.air_temperature_c is not None]
    room_c = float(np.mean(far or near or [ROOM_C]))
    range_cm = np.array([p.true_range_cm for p, _ in pairs])
    shift = np.array([p.error.value - q.error.value for p, q in pairs if p.error and q.error])
    errors = [math.hypot(standard_error(p.error), standard_error(q.error)) for p, q in pairs if p.error and q.error]
    confined = _confined(box_c, room_c, calibration_c)
    depth = _depth(range_cm, shift, confined)
    uniform_cm, gradient_cm = confined(range_cm, math.inf), _gradient(range_cm, box_c, room_c, calibration_c)
    confined_cm = confined(range_cm, depth.value)
    n = shift.size
    half = student(float(shift.std(ddof=1)) / math.sqrt(n), n - 1)
    # Correction that the readings call for: slope of -shift over range, in per cent.
    fit = stats.linregress(range_cm, -100.0 * shift)
    per_cent = IntervalEstimate.about(float(fit.slope), student(float(fit.stderr), n - 2), "%", n, "points")
    uniform_per_cent = -float(confined(np.array([100.0]), math.inf)[0])
    ideas: dict[AirBefore, Array] = {"uniform": uniform_cm, "gradient": gradient_cm, "confined": confined_cm}
    squares = {name: float(((shift - idea) ** 2).sum()) for name, idea in ideas.items()}
    # The confined air has a parameter: it must explain significantly more (1.92 in the log-likelihood).
    squares["confined"] *= math.exp(2 * 1.92 / n)
    best = min(squares, key=lambda name: squares[name])
    mean = float(shift.mean())
    # A shift that grows with range has a wide mean and a slope.
    low, high = per_cent.low or 0.0, per_cent.high or 0.0
    is_none = abs(mean) <= half and low <= 0.0 <= high
    compared: Literal["as", "and not"] = "as" if low <= uniform_per_cent <= high else "and not"
    return HotBox(
        level=level,
        box_c=box_c,
        room_c=room_c,
        room_is_assumed=not far and not near,
        depth=depth,
        per_cent=per_cent,
        uniform_per_cent=uniform_per_cent,
        compared=compared,
        rows=tuple(
            HotBoxRow(r, IntervalEstimate.about(s, Z * e, "cm", p.hits), *ideas_here)
            for r, s, e, (p, _), *ideas_here in zip(
                range_cm.tolist(),
                shift.tolist(),
                errors,
                pairs,
                *(each.tolist() for each in ideas.values()),
                strict=True,
            )
        ),
        best="none" if is_none else best,
        answer=(
            f"{box_c:.0f} C at the sensor, {room_c:.0f} C beyond: the mean error moves by {mean:+.2f} cm "
            f"({mean - half:+.2f} to {mean + half:+.2f}) over {range_cm.min():g} to {range_cm.max():g} cm, which is "
            f"{per_cent.value:.1f} % of range {compared} the {uniform_per_cent:.1f} % of air like that all the way; "
            + (
                "no shift is seen"
                if is_none
                else f"air like that over the first {depth.value:.0f} cm explains it ({_ends(depth)})"
                if best == "confined"
                else f"a {best} temperature explains it best"
            )
        ),
    )


def _ends(estimate: IntervalEstimate) -> str:
    low = "any" if estimate.low is None else f"{estimate.low:.0f}"
    high = "any" if estimate.high is None else f"{estimate.high:.0f}"
    return f"{low} to {high} cm"


def _confined(box_c: float, room_c: float, calibration_c: float) -> Callable[[Array, float], Array]:
    """Shift of a reading [cm] where the box's air fills the first so many centimetres."""
    speed = speed_of_sound(calibration_c)
    a_cm = speed / speed_of_sound(box_c) - speed / speed_of_sound(room_c)
    return lambda range_cm, depth_cm: a_cm * np.minimum(range_cm, depth_cm)


def _gradient(range_cm: Array, box_c: float, room_c: float, calibration_c: float) -> Array:
    """Shift of a reading [cm] where the temperature falls linearly from the sensor to the target.

    The time of flight is the integral of dx / c over it, c = k sqrt(T): 2 R / (c_box + c_room) one way.
    """
    speed, box, room = (speed_of_sound(each) for each in (calibration_c, box_c, room_c))
    return range_cm * speed * (2.0 / (box + room) - 1.0 / room)


def _depth(range_cm: Array, shift: Array, confined: Callable[[Array, float], Array]) -> IntervalEstimate:
    """Length of the box's air by least squares, with its interval from the sum of squares."""
    depths = np.linspace(0.0, float(range_cm.max()), 1041)
    squares = np.array([float(((shift - confined(range_cm, depth)) ** 2).sum()) for depth in depths])
    best = int(squares.argmin())
    freedom = range_cm.size - 1
    limit = squares[best] * (1.0 + float(stats.f.ppf(CONFIDENCE, 1, freedom)) / freedom)
    inside = np.flatnonzero(squares <= limit)
    high = None if inside[-1] == depths.size - 1 else float(depths[inside[-1]])
    return IntervalEstimate(float(depths[best]), float(depths[inside[0]]), high, "cm", range_cm.size, "points")


def _by_range(points: Sequence[PointResult]) -> dict[float, PointResult]:
    return {p.place_cm: p for p in reversed(points)}


def compensation_table(points: Sequence[PointReadings], calibration: Calibration) -> tuple[CompensationRow, ...]:
    """Mean error of each range as read and after compensation of the air's temperature.

    Parameters
    ----------
    points
        Of the temperature compensation experiment.
    calibration
        Of the sensor, inverted first: compensation is about the air alone.
    """
    ranges = sorted({round(point.range_cm, 3) for point in points})
    rows = [_row(r, [p for p in points if round(p.range_cm, 3) == r], calibration) for r in ranges]
    return tuple(row for row in rows if row is not None)


def _row(range_cm: float, points: Sequence[PointReadings], calibration: Calibration) -> CompensationRow | None:
    calibration_k = points[0].sensor_model.calibration_temperature_c + ZERO_CELSIUS_K
    hits = np.concatenate([calibration.inverse(p.reading_cm[p.is_hit]) for p in points])
    if hits.size < 3:
        return None
    air_c = np.concatenate([p.air_temperature_c[p.is_hit] for p in points])
    mean, half = float(hits.mean()), half_of_mean(hits, points[0].step_cm)
    uncompensated = IntervalEstimate.about(mean - range_cm, half, "cm", hits.size)
    compensated, thermometer_c = None, None
    if not np.isnan(air_c).any():
        thermometer_c = float(air_c.mean())
        corrected = hits * np.concatenate([p.compensation[p.is_hit] for p in points])
        compensated = IntervalEstimate.about(float(corrected.mean()) - range_cm, half, "cm", hits.size)
    implied = [calibration_k * (range_cm / each) ** 2 - ZERO_CELSIUS_K for each in (mean, mean + half, mean - half)]
    return CompensationRow(
        range_cm=range_cm,
        uncompensated=uncompensated,
        compensated=compensated,
        thermometer_c=thermometer_c,
        implied_c=IntervalEstimate(implied[0], implied[1], implied[2], "deg C", hits.size),
        note=_note(thermometer_c, calibration),
    )


def _note(thermometer_c: float | None, calibration: Calibration) -> str:
    notes = []
    if thermometer_c is None:
        notes.append("no thermometer here, so nothing to compensate with")
    if not calibration.is_identity:
        notes.append("after the calibration")
    return "; ".join(notes)
