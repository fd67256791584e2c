"""Readings of four sensors, drawn: a vehicle that climbs, sinks, turns and leans over rough, sloping ground.

A `Ground`, a `Fault` and a generator enter; the readings of all sensors in turn leave, as numpy arrays that `feed`
gives to a `SensorWatch`. Nothing of the bridge or the simulator is used, so hundreds of hours take minutes.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.signal import lfilter

from msp_range.geometry import Vector
from msp_range.health import Expected, GroundUse, SensorWatch, Sighting
from msp_range.health.finding import SensorFinding

SLOT_S, NAMES = 0.1, ("a", "b", "c", "d")
TURN_S = SLOT_S * len(NAMES)
CORNERS_M = ((0.25, -0.2), (0.25, 0.2), (-0.25, -0.2), (-0.25, 0.2))
SIGMA_M = 0.019445
STD_M = math.hypot(SIGMA_M, 0.01 / math.sqrt(12.0))
SHORT, MISSED, RANDOM, SHORT_RATE_PER_M = 0.01, 0.02, 0.01, 0.5
MINIMUM_M, MAXIMUM_M = 0.20, 7.65
DOWN, FACING = (0.0, 0.0, 1.0), math.cos(math.radians(8.0))
MODEL = Expected(SHORT, MISSED, RANDOM, 0.0, 0.0, 1.0, MINIMUM_M, MAXIMUM_M, DOWN, FACING)
"""What `configs/sensors/mb1242.yaml` says, as plain numbers."""
USED_M = 0.15
"""Readings within this of the ground count as used by the fusion [m]."""


@dataclass(frozen=True)
class Ground:
    """What is below the vehicle, and how its sensors err without a fault."""

    rough_m: float = 0.0
    """Standard deviation of the ground's roughness below each sensor [m]."""
    rough_lasts: float = 0.0
    """Correlation of the roughness at a sensor's successive readings: 0 in fast flight, almost 1 in a hover."""
    slope: float = 0.0
    """Rise of the ground per metre."""
    turn_s: float = 60.0
    """Time of a full turn of the vehicle about its vertical axis [s]."""
    correlation: float = 0.0
    """Of the errors of a sensor's successive readings."""
    scale: float = 1.0
    """Factor on all ranges: air that is colder than thought."""


@dataclass(frozen=True)
class Fault:
    """What sensor ``a`` does from a time on."""

    from_s: float
    """When it begins [s]."""
    short: float = SHORT
    missed: float = MISSED
    """Shares of its readings."""
    wider: float = 1.0
    """Factor on its standard deviation."""
    shift_m: float = 0.0
    """Added to its ranges [m]."""


class Drawn(NamedTuple):
    """Readings in the order of their times, (n,): time [s], sensor, range [m], true height and climb, lean [rad]."""

    time_s: NDArray[Any]
    sensor: NDArray[Any]
    range_m: NDArray[Any]
    height_m: NDArray[Any]
    climb_m_s: NDArray[Any]
    lean_rad: NDArray[Any]


def draw(draws: Generator, hours: float, ground: Ground, fault: Fault | None = None, start_s: float = 0.0) -> Drawn:
    """Draw a flight; a reading of no echo has a range of NaN."""
    n = round(hours * 3600.0 / SLOT_S)
    time_s = start_s + np.arange(n) * SLOT_S
    sensor = np.arange(n) % len(NAMES)
    height_m = 3.0 + np.sin(time_s / 17.0) + 0.3 * np.sin(time_s / 3.1) + 0.02 * np.sin(2.1 * time_s)
    lean_rad = np.radians(6.0) * np.sin(time_s / 11.0)
    off_m = height_m * (ground.scale - 1.0)
    is_faulty = np.zeros(n, dtype=bool) if fault is None else (sensor == 0) & (time_s >= fault.from_s)
    for index, (forward_m, right_m) in enumerate(CORNERS_M):
        of = sensor == index
        hits_m = SIGMA_M * _correlated(draws, int(of.sum()), ground.correlation)
        if fault is not None:
            hits_m = np.where(is_faulty[of], fault.wider * hits_m + fault.shift_m, hits_m)
        yaw_rad = 2.0 * np.pi * time_s[of] / ground.turn_s
        uphill_m = np.cos(yaw_rad) * forward_m + np.sin(yaw_rad) * right_m
        rough_m = ground.rough_m * _correlated(draws, int(of.sum()), ground.rough_lasts)
        off_m[of] += hits_m + rough_m - ground.slope * uphill_m
    range_m = np.rint(100.0 * (height_m + off_m)) / 100.0
    kind, place = draws.random(n), draws.random(n)
    short = np.where(is_faulty, fault.short if fault else SHORT, SHORT)
    missed = short + np.where(is_faulty, fault.missed if fault else MISSED, MISSED)
    length_m = height_m - MINIMUM_M
    shorts_m = MINIMUM_M - np.log1p(-place * (1.0 - np.exp(-SHORT_RATE_PER_M * length_m))) / SHORT_RATE_PER_M
    randoms_m = MINIMUM_M + place * (MAXIMUM_M - MINIMUM_M)
    range_m = np.where(kind < missed + RANDOM, np.rint(100.0 * randoms_m) / 100.0, range_m)
    range_m = np.where(kind < missed, np.nan, range_m)
    range_m = np.where(kind < short, np.rint(100.0 * shorts_m) / 100.0, range_m)
    return Drawn(time_s, sensor, range_m, height_m, np.gradient(height_m, SLOT_S), lean_rad)


def _correlated(draws: Generator, n: int, correlation: float) -> NDArray[Any]:
    """Standard normal numbers whose neighbours have this correlation."""
    white = draws.standard_normal(n)
    found: NDArray[Any] = lfilter([math.sqrt(1.0 - correlation**2)], [1.0, -correlation], white)
    return found


def feed(watch: SensorWatch, drawn: Drawn) -> Iterator[tuple[float, SensorFinding]]:
    """Update a watch with all readings, and yield each new finding with its time [s]."""
    known: list[SensorFinding] = []
    off_m = np.abs(drawn.range_m - drawn.height_m)
    rows = (drawn.time_s, drawn.sensor, drawn.range_m, off_m, drawn.climb_m_s, np.sin(drawn.lean_rad))
    for time_s, index, range_m, far_m, climb_m_s, sine in zip(*(each.tolist() for each in rows), strict=True):
        down: Vector = (sine, 0.0, math.sqrt(1.0 - sine * sine))
        if math.isnan(range_m):
            watch.update(Sighting(NAMES[index], time_s, GroundUse.MISSED, None, 0.0, 765, climb_m_s, down))
        else:
            seen = GroundUse.GROUND if far_m < USED_M else GroundUse.OTHER
            watch.update(Sighting(NAMES[index], time_s, seen, range_m, STD_M, round(100 * range_m), climb_m_s, down))
        if watch.findings != known:
            yield from ((time_s, finding) for finding in watch.findings if finding not in known)
            known = list(watch.findings)


def watch_of(model: Expected = MODEL) -> SensorWatch:
    """A watch of the four sensors."""
    return SensorWatch(dict.fromkeys(NAMES, model), TURN_S)
