"""Where the simulated vehicle is, how it is turned and how fast it moves.

A scenario's flight enters, a `Pose` for each time asked leaves. Plain floats, as it is asked about for every ping.
World frame NED with its origin on the ground, body frame FRD.
"""

import math
from collections.abc import Callable
from typing import Annotated, NamedTuple

from numpy.random import Generator
from pydantic import Field

from msp_range.geometry import Vector
from msp_range.yaml_file import Section
from msp_sim.world.profiles import Positive, Segment, TrackSection, altitude

GRAVITY_M_S2 = 9.80665
HOVER_THROTTLE = 0.5
"""At which the thrust carries the weight: a usual layout."""
IDLE_THROTTLE = 0.1
"""Of a vehicle that stands with its rotors turning, assumed."""
SWAYS_FULLY_AT_M = 0.5
"""Height above the surface from which on the whole sway shows; a vehicle that stands does not sway [m]."""


class Pose(NamedTuple):
    """The vehicle at one time.

    Attributes
    ----------
    time_s
        Time [s].
    position_ned_m
        Of the body frame's origin, north, east and down [m].
    roll_rad, pitch_rad, yaw_rad
        Euler angles, intrinsic z-y'-x'' as in `msp_range.geometry` [rad].
    velocity_ned_m_s
        North, east and down [m/s].
    throttle
        0 to 1; None where it is not known.
    """

    time_s: float
    position_ned_m: Vector
    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    velocity_ned_m_s: Vector
    throttle: float | None = None


class Sway(Section):
    """Small irregular swings in roll and pitch while the vehicle flies."""

    roll_rms_deg: Annotated[float, Field(ge=0)] = 1.0
    """root mean square of the roll [deg]; it never exceeds 2.5 times this"""
    pitch_rms_deg: Annotated[float, Field(ge=0)] = 1.0
    """root mean square of the pitch [deg]; it never exceeds 2.5 times this"""
    period_s: Positive = 2.0
    """typical time of one swing [s]"""


class AttitudeSection(Section):
    """How the vehicle is turned."""

    roll_deg: float = 0.0
    """mean roll, right side down positive [deg]"""
    pitch_deg: float = 0.0
    """mean pitch, nose up positive [deg]"""
    yaw_deg: float = 0.0
    """heading of the nose, from north to east [deg]; constant"""
    sway: Sway | None = None
    """swings about the mean; none where it is absent"""
    tilt_with_acceleration: bool = True
    """lean into horizontal acceleration as a multicopter must"""


class EulerAngles(NamedTuple):
    """Euler angles of the vehicle [rad]."""

    roll_rad: float
    pitch_rad: float
    yaw_rad: float


class AttitudeModel:
    """The vehicle's Euler angles as a function of time and of what it does.

    Sway is a sum of three sinusoids in roll and in pitch, whose periods and phases ``generator`` draws: irregular,
    smooth, and the same whenever it is asked.
    """

    def __init__(self, section: AttitudeSection, generator: Generator) -> None:
        self._mean = EulerAngles(*(math.radians(a) for a in (section.roll_deg, section.pitch_deg, section.yaw_deg)))
        self._cos_yaw, self._sin_yaw = math.cos(self._mean.yaw_rad), math.sin(self._mean.yaw_rad)
        self._tilts = section.tilt_with_acceleration
        sway = section.sway or Sway(roll_rms_deg=0.0, pitch_rms_deg=0.0)
        self._roll_swings = _swings(sway.roll_rms_deg, sway.period_s, generator)
        self._pitch_swings = _swings(sway.pitch_rms_deg, sway.period_s, generator)

    def at(self, time_s: float, north_m_s2: float, east_m_s2: float, sways: float) -> tuple[float, float, float]:
        """Roll, pitch and yaw [rad] at ``time_s`` under a horizontal acceleration.

        Thrust along the body's up axis gives the acceleration and carries the weight where tan(-pitch) = a_forward / g
        and tan(roll) = a_right cos(pitch) / g.

        Parameters
        ----------
        time_s
            Time [s].
        north_m_s2, east_m_s2
            Horizontal acceleration [m/s^2].
        sways
            Share of the sway that shows, 0 (it stands) to 1.
        """
        roll_rad, pitch_rad, yaw_rad = self._mean
        if sways:
            roll_rad += sways * _swing_at(self._roll_swings, time_s)
            pitch_rad += sways * _swing_at(self._pitch_swings, time_s)
        if self._tilts and (north_m_s2 or east_m_s2):
            forward_m_s2 = self._cos_yaw * north_m_s2 + self._sin_yaw * east_m_s2
            right_m_s2 = self._cos_yaw * east_m_s2 - self._sin_yaw * north_m_s2
            tilt_rad = -math.atan(forward_m_s2 / GRAVITY_M_S2)
            pitch_rad += tilt_rad
            roll_rad += math.atan(right_m_s2 * math.cos(tilt_rad) / GRAVITY_M_S2)
        return roll_rad, pitch_rad, yaw_rad


def _throttle(north_m_s2: float, east_m_s2: float, up_m_s2: float) -> float:
    """Thrust over weight, in units of the throttle at which the vehicle hovers; drag is left out."""
    thrust_m_s2 = math.hypot(north_m_s2, east_m_s2, GRAVITY_M_S2 + up_m_s2)
    return min(HOVER_THROTTLE * thrust_m_s2 / GRAVITY_M_S2, 1.0)


_Swing = tuple[float, float, float]


def _swings(rms_deg: float, period_s: float, generator: Generator) -> tuple[_Swing, _Swing, _Swing]:
    """Amplitude [rad], angular rate [rad/s] and phase [rad] of three sinusoids of equal power."""
    rates = 2 * math.pi / period_s * generator.uniform(0.7, 1.4, 3)
    phases = generator.uniform(0.0, 2 * math.pi, 3)
    swing_rad = math.radians(rms_deg) * math.sqrt(2 / 3)
    one, two, three = [(swing_rad, float(rate), float(phase)) for rate, phase in zip(rates, phases, strict=True)]
    return one, two, three


def _swing_at(swings: tuple[_Swing, _Swing, _Swing], time_s: float) -> float:
    # Written out, because it is asked for every message of the autopilot.
    (a, rate_a, phase_a), (b, rate_b, phase_b), (c, rate_c, phase_c) = swings
    return (
        a * math.sin(rate_a * time_s + phase_a)
        + b * math.sin(rate_b * time_s + phase_b)
        + c * math.sin(rate_c * time_s + phase_c)
    )


class FlightSection(Section):
    """What the vehicle does."""

    standing_height_m: Annotated[float, Field(ge=0)] = 0.25
    """height of the body frame's origin above the surface that the vehicle stands on [m]"""
    altitude: Annotated[tuple[Segment, ...], Field(min_length=1)]
    """heights over the starting place, segment by segment; the vehicle stays where the last one ends"""
    track: TrackSection = TrackSection()
    """where it goes over the ground"""
    attitude: AttitudeSection = AttitudeSection()
    """how it is turned"""


class Vehicle:
    """A vehicle that flies what a scenario says.

    Parameters
    ----------
    flight
        The scenario's section.
    elevation_m
        Height of the surface at a north and east [m] over the world's origin [m], objects included.
    generator
        Draws the random heights and the sway.

    Attributes
    ----------
    duration_s : float
        When the last segment of the altitude profile ends [s].
    """

    def __init__(
        self, flight: FlightSection, elevation_m: Callable[[float, float], float], generator: Generator
    ) -> None:
        altitude_generator, attitude_generator = generator.spawn(2)
        self._elevation_m = elevation_m
        self._standing_height_m = flight.standing_height_m
        self._north, self._east = flight.track.courses()
        self._start_elevation_m = elevation_m(*flight.track.start_m)
        self._height = altitude(flight.altitude, self._surface_m, altitude_generator)
        self._attitude = AttitudeModel(flight.attitude, attitude_generator)
        self.duration_s = self._height.end_s
        self._newest = self._pose(0.0)

    def pose(self, time_s: float) -> Pose:
        """The vehicle at ``time_s``; before 0 and after the end it rests."""
        # A ping, its truth and the autopilot's messages ask about the same time.
        if time_s != self._newest.time_s:
            self._newest = self._pose(time_s)
        return self._newest

    def _pose(self, time_s: float) -> Pose:
        north_m, north_m_s, north_m_s2 = self._north.at(time_s)
        east_m, east_m_s, east_m_s2 = self._east.at(time_s)
        height_m, climb_m_s, climb_m_s2 = self._height.at(time_s)
        elevation_m = self._start_elevation_m + height_m
        above_surface_m = elevation_m - self._elevation_m(north_m, east_m)
        sways = min(max(above_surface_m / SWAYS_FULLY_AT_M, 0.0), 1.0)
        roll_rad, pitch_rad, yaw_rad = self._attitude.at(time_s, north_m_s2, east_m_s2, sways)
        return Pose(
            time_s,
            (north_m, east_m, -elevation_m - self._standing_height_m),
            roll_rad,
            pitch_rad,
            yaw_rad,
            (north_m_s, east_m_s, -climb_m_s),
            _throttle(north_m_s2, east_m_s2, climb_m_s2) if above_surface_m > 0.0 else IDLE_THROTTLE,
        )

    def clearance_m(self, time_s: float) -> float:
        """How far the vehicle's feet are above the surface below [m]; negative where they are in it."""
        north_m, east_m, down_m = self.pose(time_s).position_ned_m
        return -down_m - self._standing_height_m - self._elevation_m(north_m, east_m)

    def _surface_m(self, time_s: float) -> float:
        """Height of the surface below the vehicle over its starting place [m]."""
        return self._elevation_m(self._north.at(time_s)[0], self._east.at(time_s)[0]) - self._start_elevation_m
