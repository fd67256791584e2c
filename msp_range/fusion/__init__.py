"""Several downward sensors as one: the ground below, and the distance that an autopilot expects."""

from msp_range.fusion.attitude import Angles, AttitudeTrack
from msp_range.fusion.fusion import Fusion
from msp_range.fusion.mounting import DownwardSensor, Oblique
from msp_range.fusion.outcome import OBJECT, OUTLIER, REPEATED, SUSPECT, Fused, Outcome
from msp_range.fusion.vertical import Acceleration, PressureHeight, VerticalMotion
from msp_range.fusion.windows import Windows

Received = Angles | Acceleration | PressureHeight
"""What an autopilot sends of its motion."""
