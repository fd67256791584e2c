"""'No echo': when it is sent, and its form in a DISTANCE_SENSOR message.

A working sensor got no echo, so that no ground or obstacle is within its range. The autopilot is to know that, unlike a
fault, which is silence. For ArduPilot, and for PX4 looking down or up, it is a distance above the maximum ('out of
range high', healthy); for PX4's collision prevention one that equals the maximum. Quality 0 would mean unknown and be
accepted, so it is 1, invalid; the covariance is unknown.
"""

from msp_range.fusion import Outcome
from msp_range.mavlink.orientation import DOWN, PITCH_90
from msp_range.reading import Reading, Status

QUALITY_INVALID = 1
"""``signal_quality`` of 'no echo'."""


def is_no_echo(found: Reading | Outcome) -> bool:
    """Whether 'no echo' is sent where there is no distance: of a single sensor, if it received none; of the fused
    stream, if the vehicle is above the range of its downward sensors (`msp_range.fusion.above`)."""
    return found.above_maximum if isinstance(found, Outcome) else found.status is Status.NO_ECHO


def no_echo_cm(max_distance_cm: int, orientation: int, autopilot: str) -> int:
    """``current_distance`` for a stream's maximum [cm], MAV_SENSOR_ORIENTATION and autopilot [cm]."""
    return max_distance_cm + (orientation in (DOWN, PITCH_90) or autopilot != "px4")
