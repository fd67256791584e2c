"""PX4's SITL with SIH, the simulator inside it. What is read in its sources is named in comments."""

import math
import os
import socket
from pathlib import Path
from typing import Any, ClassVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from tests.sitl import documented
from tests.sitl.autopilot import TOP_M, Autopilot, Series, version
from tests.sitl.ground_station import connected_udp

PX4 = os.environ.get("MSP_RANGE_PX4", "")
"""The build folder (build/px4_sitl_default), or the `bin/px4` in it."""
STARTS, SENSORS_STOP_S = 5, 3.0
"""On a busy computer PX4 1.17's simulated barometer, compass and GNSS stop for ever when it is armed, in about one of
four starts, whether a bridge runs or not (all that its high-resolution timer calls; drv_hrt.cpp). PX4 reports it within
3 s and cannot fly. It is then started anew, so many times at most."""


class Px4(Autopilot):
    """PX4 with SIH: the ground station at UDP port 14550, the bridge at 14540, both PX4's own choice.

    `px4 -d BUILD/etc -w FOLDER` (platforms/posix/src/px4/common/main.cpp); the start script sets the parameters that
    the environment names PX4_PARAM_... and starts MAVLink to the two ports (init.d-posix/rcS and px4-rc.mavlink).
    """

    kind = "px4"
    section = "PX4 (SIH)"
    link = "udpin:127.0.0.1:14540"
    TAKEOFF, LOITER = (4 << 16) | (2 << 24), (4 << 16) | (3 << 24)
    """px4_custom_mode.h: main mode AUTO and its sub-modes."""
    standing_m = 0.25
    """EKF2's height above the ground is the body's: 0.20 m under the sensors, which are 0.05 m below it
    (loopback.yaml)."""
    tolerance_m = 1.5
    """Its height is that of GNSS, which wanders; the range gives EKF2 the ground's height."""
    wanted: ClassVar = {"HIL_STATE_QUATERNION": 50.0, "ALTITUDE": 20.0, "ESTIMATOR_STATUS": 20.0}

    def _command(self) -> tuple[list[str], dict[str, str]]:
        build = build_folder()
        environment = os.environ | {"PX4_SIM_MODEL": "sihsim_quadx"}
        environment |= {f"PX4_PARAM_{name}": value for name, value in documented.parameters(self.section).items()}
        return [str(build / "bin" / "px4"), "-d", str(build / "etc"), "-w", str(self.folder)], environment

    def _socket(self) -> socket.socket:
        return connected_udp(14550)

    def _name(self) -> str:
        return f"PX4 {version(self.station)}"

    def get_ready(self) -> None:
        self.station.wait("HIL_STATE_QUATERNION", self.heights)

    def take_off(self) -> None:
        for _ in range(STARTS):
            self.get_ready()
            self.station.command_until_accepted("arming", mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
            self.wait(SENSORS_STOP_S)
            if not any("No valid data from Baro" in text for text in self.texts()):
                break
            self.end()
            self.start()
        nan = math.nan
        takeoff = (nan, 0, 0, nan, nan, nan, nan)
        self.station.command_until_accepted("take-off", mavlink.MAV_CMD_NAV_TAKEOFF, *takeoff)
        self.wait_for_hover(TOP_M)

    def go_to(self, height_m: float) -> None:
        """Over the sea, by the estimate's own offset from the truth (navigator_main.cpp)."""
        altitude_m = self.station.all("ALTITUDE")[-1][1].altitude_amsl
        self.station.command(mavlink.MAV_CMD_DO_CHANGE_ALTITUDE, altitude_m + height_m - self.height_m())

    def land(self) -> None:
        nan = math.nan
        self.station.command_until_accepted("landing", mavlink.MAV_CMD_NAV_LAND, 0, 0, 0, nan, nan, nan, nan)
        self.station.wait("disarmed after landing", lambda: not self.station.is_armed())

    def height_m(self) -> float:
        states = self._states()
        return (states[-1][1].alt - states[0][1].alt) / 1e3 if states else 0.0

    def heights(self) -> Series:
        states = self._states()
        return [(time_s, (state.alt - states[0][1].alt) / 1e3) for time_s, state in states]

    def ranges(self) -> Series:
        # Not a number until EKF2 has a terrain estimate (streams/ALTITUDE.hpp).
        return [(time_s, each.bottom_clearance) for time_s, each in self.station.all("ALTITUDE")]

    def healthy(self) -> list[tuple[float, bool]]:
        return [
            (time_s, bool(status.flags & mavlink.ESTIMATOR_POS_VERT_AGL))
            for time_s, status in self.station.all("ESTIMATOR_STATUS")
        ]

    def flies_as_commanded(self) -> bool:
        return self.station.is_armed() and self.mode() in (self.TAKEOFF, self.LOITER)

    def _states(self) -> list[tuple[float, Any]]:
        """Poses of the simulator, once it has found its place: before that it sends zeros."""
        states = self.station.all("HIL_STATE_QUATERNION")
        first = next((i for i, (_, state) in enumerate(states) if state.lat), len(states))
        return states[first:]


def build_folder() -> Path:
    """The folder with `bin/px4` and `etc`."""
    binary = Path(PX4) if Path(PX4).is_file() else Path(PX4) / "bin" / "px4"
    return binary.resolve().parents[1]
