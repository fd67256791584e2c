"""The bridge on arm64, emulated: what `requirements.lock` pins for it loads, the bridge flies, and its tests pass.

The tests are those of what a reading passes on its way from the bus to the link, in modules that import no more than
the bridge and pytest: scipy, hypothesis and the simulator take minutes to load there, where all is some 20 times as
slow. Of a test with several values the first ones are run.
"""

import re
from pathlib import Path

import pytest

from evaluation import ROOT
from evaluation.arm64.command import START_GOAL, fly
from evaluation.arm64.computer import Arm64
from tests.support.service import missing

FLOWN = ("acoustics", "correction", "fusion", "health", "mavlink", "sensors")
"""Folders of tests/unit/msp_range."""
MORE = re.compile(r"^(import|from) (scipy|hypothesis|numpy|msp_sim|tests|subprocess)\b", re.M)
MAX_FLIGHT = 25e6
"""Instructions of a second of flight at most: docs/figures.md has 15 million."""


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


@pytest.mark.slow
def test_it_flies_and_takes_no_more_instructions_than_a_small_computer_has(computer: Arm64) -> None:
    fly(computer, 0.0)  # makes bytecode
    start, flight = fly(computer, 10.0)
    assert 1e8 < start < START_GOAL
    assert 1e6 < flight < MAX_FLIGHT


@pytest.mark.slow
def test_the_tests_of_the_bridge_pass(computer: Arm64) -> None:
    folder = Path(__file__).parents[1] / "unit/msp_range"
    files = [path for name in FLOWN for path in sorted((folder / name).rglob("test_*.py"))]
    alone = [path for path in files if not MORE.search(path.read_text(encoding="utf-8"))]
    # Neither this project's conftest.py, which needs hypothesis and xdist, nor assertions that are rewritten: a minute.
    options = ["-q", "-p", "no:cacheprovider", "--noconftest", "--assert=plain", "-m", "not slow"]
    done = computer.run(["-m", "pytest", *options, "-p", "evaluation.arm64.first_values", *alone])
    assert done.returncode == 0, done.stdout[-5000:] + done.stderr[-2000:]
    passed = re.search(r"(\d+) passed", done.stdout)
    assert passed is not None
    assert int(passed[1]) > 150
