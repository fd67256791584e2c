"""`msp-range commission` with a real ArduCopter in a person's hands: finds five wrong mountings, passes a right one.

The autopilot's attitude is its own estimate, by accelerometers and gyroscopes that feel the person's motions; the
sensors are emulated at their true places, over a flat floor.
"""

import json
import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from msp_range.clock import SystemClock
from msp_range.commission.command import commission
from msp_range.commission.session import Session
from msp_range.commission.steps.table import STEPS
from msp_range.config import load_airframe
from msp_range.doctor.computer import Computer, User
from msp_range.mavlink.transport import open_transport
from msp_range.yaml_file import ConfigError
from tests.loop.test_commission import GOOD, LOW, REVERSED, ROTATED, SWAPPED, WRONG_SIGN, at
from tests.peers.test_commission_phone import Phone
from tests.sitl.arducopter import ArduCopter
from tests.sitl.autopilot import running
from tests.sitl.documented import ROOT
from tests.sitl.held import HeldCopter, SmoothlyHeld
from tests.sitl.kinds import needs_arducopter
from tests.sitl.msp_sim import msp_sim
from tests.sitl.test_params import params
from tests.support.fake_computer import FakeComputer
from tests.support.hand_held import EmulatedBus, HandHeld, Person
from tests.support.known import known

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


@contextmanager
def held_by(copter: ArduCopter, folder: Path, mounted: str, in_file: str) -> Iterator[tuple[Person, Session]]:
    """A vehicle in a person's hands, which is put down at the end: the next one starts there, and must not jump."""
    (folder / "mounted.yaml").write_text(mounted)
    path = folder / "airframe.yaml"
    path.write_text(in_file.replace("serial:/dev/serial0:921600", copter.link))
    airframe = load_airframe(folder / "mounted.yaml")
    vehicle = HandHeld(airframe, clock=SystemClock())
    if isinstance(copter, HeldCopter):
        copter.vehicle = vehicle = SmoothlyHeld(airframe)
    person = Person(vehicle)
    fake = FakeComputer(folder / "computer")
    user = User(fake.user, 54321, frozenset(fake.gids))
    computer = Computer(fake.root, user, vehicle.clock.utc, fake.disk)
    yield person, Session(path, computer, vehicle.clock, person, make_bus=lambda bus: EmulatedBus(vehicle), port=1)
    person.instruct("Leave it on the floor.")
    copter.wait(4.0)


def commissioned(copter: HeldCopter, folder: Path, mounted: str, in_file: str, *steps: str) -> tuple[Person, list[str]]:
    """Do these steps; the person, and the steps that have passed."""
    with held_by(copter, folder, mounted, in_file) as (person, session):
        return person, [step for step in steps if reported(session, step)["passed"]]


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


class WithPhone(NamedTuple):
    """Who answers on a phone, and the texts that its large letters have shown."""

    phone: Phone
    shown: list[str]

    def refused(self, step: str) -> str:
        """The last text of a step that is refused."""
        with pytest.raises(ConfigError) as error:
            self.phone.do(step)
        assert self.shown[-1] == " ".join(str(error.value).split())
        return self.shown[-1]


@pytest.fixture
def with_phone(monkeypatch: pytest.MonkeyPatch) -> Callable[[Session, Person], WithPhone]:
    def make(session: Session, person: Person) -> WithPhone:
        found = WithPhone(Phone(session, person, monkeypatch), [])
        found.phone.look = lambda page: found.shown.append(" ".join(page.locator("#now").inner_text().split()))
        return found

    return make


MakePhone = Callable[[Session, Person], WithPhone]


def test_all_steps_on_the_ground_from_a_phone(copter: HeldCopter, tmp_path: Path, with_phone: MakePhone) -> None:
    """Exchanged addresses, and two wrong parameters: each is asked for with its reason, set, read back and undone."""
    wrong = {"RNGFND1_ORIENT": 0.0, "RNGFND1_GNDCLR": 0.45}
    for name, value in wrong.items():
        copter.set_parameter(name, value)
    with held_by(copter, tmp_path, GOOD, SWAPPED) as (person, session):
        held = with_phone(session, person).phone
        report, log = held.do()
    assert [name for name, each in report["steps"].items() if each["passed"]] == [*STEPS][:5], log
    assert report["next"] == "hover"
    asked = [each for each in held.asked if "RNGFND1" in each]
    assert [each.partition(": ")[0] for each in asked] == [*wrong]
    assert all(re.search(r"-> [\d.]+: \w.*\(.+\)", each, re.DOTALL) for each in asked), asked
    assert "RNGFND1_ORIENT: set to 25 and read back" in log
    assert "exchanged: front_left" in log
    assert [each.address for each in load_airframe(session.path).sensors] == [0x70, 0x71, 0x72, 0x73]
    assert copter.parameter("RNGFND1_ORIENT") == 25.0
    undo = known(re.search(r"to undo: msp-range params (\S+) --restore (\S+)", log))
    assert params(Path(undo[1]), "--port", "1", "--compare").returncode == 0
    assert params(Path(undo[1]), "--restore", undo[2], answers="y\ny\n").returncode == 0
    assert {name: copter.parameter(name) for name in wrong} == pytest.approx(wrong)
    assert params(Path(undo[1]), "--port", "1", "--compare").returncode == 1
    assert params(Path(undo[1]), "--port", "1", "--write", answers="y\ny\n").returncode == 0


def test_a_phone_changes_nothing_while_armed_or_without_a_heartbeat(tmp_path: Path, with_phone: MakePhone) -> None:
    copter = ArduCopter(tmp_path)
    arm, disarm = (400, 1, 21196), (400, 0, 21196)
    with running(copter), held_by(copter, tmp_path, GOOD, SWAPPED) as (person, session):
        copter.set_parameter("RNGFND1_GNDCLR", 0.45)
        held = with_phone(session, person)
        copter.station.command_until_accepted("arming", *arm)
        assert "the vehicle is armed" in held.refused("addresses")
        report, log = held.phone.do("parameters")
        assert "the vehicle is armed" in log
        assert not report["steps"]["parameters"]["passed"]
        assert copter.parameter("RNGFND1_GNDCLR") == pytest.approx(0.45)
        copter.station.command_until_accepted("disarming", *disarm)

        person.when["Cover rear_left."] = lambda: copter.station.command(*arm)
        assert "the vehicle is armed" in held.refused("addresses")
        assert held.shown[-2] == "Cover rear_left."
        copter.station.command_until_accepted("disarming", *disarm)

        person.when["Cover rear_left."] = copter.pause
        assert "heartbeat is lost" in held.refused("addresses")
        assert "no autopilot is received" in held.refused("bench")
        copter.resume()
    assert "address: 0x71" in (tmp_path / "airframe.yaml").read_text()
    assert not [*tmp_path.glob("airframe.yaml.*")]


@pytest.fixture(scope="module")
def hover(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recording of a hover that ArduCopter flew."""
    folder = tmp_path_factory.mktemp("hover")
    copter = ArduCopter(folder)
    with running(copter):
        copter.get_ready()
        with msp_sim(copter, "--record", str(folder / "flights")):
            copter.station.wait("a healthy range finder", lambda: [time_s for time_s, good in copter.healthy() if good])
            copter.take_off()
            copter.wait(25.0)
            copter.land()
    (recording,) = (folder / "flights").glob("*.mcap")
    return recording


@pytest.fixture
def flown(hover: Path, copter: HeldCopter, tmp_path: Path) -> tuple[Person, Session]:
    """A session after the hover, of a vehicle that stands disarmed."""
    shutil.copytree(ROOT / "configs/sensors", tmp_path / "sensors")
    path = tmp_path / "airframe.yaml"
    shutil.copy(ROOT / "configs/loopback.yaml", path)
    person = Person(SmoothlyHeld(load_airframe(path)))
    computer = Computer(tmp_path, User("root", 0, frozenset()), SystemClock().utc)
    session = Session(path, computer, SystemClock(), person, recording=hover)
    session.make_transport = lambda url, clock: open_transport(copter.link, clock)
    return person, session


def with_wrong_height(path: Path) -> None:
    path.write_text(at(path.read_text(), "rear_right", ("0.20, 0.05]", "0.20, 0.15]")))


def test_a_hover_by_the_autopilot_is_reviewed(flown: tuple[Person, Session]) -> None:
    """Its own recording passes; with a wrong height in the file the review finds it."""
    person, session = flown
    assert reported(session, "hover")["passed"]
    assert reported(session, "review")["passed"]
    assert person.asked == []
    with_wrong_height(session.path)
    assert reported(session, "review")["changes"]
    assert ["rear_right: z 0.0" in each for each in person.asked] == [True]


def test_a_hover_is_reviewed_from_a_phone(flown: tuple[Person, Session], with_phone: MakePhone) -> None:
    person, session = flown
    held = with_phone(session, person)
    assert held.phone.do("hover")[0]["steps"]["hover"]["passed"]
    with_wrong_height(session.path)
    report, log = held.phone.do("review")
    assert report["steps"]["review"]["passed"]
    assert "rear_right: z 0.0" in log
    assert load_airframe(session.path).sensors[3].position_m[2] == pytest.approx(0.05, abs=0.02)
