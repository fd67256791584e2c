"""`msp-range commission` with a real ArduCopter in a person's hands: finds five wrong mountings, passes a right one.

The autopilot's attitude is its own estimate, by accelerometers and gyroscopes that feel the person's motions; the
sensors are emulated at their true places, over a flat floor.
"""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from msp_range.clock import SystemClock
from msp_range.commission.command import commission
from msp_range.commission.session import Session
from msp_range.config import load_airframe
from msp_range.doctor.computer import Computer, User
from tests.loop.test_commission import GOOD, LOW, REVERSED, ROTATED, SWAPPED, WRONG_SIGN, at
from tests.sitl.arducopter import ArduCopter
from tests.sitl.autopilot import running
from tests.sitl.documented import ROOT
from tests.sitl.held import HeldCopter, SmoothlyHeld
from tests.sitl.kinds import needs_arducopter
from tests.sitl.msp_sim import msp_sim
from tests.support.hand_held import EmulatedBus, Person

pytestmark = [needs_arducopter, pytest.mark.real_time]


@pytest.fixture(scope="module")
def copter(tmp_path_factory: pytest.TempPathFactory) -> Iterator[HeldCopter]:
    """One ArduCopter for all vehicles, when its estimator has settled."""
    held = HeldCopter(tmp_path_factory.mktemp("copter"))
    with running(held):
        held.get_ready()
        yield held


def reported(session: Session, step: str) -> dict[str, Any]:
    """Do a step; its report."""
    report: dict[str, Any] = commission(session, step)["steps"][step]
    print(json.dumps(report))
    return report


def commissioned(copter: HeldCopter, folder: Path, mounted: str, in_file: str, *steps: str) -> tuple[Person, list[str]]:
    """Do these steps; the person, and the steps that have passed."""
    (folder / "mounted.yaml").write_text(mounted)
    path = folder / "airframe.yaml"
    path.write_text(in_file.replace("serial:/dev/serial0:921600", copter.link))
    vehicle = SmoothlyHeld(load_airframe(folder / "mounted.yaml"))
    copter.vehicle = vehicle
    person = Person(vehicle)
    session = Session(
        path,
        Computer(folder, User("root", 0, frozenset()), vehicle.clock.utc),
        vehicle.clock,
        person,
        make_bus=lambda bus: EmulatedBus(vehicle),
        port=1,
    )
    passed = [step for step in steps if reported(session, step)["passed"]]
    person.instruct("Leave it on the floor.")  # the next vehicle starts there, and must not jump
    copter.wait(4.0)
    return person, passed


def test_a_vehicle_that_is_mounted_as_its_file_says_passes(copter: HeldCopter, tmp_path: Path) -> None:
    steps = ("addresses", "bench", "parameters", "lift")
    person, passed = commissioned(copter, tmp_path, GOOD, GOOD, *steps)
    assert person.asked == []
    assert passed == [*steps]


@pytest.mark.parametrize(
    ("mounted", "in_file", "step", "words"),
    [
        pytest.param(GOOD, SWAPPED, "addresses", "exchanged: front_left", id="swapped addresses"),
        pytest.param(GOOD, REVERSED, "lift", "rear_left looks to pitch -90", id="reversed pitch"),
        pytest.param(GOOD, LOW, "bench", "rear_right: 0.0", id="wrong height"),
        pytest.param(GOOD, WRONG_SIGN, "lift", "wrong sign", id="wrong sign of y"),
        pytest.param(ROTATED, GOOD, "lift", "front_right looks to pitch -", id="one sensor rotated"),
    ],
)
def test_a_wrong_mounting_is_found_and_corrected(
    copter: HeldCopter, tmp_path: Path, mounted: str, in_file: str, step: str, words: str
) -> None:
    person, passed = commissioned(copter, tmp_path, mounted, in_file, step)
    assert [words in each for each in person.asked] == [True], person.asked
    assert passed == [step]
    for found, true in zip(
        load_airframe(tmp_path / "airframe.yaml").sensors,
        load_airframe(tmp_path / "mounted.yaml").sensors,
        strict=True,
    ):
        assert found.address == true.address
        assert found.position_m == pytest.approx(true.position_m, abs=0.03)
        # Echoes of a canted sensor show one edge of its beam.
        assert sum(a * b for a, b in zip(found.boresight, true.boresight, strict=True)) > 0.985


def test_a_hover_by_the_autopilot_is_reviewed(tmp_path: Path) -> None:
    """Its own recording passes; with a wrong height in the file the review finds it."""
    copter = ArduCopter(tmp_path)
    with running(copter):
        copter.get_ready()
        with msp_sim(copter, "--record", str(tmp_path / "flights")):
            copter.station.wait("a healthy range finder", lambda: [time_s for time_s, good in copter.healthy() if good])
            copter.take_off()
            copter.wait(25.0)
            copter.land()
    (recording,) = (tmp_path / "flights").glob("*.mcap")
    shutil.copytree(ROOT / "configs/sensors", tmp_path / "sensors")
    path = tmp_path / "airframe.yaml"
    shutil.copy(ROOT / "configs/loopback.yaml", path)
    person = Person(SmoothlyHeld(load_airframe(path)))
    computer = Computer(tmp_path, User("root", 0, frozenset()), SystemClock().utc)
    session = Session(path, computer, SystemClock(), person, recording=recording)
    assert reported(session, "hover")["passed"]
    assert reported(session, "review")["passed"]
    assert person.asked == []
    path.write_text(at(path.read_text(), "rear_right", ("0.20, 0.05]", "0.20, 0.15]")))
    assert reported(session, "review")["changes"]
    assert ["rear_right: z 0.0" in each for each in person.asked] == [True]
