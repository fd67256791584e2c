"""`msp-sim sitl` as a process alongside an autopilot, started by the command that docs/sitl.md shows."""

import contextlib
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from tests.sitl import documented
from tests.sitl.autopilot import Autopilot
from tests.sitl.ground_station import SITL_LIMIT_S
from tests.support.known import known
from tests.support.waiting import LIMIT_S, until


class MspSim:
    """The process.

    Attributes
    ----------
    start_s
        When it started to count its time [s, monotonic].
    """

    def __init__(self, process: "subprocess.Popen[bytes]", log: Path) -> None:
        self._process = process
        self._log = log
        first = self.wait_for(r"^ *([0-9.]+) s  ")
        self.start_s = time.monotonic() - float(first[1])

    def printed(self) -> str:
        """What it has printed so far."""
        return self._log.read_text()

    def wait_for(self, pattern: str) -> "re.Match[str]":
        """Wait until it prints something."""

        def is_printed() -> bool:
            assert self._process.poll() is None, self.printed()
            return re.search(pattern, self.printed(), re.M) is not None

        until(is_printed, SITL_LIMIT_S, seen=self.printed)
        return known(re.search(pattern, self.printed(), re.M))


@contextlib.contextmanager
def msp_sim(autopilot: Autopilot, *options: str) -> Iterator[MspSim]:
    """`msp-sim sitl`, entered when it receives the simulator's truth; it must end without an error."""
    log = autopilot.folder / "msp-sim.log"
    command = documented.sitl_command(autopilot.section, autopilot.link)
    with log.open("wb") as output:
        process = subprocess.Popen(
            [sys.executable, "-c", "from msp_sim.cli import main; main()", *command, *options],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
        )
    with process:
        try:
            simulation = MspSim(process, log)
            simulation.wait_for("pose from (SIM_STATE|HIL_STATE_QUATERNION)")
            yield simulation
            assert process.poll() is None, simulation.printed()
        finally:
            process.send_signal(signal.SIGTERM)
            try:
                process.wait(LIMIT_S)
            finally:
                process.kill()
    assert process.returncode == 0, simulation.printed()
