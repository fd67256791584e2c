"""The autopilots as a person starts them: docs/sitl.md's sim_vehicle.py with MAVProxy, and PX4's own make.

Both are in their source trees, which are found from the binaries that the environment names. What the person types goes
to the program's input, and what it prints is read in `autopilot.log`.
"""

import os
import signal
import socket
import subprocess
from abc import abstractmethod
from contextlib import suppress
from pathlib import Path

from tests.docs.shown import blocks, commands, shown
from tests.peers import mavproxy_env
from tests.sitl import documented
from tests.sitl.arducopter import ARDUCOPTER, ArduCopter
from tests.sitl.autopilot import TOP_M, Autopilot
from tests.sitl.ground_station import connected_udp
from tests.sitl.px4 import SENSORS_STOP_S, STARTS, Px4, build_folder
from tests.support.waiting import LIMIT_S

SIM_VEHICLE = "sim_vehicle.py -N -v ArduCopter --add-param-file=range.parm"
SIM_VEHICLE_AT = (
    "sim_vehicle.py -N -v ArduCopter --add-param-file=range.parm --custom-location=-35.363262,149.165237,584,0"
)
MAKE_PX4 = "make px4_sitl sihsim_quadx"
AUTOTEST = Path(ARDUCOPTER).absolute().parent / "../../../Tools/autotest"
"""Of the ArduPilot tree in which build/sitl/bin/arducopter is named."""
PX4_TREE = build_folder().parent.parent
"""The PX4 tree in which build/px4_sitl_default is named."""
GROUND_STATION_PORT = 14550
"""Where MAVProxy passes on what it receives, and PX4 sends to."""
TYPING_S = 2.0
"""A person needs so long for a line."""


class Typed(Autopilot):
    """An autopilot that a person starts in a terminal."""

    def start(self) -> None:
        command, environment = self._command()
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(
                command,
                cwd=self._place(),
                env=environment,
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )
        self.connect()

    def type(self, line: str) -> None:
        """Type a line."""
        assert self._process.stdin is not None
        self.wait(TYPING_S)
        self._process.stdin.write(f"{line}\n".encode())
        self._process.stdin.flush()

    def wait_until_printed(self, text: str) -> None:
        """Wait until it has printed a text."""
        self.station.wait(f"printed: {text}", lambda: text in self._log.read_text(errors="replace"))

    def land(self) -> None:
        self.type(documented.typed(self.section)[-1])
        self.station.wait("disarmed after landing", lambda: not self.station.is_armed())

    def end(self, signum: signal.Signals = signal.SIGINT) -> None:
        """Press Ctrl-C, and end what is left of what the terminal has started."""
        if self._station is not None:
            self._station.close()
        with self._process:
            with suppress(ProcessLookupError, subprocess.TimeoutExpired):
                os.killpg(self._process.pid, signum)
                self._process.wait(LIMIT_S)
            with suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)

    @property
    def _log(self) -> Path:
        return self.folder / "autopilot.log"

    @abstractmethod
    def _place(self) -> Path:
        """The folder in which the person gives the command."""

    def _socket(self) -> socket.socket:
        return connected_udp(GROUND_STATION_PORT)


class SimVehicle(Typed, ArduCopter):
    """ArduCopter by sim_vehicle.py, with all of its arming checks."""

    def __init__(self, folder: Path, section: str = ArduCopter.section, command: str = SIM_VEHICLE) -> None:
        Autopilot.__init__(self, folder)
        self.section = section
        self.link = documented.sitl_link(section)
        self._shown = shown(command)
        parameters = documented.parameters(section)
        (folder / "range.parm").write_text("".join(f"{name} {value}\n" for name, value in parameters.items()))

    def take_off(self) -> None:
        self.wait_until_printed("EKF3 IMU0 is using GPS")
        *lines, _ = documented.typed(self.section)
        for line in lines:
            self.type(line)
        self.wait_for_hover(TOP_M)

    def _place(self) -> Path:
        return self.folder

    def _command(self) -> tuple[list[str], dict[str, str]]:
        programs = (mavproxy_env.PYTHON.parent, AUTOTEST, os.environ["PATH"])
        here = {"PATH": os.pathsep.join(map(str, programs)), "PYTHONUNBUFFERED": "1"}
        # It opens windows where it can.
        outside = {"DISPLAY", "TMUX", "STY", "ZELLIJ", "SITL_RITW_TERMINAL"}
        kept = {name: value for name, value in os.environ.items() if name not in outside}
        return ["bash", "-c", self._shown], kept | here


class MadePx4(Typed, Px4):
    """PX4 by make; it builds what is not built yet, and keeps its parameters in its tree."""

    link = documented.sitl_link(Px4.section)

    def take_off(self) -> None:
        takeoff, _ = documented.typed(self.section)
        for _ in range(STARTS):
            self.wait_until_printed("Ready for takeoff!")
            self.type(takeoff)
            self.station.wait("armed", self.station.is_armed)
            self.wait(SENSORS_STOP_S)
            if not any("No valid data from Baro" in text for text in self.texts()):
                break
            self.end()
            self.start()
        self.wait_for_hover(TOP_M)

    def _place(self) -> Path:
        return PX4_TREE

    def _command(self) -> tuple[list[str], dict[str, str]]:
        scripts = [block.script for block in blocks(documented.ROOT / "docs/sitl.md") if block.script]
        (script,) = [each for each in scripts if MAKE_PX4 in commands(each)]
        return ["bash", "-ec", script], dict(os.environ)
