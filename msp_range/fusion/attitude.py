"""How the vehicle is turned at the time of an echo, from the autopilot's ATTITUDE messages.

Between the newest two messages the angles are interpolated, since an echo is older than the message that comes after
it. Where none is sent, or the last one is old, the rotation is not known.
"""

import math
from typing import NamedTuple

from msp_range.geometry import Matrix, Vector, down_axis, rotation_matrix
from msp_range.numbers import limited
from msp_range.pilot_texts import Condition, Text

OLDEST_S = 0.6
"""An attitude this much older than the echo says nothing of it [s]; autopilots send it at 4 Hz or more."""
AHEAD_S = 0.1
"""A turn is thought to go on for this long after the newest message [s]."""
TOGETHER_S = 0.001
STEEPEST_RAD = math.radians(75)
"""A vehicle that leans more than this does not fly on range finders that look down, and a message that says so is
believed to be wrong [rad]: the distance is then that of a vehicle whose attitude nobody says."""
TURNS_RAD = 4 * math.pi
"""Angles beyond this are no angles [rad]: more than a wrapped or an unwrapped turn."""
REFUSED_S = 1.0
"""The attitude makes no sense where it has been refused for so long, and not taken [s]."""


class Angles(NamedTuple):
    """An attitude: when the vehicle had it, on the bridge's clock [s], and Euler angles [rad], intrinsic z-y'-x''."""

    time_s: float
    roll_rad: float
    pitch_rad: float
    yaw_rad: float


class AttitudeTrack:
    """The newest attitude received, and how it has turned since the one before."""

    def __init__(self) -> None:
        self._newest: Angles | None = None
        # Since when it turns as it does now [s], and the rates of roll, pitch and yaw [rad/s].
        self._since_s, self._rates = 0.0, (0.0, 0.0, 0.0)
        # When it was first and last refused, since one that was taken [s].
        self._refused_s = math.inf, -math.inf

    def condition(self, now_s: float) -> Condition:
        """Attitudes come that make no sense, and have for a while; for `msp_range.health.Health.set`."""
        first_s, last_s = self._refused_s
        return Text.ATTITUDE.when(now_s - first_s > REFUSED_S > now_s - last_s)

    def update(self, angles: Angles) -> bool:
        """Take an attitude; False where it is no use: it makes no sense, or comes together with the one before."""
        if not self._makes_sense(angles):
            self._refused_s = min(self._refused_s[0], angles.time_s), angles.time_s
            return False
        self._refused_s = math.inf, -math.inf
        elapsed_s = math.inf if self._newest is None else angles.time_s - self._newest.time_s
        if elapsed_s < TOGETHER_S:
            return False  # They lay in one buffer; a line through them could have any slope.
        self._since_s, self._rates = angles.time_s, (0.0, 0.0, 0.0)
        if self._newest is not None and elapsed_s < OLDEST_S:
            self._since_s, *before = self._newest
            roll, pitch, yaw = (
                math.remainder(end_rad - start_rad, math.tau) / elapsed_s
                for start_rad, end_rad in zip(before, angles[1:], strict=True)
            )
            self._rates = roll, pitch, yaw
        self._newest = angles
        return True

    @staticmethod
    def _makes_sense(angles: Angles) -> bool:
        _, roll, pitch, yaw = angles
        # Each by itself: the largest of some that are no numbers is whichever comes first.
        if not (abs(roll) < TURNS_RAD and abs(pitch) < TURNS_RAD and abs(yaw) < TURNS_RAD):
            return False
        return math.cos(roll) * math.cos(pitch) > math.cos(STEEPEST_RAD)

    def rotation_at(self, time_s: float) -> Matrix | None:
        """Body to north, east, down; None where nothing is known.

        Examples
        --------
        >>> AttitudeTrack().rotation_at(0.0) is None
        True
        """
        angles = self._angles_at(time_s)
        return None if angles is None else rotation_matrix(*angles)

    def down_at(self, time_s: float) -> Vector | None:
        """Straight down, a unit vector in body FRD; None where nothing is known."""
        angles = self._angles_at(time_s)
        return None if angles is None else down_axis(*angles[:2])

    def _angles_at(self, time_s: float) -> tuple[float, float, float] | None:
        """Roll, pitch and yaw [rad] on the line through the newest two attitudes."""
        if self._newest is None or time_s - self._newest.time_s > OLDEST_S:
            return None
        end_s, roll, pitch, yaw = self._newest
        t = limited(time_s, self._since_s, end_s + AHEAD_S) - end_s
        by_roll, by_pitch, by_yaw = self._rates
        return roll + by_roll * t, pitch + by_pitch * t, yaw + by_yaw * t
