"""`msp-range doctor` on a pretended computer, as a program of its own on umockdev's I2C bus."""

import json
import sys
from pathlib import Path
from typing import NamedTuple

from tests.support.fake_computer import FakeComputer
from tests.support.kernel_bus import KernelTestbed

PROGRAM = Path(__file__).with_name("doctor_program.py")
AT_ONCE = 6
"""Set-ups that are examined at the same time: each waits for sensors and autopilots most of its time."""
LIMIT_S = 120.0


class Found(NamedTuple):
    """One finding."""

    step: str
    verdict: str
    text: str
    remedy: str


def doctor_command(computer: FakeComputer, airframe: Path, link: str, preflight: bool = False) -> list[str]:
    """The program; ``link`` is used in place of the airframe's URL."""
    specification = {
        "root": str(computer.root),
        "airframe": str(airframe),
        "user": computer.user,
        "gids": computer.gids,
        "utc_s": computer.utc_s,
        "disk": list(computer.disk(computer.root)),
        "link": link,
        "preflight": preflight,
    }
    return [sys.executable, str(PROGRAM), json.dumps(specification)]


def findings_in(output: str) -> list[Found]:
    """What the program has printed."""
    return [Found(*each) for each in json.loads(output)]


def examined(testbed: KernelTestbed, computer: FakeComputer, airframe: Path, link: str) -> list[Found]:
    """What doctor finds."""
    done = testbed.run(doctor_command(computer, airframe, link), LIMIT_S)
    assert done.returncode == 0, done.stderr
    return findings_in(done.stdout)
