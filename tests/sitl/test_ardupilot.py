"""ArduCopter's own simulator flies on what the bridge tells it.

Set MSP_RANGE_ARDUCOPTER to an `arducopter` SITL binary; without it these tests skip. They are unverified against a real
binary: what they rely on was read in ArduPilot's sources, which the comments name.
"""

import math
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from tests.sitl.ground_station import BRIDGE, CONFIGS, GroundStation, bridge_in_sitl, connected_tcp, errors, program

BINARY = os.environ.get("MSP_RANGE_ARDUCOPTER", "")
pytestmark = [
    pytest.mark.skipif(not BINARY, reason="set MSP_RANGE_ARDUCOPTER to an arducopter SITL binary"),
    pytest.mark.real_time,
]

HOME = "-35.363262,149.165237,584,0"
"""Latitude, longitude, altitude [m], heading [deg]."""
GUIDED, LAND = 4, 9
"""ArduCopter/mode.h."""
TOP_M = 6.0
STANDING_RANGE_M = 0.20
"""The fused range on the ground: `msp-sim sitl` stands the sensors at their minimum."""
RANGEFINDER, PROXIMITY = mavlink.MAV_SYS_STATUS_SENSOR_LASER_POSITION, mavlink.MAV_SYS_STATUS_SENSOR_PROXIMITY

# Names that a version does not know are ignored (AP_Param.cpp, read_param_defaults_file); some have changed.
COMMON = {
    "FRAME_CLASS": 1,
    "FRAME_TYPE": 0,
    "SERIAL1_PROTOCOL": 2,
    "FS_THR_ENABLE": 0,
    "FS_GCS_ENABLE": 0,
    # Of the arming checks only the rangefinder's stays, bit 15; ARMING_CHECK names what is checked, ARMING_SKIPCHK of
    # 4.7 and later what is not.
    "ARMING_CHECK": 1 << 15,
    "ARMING_SKIPCHK": sum(1 << bit for bit in range(1, 20)) - (1 << 15),
    # What the simulated compasses and accelerometers need (Tools/autotest/default_params/copter.parm).
    **{f"COMPASS_OFS{n}_{axis}": offset for n in ("", "2", "3") for axis, offset in zip("XYZ", (5, 13, -18))},  # noqa: B905
    **{f"INS_ACC{n}OFFS_{axis}": 0.001 for n in ("", "2") for axis in "XYZ"},
    **{f"INS_ACC{n}SCAL_{axis}": 1.001 for n in ("", "2") for axis in "XYZ"},
}
RANGEFINDER_PARAMETERS = {
    "RNGFND1_TYPE": 10,
    "RNGFND1_ORIENT": 25,
    # Metres from 4.7 on, before that centimetres.
    "RNGFND1_MIN": 0.19,
    "RNGFND1_MAX": 7.60,
    "RNGFND1_GNDCLR": 0.20,
    "RNGFND1_MIN_CM": 19,
    "RNGFND1_MAX_CM": 760,
    "RNGFND1_GNDCLEAR": 20,
    "RNGFND1_POS_Z": 0.05,
}


@contextmanager
def arducopter(folder: Path, parameters: dict[str, float]) -> Iterator[tuple[GroundStation, str]]:
    """A running ArduCopter: a ground station on SERIAL0, and the link for the bridge, SERIAL1.

    SERIAL0 waits at the base port for somebody to connect, SERIAL1 listens two ports above (AP_HAL_SITL,
    SITL_State.h and UARTDriver.cpp).
    """
    defaults = folder / "defaults.parm"
    defaults.write_text("".join(f"{name} {value}\n" for name, value in parameters.items()))
    base = free_base_port()
    command = [BINARY, "--model", "+", "--speedup", "1", "--home", HOME, "--defaults", str(defaults)]
    with program([*command, "--base-port", str(base)], folder / "arducopter.log", cwd=folder):
        station = GroundStation(connected_tcp(base))
        try:
            station.wait("a heartbeat of ArduCopter", lambda: station.all("HEARTBEAT"), 30.0)
            yield station, f"tcp:127.0.0.1:{base + 2}"
        finally:
            station.close()


def free_base_port() -> int:
    """A port that is free with the two and three ports above it (SERIAL1 and SERIAL2)."""
    while True:
        with socket.create_server(("127.0.0.1", 0)) as first:
            base: int = first.getsockname()[1]
            try:
                for port in (base + 2, base + 3):
                    socket.create_server(("127.0.0.1", port)).close()
            except OSError:
                continue
        return base


def healthy_since(station: GroundStation, sensor: int) -> float | None:
    """When SYS_STATUS first said that a sensor is present, enabled and healthy."""
    for time_s, status in station.all("SYS_STATUS"):
        if (
            sensor
            & status.onboard_control_sensors_present
            & status.onboard_control_sensors_enabled
            & status.onboard_control_sensors_health
        ):
            return time_s
    return None


def test_takeoff_to_6_m_and_landing(tmp_path: Path) -> None:
    with arducopter(tmp_path, COMMON | RANGEFINDER_PARAMETERS) as (station, link):
        for name in ("SYS_STATUS", "SIM_STATE", "DISTANCE_SENSOR"):
            station.ask(name, 20.0)
        standing_m = station.wait("SIM_STATE", lambda: station.all("SIM_STATE"), 10.0)[0][1].alt

        def height_m() -> float:
            return station.all("SIM_STATE")[-1][1].alt - standing_m

        with bridge_in_sitl("loopback.yaml", link, tmp_path / "msp-sim.log"):
            # ArduPilot passes the bridge's messages on to other links (MAVLink_routing.cpp).
            heard = station.wait("DISTANCE_SENSOR", lambda: station.all("DISTANCE_SENSOR", BRIDGE), 30.0)
            healthy_s = station.wait("a healthy rangefinder", lambda: healthy_since(station, RANGEFINDER), 10.0)
            assert healthy_s - heard[0][0] < 2.0

            custom = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
            station.command_until_accepted("GUIDED", 90.0, mavlink.MAV_CMD_DO_SET_MODE, custom, GUIDED)
            station.command_until_accepted("arming", 90.0, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
            station.wait("armed", station.is_armed, 5.0)
            left_s = station.heard[-1][0]
            takeoff = (0, 0, 0, 0, 0, 0, TOP_M)
            station.command_until_accepted("take-off", 5.0, mavlink.MAV_CMD_NAV_TAKEOFF, *takeoff)
            station.wait("the climb", lambda: height_m() > TOP_M - 0.5, 30.0)
            hovering_s = station.heard[-1][0] + 3.0
            station.wait("the hover", lambda: station.heard[-1][0] > hovering_s + 8.0, 15.0)
            hovered_m = [
                message.alt - standing_m for time_s, message in station.all("SIM_STATE") if time_s > hovering_s
            ]
            station.command_until_accepted("LAND", 5.0, mavlink.MAV_CMD_DO_SET_MODE, custom, LAND)
            station.wait("disarmed after landing", lambda: not station.is_armed(), 60.0)
            landed_s = station.heard[-1][0]

    # In GUIDED a healthy rangefinder's range is the height of a take-off below its maximum (mode_guided.cpp).
    assert abs(np.median(hovered_m) - TOP_M) < 0.5
    believed = [
        (time_s, message.current_distance / 100)
        for time_s, message in station.all("DISTANCE_SENSOR")
        if message.orientation == mavlink.MAV_SENSOR_ROTATION_PITCH_270
    ]
    truth = [
        (time_s, (state.alt - standing_m + STANDING_RANGE_M) / (math.cos(state.roll) * math.cos(state.pitch)))
        for time_s, state in station.all("SIM_STATE")
    ]
    error_m = errors(believed, truth, left_s, landed_s)
    # A program that sends the truth at 20 Hz has 0.02-0.03 m and 0.12-0.15 m; the climb at 2.5 m/s makes most of it.
    assert np.median(error_m) < 0.15
    assert np.percentile(error_m, 95) < 0.5
    said_healthy = [
        bool(status.onboard_control_sensors_health & RANGEFINDER)
        for time_s, status in station.all("SYS_STATUS")
        if left_s < time_s < landed_s
    ]
    assert np.mean(said_healthy) > 0.95


def test_proximity_sees_the_walls(tmp_path: Path) -> None:
    """On the ground in the middle of a yard of 8 m by 6 m, the nose to the north, sensors 0.25 m from the middle."""
    with arducopter(tmp_path, COMMON | {"PRX1_TYPE": 2, "PRX_TYPE": 2}) as (station, link):
        for name in ("SYS_STATUS", "DISTANCE_SENSOR"):
            station.ask(name, 10.0)
        walls_m = {
            mavlink.MAV_SENSOR_ROTATION_NONE: 3.75,
            mavlink.MAV_SENSOR_ROTATION_YAW_90: 2.75,
            mavlink.MAV_SENSOR_ROTATION_YAW_180: 3.75,
            mavlink.MAV_SENSOR_ROTATION_YAW_270: 2.75,
        }
        seen_m: dict[int, float] = {}

        def sees_walls() -> bool:
            # ArduPilot tells what its proximity library holds, one message a sector (GCS_Common.cpp, send_proximity).
            seen_m.update({each.orientation: each.current_distance / 100 for _, each in station.all("DISTANCE_SENSOR")})
            return all(abs(seen_m.get(orientation, 0.0) - wall_m) < 0.3 for orientation, wall_m in walls_m.items())

        yard = str(CONFIGS / "scenarios" / "proximity.yaml")
        with bridge_in_sitl("proximity.yaml", link, tmp_path / "msp-sim.log", "--ground", yard):
            station.wait("a healthy proximity sensor", lambda: healthy_since(station, PROXIMITY), 30.0)
            # The library smooths with 0.25 Hz, and a wild reading takes that long to be forgotten.
            station.wait(f"walls at {walls_m}, seen at {seen_m}", sees_walls, 30.0)
