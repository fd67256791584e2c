"""An autopilot in its own simulator with a ground station: one interface for tests that fly ArduCopter and PX4."""

import contextlib
import math
import signal
import socket
import subprocess
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from tests.sitl.ground_station import GroundStation
from tests.support.waiting import LIMIT_S

TOP_M = 6.0
STANDING_RANGE_M = 0.20
"""The fused range on the ground: `msp-sim sitl` stands the sensors at their minimum."""

Series = list[tuple[float, float]]
"""Times [s, monotonic] and values."""


class Autopilot(ABC):
    """A running autopilot with its simulator.

    Attributes
    ----------
    kind
        As `link.autopilot` of an airframe file.
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

    kind: str
    section: str
    link: str
    name: str
    standing_m: float
    tolerance_m: float
    wanted: ClassVar[dict[str, float]]

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._station: GroundStation | None = None
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
        if self._station is not None:
            self._station.close()
        self._station = GroundStation(self._socket())
        self.station.wait("a heartbeat of the autopilot", lambda: self.station.all("HEARTBEAT"))
        self.name = self._name()
        for message, rate_hz in self.wanted.items():
            self.station.ask(message, rate_hz)

    def end(self, signum: signal.Signals = signal.SIGTERM) -> None:
        """End the program and the ground station."""
        if self._station is not None:
            self._station.close()
        self._process.send_signal(signum)
        try:
            self._process.wait(LIMIT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def pause(self) -> None:
        """Stop the program: it sends nothing."""
        self._process.send_signal(signal.SIGSTOP)

    def resume(self) -> None:
        """Let it go on."""
        self._process.send_signal(signal.SIGCONT)

    @property
    def station(self) -> GroundStation:
        """The ground station of the last `connect`."""
        assert self._station is not None
        return self._station

    def wait_for_hover(self, height_m: float) -> None:
        """Wait until the vehicle has stayed near a height for three seconds."""
        from_s = time.monotonic()

        def has_stayed() -> bool:
            since_s = time.monotonic() - 3.0
            heights = [each for time_s, each in self.heights() if time_s >= since_s]
            return (
                bool(heights) and from_s < since_s and all(abs(each - height_m) < self.tolerance_m for each in heights)
            )

        self.station.wait(f"hover at {height_m} m", has_stayed)

    def wait(self, duration_s: float) -> None:
        """Let time pass."""
        end_s = time.monotonic() + duration_s
        self.station.wait("time", lambda: time.monotonic() > end_s)

    def texts(self, from_s: float = -math.inf) -> list[str]:
        """STATUSTEXT of the autopilot and of the bridge since a time."""
        return [
            f"{message.text}"
            for time_s, message in self.station.received
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
    def height_m(self) -> float:
        """The last of `heights`; 0 before the first."""

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


@contextlib.contextmanager
def running(autopilot: Autopilot) -> Iterator[Autopilot]:
    """The autopilot, started, and ended at the end."""
    try:
        autopilot.start()
        yield autopilot
    finally:
        autopilot.end()


def version(station: GroundStation) -> str:
    """Version and the first digits of the commit, from AUTOPILOT_VERSION."""
    station.command(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    _, version = station.wait("AUTOPILOT_VERSION", lambda: station.all("AUTOPILOT_VERSION"))[0]
    number = version.flight_sw_version
    kind = {0: "dev", 64: "alpha", 128: "beta", 192: "rc", 255: ""}.get(number & 0xFF, "")
    # ArduPilot sends the digits as text, PX4 the bytes with the first one last.
    custom = bytes(version.flight_custom_version)
    commit = custom.decode() if custom.isascii() and custom.isalnum() else custom[::-1].hex()
    return f"{number >> 24}.{number >> 16 & 0xFF}.{number >> 8 & 0xFF}{'-' + kind if kind else ''} ({commit[:8]})"
