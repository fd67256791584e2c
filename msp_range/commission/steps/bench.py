"""The vehicle still and level at known heights: noise, heights of the sensors, and the air's temperature.

A person measures the height H of the reference point over the floor with a tape. A sensor z below the reference point
reads r, which was corrected for air of temperature T:

    H = z + s r

s is 1 where T is right. With one height z follows if s is assumed to be 1, with two or more both are fitted. The speed
of sound grows with the root of the temperature in kelvin, so the true one is T s^2.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from msp_range.acoustics.air import FIXED, TWO_SIDED_95_PERCENT, ZERO_CELSIUS_K, source_in_words
from msp_range.commission.edit import Edit
from msp_range.commission.motion import Measured, NotMeasured, without_outliers
from msp_range.commission.noise import compare_noise
from msp_range.commission.outcome import StepOutcome, shown
from msp_range.commission.samples import Samples, samples_of
from msp_range.commission.session import Session
from msp_range.commission.steps.places import DEEPER_M
from msp_range.config import Airframe, SensorSettings

TAPE_STD_M = 0.005
"""Standard deviation of a height that a person measures with a tape [m]; a floor is level to about as much."""
SENSOR_STD_M = 0.005
"""Standard deviation of a sensor's own constant error [m]: the report saw none above 1 cm (4.3.1)."""
LEAST_READINGS = 8
"""Readings of each sensor at each height, at least: 3 s of four sensors that ping in turn."""
LEVEL_RAD = np.radians(5.0)
"""A vehicle that leans more than this does not stand level [rad]: 0.4 % of its height are lost."""
LEAD_S, STILL_S = 2.0, 15.0
"""Time for the hands to go, and time that is measured [s]: 37 readings of each of four sensors."""
ELSEWHERE_M = 0.6
"""A sensor this far from where the file has it [m] does not look at the floor: the lift shows where it looks."""
WARMER_C = 4.0
"""An air temperature that differs by less [deg C] stays: 0.7 % of the distance, of which a tape gives half."""
TEXT = """\
Bench check: noise, heights and air. Propellers off. Put the vehicle level on a stand, so that its sensors see a flat
hard floor from 0.4 to 2 m (across two chairs, say), and measure with a tape how high its reference point is above the
floor: the point from which the positions in the file count, [0, 0, 0], usually the autopilot. A second height that is
at least 0.5 m higher also shows whether the air temperature is right."""
QUESTION = "How high is the reference point above the floor now? Then take your hands off."


@dataclass(frozen=True)
class Stand:
    """The vehicle at one height: what was received, and the height of the reference point over the floor [m]."""

    samples: Samples
    height_m: float


@dataclass(frozen=True)
class Levels:
    """Results of holding the vehicle level at measured heights."""

    down_m: Mapping[str, Measured]
    """How far below the reference point each sensor is, by name [m]."""
    scale: Measured | None
    """True distance divided by the corrected one; None with one height only."""

    def air_c(self, assumed_c: float) -> Measured | None:
        """The air's temperature, if the distances were corrected for another one [deg C]; None if it is not known."""
        if self.scale is None:
            return None
        kelvin = assumed_c + ZERO_CELSIUS_K
        return Measured(kelvin * self.scale.value**2 - ZERO_CELSIUS_K, 2 * kelvin * self.scale.half_width)


def median_ranges_m(samples: Samples) -> dict[str, float]:
    """Median distance of each sensor that has enough of them, by name [m]."""
    return {
        name: float(np.median(readings.range_m[readings.is_distance]))
        for name, readings in samples.readings.items()
        if readings.is_distance.sum() >= LEAST_READINGS
    }


def noise_m(samples: Samples) -> dict[str, Measured]:
    """Standard deviation of the single readings of each sensor while nothing moves, by name [m].

    From the differences of successive readings, so that a slow drift does not count; outliers do not count either. The
    rounding to whole centimetres is taken off.
    """
    found = {}
    for name, readings in samples.readings.items():
        steps = np.diff(readings.range_m[readings.is_distance])
        if len(steps) < LEAST_READINGS:
            continue
        kept = without_outliers(steps, 0.01)
        variance = float(np.mean(kept**2)) / 2 - 0.01**2 / 12
        std = float(np.sqrt(max(variance, 0.0)))
        # Successive differences share a reading: 1.5 times the variance of independent ones.
        found[name] = Measured(std, TWO_SIDED_95_PERCENT * max(std, 0.003) * float(np.sqrt(1.5 / (2 * len(kept)))))
    return found


def tilt_rad(samples: Samples) -> float:
    """How far the vehicle leans, by the autopilot [rad]; NaN where no attitude was received."""
    if not len(samples.attitude):
        return float("nan")
    return float(np.hypot(*np.median(samples.attitude[:, 1:], axis=0)))


def levels(stands: Sequence[Stand], vertical: Mapping[str, float], air_std_c: float) -> Levels:
    """Heights of the sensors below the reference point, and the scale of the distances.

    Parameters
    ----------
    stands
        At least one height.
    vertical
        Share of each sensor's distance that is vertical, by name: 1 for a sensor that reads the nearest point of the
        floor, the cosine of its tilt for one that reads along its axis. Sensors that are left out do not look down.
    air_std_c
        Standard deviation of the temperature that the distances were corrected for [deg C].

    Raises
    ------
    NotMeasured
        No sensor has distances at all heights.
    """
    medians = [median_ranges_m(stand.samples) for stand in stands]
    names = [name for name in vertical if all(name in median for median in medians)]
    if not names:
        raise NotMeasured(
            "no sensor that looks down has distances: raise the vehicle until nothing is nearer than 30 cm to a sensor"
        )
    ranges_m = np.array([[median[name] * vertical[name] for name in names] for median in medians])
    heights_m = np.array([stand.height_m for stand in stands])
    scale_std = 0.5 * air_std_c / (20.0 + ZERO_CELSIUS_K)
    # Unknown: each sensor's z, and the scale's difference from 1, known beforehand to the thermometer's accuracy where
    # there is one height only. A tape's error is common to the sensors at that height.
    matrix = np.hstack([np.tile(np.eye(len(names)), (len(stands), 1)), ranges_m.reshape(-1, 1)])
    wanted, tape = (heights_m[:, None] - ranges_m).ravel(), np.repeat(heights_m, len(names))
    covariance = SENSOR_STD_M**2 * np.eye(len(wanted)) + TAPE_STD_M**2 * np.equal.outer(tape, tape)
    spread = float(np.ptp(heights_m))
    prior = np.diag([0.0] * len(names) + [1 / (1.0 if spread >= 0.3 else max(scale_std, 1e-4)) ** 2])
    inverse = np.linalg.inv(covariance)
    solved = np.linalg.inv(matrix.T @ inverse @ matrix + prior)
    solution = solved @ matrix.T @ inverse @ wanted
    half = TWO_SIDED_95_PERCENT * np.sqrt(np.diag(solved))
    down = {name: Measured(float(solution[i]), float(half[i])) for i, name in enumerate(names)}
    scale = Measured(1.0 + float(solution[-1]), float(half[-1])) if spread >= 0.3 else None
    return Levels(down, scale)


def mean_air_c(samples: Samples) -> tuple[float, str] | None:
    """Temperature that the distances were corrected for [deg C], and its source; None without a sensor of sound."""
    known: list[tuple[float, str]] = [
        (of_sensor.air_c, of_sensor.air_source or "")
        for of_sensor in samples.readings.values()
        if of_sensor.air_c is not None
    ]
    return known[-1] if known else None


def run(session: Session) -> StepOutcome:
    """Measure at each height that the person gives."""
    operator = session.operator
    operator.begin(TEXT)
    stands: list[Stand] = []
    loose: list[Samples] = []
    while len(stands) < 3:
        height_m = operator.height_m(QUESTION if not stands else f"{QUESTION} (another height)")
        if height_m is None and (stands or loose):
            break
        with session.live() as live:
            operator.instruct(f"Leave it still for {STILL_S:.0f} s.")
            live.record(LEAD_S)
            samples = samples_of(live.record(STILL_S))
        if height_m is None:
            loose.append(samples)
        else:
            stands.append(Stand(samples, height_m))
    return compare(session.airframe(), stands, stands[0].samples if stands else loose[0])


def compare(airframe: Airframe, stands: Sequence[Stand], still: Samples, flown: Airframe | None = None) -> StepOutcome:
    """What the stands mean for the airframe file.

    Parameters
    ----------
    airframe
        The file.
    stands
        Measured heights; none: only noise and latency are known.
    still
        What was received while nothing moved.
    flown
        The file as it was then; None: the same.
    """
    flown = flown or airframe
    outcome = StepOutcome(again=lambda changed: compare(changed, stands, still, flown))
    tilts = [tilt_rad(stand.samples) for stand in stands]
    if any(tilt > LEVEL_RAD for tilt in tilts):
        text = f"the autopilot reports that it leans by {math.degrees(max(tilts)):.0f} deg"
        outcome.wrong("level", text, "put it level, or calibrate the autopilot's level, then again")
        return outcome
    noise = noise_m(still)
    outcome.measured["noise_cm"] = {name: round(100 * std_m.value, 2) for name, std_m in noise.items()}
    compare_noise(airframe, noise, "while still", outcome)
    # A busy computer adds to the others.
    answer_s = min((of_sensor.latency_s for of_sensor in still.readings.values()), default=math.inf)
    if math.isfinite(answer_s):
        outcome.measured["echo_to_answer_s"] = round(answer_s, 4)
        outcome.right("latency", f"{1e3 * answer_s:.0f} ms from the echo to its answer")
    if not stands:
        text = "no height was measured: heights and air temperature of the file are not checked"
        outcome.unknown("heights", text, "answer with a height, or give --height METRES")
        return outcome
    vertical = {sensor.name: _vertical(sensor) for sensor in airframe.sensors if sensor.tilt_from_down_rad < 0.8}
    air = mean_air_c(still)
    try:
        found = levels(stands, vertical, airframe.temperature.fixed_std_c if air and air[1] == FIXED else 2.0)
    except NotMeasured as error:
        outcome.wrong("heights", str(error), "then again")
        return outcome
    _heights(airframe, found, stands, outcome)
    if air is not None:
        used_c, source = air
        _air(airframe, found.air_c(used_c), used_c + _warmer_c(airframe, flown, source), source, outcome)
    return outcome


def _vertical(sensor: SensorSettings) -> float:
    """Share of its distance that is vertical over a level floor, as the fusion has it."""
    slant = {"slant": 1.0, "nearest": 0.0, "unknown": 0.5}[sensor.sensor_model.oblique_reading]
    return slant * math.cos(sensor.tilt_from_down_rad) + 1.0 - slant


def _heights(airframe: Airframe, found: Levels, stands: Sequence[Stand], outcome: StepOutcome) -> None:
    first = median_ranges_m(stands[0].samples)
    by_m: list[float] = []
    for i, sensor in enumerate(airframe.sensors):
        if sensor.tilt_from_down_rad >= 0.8:
            continue
        measured, in_file, step = found.down_m.get(sensor.name), sensor.position_m[2], f"height of {sensor.name}"
        expected_m = stands[0].height_m - in_file
        if measured is None:
            text = f"no distance where {expected_m:.2f} m are expected"
            outcome.unknown(step, text, "the lift shows where it looks")
            continue
        off_m, below = measured.value - in_file, f"{shown(measured)} below the reference point"
        if abs(off_m) > ELSEWHERE_M:
            text = f"it reads {first[sensor.name]:.2f} m where {expected_m:.2f} m are expected"
            remedy = "was the right height typed, and does it look at the floor? The lift shows where it looks"
            outcome.unknown(step, text, remedy)
        elif measured.differs_from(in_file, DEEPER_M):
            by_m.append(off_m)
            text = f"{sensor.name}: {below}, and the file has {in_file:g}"
            outcome.propose(text, Edit(("sensors", i, "position_m", 2), round(measured.value, 2)))
        else:
            outcome.right(step, f"{below}, {in_file:g} in the file")
    if len(by_m) > 1 and len(by_m) == len(found.down_m) and max(by_m) - min(by_m) < 0.03:
        text = f"all sensors are {abs(by_m[0]):.2f} m {'lower' if by_m[0] > 0 else 'higher'} than the file says"
        remedy = "was the tape held at the reference point, [0, 0, 0] of the file?"
        outcome.unknown("heights", text, remedy)


def _warmer_c(airframe: Airframe, flown: Airframe, source: str) -> float:
    """How much warmer the air would be by a changed file [deg C]."""
    if source == FIXED:
        return airframe.temperature.fixed_c - flown.temperature.fixed_c
    bias_c = {thermometer.name: thermometer.bias_c for thermometer in airframe.temperature.sources}
    bias_then_c = {thermometer.name: thermometer.bias_c for thermometer in flown.temperature.sources}
    return bias_then_c.get(source, 0.0) - bias_c.get(source, 0.0)


def _air(airframe: Airframe, measured: Measured | None, assumed_c: float, source: str, outcome: StepOutcome) -> None:
    if measured is None:
        outcome.unknown("air temperature", "one height does not show it", "measure at a second height")
        return
    text = f"by the distances the air has {shown(measured, 'C', 0)}; used are {assumed_c:.0f} C, "
    text += source_in_words(source)
    if not measured.differs_from(assumed_c, WARMER_C):
        outcome.right("air temperature", text)
        return
    sources, fixed_c = [thermometer.name for thermometer in airframe.temperature.sources], airframe.temperature.fixed_c
    if source in sources:
        i = sources.index(source)
        before_c = airframe.temperature.sources[i].bias_c
        bias_c = round(before_c + assumed_c - measured.value)
        edit = Edit(("temperature", "sources", i, "bias_c"), bias_c)
        outcome.propose(f"{text}: bias_c of {source} from {before_c:g} to {bias_c}", edit)
    elif source == FIXED and not sources:
        edit = Edit(("temperature", "fixed_c"), round(measured.value))
        outcome.propose(f"{text}: fixed_c from {fixed_c:g} to {edit.value}", edit)
    else:
        outcome.unknown("air temperature", text, "its source has no value now: see 'msp-range doctor'")
