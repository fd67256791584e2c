"""Air at the sensor and air on the way: the hot box, and temperature compensation.

How long the box's air must be to explain the errors, and mean errors with and without compensation.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from scipy import stats

from msp_lab.characterise.findings import AirBefore, CompensationRow, HotBox, HotBoxRow, Question
from msp_lab.characterise.points import PointReadings, grouped
from msp_lab.estimates import CONFIDENCE, LIKELIHOOD_DROP, IntervalEstimate, Z, fit_line, half_of_mean, mean_of_points
from msp_range.acoustics.air import ZERO_CELSIUS_K, speed_of_sound
from msp_range.arrays import Array
from msp_range.correction.calibration import Calibration

ROOM_C, ROOM_WITHIN_C = 21.1, 5.0
"""Room temperature where nobody measured the air at the target, 70 deg F, and how far a temperature may be from it to
count as room temperature [deg C]. The first is also the air that is assumed outside of a box."""


def hot_boxes(questions: Sequence[Question], calibration_c: float) -> Iterator[HotBox]:
    """Yield a finding for each level of the temperature experiment that is not room temperature.

    `questions` have what each level is compared with, `calibration_c` is the air temperature that the sensor assumes
    [deg C].
    """
    for question in questions:
        if question.name == "temperature":
            yield from _hot_box(question, calibration_c)


def _hot_box(question: Question, calibration_c: float) -> Iterator[HotBox]:
    points = [(p, p.error, p.air_temperature_c) for p in question.points if p.error and p.air_temperature_c is not None]
    zero = {p.place_cm: p.error for p in reversed(question.reference_points) if p.error}
    pairs = [(p, error, other) for p, error, _ in points if (other := zero.get(p.place_cm))]
    if len(pairs) < 3:
        return
    far = [p.target_temperature_c for p, *_ in points if p.target_temperature_c is not None]
    near = [p.air_temperature_c for p in question.reference_points if p.air_temperature_c is not None]
    box_c, room_c = float(np.mean([air_c for *_, air_c in points])), float(np.mean(far or near or [ROOM_C]))
    if abs(box_c - ROOM_C) < ROOM_WITHIN_C:
        return
    range_cm = np.array([p.true_range_cm for p, *_ in pairs])
    shifts = [
        IntervalEstimate.about(
            error.value - other.value, Z * math.hypot(error.standard_error, other.standard_error), p.hits
        )
        for p, error, other in pairs
    ]
    shift_cm = np.array([shift.value for shift in shifts])
    speed, box, room = speed_of_sound(calibration_c), speed_of_sound(box_c), speed_of_sound(room_c)
    # Shift of a reading over each centimetre of the box's air.
    slope = speed / box - speed / room
    mean, depth = mean_of_points(shift_cm), _depth(range_cm, shift_cm, slope)
    # Correction that the readings call for: slope of -shift over range, in per cent.
    per_cent = fit_line(range_cm, -100.0 * shift_cm).estimate(1, "%")
    uniform_per_cent = slope * -100.0
    ideas: dict[AirBefore, Array] = {
        "uniform": slope * range_cm,
        # The time of flight is the integral of dx / c over the way, c = k sqrt(T): 2 R / (c_box + c_room) one way.
        "gradient": range_cm * speed * (2.0 / (box + room) - 1.0 / room),
        "confined": slope * np.minimum(range_cm, depth.value),
    }
    squares: dict[str, float] = {name: float(((shift_cm - idea) ** 2).sum()) for name, idea in ideas.items()}
    # The confined air has a parameter: it must explain significantly more.
    squares["confined"] *= math.exp(2.0 * LIKELIHOOD_DROP / shift_cm.size)
    # A shift that grows with range has a wide mean and a slope.
    is_none = mean.holds(0.0) and per_cent.holds(0.0)
    best: AirBefore | Literal["none"] = "none" if is_none else min(ideas, key=lambda name: squares[name])
    compared: Literal["as", "and not"] = "as" if per_cent.holds(uniform_per_cent) else "and not"
    yield HotBox(
        level=question.level,
        box_c=box_c,
        room_c=room_c,
        room_is_assumed=not far and not near,
        depth=depth,
        per_cent=per_cent,
        uniform_per_cent=uniform_per_cent,
        compared=compared,
        rows=tuple(map(HotBoxRow, range_cm.tolist(), shifts, *(idea.tolist() for idea in ideas.values()))),
        best=best,
        answer=(
            f"{box_c:.0f} C at the sensor, {room_c:.0f} C beyond: the mean error moves by "
            f"{mean} over {range_cm.min():g} to {range_cm.max():g} cm, which is "
            f"{per_cent.value:.1f} % of range {compared} the {uniform_per_cent:.1f} % of air like that all the way; "
            f"{_explanation(best, depth)}"
        ),
    )


def _explanation(best: AirBefore | Literal["none"], depth: IntervalEstimate) -> str:
    if best == "none":
        return "no shift is seen"
    if best != "confined":
        return f"a {best} temperature explains it best"
    return f"air like that over the first {depth} explains it"


def _depth(range_cm: Array, shift_cm: Array, slope: float) -> IntervalEstimate:
    """Length of the box's air by least squares, with its interval from the sum of squares."""
    depths_cm = np.linspace(0.0, range_cm.max(), 1041)
    squares = ((shift_cm - slope * np.minimum(range_cm, depths_cm[:, None])) ** 2).sum(axis=1)
    freedom = range_cm.size - 1
    inside = depths_cm[squares <= squares.min() * (1.0 + stats.f.ppf(CONFIDENCE, 1, freedom) / freedom)].tolist()
    high_cm = None if inside[-1] == depths_cm[-1] else inside[-1]
    return IntervalEstimate(float(depths_cm[squares.argmin()]), inside[0], high_cm, "cm", range_cm.size, "points")


def compensation_table(points: Sequence[PointReadings], calibration: Calibration) -> Iterator[CompensationRow]:
    """Yield the mean error of each range of the compensation experiment as read, and compensated for the temperature.

    The sensor's calibration is inverted first: compensation is about the air alone.
    """
    for range_cm, here in grouped(points, lambda point: round(point.range_cm, 3)).items():
        columns = [
            np.array([calibration.inverse(point.reading_cm), point.air_temperature_c, point.compensation])[
                :, point.is_hit
            ]
            for point in here
        ]
        hit_cm, air_c, factor = np.concatenate(columns, axis=1)
        if hit_cm.size < 3:
            continue
        half, compensated, thermometer_c, notes = half_of_mean(hit_cm, here[0].step_cm), None, None, []
        uncompensated = IntervalEstimate.about(float(hit_cm.mean()) - range_cm, half, hit_cm.size)
        if np.isnan(air_c).any():
            notes.append("no thermometer here, so nothing to compensate with")
        else:
            thermometer_c = float(air_c.mean())
            compensated = IntervalEstimate.about(float((hit_cm * factor).mean()) - range_cm, half, hit_cm.size)
        if not calibration.is_identity:
            notes.append("after the calibration")
        calibration_k = here[0].sensor_model.calibration_temperature_c + ZERO_CELSIUS_K
        # The farther it reads, the colder.
        value, high, low = (
            calibration_k / (1.0 + error_cm / range_cm) ** 2 - ZERO_CELSIUS_K
            for error_cm in (uncompensated.value, *uncompensated.ends)
        )
        implied_c = replace(uncompensated, value=value, low=low, high=high, unit="deg C")
        yield CompensationRow(range_cm, uncompensated, compensated, thermometer_c, implied_c, "; ".join(notes))
