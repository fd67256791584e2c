"""`msp-range doctor` on set-ups of owners (tests/support/doctor_set_ups.py): does it name the mistake, and no other?"""

import json
import re
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.support.doctor_set_ups import BROKEN, GOOD, SetUp
from tests.support.fake_computer import FakeComputer
from tests.support.kernel_bus import kernel_bus
from tests.support.service import COMMAND

PROGRAM = Path(__file__).parents[1] / "support" / "doctor_program.py"
LIMIT_S = 120.0
SERVICE_S = 20.0
SERVICE_FLIES_S = 5.0


@dataclass(frozen=True)
class Line:
    """One line of the doctor's report."""

    step: str
    verdict: str
    text: str
    remedy: str

    @property
    def is_right(self) -> bool:
        return self.verdict == "right"

    def names(self, cause: Sequence[str]) -> bool:
        """Whether it is reported as wrong or unknown, and contains the whole cause."""
        words = f"{self.step}: {self.text} {self.remedy}"
        return not self.is_right and all(re.search(each, words) for each in cause)


def report(set_up: SetUp, folder: Path) -> list[Line]:
    """What the doctor reports."""
    computer = FakeComputer(folder / "computer")
    set_up.computer(computer)
    airframe = folder / "airframe.yaml"
    airframe.write_text(set_up.airframe_text())
    with ExitStack() as stack:
        link = stack.enter_context(set_up.far_end())
        testbed = stack.enter_context(kernel_bus(set_up.devices))
        if set_up.service:
            socket = computer.at("/run/msp-range/status.sock")
            socket.parent.mkdir(parents=True)
            log = stack.enter_context((folder / "log").open("w"))
            service = testbed.popen(
                [COMMAND, "run", airframe, "--link", link, "--log", "json", "--socket", socket], stderr=log
            )
            stack.callback(service.kill)
            _wait_for(socket, folder / "log")
        spec = {
            "user": computer.user,
            "gids": computer.gids,
            "root": str(computer.root),
            "utc_s": computer.utc_s,
            "free_bytes": computer.free_bytes,
            "airframe": str(airframe),
            "link": link,
        }
        done = testbed.run([sys.executable, PROGRAM, json.dumps(spec)], LIMIT_S)
    assert done.returncode == 0, done.stderr
    return [Line(*each) for each in json.loads(done.stdout)]


def _wait_for(socket: Path, log: Path) -> None:
    """Wait until the service is watched at its socket, and has flown for some seconds."""
    end_s = time.monotonic() + SERVICE_S
    while not socket.exists():
        assert time.monotonic() < end_s, log.read_text()
        time.sleep(0.05)
    time.sleep(SERVICE_FLIES_S)


@pytest.mark.parametrize("set_up", BROKEN, ids=lambda each: each.name)
def test_names_the_mistake(set_up: SetUp, tmp_path: Path) -> None:
    lines = report(set_up, tmp_path)
    assert [line for line in lines if line.names(set_up.cause)], _shown(lines)


@pytest.mark.parametrize("set_up", GOOD, ids=lambda each: each.name)
def test_no_false_alarm(set_up: SetUp, tmp_path: Path) -> None:
    lines = report(set_up, tmp_path)
    assert not [line for line in lines if line.verdict == "wrong"], _shown(lines)


def _shown(lines: list[Line]) -> str:
    return "\n".join(f"{line.verdict:8} {line.step}: {line.text} {line.remedy}" for line in lines)
