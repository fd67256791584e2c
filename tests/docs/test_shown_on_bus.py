"""What documents show of commands that need sensors and an autopilot: both are emulated."""

import socket
import subprocess
from contextlib import ExitStack
from pathlib import Path

import pytest

from tests.docs import how
from tests.docs.runner import clone, environment, fly_four, scripts
from tests.docs.shown import ROOT
from tests.support.kernel_bus import Sonar, kernel_bus
from tests.support.parameter_autopilot import ParameterAutopilot
from tests.support.transports import free_port

FOUR = [Sonar(0x70 + number, [120, 121]) for number in range(4)]
FRESH = {
    "RNGFND1_TYPE": 0.0,
    "RNGFND1_ORIENT": 25.0,
    "RNGFND1_MIN": 0.2,
    "RNGFND1_MAX": 7.0,
    "RNGFND1_GNDCLR": 0.1,
    "RNGFND1_POS_X": 0.0,
    "RNGFND1_POS_Y": 0.0,
    "RNGFND1_POS_Z": 0.0,
    "SERIAL2_PROTOCOL": 2.0,
    "SERIAL2_BAUD": 57.0,
}
"""Parameters of an autopilot that nobody has set up."""


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(how.ON_BUS))
def test_what_a_document_shows_runs(name: str, tmp_path: Path) -> None:
    before = how.PREPARE.get(name, "")
    flown = fly_four(tmp_path / "flown") if "$FLOWN" in before else None
    place = clone(tmp_path)
    port = free_port(socket.SOCK_DGRAM)
    surroundings = environment(place, flown) | {"PORT": str(port)}
    with ExitStack() as stack:
        four = stack.enter_context(kernel_bus(FOUR))
        stack.enter_context(ParameterAutopilot(f"udpin:127.0.0.1:{port}", FRESH))
        for script in [before, *scripts(ROOT / name)]:
            lines = script.splitlines()
            alone = [line for line in lines if any(each in line for each in how.ONE_SENSOR)]
            testbed = stack.enter_context(kernel_bus(FOUR[:1])) if alone else four
            program = testbed.popen(
                ["bash", "-ec", script],
                cwd=place,
                env=surroundings,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
            )
            output, _ = program.communicate(timeout=300.0)
            assert program.returncode == 0, f"{script}\n{output[-3000:]}"
