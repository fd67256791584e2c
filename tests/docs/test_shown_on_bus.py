"""What documents show of commands that need sensors and an autopilot: both are emulated."""

import socket
from pathlib import Path

import pytest

from tests.docs import how
from tests.docs.runner import before, clone, environment, run, script_of
from tests.docs.shown import ROOT
from tests.support.kernel_bus import WRAPPER, Sonar, kernel_bus
from tests.support.parameter_autopilot import ParameterAutopilot
from tests.support.transports import free_port

LIMIT_S = 300.0
FOUR = [Sonar(0x70 + number, [120, 121]) for number in range(4)]
FRESH = {
    "RNGFND1_TYPE": 0.0,
    "RNGFND1_ORIENT": 25.0,
    "RNGFND1_ADDR": 0.0,
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


PX4_FRESH = {"EKF2_RNG_CTRL": 1.0, "EKF2_HGT_REF": 1.0}


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(how.ON_BUS))
def test_what_a_document_shows_runs(name: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    script = f"{before(ROOT / name)}\n{script_of(ROOT / name)}"
    flights = request.getfixturevalue("flown") if "$FLOWN" in script else None
    place = clone(tmp_path)
    port = free_port(socket.SOCK_DGRAM)
    px4 = name in how.PX4
    autopilot = ParameterAutopilot(how.PX4.get(name, f"udpin:127.0.0.1:{port}"), PX4_FRESH if px4 else FRESH, px4=px4)
    with kernel_bus(FOUR) as four, kernel_bus(FOUR[:1]) as one, autopilot:
        surroundings = environment(place, flights) | {
            "PORT": str(port),
            "UMOCKDEV_DIR": str(four.root),
            "ONE_SENSOR": str(one.root),
            "XDG_RUNTIME_DIR": str(tmp_path),
        }
        run(script, place, surroundings, LIMIT_S, [WRAPPER])
