"""Attitudes, accelerations and pressures in the autopilot's messages, in SI units.

No other estimates of the autopilot's: its height or climb rate may be based on the very distances that they would be
compared with.
"""

import math
from typing import Any

from msp_range.fusion import Acceleration, Angles, AttitudeTrack, PressureHeight, Received
from msp_range.fusion.vertical import GRAVITY_M_S2
from msp_range.geometry import dot
from msp_range.mavlink.distance_sensor import Autopilot
from msp_range.mavlink.time_sync import AutopilotClock

ATTITUDE = "ATTITUDE"
_BOTH = {ATTITUDE: 10.0, "SCALED_PRESSURE": 10.0}
WITNESSES: dict[Autopilot, dict[str, float]] = {
    "ardupilot": _BOTH | {"RAW_IMU": 25.0},
    "px4": _BOTH | {"HIGHRES_IMU": 25.0},
}
"""Requested rates [Hz] by message, for each autopilot: attitudes as many as four sensors ping, a pressure with each
reading, and two accelerations between readings."""
_M_S2_PER_UNIT = {"HIGHRES_IMU": 1.0, "RAW_IMU": GRAVITY_M_S2 / 1000, "SCALED_IMU": GRAVITY_M_S2 / 1000}
"""Unit of xacc, yacc, zacc: ArduPilot sends thousandths of g in RAW_IMU (GCS_Common.cpp, send_raw_imu)."""
SCALE_HEIGHT_M = 8434.0
"""Scale height of the standard atmosphere at 15 C: h = -8434 m ln(p). At 0 C it is 5 % less, which is within the
assumed uncertainty of a climb."""
LOWEST_HPA, HIGHEST_HPA = 300.0, 1200.0
"""Pressures outside these limits are rejected [hPa]."""


def motion_of(message: Any, now_s: float, clock: AutopilotClock, attitude: AttitudeTrack) -> Received | None:
    """What a message that has come now says of the vehicle's motion; None: nothing, or nothing that can be used.

    Parameters
    ----------
    clock
        The autopilot's, of which an attitude has its time.
    attitude
        Where down is, so that of an acceleration the part that is upwards is known.
    """
    kind = message.msgname
    if kind == ATTITUDE:
        time_s = clock.time_of(message.time_boot_ms, now_s)
        return Angles(time_s, message.roll, message.pitch, message.yaw)
    scale = _M_S2_PER_UNIT.get(kind)
    if scale is not None:
        # What the accelerometer measures, without gravity, which it does not feel: body FRD [m/s^2].
        force = message.xacc * scale, message.yacc * scale, message.zacc * scale
        down = attitude.down_at(now_s)
        if down is None or not 0.0 < math.hypot(*force) < math.inf:
            return None
        return Acceleration(now_s, -dot(down, force) - GRAVITY_M_S2)
    if kind != "SCALED_PRESSURE" or not LOWEST_HPA <= message.press_abs <= HIGHEST_HPA:
        return None
    return PressureHeight(now_s, -SCALE_HEIGHT_M * math.log(message.press_abs))
