"""What the other sensors say of the height at the time of a sensor's reading: a leave-one-out reference.

Given the heights that successive readings of all sensors show, it estimates the height at the time of the reading in
the middle of the window from the readings of the others around it. Up to two before and two after are averaged, and the
line through the two means is read at the reading's time, so a steady climb costs nothing. The reading itself, and all
others of its sensor, take no part.
"""

from collections.abc import Sequence
from enum import Enum
from typing import NamedTuple

from msp_range.geometry import Vector

ACCELERATION_M_S2 = 0.5
"""Standard deviation of the vehicle's acceleration [m/s^2], which bends the line between the readings before and those
after: 0.6 cm at 0.1 s. Smaller takes manoeuvres for scatter, larger hides scatter of good sensors."""
LARGEST_SPREAD = 4.0
"""Readings that are farther from the line than so many standard deviations are not of one ground: no reference."""
MOST_CLIMB_ERROR_M_S = 0.6
"""Where the line climbs faster or slower than the vehicle by so much, the ground has a step: no reference [m/s]. The
fused climb lags behind a hard start by half of this."""


class GroundUse(Enum):
    """What a reading was for the fused ground."""

    GROUND = "ground"
    """used for it"""
    OTHER = "other"
    """a range that does not fit it"""
    MISSED = "missed"
    """the code for no echo, or its damaged form"""
    REPEATED = "repeated"
    """the same answer as before, where others see other things"""
    NOTHING = "nothing"
    """a fault, or a range that nothing is known about"""


class Sighting(NamedTuple):
    """One reading, and what the vehicle did."""

    sensor: str
    """Name of the sensor."""
    time_s: float
    """Time of the echo [s]."""
    seen: GroundUse
    """What it was for the fused ground."""
    height_m: float | None
    """Height of the reference point over level ground by this reading alone [m]; None without a range."""
    std_m: float
    """Standard deviation of the reading [m]; 0 without a range."""
    raw: float | None
    """The sensor's answer."""
    climb_m_s: float
    """How fast the vehicle climbs by all sensors [m/s]; of a single one by its barometer, 0 where there is none."""
    down: Vector | None
    """Straight down, a unit vector in body FRD; None where the attitude is not known."""
    common_m: float | None = None
    """The height without the sensor's own offset from the others [m]; None where the reading is not of the ground, so
    that it is no reference for others."""


class ReferenceHeight(NamedTuple):
    """The height by the others."""

    height_m: float
    variance_m2: float
    """Height at the reading's time [m], and the variance of its error by the readings' own deviation [m^2]."""
    climb_m_s: float
    """How fast it grows [m/s]."""


def reference(window: Sequence[Sighting], middle: int, scale: float) -> ReferenceHeight | None:
    """The height at the time of the window's reading ``middle`` by the other sensors; None where they do not agree.

    Parameters
    ----------
    window
        Successive readings of all sensors.
    middle
        Index of the reading.
    scale
        Variance of the readings over that of their model, more than 1 on rough ground.
    """
    this = window[middle]
    before = _mean(window[:middle][::-1], this.sensor)
    after = _mean(window[middle + 1 :], this.sensor)
    if before is None or after is None:
        return None
    before_m, before_s, first_m, first_s, befores, variance_m2 = before
    after_m, after_s, last_m, last_s, afters, _ = after
    if after_s <= before_s:
        return None
    slope = (after_m - before_m) / (after_s - before_s)
    spread_m2 = 2.0 * LARGEST_SPREAD * LARGEST_SPREAD * scale * variance_m2
    if (
        abs(slope - this.climb_m_s) > MOST_CLIMB_ERROR_M_S
        or (first_m - slope * first_s) ** 2 > spread_m2
        or (last_m - slope * last_s) ** 2 > spread_m2
    ):
        return None
    early_s, late_s = this.time_s - before_s, after_s - this.time_s
    share = early_s / (early_s + late_s)
    bend_m = 0.5 * ACCELERATION_M_S2 * early_s * late_s
    variance_m2 *= (1.0 - share) ** 2 / befores + share**2 / afters
    return ReferenceHeight(before_m + slope * early_s, variance_m2 + bend_m**2, slope)


def _mean(sightings: Sequence[Sighting], sensor: str) -> tuple[float, float, float, float, int, float] | None:
    """The first two of these readings that are of other sensors: their mean height and time, by how much the second
    differs in both, how many there are, and the variance of the first [m^2]; None: there are none."""
    heights = [
        (each.common_m, each.time_s, each.std_m**2)
        for each in sightings
        if each.common_m is not None and each.sensor != sensor
    ][:2]
    if not heights:
        return None
    (first_m, first_s, variance_m2), (last_m, last_s, _) = heights[0], heights[-1]
    apart_m, apart_s = last_m - first_m, last_s - first_s
    return first_m + 0.5 * apart_m, first_s + 0.5 * apart_s, apart_m, apart_s, len(heights), variance_m2
