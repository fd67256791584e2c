"""Accelerations and pressures in the autopilot's messages, in SI units.

Only what its sensors measured: an estimate of its own, such as a height or a climb, may rest on the very distances that
it would be held against.
"""

import math
from typing import Any

from msp_range.fusion.vertical import GRAVITY_M_S2
from msp_range.geometry import Vector
from msp_range.mavlink.distance_sensor import Autopilot

IMU_HZ, PRESSURE_HZ = 25.0, 10.0
"""Rates that are asked for [Hz]: two accelerations between readings, and a pressure with each."""
WITNESSES: dict[Autopilot, dict[str, float]] = {
    "ardupilot": {"RAW_IMU": IMU_HZ, "SCALED_PRESSURE": PRESSURE_HZ},
    "px4": {"HIGHRES_IMU": IMU_HZ, "SCALED_PRESSURE": PRESSURE_HZ},
}
"""What each autopilot is asked for: message -> rate [Hz]."""
_M_S2_PER_UNIT = {"HIGHRES_IMU": 1.0, "RAW_IMU": GRAVITY_M_S2 / 1000, "SCALED_IMU": GRAVITY_M_S2 / 1000}
"""Of xacc, yacc, zacc: ArduPilot fills RAW_IMU with thousandths of g (GCS_Common.cpp, send_raw_imu)."""
_HPA_FIELD = {"SCALED_PRESSURE": "press_abs"}
SCALE_HEIGHT_M = 8434.0
"""Of the standard atmosphere at 15 C: h = -8434 m ln(p); 5 % less at 0 C, which is within what a climb is trusted."""
PRESSURES_HPA = (300.0, 1200.0)
"""Pressures outside of these are not those of air in which a vehicle flies [hPa]."""


def specific_force(message: Any) -> Vector | None:
    """What the accelerometer measures, body FRD, gravity not taken off [m/s^2]; None in a message of another kind."""
    scale = _M_S2_PER_UNIT.get(message.get_type())
    if scale is None:
        return None
    force = (message.xacc * scale, message.yacc * scale, message.zacc * scale)
    return force if all(map(math.isfinite, force)) and any(force) else None


def pressure_height_m(message: Any) -> float | None:
    """The pressure as a height over an arbitrary level [m]; None in a message of another kind."""
    field = _HPA_FIELD.get(message.get_type())
    if field is None:
        return None
    pressure_hpa = getattr(message, field)
    lowest_hpa, highest_hpa = PRESSURES_HPA
    if not lowest_hpa <= pressure_hpa <= highest_hpa:
        return None
    return -SCALE_HEIGHT_M * math.log(pressure_hpa)
