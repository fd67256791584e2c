"""The bridge on arm64, emulated: what `requirements.lock` pins for it installs, loads, and passes the bridge's tests.

The tests are those of what a reading passes on its way from the bus to the link: `FLOWN`. An instruction takes some 20
times as long there, and all tests of the bridge would take 15 minutes.
"""

import pytest

from evaluation import ROOT
from evaluation.arm64.computer import Arm64
from tests.support.service import missing

FLOWN = ("test_bridge.py", "test_geometry.py", "acoustics", "correction", "fusion", "health", "mavlink", "sensors")
"""Of tests/unit/msp_range."""


@pytest.fixture(scope="module")
def computer() -> Arm64:
    try:
        return Arm64(ROOT / "build/arm64")
    except FileNotFoundError as error:
        missing(str(error))


@pytest.mark.slow
def test_every_compiled_file_of_the_wheels_loads(computer: Arm64) -> None:
    libraries = computer.libraries()
    assert {path.name.partition(".")[0] for path in libraries} > {"fastcrc", "orjson", "_pydantic_core", "_yaml"}
    program = "import ctypes, platform, sys; list(map(ctypes.PyDLL, sys.argv[1:])); print(platform.machine())"
    done = computer.run(["-c", program, *libraries])
    assert (done.returncode, done.stdout) == (0, "aarch64\n"), done.stderr
