"""ArduCopter's SITL. What is read in its sources is named in comments."""

import math
import os
import shlex
import socket
import time
from pathlib import Path
from typing import ClassVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from msp_sim.sitl.sitl import EARTH_RADIUS_M
from tests.docs.shown import shown
from tests.sitl import documented
from tests.sitl.autopilot import STANDING_RANGE_M, TOP_M, Autopilot, Series, version
from tests.sitl.ground_station import connected_tcp

ARDUCOPTER = os.environ.get("MSP_RANGE_ARDUCOPTER", "")
"""The `arducopter` SITL binary."""
COMMAND = "arducopter --model + --speedup 1 --home -35.363262,149.165237,584,0 --defaults copter.parm,range.parm"
"""How docs/sitl.md starts it."""


class ArduCopter(Autopilot):
    """ArduCopter: the ground station on SERIAL0, the bridge on SERIAL1.

    SERIAL0 waits at the base port for somebody to connect, SERIAL1 listens two ports above (AP_HAL_SITL,
    SITL_State.h and UARTDriver.cpp).
    """

    kind = "ardupilot"
    section = "ArduPilot"
    GUIDED, LAND, RTL = 4, 9, 6
    """ArduCopter/mode.h."""
    standing_m = STANDING_RANGE_M
    top_m = TOP_M
    tolerance_m = 0.5
    wanted: ClassVar = {"SYS_STATUS": 20.0, "SIM_STATE": 50.0, "DISTANCE_SENSOR": 20.0, "EKF_STATUS_REPORT": 5.0}

    # Names that a version does not know are ignored (AP_Param.cpp, read_param_defaults_file); some have changed.
    COMMON: ClassVar = {
        "FRAME_CLASS": 1,
        "FRAME_TYPE": 0,
        "FS_THR_ENABLE": 0,
        "FS_GCS_ENABLE": 0,
        # Of the arming checks only the rangefinder's stays, bit 15; ARMING_CHECK names what is checked, ARMING_SKIPCHK
        # of 4.7 and later what is not.
        "ARMING_CHECK": 1 << 15,
        "ARMING_SKIPCHK": sum(1 << bit for bit in range(1, 20)) - (1 << 15),
        # What the simulated compasses and accelerometers need (Tools/autotest/default_params/copter.parm).
        **{f"COMPASS_OFS{n}_{axis}": at for n in ("", "2", "3") for axis, at in zip("XYZ", (5, 13, -18), strict=True)},
        **{f"INS_ACC{n}OFFS_{axis}": 0.001 for n in ("", "2") for axis in "XYZ"},
        **{f"INS_ACC{n}SCAL_{axis}": 1.001 for n in ("", "2") for axis in "XYZ"},
    }

    def __init__(self, folder: Path, section: str = section, home: str | None = None) -> None:
        super().__init__(folder)
        self.section = section
        self._home = home or documented.home(section)
        parameters = self.COMMON | documented.parameters(section)
        defaults = "".join(f"{name} {value}\n" for name, value in parameters.items())
        (folder / "defaults.parm").write_text(defaults)
        self._port = free_base_port()
        self.link = f"tcp:127.0.0.1:{self._port + 2}"

    def _command(self) -> tuple[list[str], dict[str, str]]:
        _, *options = shlex.split(shown(COMMAND))
        options[options.index("--home") + 1] = self._home
        options[options.index("--defaults") + 1] = "defaults.parm"
        return [ARDUCOPTER, *options, "--base-port", str(self._port)], dict(os.environ)

    def _socket(self) -> socket.socket:
        return connected_tcp(self._port)

    def _name(self) -> str:
        return f"ArduCopter {version(self.station)}"

    def get_ready(self) -> None:
        # A take-off is refused before the estimator uses GPS, some 43 s after the start.
        self.station.wait(
            "a position of EKF3",
            lambda: [
                each for _, each in self.station.all("EKF_STATUS_REPORT") if each.flags & mavlink.EKF_POS_HORIZ_ABS
            ],
        )
        custom = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        self.station.command_until_accepted("GUIDED", mavlink.MAV_CMD_DO_SET_MODE, custom, self.GUIDED)

    def take_off(self) -> None:
        self.get_ready()
        self.station.command_until_accepted("arming", mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
        takeoff = (0, 0, 0, 0, 0, 0, self.top_m)
        self.station.command_until_accepted("take-off", mavlink.MAV_CMD_NAV_TAKEOFF, *takeoff)
        self.wait_for_hover(self.top_m)

    def go_to(self, height_m: float, frame: int = mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT) -> None:
        """In GUIDED; the height above the terrain is what the range finder measures (GCS_MAVLink_Copter.cpp)."""
        place = self.station.all("SIM_STATE")[-1][1]
        self._set_target(frame, place.lat_int, place.lon_int, height_m)

    def follow_ground(self, north_m: float, height_m: float, speed_m_s: float) -> None:
        """In GUIDED to a place north of the start, at a height above the terrain all the way."""
        speed = (1, speed_m_s)  # SPEED_TYPE_GROUNDSPEED
        self.station.command_until_accepted("speed", mavlink.MAV_CMD_DO_CHANGE_SPEED, *speed)
        start = self.station.all("SIM_STATE")[0][1]
        north_1e7 = round(1e7 * math.degrees(north_m / EARTH_RADIUS_M))
        frame = mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT
        self._set_target(frame, start.lat_int + north_1e7, start.lon_int, height_m)

    def _set_target(self, frame: int, lat_int: int, lon_int: int, height_m: float) -> None:
        fields: dict[str, float] = dict.fromkeys(mavlink.MAVLink_set_position_target_global_int_message.fieldnames, 0)
        fields |= {"target_system": 1, "target_component": 1, "coordinate_frame": frame}
        # Of position, velocity, acceleration, yaw and its rate only the position and the yaw count, which is north.
        fields |= {"type_mask": 0b1001_1111_1000, "lat_int": lat_int, "lon_int": lon_int, "alt": height_m}
        self.station.send(mavlink.MAVLink_set_position_target_global_int_message(**fields))

    def land(self) -> None:
        custom = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        self.station.command_until_accepted("LAND", mavlink.MAV_CMD_DO_SET_MODE, custom, self.LAND)
        self.station.wait("disarmed after landing", lambda: not self.station.is_armed())

    def height_m(self) -> float:
        states = self.station.all("SIM_STATE")
        return states[-1][1].alt - states[0][1].alt if states else 0.0

    def heights(self) -> Series:
        states = self.station.all("SIM_STATE")
        return [(time_s, state.alt - states[0][1].alt) for time_s, state in states]

    def true_ranges(self) -> Series:
        # The range finder's own distance: along the vehicle's down axis.
        tilts = [math.cos(each.roll) * math.cos(each.pitch) for _, each in self.station.all("SIM_STATE")]
        return [(time_s, range_m / tilt) for (time_s, range_m), tilt in zip(super().true_ranges(), tilts, strict=False)]

    def ranges(self) -> Series:
        return [
            (time_s, message.current_distance / 100)
            for time_s, message in self.station.all("DISTANCE_SENSOR")
            if message.orientation == mavlink.MAV_SENSOR_ROTATION_PITCH_270
        ]

    def healthy(self) -> list[tuple[float, bool]]:
        return self.sensor_health(mavlink.MAV_SYS_STATUS_SENSOR_LASER_POSITION)

    def sensor_health(self, sensor: int) -> list[tuple[float, bool]]:
        """Whether SYS_STATUS says that a sensor is present, enabled and healthy."""
        return [
            (
                time_s,
                bool(
                    sensor
                    & status.onboard_control_sensors_present
                    & status.onboard_control_sensors_enabled
                    & status.onboard_control_sensors_health
                ),
            )
            for time_s, status in self.station.all("SYS_STATUS")
        ]

    def parameter(self, name: str) -> float:
        """The value that it reports of a parameter."""
        first_s = time.monotonic()
        self.station.send(mavlink.MAVLink_param_request_read_message(1, 1, name.encode(), -1))

        def values() -> list[float]:
            return [
                message.param_value
                for time_s, message in self.station.all("PARAM_VALUE")
                if time_s > first_s and message.param_id == name
            ]

        return self.station.wait(name, values)[-1]

    def set_parameter(self, name: str, value: float) -> None:
        """Set a parameter, and see that it has it."""
        self.station.send(mavlink.MAVLink_param_set_message(1, 1, name.encode(), value, mavlink.MAV_PARAM_TYPE_REAL32))
        assert abs(self.parameter(name) - value) < 1e-6, name

    def flies_as_commanded(self) -> bool:
        return self.station.is_armed() and self.mode() == self.GUIDED


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
