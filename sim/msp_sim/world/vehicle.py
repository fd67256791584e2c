"""Position, attitude and velocity of the simulated vehicle.

A scenario's `FlightSection` gives a `Pose` for any time. It computes with plain floats for speed, because it is called
for every ping. World frame NED with its origin on the ground, body frame FRD.
"""

import math
from collections.abc import Callable, Sequence
from typing import Annotated, NamedTuple

from numpy.random import Generator
from pydantic import Field

from msp_range.geometry import Vector
from msp_range.yaml_file import Section
from msp_sim.world.profiles import Height, Motion, Positive, Segment, TrackSection

GRAVITY_M_S2 = 9.80665
HOVER_THROTTLE = 0.5
"""Throttle at which the thrust equals the weight; typical."""
IDLE_THROTTLE = 0.1
"""Throttle of a vehicle on the ground with its rotors turning; assumed."""
FULL_SWAY_HEIGHT_M = 0.5
"""Height above the surface from which the vehicle sways fully [m]; on the ground it does not sway."""


class Pose(NamedTuple):
    """Position, attitude and velocity of the vehicle at one time."""

    time_s: float
    """Time [s]."""
    position_ned_m: Vector
    """Body frame's origin, north, east and down [m]."""
    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    """Euler angles, intrinsic z-y'-x'' as in `msp_range.geometry` [rad]."""
    velocity_ned_m_s: Vector
    """Velocity north, east and down [m/s]."""
    throttle: float | None = None
    """0 to 1; None if unknown."""
    clearance_m: float = math.inf
    """Height of the vehicle's feet above the surface below [m]; negative: below it; infinite if unknown."""


class Sway(Section):
    """Small irregular oscillation of roll and pitch in flight."""

    roll_rms_deg: Annotated[float, Field(ge=0)] = 1.0
    """root mean square of the roll [deg]; at most 2.5 times this"""
    pitch_rms_deg: Annotated[float, Field(ge=0)] = 1.0
    """root mean square of the pitch [deg]; at most 2.5 times this"""
    period_s: Positive = 2.0
    """typical period [s]"""


class Heave(Section):
    """Small irregular oscillation of the height in flight, as of an autopilot that hunts for its height."""

    rms_m: Annotated[float, Field(ge=0, le=0.5)]
    """root mean square [m]; at most 2.5 times this"""
    period_s: Positive = 3.0
    """typical period [s]"""


class Lean(Section):
    """A time in which the vehicle leans, as in steady wind or in a turn."""

    from_s: Annotated[float, Field(ge=0)]
    """when it begins, from the start of the flight [s]"""
    to_s: Annotated[float, Field(ge=0)]
    """when it ends [s]"""
    roll_deg: float = 0.0
    """roll on top of the mean [deg]"""
    pitch_deg: float = 0.0
    """pitch on top of the mean [deg]"""
    change_s: Positive = 1.0
    """time in which it leans over, after from_s, and in which it straightens up, before to_s [s]"""

    def share(self, time_s: float) -> float:
        """How far the vehicle leans at a time [s]: 0 to 1, along a smooth step 3 u^2 - 2 u^3."""
        u = min(max(min(time_s - self.from_s, self.to_s - time_s) / self.change_s, 0.0), 1.0)
        return u * u * (3 - 2 * u)


class AttitudeSection(Section):
    """The vehicle's attitude."""

    roll_deg: float = 0.0
    """mean roll, right side down positive [deg]"""
    pitch_deg: float = 0.0
    """mean pitch, nose up positive [deg]"""
    yaw_deg: float = 0.0
    """heading of the nose, from north to east [deg]; constant"""
    sway: Sway | None = None
    """oscillation about the mean; default: none"""
    leans: tuple[Lean, ...] = ()
    """times in which it leans; default: none"""
    tilt_with_acceleration: bool = True
    """tilt with horizontal acceleration, as a multicopter does"""


class EulerAngles(NamedTuple):
    """Euler angles of the vehicle [rad]."""

    roll_rad: float
    pitch_rad: float
    yaw_rad: float


class AttitudeModel:
    """The vehicle's Euler angles as a function of time and acceleration.

    Sway is a sum of three sinusoids each in roll and pitch, whose periods and phases ``generator`` draws once.
    """

    def __init__(self, section: AttitudeSection, generator: Generator) -> None:
        self._mean = EulerAngles(*map(math.radians, (section.roll_deg, section.pitch_deg, section.yaw_deg)))
        self._cos_yaw, self._sin_yaw = math.cos(self._mean.yaw_rad), math.sin(self._mean.yaw_rad)
        self._tilts = section.tilt_with_acceleration
        self._leans = section.leans
        sway = section.sway or Sway(roll_rms_deg=0.0, pitch_rms_deg=0.0)
        self._roll_swings = _swings(math.radians(sway.roll_rms_deg), sway.period_s, generator)
        self._pitch_swings = _swings(math.radians(sway.pitch_rms_deg), sway.period_s, generator)

    def at(self, time_s: float, north_m_s2: float, east_m_s2: float, sways: float) -> tuple[float, float, float]:
        """Roll, pitch and yaw [rad] at ``time_s`` with a horizontal acceleration.

        Thrust along the body's up axis balances weight and acceleration if tan(-pitch) = a_forward / g and tan(roll) =
        a_right cos(pitch) / g.

        Parameters
        ----------
        time_s
            Time [s].
        north_m_s2, east_m_s2
            Horizontal acceleration [m/s^2].
        sways
            Factor on the sway, 0 (on the ground) to 1.
        """
        roll_rad, pitch_rad, yaw_rad = self._mean
        if sways:
            roll_rad += sways * _swing_at(self._roll_swings, time_s)
            pitch_rad += sways * _swing_at(self._pitch_swings, time_s)
        for lean in self._leans:
            share = lean.share(time_s)
            roll_rad += share * math.radians(lean.roll_deg)
            pitch_rad += share * math.radians(lean.pitch_deg)
        if self._tilts and (north_m_s2 or east_m_s2):
            forward_m_s2 = self._cos_yaw * north_m_s2 + self._sin_yaw * east_m_s2
            right_m_s2 = self._cos_yaw * east_m_s2 - self._sin_yaw * north_m_s2
            tilt_rad = -math.atan(forward_m_s2 / GRAVITY_M_S2)
            pitch_rad += tilt_rad
            roll_rad += math.atan(right_m_s2 * math.cos(tilt_rad) / GRAVITY_M_S2)
        return roll_rad, pitch_rad, yaw_rad


def _throttle(north_m_s2: float, east_m_s2: float, up_m_s2: float) -> float:
    """Throttle for a given acceleration: thrust over weight times the hover throttle; drag is neglected."""
    thrust_m_s2 = math.hypot(north_m_s2, east_m_s2, GRAVITY_M_S2 + up_m_s2)
    return min(HOVER_THROTTLE * thrust_m_s2 / GRAVITY_M_S2, 1.0)


_Swings = Sequence[tuple[float, float, float]]


def _swings(rms: float, period_s: float, generator: Generator) -> _Swings:
    """Amplitude, in the unit of ``rms``, angular rate [rad/s] and phase [rad] of three sinusoids of equal power."""
    rates = 2 * math.pi / period_s * generator.uniform(0.7, 1.4, 3)
    phases = generator.uniform(0.0, 2 * math.pi, 3)
    swing = rms * math.sqrt(2 / 3)
    return [(swing, rate, phase) for rate, phase in zip(rates.tolist(), phases.tolist(), strict=True)]


def _swing_at(swings: _Swings, time_s: float) -> float:
    return sum([size * math.sin(rate * time_s + phase) for size, rate, phase in swings])


def _swing_motion(swings: _Swings, time_s: float) -> Motion:
    """The sum of the sinusoids with its first and second derivative by time."""
    rate = sum(size * rate * math.cos(rate * time_s + phase) for size, rate, phase in swings)
    bend = sum(-size * rate * rate * math.sin(rate * time_s + phase) for size, rate, phase in swings)
    return _swing_at(swings, time_s), rate, bend


class FlightSection(Section):
    """The vehicle's motion."""

    standing_height_m: Annotated[float, Field(ge=0)] = 0.25
    """height of the body frame's origin above the surface when the vehicle stands on it [m]"""
    altitude: Annotated[tuple[Segment, ...], Field(min_length=1)]
    """heights above the starting point, segment by segment; the vehicle stays where the last one ends"""
    heave: Heave | None = None
    """oscillation about these heights; default: none"""
    track: TrackSection = TrackSection()
    """horizontal motion"""
    attitude: AttitudeSection = AttitudeSection()
    """attitude"""


class Vehicle:
    """A vehicle that flies according to a scenario.

    Parameters
    ----------
    flight
        The scenario's section ``flight``.
    elevation_m
        Height of the surface above the world's origin [m] at a north and east [m], objects included.
    generator
        Draws random heights and the sway.

    Attributes
    ----------
    duration_s : float
        End of the last segment of the altitude profile [s].
    """

    def __init__(
        self, flight: FlightSection, elevation_m: Callable[[float, float], float], generator: Generator
    ) -> None:
        altitude_generator, attitude_generator, heave_generator = generator.spawn(3)
        self._elevation_m = elevation_m
        self._standing_height_m = flight.standing_height_m
        self._north, self._east = flight.track.courses()
        self._start_elevation_m = elevation_m(*flight.track.start_m)
        self._height = Height(self._surface_m, altitude_generator)
        for segment in flight.altitude:
            segment.fly(self._height)
        self._attitude = AttitudeModel(flight.attitude, attitude_generator)
        heave = flight.heave
        self._heave = _swings(heave.rms_m, heave.period_s, heave_generator) if heave else None
        self.duration_s = self._height.end_s
        self._newest = self._pose(0.0)

    def pose(self, time_s: float) -> Pose:
        """Pose at ``time_s``; before 0 and after the end the vehicle is at rest."""
        # A ping, its truth and the autopilot's messages often ask for the same time.
        if time_s != self._newest.time_s:
            self._newest = self._pose(time_s)
        return self._newest

    def _pose(self, time_s: float) -> Pose:
        north_m, north_m_s, north_m_s2 = self._north.at(time_s)
        east_m, east_m_s, east_m_s2 = self._east.at(time_s)
        height_m, climb_m_s, climb_m_s2 = self._height.at(time_s)
        elevation_m = self._start_elevation_m + height_m
        surface_m = self._elevation_m(north_m, east_m)
        above_surface_m = elevation_m - surface_m
        sways = 1.0 if above_surface_m >= FULL_SWAY_HEIGHT_M else max(above_surface_m / FULL_SWAY_HEIGHT_M, 0.0)
        if self._heave is not None and sways > 0.0:
            heave_m, heave_m_s, heave_m_s2 = _swing_motion(self._heave, time_s)
            # Near the ground it grows with the height, so that its rate does with the climb.
            growing_hz = climb_m_s / FULL_SWAY_HEIGHT_M if sways < 1.0 else 0.0
            elevation_m += sways * heave_m
            climb_m_s += sways * heave_m_s + growing_hz * heave_m
            climb_m_s2 += sways * heave_m_s2 + 2 * growing_hz * heave_m_s
        down_m = -elevation_m - self._standing_height_m
        return Pose(
            time_s,
            (north_m, east_m, down_m),
            *self._attitude.at(time_s, north_m_s2, east_m_s2, sways),
            (north_m_s, east_m_s, -climb_m_s),
            _throttle(north_m_s2, east_m_s2, climb_m_s2) if above_surface_m > 0.0 else IDLE_THROTTLE,
            -down_m - self._standing_height_m - surface_m,
        )

    def _surface_m(self, time_s: float) -> float:
        """Height of the surface below the vehicle relative to its starting point [m]."""
        return self._elevation_m(self._north.at(time_s)[0], self._east.at(time_s)[0]) - self._start_elevation_m
