"""A vehicle that stands still and level at known heights: noise, heights of the sensors, and the air's temperature.

A person measures the height H of the reference point over the floor with a tape. A sensor z below the reference point
reads r, which was corrected for air of temperature T:

    H = z + s r

s is 1 where T is right. With one height z follows if s is assumed to be 1, with two or more both are fitted. The speed
of sound grows with the root of the temperature in kelvin, so the true one is T s^2.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from msp_range.arrays import Array
from msp_range.commission.motion import Measured, NotMeasured, without_outliers
from msp_range.commission.samples import Samples

TAPE_STD_M = 0.005
"""Standard deviation of a height that a person measures with a tape [m]; a floor is level to about as much."""
SENSOR_STD_M = 0.005
"""Standard deviation of a sensor's own constant error [m]: the report saw none above 1 cm (4.3.1)."""
LEAST_READINGS = 8
"""Of each sensor at each height: 3 s of four sensors that ping in turn."""
LEVEL_RAD = np.radians(5.0)
"""A vehicle that leans more than this does not stand level [rad]: 0.4 % of its height are lost."""
ZERO_C_K = 273.15


@dataclass(frozen=True)
class Stand:
    """The vehicle at one height: what was received, and the height of the reference point over the floor [m]."""

    samples: Samples
    height_m: float


@dataclass(frozen=True)
class Levels:
    """What the heights show."""

    down_m: Mapping[str, Measured]
    """How far below the reference point each sensor is, by name [m]."""
    scale: Measured | None
    """True distance divided by the corrected one; None with one height only."""

    def air_c(self, assumed_c: float) -> Measured | None:
        """The air's temperature, if the distances were corrected for another one [deg C]; None if it is not known."""
        if self.scale is None:
            return None
        kelvin = assumed_c + ZERO_C_K
        return Measured(kelvin * self.scale.value**2 - ZERO_C_K, 2 * kelvin * self.scale.half_width)


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
        found[name] = Measured(std, 1.96 * max(std, 0.003) * float(np.sqrt(1.5 / (2 * len(kept)))))
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
    names = [name for name in vertical if all(name in each for each in medians)]
    if not names:
        raise NotMeasured(
            "no sensor that looks down has distances: raise the vehicle until nothing is nearer than 30 cm to a sensor"
        )
    ranges_m = np.array([[each[name] * vertical[name] for name in names] for each in medians])
    heights_m = np.array([stand.height_m for stand in stands])
    scale_std = 0.5 * air_std_c / (20.0 + ZERO_C_K)
    # Unknown: each sensor's z, and the scale's difference from 1, known beforehand to the thermometer's accuracy where
    # there is one height only. A tape's error is common to the sensors at that height.
    matrix = np.hstack([np.tile(np.eye(len(names)), (len(stands), 1)), ranges_m.reshape(-1, 1)])
    wanted, tape = (heights_m[:, None] - ranges_m).ravel(), np.repeat(heights_m, len(names))
    covariance = SENSOR_STD_M**2 * np.eye(len(wanted)) + TAPE_STD_M**2 * np.equal.outer(tape, tape)
    spread = float(np.ptp(heights_m))
    prior = np.zeros((matrix.shape[1], matrix.shape[1]))
    prior[-1, -1] = 1 / (1.0 if spread >= 0.3 else max(scale_std, 1e-4)) ** 2
    inverse = np.linalg.inv(covariance)
    solved = np.linalg.inv(matrix.T @ inverse @ matrix + prior)
    solution = solved @ matrix.T @ inverse @ wanted
    half = 1.96 * np.sqrt(np.diag(solved))
    down = {name: Measured(float(solution[i]), float(half[i])) for i, name in enumerate(names)}
    scale = Measured(1.0 + float(solution[-1]), float(half[-1])) if spread >= 0.3 else None
    return Levels(down, scale)


def mean_air_c(samples: Samples) -> tuple[float, str] | None:
    """Temperature that the distances were corrected for [deg C], and its source; None without a sensor of sound."""
    known: list[tuple[float, str]] = [
        (each.air_c, each.air_source or "") for each in samples.readings.values() if each.air_c is not None
    ]
    return known[-1] if known else None


def latency_s(samples: Samples) -> float:
    """Shortest time from an echo to its answer [s]; NaN without one. A busy computer adds to the others."""
    known: Array = np.array([each.latency_s for each in samples.readings.values()])
    return float(np.nanmin(known)) if np.isfinite(known).any() else float("nan")
