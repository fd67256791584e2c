"""Attitudes, accelerations and pressures in the autopilot's messages, in SI units.

No other estimates of the autopilot's: its height or climb rate may be based on the very distances that they would be
compared with.
"""

import math
from typing import Any

from msp_range.fusion import Acceleration, Angles, AttitudeTrack, PressureHeight, Received
from msp_range.fusion.vertical import GRAVITY_M_S2
from msp_range.geometry import Vector, dot
from msp_range.mavlink.distance_sensor import Autopilot
from msp_range.mavlink.time_sync import AutopilotClock

ATTITUDE = "ATTITUDE"
ATTITUDE_HZ, IMU_HZ, PRESSURE_HZ = 10.0, 25.0, 10.0
"""Requested rates [Hz]: attitudes as many as four sensors ping, two accelerations between readings, and a pressure with
each reading."""
WITNESSES: dict[Autopilot, dict[str, float]] = {
    "ardupilot": {ATTITUDE: ATTITUDE_HZ, "RAW_IMU": IMU_HZ, "SCALED_PRESSURE": PRESSURE_HZ},
    "px4": {ATTITUDE: ATTITUDE_HZ, "HIGHRES_IMU": IMU_HZ, "SCALED_PRESSURE": PRESSURE_HZ},
}
"""Requested rates [Hz] by message, for each autopilot."""
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
    if message.msgname == ATTITUDE:
        time_s = clock.time_of(message.time_boot_ms, now_s)
        return Angles(time_s, message.roll, message.pitch, message.yaw)
    if (force := specific_force(message)) is not None and (down := attitude.down_at(now_s)) is not None:
        return Acceleration(now_s, -dot(down, force) - GRAVITY_M_S2)
    height_m = pressure_height_m(message)
    return None if height_m is None else PressureHeight(now_s, height_m)


def specific_force(message: Any) -> Vector | None:
    """Specific force measured by the accelerometer, body FRD [m/s^2]; None for other messages."""
    scale = _M_S2_PER_UNIT.get(message.msgname)
    if scale is None:
        return None
    force = message.xacc * scale, message.yacc * scale, message.zacc * scale
    return force if 0.0 < math.hypot(*force) < math.inf else None


def pressure_height_m(message: Any) -> float | None:
    """The pressure as a height above an arbitrary level [m]; None for other messages."""
    if message.msgname != "SCALED_PRESSURE" or not LOWEST_HPA <= message.press_abs <= HIGHEST_HPA:
        return None
    return -SCALE_HEIGHT_M * math.log(message.press_abs)
