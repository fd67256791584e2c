"""`msp-range doctor` on set-ups of owners (tests/support/doctor_set_ups.py): does it name the mistake, and no other?

When they were written and the doctor first run on them, it named 10 of the 15 mistakes right. Not named were sensors
with their factory address, a leg in a beam, Bluetooth's serial port, a loose TX wire, and two programs that both send
by UDP. Of the five without a mistake one raised an alarm: a running bridge whose file names no thermometer.
"""

import re
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path

import pytest

from msp_range.watch.place import own_socket
from tests.support.doctor_runs import AT_ONCE, Found, examined
from tests.support.doctor_set_ups import BROKEN, GOOD, SetUp
from tests.support.fake_computer import FakeComputer
from tests.support.kernel_bus import kernel_bus
from tests.support.service import running_service
from tests.support.waiting import until

pytestmark = pytest.mark.slow


def examine(set_up: SetUp, folder: Path) -> list[Found]:
    """What doctor finds."""
    computer = FakeComputer(folder / "computer")
    set_up.computer(computer)
    airframe = folder / "airframe.yaml"
    airframe.write_text(set_up.airframe_text())
    with ExitStack() as stack:
        link = stack.enter_context(set_up.far_end())
        testbed = stack.enter_context(kernel_bus(set_up.devices))
        if set_up.service:
            service = stack.enter_context(running_service(testbed, link, folder, airframe=airframe))
            until(lambda: own_socket().exists() and any("autopilot" in str(line) for line in service.log()))
        return examined(testbed, computer, airframe, link)


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, "Future[list[Found]]"]]:
    """All set-ups, several at a time."""
    with ThreadPoolExecutor(AT_ONCE) as pool:
        yield {each.name: pool.submit(examine, each, tmp_path_factory.mktemp("set_up")) for each in [*BROKEN, *GOOD]}


@pytest.mark.parametrize("set_up", BROKEN, ids=lambda each: each.name)
def test_names_the_mistake(set_up: SetUp, results: dict[str, "Future[list[Found]]"]) -> None:
    findings = results[set_up.name].result()
    assert [each for each in findings if names(each, set_up.cause)], findings


@pytest.mark.parametrize("set_up", GOOD, ids=lambda each: each.name)
def test_no_false_alarm(set_up: SetUp, results: dict[str, "Future[list[Found]]"]) -> None:
    findings = results[set_up.name].result()
    assert [each for each in findings if each.verdict == "wrong"] == []
    steps = [each.step for each in findings]
    assert ("running bridge" if set_up.service else "distances") in steps


def names(finding: Found, cause: Sequence[str]) -> bool:
    """Whether it is reported as wrong or unknown, and contains the whole cause."""
    words = f"{finding.step}: {finding.text} {finding.remedy}"
    return finding.verdict != "right" and all(re.search(each, words) for each in cause)
