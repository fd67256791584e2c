"""ArduCopter's own simulator flies on what the bridge sends; what is read in its sources is named in comments."""

import time
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from tests.sitl.arducopter import ArduCopter
from tests.sitl.autopilot import TOP_M, running
from tests.sitl.figures import measure, note
from tests.sitl.ground_station import BRIDGE
from tests.sitl.kinds import needs_arducopter
from tests.sitl.msp_sim import msp_sim

pytestmark = [needs_arducopter, pytest.mark.real_time]


def test_takeoff_to_6_m_and_landing(tmp_path: Path) -> None:
    copter = ArduCopter(tmp_path)
    with running(copter):
        copter.get_ready()
        with msp_sim(copter):
            # ArduPilot passes the bridge's messages on to other links (MAVLink_routing.cpp).
            first = copter.station.wait("DISTANCE_SENSOR", lambda: copter.station.all("DISTANCE_SENSOR", BRIDGE))
            healthy_s = copter.station.wait(
                "a healthy range finder", lambda: [time_s for time_s, good in copter.healthy() if good]
            )
            assert healthy_s[0] - first[0][0] < 2.0
            left_s = time.monotonic()
            copter.take_off()
            hovering_s = time.monotonic()
            copter.wait(8.0)
            hovered_m = [height_m for time_s, height_m in copter.heights() if time_s > hovering_s]
            copter.land()
            flown = measure(copter, left_s, time.monotonic())
        note(copter, "take-off in GUIDED to 6 m, hover, landing", "uses it", flown)

    # In GUIDED a healthy range finder's range is the height of a take-off below its maximum (mode_guided.cpp).
    assert abs(np.median(hovered_m) - TOP_M) < 0.5
    # A program that sends the truth at 20 Hz has 0.02-0.03 m and 0.12-0.15 m; the climb at 2.5 m/s makes most of it.
    assert flown.median_m < 0.15
    assert flown.p95_m < 0.5
    assert flown.healthy > 0.95
    # It shows its pilot a text at every request for a message that it does not have (GCS_Common.cpp).
    assert not [text for text in copter.texts() if "No ap_message" in text]


def wait_for_walls(copter: ArduCopter) -> None:
    """Wait until its proximity library sees all walls: in a yard of 8 m by 6 m, sensors 0.25 m from the middle."""
    walls_m = {
        mavlink.MAV_SENSOR_ROTATION_NONE: 3.75,
        mavlink.MAV_SENSOR_ROTATION_YAW_90: 2.75,
        mavlink.MAV_SENSOR_ROTATION_YAW_180: 3.75,
        mavlink.MAV_SENSOR_ROTATION_YAW_270: 2.75,
    }
    seen_m: dict[int, float] = {}

    def sees_walls() -> bool:
        # ArduPilot sends what its proximity library holds, one message a sector (GCS_Common.cpp, send_proximity).
        messages = copter.station.all("DISTANCE_SENSOR")
        seen_m.update({each.orientation: each.current_distance / 100 for _, each in messages})
        return all(abs(seen_m.get(orientation, 0.0) - wall_m) < 0.3 for orientation, wall_m in walls_m.items())

    def is_healthy() -> bool:
        health = copter.sensor_health(mavlink.MAV_SYS_STATUS_SENSOR_PROXIMITY)
        return any(good for _, good in health)

    copter.station.wait("a healthy proximity sensor", is_healthy)
    # The library smooths with 0.25 Hz, and an outlier takes that long to be forgotten.
    copter.station.wait(f"walls at {walls_m}, seen at {seen_m}", sees_walls)


def test_proximity_sees_the_walls(tmp_path: Path) -> None:
    copter = ArduCopter(tmp_path, "ArduPilot with proximity sensors")
    with running(copter), msp_sim(copter):
        wait_for_walls(copter)
        note(copter, "on the ground between four walls", "sees the four walls within 0.3 m")
