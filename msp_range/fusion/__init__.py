"""Several downward sensors as one: the ground below, and the distance that an autopilot expects."""

from msp_range.fusion.attitude import Angles, Attitude, AttitudeTrack, RecordedAttitude
from msp_range.fusion.fusion import Fused, Fusion
from msp_range.fusion.ground_filter import Ground
from msp_range.fusion.mounting import DownwardSensor, Oblique

__all__ = [
    "Angles",
    "Attitude",
    "AttitudeTrack",
    "DownwardSensor",
    "Fused",
    "Fusion",
    "Ground",
    "Oblique",
    "RecordedAttitude",
]
