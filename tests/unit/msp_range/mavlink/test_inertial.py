"""What an autopilot's messages say of the vehicle's motion, in SI units."""

import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from msp_range.fusion import Acceleration, Angles, AttitudeTrack, PressureHeight, Received
from msp_range.mavlink.inertial import motion_of
from msp_range.mavlink.time_sync import AutopilotClock


def test_messages_in_si_units() -> None:
    def motion(message: Any, pitch_rad: float = 0.0) -> Received | None:
        """What a message says of a vehicle with this attitude."""
        attitude = AttitudeTrack()
        attitude.update(Angles(0.0, 0.0, pitch_rad, 0.0))
        return motion_of(message, 0.0, AutopilotClock(0.0), attitude)

    def upwards(message: Any, pitch_rad: float = 0.0) -> float:
        found = motion(message, pitch_rad)
        assert isinstance(found, Acceleration)
        return found.up_m_s2

    raw = mavlink.MAVLink_raw_imu_message(0, 100, 0, -1100, 0, 0, 0, 0, 0, 0)
    assert upwards(raw) == pytest.approx(0.980665)
    assert upwards(raw, math.pi / 4) == pytest.approx((math.sqrt(0.5) * 1.2 - 1) * 9.80665)
    highres = mavlink.MAVLink_highres_imu_message(0, 0.5, 0.0, -9.8, *[0.0] * 10, 0)
    assert upwards(highres) == pytest.approx(9.8 - 9.80665)
    assert upwards(highres, math.pi / 2 - 0.3) == pytest.approx(0.5 * math.cos(0.3) + 9.8 * math.sin(0.3) - 9.80665), (
        "the nose up: part of what is forward is upwards"
    )
    assert motion(mavlink.MAVLink_raw_imu_message(0, *[0] * 9)) is None, "no accelerometer"
    assert motion_of(raw, 0.0, AutopilotClock(0.0), AttitudeTrack()) is None, "where down is, is not known"
    low, high = (motion(mavlink.MAVLink_scaled_pressure_message(0, hpa, 0.0, 2000)) for hpa in (1013.25, 1012.05))
    assert isinstance(low, PressureHeight)
    assert isinstance(high, PressureHeight)
    climbed_m = high.pressure_height_m - low.pressure_height_m
    assert climbed_m == pytest.approx(10.0, rel=0.01), "0.12 hPa a metre near the ground"
    for hpa in (0.0, math.nan, 5000.0):
        assert motion(mavlink.MAVLink_scaled_pressure_message(0, hpa, 0.0, 2000)) is None
