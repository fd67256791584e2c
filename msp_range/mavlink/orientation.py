"""MAV_SENSOR_ORIENTATION for a mounting: the value whose axis is within the sensor's beam, or CUSTOM.

The enum's values are rotations; a range finder's beam is round, so only the axis counts, and of the values that share
an axis the lowest is used. The quaternion goes with CUSTOM only.
"""

import math
from typing import NamedTuple

from msp_range.geometry import Quaternion, angle_between, boresight, quaternion

PITCH_90 = 24
DOWN = 25
ROLL_90_PITCH_68_YAW_293 = 38
PITCH_315 = 39
CUSTOM = 100

_LEVEL = "forward", "forward right", "right", "rear right", "rear", "rear left", "left", "forward left"
"""Values 0 to 7: yaw in steps of 45 deg."""
_LOOKS = {
    **{step: (name, 0.0, 45.0 * step) for step, name in enumerate(_LEVEL)},
    PITCH_90: ("up", 90.0, 0.0),
    DOWN: ("down", 270.0, 0.0),
    ROLL_90_PITCH_68_YAW_293: ("up, 68 deg, towards yaw 293", 68.0, 293.0),
    PITCH_315: ("forward and down", 315.0, 0.0),
}
"""Name, pitch and yaw [deg] of each axis, from the enum's own descriptions in common.xml; the roll does not move it."""
NAMES = {**{value: name for value, (name, _, _) in _LOOKS.items()}, CUSTOM: "custom"}
_AXES = {
    value: boresight(0.0, math.radians(pitch_deg), math.radians(yaw_deg))
    for value, (_, pitch_deg, yaw_deg) in _LOOKS.items()
}


class Orientation(NamedTuple):
    """Orientation fields of DISTANCE_SENSOR."""

    value: int
    """MAV_SENSOR_ORIENTATION."""
    quaternion: Quaternion
    """(w, x, y, z) of the mounting if ``value`` is CUSTOM, otherwise zeros, which mean 'not given'."""

    @property
    def name(self) -> str:
        """The orientation in words."""
        return NAMES[self.value]


def orientation_of(roll_rad: float, pitch_rad: float, yaw_rad: float, breakaway_rad: float) -> Orientation:
    """The nearest orientation whose axis lies within the beam, or CUSTOM.

    Parameters
    ----------
    roll_rad, pitch_rad, yaw_rad
        Mounting, intrinsic z-y'-x'', body FRD [rad].
    breakaway_rad
        Half angle within which the sensor detects a wall [rad]: the smallest one of all characterised ranges, so that
        the orientation is valid at all of them.

    Examples
    --------
    >>> orientation_of(0.0, math.radians(-95), 0.0, math.radians(12.6)).name
    'down'
    >>> orientation_of(0.0, math.radians(-70), 0.0, math.radians(12.6)).name
    'custom'
    """
    looks = boresight(roll_rad, pitch_rad, yaw_rad)
    nearest = min(_AXES, key=lambda value: (round(angle_between(looks, _AXES[value]), 9), value))
    if angle_between(looks, _AXES[nearest]) <= breakaway_rad:
        return Orientation(nearest, (0.0, 0.0, 0.0, 0.0))
    return Orientation(CUSTOM, quaternion(roll_rad, pitch_rad, yaw_rad))
