"""Motion of a simulated vehicle: height and horizontal track as functions of time.

The lists of segments of a scenario become `Course` objects, each the motion along one axis. Segments of a real vehicle
change speed along a smooth step with bounded acceleration. The kinds `step`, `ramp` and `random` are those of a bench
(the report's Table 5.3) and change abruptly. Heights are relative to the vehicle's position at the start, up positive
[m].
"""

import math
from bisect import bisect_right
from collections.abc import Callable
from typing import Annotated, Literal

from numpy.random import Generator
from pydantic import Field

from msp_range.yaml_file import Section

MAX_STEP_SLOPE = 1.5
"""Largest slope of the smooth step 3 u^2 - 2 u^3, so the ratio of largest to mean acceleration."""
TERRAIN_STEP_S = 0.05
"""Control period of the terrain follower [s]; smaller follows more smoothly and costs time."""
TERRAIN_GAIN_HZ = 1.0
"""Speed per metre of height error, near the goal [1/s]: typical for an altitude controller."""
RANDOM_RATE_HZ = 10.0
"""Sample rate of the report's random range (5.3.1)."""
SAMPLES_PER_SECTION = (5, 19)
"""Smallest and largest number of samples in a section of the random profile; chosen to look like the report's
figures."""

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
SurfaceHeight = Callable[[float], float]
"""Height of the ground under the vehicle's course above its start [m], by time [s]."""
Motion = tuple[float, float, float]
"""Position [m], speed [m/s] and acceleration [m/s^2] along one axis."""


class Course:
    """Motion along one axis, made of consecutive pieces; at rest after the last one.

    Parameters
    ----------
    position_m
        Start position, at rest [m].

    Attributes
    ----------
    end_s, end_m, end_m_s
        Time, position and speed at the end of the present pieces [s, m, m/s].
    """

    def __init__(self, position_m: float) -> None:
        self.end_s = 0.0
        self.end_m = position_m
        self.end_m_s = 0.0
        self._starts_s: list[float] = []
        self._pieces: list[Callable[[float], Motion]] = []

    def at(self, time_s: float) -> Motion:
        """Position, speed and acceleration at ``time_s``; at rest before the first piece and after the last."""
        if time_s >= self.end_s:
            return self.end_m, 0.0, 0.0
        if time_s < 0.0:
            time_s = 0.0
        index = bisect_right(self._starts_s, time_s) - 1
        return self._pieces[index](time_s - self._starts_s[index])

    def change_speed(self, by_m_s: float, duration_s: float) -> None:
        """Change speed by ``by_m_s`` along a smooth step; the acceleration is at most 1.5 times the mean.

        With u = t / T: v = v0 + dv (3 u^2 - 2 u^3), s = s0 + v0 t + dv T (u^3 - u^4 / 2).
        """
        from_m, from_m_s = self.end_m, self.end_m_s

        def piece(t: float) -> Motion:
            u = t / duration_s
            return (
                from_m + from_m_s * t + by_m_s * duration_s * u * u * u * (1 - u / 2),
                from_m_s + by_m_s * u * u * (3 - 2 * u),
                6 * by_m_s / duration_s * u * (1 - u),
            )

        if duration_s > 0:
            self._append(piece, duration_s, piece(duration_s))

    def coast(self, duration_s: float) -> None:
        """Keep the present speed."""
        self.change_speed(0.0, duration_s)

    def set(self, position_m: float, speed_m_s: float = 0.0) -> None:
        """Jump to another position and speed."""
        self.end_m, self.end_m_s = position_m, speed_m_s

    def swing(self, by_m: float, period_s: float, cycles: int) -> None:
        """Oscillate between here and here + ``by_m``, s = s0 + by (1 - cos(2 pi t / T)) / 2, from rest to rest."""
        from_m, rate = self.end_m, 2 * math.pi / period_s

        def piece(t: float) -> Motion:
            sine, cosine = math.sin(rate * t), math.cos(rate * t)
            return from_m + by_m * (1 - cosine) / 2, by_m * rate * sine / 2, by_m * rate * rate * cosine / 2

        self._append(piece, period_s * cycles, (from_m, 0.0, 0.0))

    def move_to(self, to_m: float, speed_m_s: float, acceleration_m_s2: float) -> None:
        """Move from rest to rest at ``to_m`` with limited speed; over a short distance that speed is not reached."""
        distance_m = abs(to_m - self.end_m)
        # Accelerating and braking each take MAX_STEP_SLOPE v / a at the mean speed v / 2.
        top_speed_m_s = min(speed_m_s, math.sqrt(distance_m * acceleration_m_s2 / MAX_STEP_SLOPE))
        if top_speed_m_s > 0:
            signed_m_s = math.copysign(top_speed_m_s, to_m - self.end_m)
            acceleration_s = MAX_STEP_SLOPE * top_speed_m_s / acceleration_m_s2
            self.change_speed(signed_m_s, acceleration_s)
            self.coast(max(distance_m - top_speed_m_s * acceleration_s, 0.0) / top_speed_m_s)
            self.change_speed(-signed_m_s, acceleration_s)
        self.set(to_m)

    def stop(self, acceleration_m_s2: float) -> None:
        """Come to rest."""
        self.change_speed(-self.end_m_s, MAX_STEP_SLOPE * abs(self.end_m_s) / acceleration_m_s2)
        self.set(self.end_m)

    def _append(self, piece: Callable[[float], Motion], duration_s: float, end: Motion) -> None:
        self._starts_s.append(self.end_s)
        self._pieces.append(piece)
        self.end_s += duration_s
        self.end_m, self.end_m_s, _ = end


class Height(Course):
    """Height above the starting point, from there on.

    Parameters
    ----------
    surface_m
        Height of the surface below the vehicle at a time [s], relative to the starting point [m]; used by landing and
        terrain following only.
    generator
        Draws random levels.
    """

    def __init__(self, surface_m: SurfaceHeight, generator: Generator) -> None:
        super().__init__(0.0)
        self.surface_m = surface_m
        self.generator = generator


class HoldSegment(Section):
    """Keep the present height."""

    kind: Literal["hold"]
    duration_s: Positive
    """duration [s]"""

    def fly(self, height: Height) -> None:
        """Append this segment to ``height``."""
        height.coast(self.duration_s)


class ClimbSegment(Section):
    """Take off, climb or descend to a height, and stop there."""

    kind: Literal["climb"]
    to_m: float
    """height above the starting point [m]"""
    speed_m_s: Positive = 1.0
    """largest vertical speed, up or down [m/s]"""
    acceleration_m_s2: Positive = 1.0
    """largest vertical acceleration [m/s^2]"""

    def fly(self, height: Height) -> None:
        """Append this segment to ``height``."""
        height.move_to(self.to_m, self.speed_m_s, self.acceleration_m_s2)


class LandSegment(Section):
    """Descend to the surface below, and stay on it."""

    kind: Literal["land"]
    speed_m_s: Positive = 0.5
    """largest speed of descent [m/s]"""
    acceleration_m_s2: Positive = 1.0
    """largest vertical acceleration [m/s^2]"""

    def fly(self, height: Height) -> None:
        """Append this segment to ``height``; the surface is that below the vehicle when the segment starts."""
        height.move_to(height.surface_m(height.end_s), self.speed_m_s, self.acceleration_m_s2)


class StepSegment(Section):
    """Jump to another height, as when the target of a bench is replaced."""

    kind: Literal["step"]
    to_m: float
    """height above the starting point [m]"""

    def fly(self, height: Height) -> None:
        """Append this segment to ``height``; it takes no time."""
        height.set(self.to_m)


class RampSegment(Section):
    """Change height at constant speed, with abrupt start and end."""

    kind: Literal["ramp"]
    to_m: float
    """height above the starting point at the end [m]"""
    duration_s: Positive
    """duration [s]"""

    def fly(self, height: Height) -> None:
        """Append this segment to ``height``."""
        _ramp(height, self.to_m, self.duration_s)


class SinusoidSegment(Section):
    """Oscillate between the present height and another one, from rest to rest."""

    kind: Literal["sinusoid"]
    swing_m: float
    """distance from the present height to the other turning point, up positive: twice the amplitude [m]"""
    period_s: Positive
    """period [s]"""
    cycles: Annotated[int, Field(ge=1, le=100_000)]
    """number of whole cycles"""

    def fly(self, height: Height) -> None:
        """Append this segment to ``height``."""
        height.swing(self.swing_m, self.period_s, self.cycles)


class TerrainSegment(Section):
    """Keep a height above the surface below, within the vehicle's limits."""

    kind: Literal["terrain"]
    height_m: Positive
    """height to keep above the surface below [m]"""
    duration_s: Positive
    """duration [s]; if the vehicle still moves at the end, until it has stopped"""
    speed_m_s: Positive = 1.5
    """largest vertical speed [m/s]"""
    acceleration_m_s2: Positive = 2.0
    """largest vertical acceleration [m/s^2]"""

    def fly(self, height: Height) -> None:
        """Append this segment to ``height``.

        Near the goal the speed is proportional to the error; further away it is that from which half of the
        acceleration is enough to stop in time, v = sqrt(a |error|).
        """
        most_change_m_s = self.acceleration_m_s2 * TERRAIN_STEP_S / MAX_STEP_SLOPE
        for _ in range(round(self.duration_s / TERRAIN_STEP_S)):
            error_m = height.surface_m(height.end_s) + self.height_m - height.end_m
            near_m_s, far_m_s = TERRAIN_GAIN_HZ * abs(error_m), math.sqrt(self.acceleration_m_s2 * abs(error_m))
            wanted_m_s = math.copysign(min(near_m_s, far_m_s, self.speed_m_s), error_m)
            change_m_s = min(max(wanted_m_s - height.end_m_s, -most_change_m_s), most_change_m_s)
            height.change_speed(change_m_s, TERRAIN_STEP_S)
        height.stop(self.acceleration_m_s2)


class RandomSegment(Section):
    """The report's random range (5.3): jumps, slopes and short constant sections.

    Sections of 5 to 19 samples at 10 Hz; half of them are constant at a new level, half a ramp from the last value to a
    new level. Levels are uniform between ``low_m`` and ``high_m``. The report has only figures of it; this rule
    reproduces their look.
    """

    kind: Literal["random"]
    duration_s: Positive
    """duration [s]"""
    low_m: float = 2.3
    """lowest level [m]"""
    high_m: float = 3.6
    """highest level [m]"""

    def fly(self, height: Height) -> None:
        """Append this segment to ``height``."""
        fewest, most = SAMPLES_PER_SECTION
        end_s = height.end_s + self.duration_s
        while height.end_s < end_s - 1e-9:
            section_s = int(height.generator.integers(fewest, most, endpoint=True)) / RANDOM_RATE_HZ
            is_ramp = height.generator.random() < 0.5
            level_m = float(height.generator.uniform(self.low_m, self.high_m))
            flown_s = min(section_s, end_s - height.end_s)
            if is_ramp:
                _ramp(height, height.end_m + (level_m - height.end_m) * flown_s / section_s, flown_s)
            else:
                height.set(level_m)
                height.coast(flown_s)


Segment = Annotated[
    HoldSegment
    | ClimbSegment
    | LandSegment
    | StepSegment
    | RampSegment
    | SinusoidSegment
    | TerrainSegment
    | RandomSegment,
    Field(discriminator="kind"),
]


def _ramp(height: Course, to_m: float, duration_s: float) -> None:
    height.set(height.end_m, (to_m - height.end_m) / duration_s)
    height.coast(duration_s)
    height.set(to_m)


class Leg(Section):
    """A part of the horizontal track with constant speed and heading."""

    duration_s: Positive
    """duration [s], including the change of speed at its start"""
    speed_m_s: Annotated[float, Field(ge=0)] = 0.0
    """speed over ground [m/s]; 0: wait"""
    heading_deg: float = 0.0
    """direction of motion, from north to east [deg]"""


class TrackSection(Section):
    """Horizontal motion; after the last leg the vehicle stops."""

    start_m: tuple[float, float] = (0.0, 0.0)
    """north and east coordinates at the start [m]"""
    acceleration_m_s2: Positive = 1.0
    """largest horizontal acceleration [m/s^2]"""
    legs: tuple[Leg, ...] = ()
    """legs in order, from the start of the scenario"""

    def courses(self) -> tuple[Course, Course]:
        """North and east coordinates as functions of time."""
        north, east = Course(self.start_m[0]), Course(self.start_m[1])
        for leg in (*self.legs, None):
            speed_m_s, heading_rad = (leg.speed_m_s, math.radians(leg.heading_deg)) if leg else (0.0, 0.0)
            by_north_m_s = speed_m_s * math.cos(heading_rad) - north.end_m_s
            by_east_m_s = speed_m_s * math.sin(heading_rad) - east.end_m_s
            change_s = MAX_STEP_SLOPE * math.hypot(by_north_m_s, by_east_m_s) / self.acceleration_m_s2
            if leg and change_s > leg.duration_s:
                by_north_m_s *= leg.duration_s / change_s
                by_east_m_s *= leg.duration_s / change_s
                change_s = leg.duration_s
            for course, by_m_s in ((north, by_north_m_s), (east, by_east_m_s)):
                course.change_speed(by_m_s, change_s)
                if leg and leg.duration_s > change_s:
                    course.coast(leg.duration_s - change_s)
        return north, east
