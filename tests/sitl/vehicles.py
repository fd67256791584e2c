"""ArduCopter and PX4 in their own simulators, each with a ground station: one interface for the tests that fly both.

Set MSP_RANGE_ARDUCOPTER to an `arducopter` SITL binary and MSP_RANGE_PX4 to a PX4 SITL build folder
(build/px4_sitl_default) or the `bin/px4` in it. The parameters are those of docs/sitl.md.
"""

import contextlib
import math
import os
import signal
import socket
import subprocess
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from tests.sitl import documented
from tests.sitl.ground_station import GroundStation, connected_tcp, connected_udp

ARDUCOPTER = os.environ.get("MSP_RANGE_ARDUCOPTER", "")
PX4 = os.environ.get("MSP_RANGE_PX4", "")
TOP_M = 6.0
STANDING_RANGE_M = 0.20
"""The fused range on the ground: `msp-sim sitl` stands the sensors at their minimum."""

Series = list[tuple[float, float]]
"""Times [s, monotonic] and values."""


class Autopilot(ABC):
    """A running autopilot with its simulator.

    Attributes
    ----------
    section
        Of docs/sitl.md, with its parameters and commands.
    link
        Where the bridge connects to.
    name
        With the version, once it runs.
    standing_m
        What `ranges` is on the ground.
    tolerance_m
        How near to a commanded height it hovers.
    wanted
        Messages that the ground station asks for: name -> rate [Hz].
    """

    section: str
    link: str
    name: str
    standing_m: float
    tolerance_m: float
    wanted: ClassVar[dict[str, float]]

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.station: GroundStation
        self._process: subprocess.Popen[bytes]

    def start(self) -> None:
        """Start the program, or start it anew, and wait for its heartbeat."""
        command, environment = self._command()
        with (self.folder / "autopilot.log").open("ab") as log:
            self._process = subprocess.Popen(
                command, cwd=self.folder, env=environment, stdin=subprocess.DEVNULL, stdout=log, stderr=log
            )
        self.connect()

    def connect(self) -> None:
        """Connect a new ground station: that of before has lost its connection when the autopilot starts anew."""
        if hasattr(self, "station"):
            self.station.close()
        self.station = GroundStation(self._socket())
        self.station.wait("a heartbeat of the autopilot", lambda: self.station.all("HEARTBEAT"), 30.0)
        self.name = self._name()
        for message, rate_hz in self.wanted.items():
            self.station.ask(message, rate_hz)

    def end(self, signum: signal.Signals = signal.SIGTERM) -> None:
        """End the program."""
        self._process.send_signal(signum)
        try:
            self._process.wait(20.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def wait_for_hover(self, height_m: float, limit_s: float = 40.0) -> None:
        """Wait until the vehicle has stayed near a height for three seconds."""

        def is_there() -> bool:
            return abs(self.heights()[-1][1] - height_m) < self.tolerance_m

        self.station.wait(f"{height_m} m", is_there, limit_s)
        self.wait(3.0)
        assert is_there(), f"{self.heights()[-1][1]:.2f} m after {height_m} m"

    def wait(self, duration_s: float) -> None:
        """Let time pass."""
        end_s = time.monotonic() + duration_s
        self.station.wait("time", lambda: time.monotonic() > end_s, duration_s + 5.0)

    def texts(self, from_s: float = -math.inf) -> list[str]:
        """STATUSTEXT of the autopilot and of the bridge since a time."""
        return [
            f"{message.text}"
            for time_s, message in self.station.heard
            if message.get_type() == "STATUSTEXT" and time_s >= from_s
        ]

    def mode(self) -> int:
        """The autopilot's own number of its flight mode, in the last heartbeat."""
        return int(self.station.all("HEARTBEAT")[-1][1].custom_mode)

    @abstractmethod
    def _command(self) -> tuple[list[str], dict[str, str]]: ...

    @abstractmethod
    def _socket(self) -> socket.socket: ...

    @abstractmethod
    def _name(self) -> str: ...

    @abstractmethod
    def get_ready(self) -> None:
        """Wait until it can be armed, but for its range finder."""

    @abstractmethod
    def take_off(self) -> None:
        """Arm, take off to `TOP_M` and wait until it hovers there."""

    @abstractmethod
    def go_to(self, height_m: float) -> None:
        """Send the command to change the height."""

    @abstractmethod
    def land(self) -> None:
        """Send the command to land, and wait until it has disarmed."""

    @abstractmethod
    def heights(self) -> Series:
        """True heights over the place where it stood at first [m]."""

    @abstractmethod
    def ranges(self) -> Series:
        """Distance to the ground that the autopilot goes by [m]; not a number where it has none."""

    @abstractmethod
    def healthy(self) -> list[tuple[float, bool]]:
        """Whether the autopilot goes by its range finder."""

    def true_ranges(self) -> Series:
        """What `ranges` should be."""
        return [(time_s, height_m + self.standing_m) for time_s, height_m in self.heights()]

    @abstractmethod
    def flies_as_commanded(self) -> bool:
        """Whether it is armed, and in the mode of its last command: no failsafe has changed it."""


class ArduCopter(Autopilot):
    """ArduCopter: the ground station on SERIAL0, the bridge on SERIAL1.

    SERIAL0 waits at the base port for somebody to connect, SERIAL1 listens two ports above (AP_HAL_SITL,
    SITL_State.h and UARTDriver.cpp).
    """

    section = "ArduPilot"
    GUIDED, LAND, RTL = 4, 9, 6
    """ArduCopter/mode.h."""
    standing_m = STANDING_RANGE_M
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

    def __init__(self, folder: Path, section: str = section) -> None:
        super().__init__(folder)
        self.section = section
        parameters = self.COMMON | documented.parameters(section)
        defaults = "".join(f"{name} {value}\n" for name, value in parameters.items())
        (folder / "defaults.parm").write_text(defaults)
        self._port = free_base_port()
        self.link = f"tcp:127.0.0.1:{self._port + 2}"
        self._standing_alt_m = 0.0

    def _command(self) -> tuple[list[str], dict[str, str]]:
        home = documented.home(self.section)
        options = ["--model", "+", "--speedup", "1", "--home", home, "--defaults", "defaults.parm"]
        return [ARDUCOPTER, *options, "--base-port", str(self._port)], dict(os.environ)

    def _socket(self) -> socket.socket:
        return connected_tcp(self._port)

    def _name(self) -> str:
        return f"ArduCopter {_version(self.station)}"

    def get_ready(self) -> None:
        # A take-off is refused before the estimator uses GPS, some 43 s after the start.
        self.station.wait(
            "a position of EKF3",
            lambda: [
                each for _, each in self.station.all("EKF_STATUS_REPORT") if each.flags & mavlink.EKF_POS_HORIZ_ABS
            ],
            120.0,
        )
        custom = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        self.station.command_until_accepted("GUIDED", 10.0, mavlink.MAV_CMD_DO_SET_MODE, custom, self.GUIDED)

    def take_off(self) -> None:
        self.get_ready()
        self.station.command_until_accepted("arming", 60.0, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
        takeoff = (0, 0, 0, 0, 0, 0, TOP_M)
        self.station.command_until_accepted("take-off", 5.0, mavlink.MAV_CMD_NAV_TAKEOFF, *takeoff)
        self.wait_for_hover(TOP_M)

    def go_to(self, height_m: float, frame: int = mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT) -> None:
        """In GUIDED; the height above the terrain is what the range finder measures (GCS_MAVLink_Copter.cpp)."""
        place = self.station.all("SIM_STATE")[-1][1]
        fields = dict.fromkeys(mavlink.MAVLink_set_position_target_global_int_message.fieldnames, 0)
        fields |= {"target_system": 1, "target_component": 1, "coordinate_frame": frame}
        # Of position, velocity, acceleration and yaw only the position counts.
        fields |= {"type_mask": 0b1101_1111_1000, "lat_int": place.lat_int, "lon_int": place.lon_int, "alt": height_m}
        self.station.send(mavlink.MAVLink_set_position_target_global_int_message(**fields))

    def land(self) -> None:
        custom = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        self.station.command_until_accepted("LAND", 5.0, mavlink.MAV_CMD_DO_SET_MODE, custom, self.LAND)
        self.station.wait("disarmed after landing", lambda: not self.station.is_armed(), 60.0)

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

    def flies_as_commanded(self) -> bool:
        return self.station.is_armed() and self.mode() == self.GUIDED


class Px4(Autopilot):
    """PX4 with SIH: the ground station at UDP port 14550, the bridge at 14540, both PX4's own choice.

    `px4 -d BUILD/etc -w FOLDER` (platforms/posix/src/px4/common/main.cpp); the start script sets the parameters that
    the environment names PX4_PARAM_... and starts MAVLink to the two ports (init.d-posix/rcS and px4-rc.mavlink).
    """

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
        binary = Path(PX4) if Path(PX4).is_file() else Path(PX4) / "bin" / "px4"
        build = binary.resolve().parents[1]
        environment = os.environ | {"PX4_SIM_MODEL": "sihsim_quadx"}
        environment |= {f"PX4_PARAM_{name}": value for name, value in documented.parameters(self.section).items()}
        return [str(build / "bin" / "px4"), "-d", str(build / "etc"), "-w", str(self.folder)], environment

    def _socket(self) -> socket.socket:
        return connected_udp(14550, 30.0)

    def _name(self) -> str:
        return f"PX4 {_version(self.station)}"

    def get_ready(self) -> None:
        self.station.wait("HIL_STATE_QUATERNION", self.heights, 10.0)

    def take_off(self) -> None:
        self.get_ready()
        self.station.command_until_accepted("arming", 90.0, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
        nan = math.nan
        takeoff = (nan, 0, 0, nan, nan, nan, nan)
        self.station.command_until_accepted("take-off", 5.0, mavlink.MAV_CMD_NAV_TAKEOFF, *takeoff)
        self.wait_for_hover(TOP_M)

    def go_to(self, height_m: float) -> None:
        """Over the sea, by the estimate's own offset from the truth (navigator_main.cpp)."""
        altitude_m = self.station.all("ALTITUDE")[-1][1].altitude_amsl
        self.station.command(mavlink.MAV_CMD_DO_CHANGE_ALTITUDE, altitude_m + height_m - self.heights()[-1][1])

    def land(self) -> None:
        nan = math.nan
        self.station.command_until_accepted("landing", 5.0, mavlink.MAV_CMD_NAV_LAND, 0, 0, 0, nan, nan, nan, nan)
        self.station.wait("disarmed after landing", lambda: not self.station.is_armed(), 60.0)

    def heights(self) -> Series:
        states = [each for each in self.station.all("HIL_STATE_QUATERNION") if each[1].lat]
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


KINDS = {ArduCopter: (ARDUCOPTER, "MSP_RANGE_ARDUCOPTER"), Px4: (PX4, "MSP_RANGE_PX4")}
needs_arducopter, needs_px4 = (
    pytest.mark.skipif(not path, reason=f"set {variable} to a SITL build") for path, variable in KINDS.values()
)
both = pytest.mark.parametrize(
    "kind", [pytest.param(ArduCopter, marks=needs_arducopter), pytest.param(Px4, marks=needs_px4)]
)


@contextlib.contextmanager
def running(autopilot: Autopilot) -> Iterator[Autopilot]:
    """The autopilot, started, and ended at the end."""
    autopilot.start()
    try:
        yield autopilot
    finally:
        autopilot.station.close()
        autopilot.end()


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


def _version(station: GroundStation) -> str:
    """Version and the first digits of the commit, from AUTOPILOT_VERSION."""
    station.command(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    _, version = station.wait("AUTOPILOT_VERSION", lambda: station.all("AUTOPILOT_VERSION"), 10.0)[0]
    number = version.flight_sw_version
    kind = {0: "dev", 64: "alpha", 128: "beta", 192: "rc", 255: ""}.get(number & 0xFF, "")
    # ArduPilot sends the digits as text, PX4 the bytes with the first one last.
    custom = bytes(version.flight_custom_version)
    commit = custom.decode() if custom.isascii() and custom.isalnum() else custom[::-1].hex()
    return f"{number >> 24}.{number >> 16 & 0xFF}.{number >> 8 & 0xFF}{'-' + kind if kind else ''} ({commit[:8]})"
