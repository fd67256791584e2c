"""How the vehicle is turned at the time of an echo, from the autopilot's ATTITUDE messages.

The angles of the newest two messages enter, a rotation leaves: a straight line through them, since an echo is older
than the message that comes after it. Where none is sent, or the last one is old, there is none.
"""

import math
from typing import NamedTuple

from msp_range.geometry import Matrix, Vector, down_axis, rotation_matrix
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
    """The last two attitudes received."""

    def __init__(self) -> None:
        self._before: Angles | None = None
        self._newest: Angles | None = None
        self._refused_s: tuple[float, float] | None = None

    def is_refused(self, now_s: float) -> bool:
        """Whether attitudes come that make no sense, and have for a while."""
        return self._refused_s is not None and now_s - self._refused_s[0] > REFUSED_S > now_s - self._refused_s[1]

    def condition(self, now_s: float) -> Condition:
        """Attitudes that make no sense, for `msp_range.health.Health.set`."""
        return Text.ATTITUDE.when(self.is_refused(now_s))

    def update(self, angles: Angles) -> bool:
        """Take an attitude; False where it is no use: it makes no sense, or comes together with the one before."""
        if not self._makes_sense(angles):
            first_s = angles.time_s if self._refused_s is None else self._refused_s[0]
            self._refused_s = first_s, angles.time_s
            return False
        self._refused_s = None
        if self._newest is not None and angles.time_s - self._newest.time_s < TOGETHER_S:
            return False  # They lay in one buffer; a line through them could have any slope.
        self._before, self._newest = self._newest, angles
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
        newest, before = self._newest, self._before
        if newest is None or time_s - newest[0] > OLDEST_S:
            return None
        end_s, roll, pitch, yaw = newest
        if before is not None and end_s - before[0] < OLDEST_S:
            begin_s, from_roll, from_pitch, from_yaw = before
            share = (min(max(time_s, begin_s), end_s + AHEAD_S) - end_s) / (end_s - begin_s)
            roll += share * _turn(from_roll, roll)
            pitch += share * (pitch - from_pitch)
            yaw += share * _turn(from_yaw, yaw)
        return roll, pitch, yaw


def _turn(start_rad: float, end_rad: float) -> float:
    """The shorter way round from one angle to another [rad]."""
    turn_rad = end_rad - start_rad
    if -math.pi <= turn_rad <= math.pi:
        return turn_rad
    return math.remainder(turn_rad, 2 * math.pi)
