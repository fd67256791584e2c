"""`msp-range doctor --preflight` as a program: with sensors and an autopilot, and next to a running bridge."""

import time
from pathlib import Path

import pytest
from pymavlink.dialects.v20.common import MAV_STATE_CRITICAL

from tests.support.doctor_runs import doctor_command
from tests.support.fake_computer import FakeComputer
from tests.support.far_ends import by_udp
from tests.support.kernel_bus import KernelTestbed, Other, Sonar, kernel_bus
from tests.support.parameter_autopilot import RANGE_FINDER, ParameterAutopilot
from tests.support.service import Autopilot, LinkEnd, running_service
from tests.support.shipped import write_airframe

LIMIT_S = 5.0
FOUR = [Sonar(0x70 + number, [30, 31]) for number in range(4)]
VALUES = RANGE_FINDER | {"RTL_ALT_M": 15.0, "RTL_ALT_TYPE": 0.0, "WP_RFND_USE": 1.0, "EK3_SRC1_POSZ": 1.0}


@pytest.fixture(autouse=True)
def _own_socket(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No other bridge of this user is asked."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))


def preflight(testbed: KernelTestbed, computer: FakeComputer, airframe: Path) -> tuple[int, list[str]]:
    """Exit code and lines."""
    start_s = time.monotonic()
    done = testbed.run(doctor_command(computer, airframe, "", preflight=True))
    assert time.monotonic() - start_s < LIMIT_S, "too late"
    return done.returncode, done.stdout.splitlines()


@pytest.mark.parametrize("sonars", [4, 3])
def test_without_a_bridge_sensors_and_autopilot_are_asked(sonars: int, tmp_path: Path) -> None:
    devices: list[Sonar | Other] = [*FOUR[:sonars], Other(0x44, "000000")]
    with kernel_bus(devices) as testbed, by_udp(lambda url: ParameterAutopilot(url, VALUES, mission=[])) as url:
        airframe = write_airframe(tmp_path, "quad_pallet", ("serial:/dev/serial0:921600", url))
        code, lines = preflight(testbed, FakeComputer(tmp_path / "computer"), airframe)
    # pymavlink's autopilot sends five heartbeats a second, so that nobody waits for it.
    text = " ".join(" ".join(lines).split())
    assert "heights: RTL_ALT_M 15 m: above 7.65 m distances read 'above the maximum'" in text
    assert "readings of front_left: 0.30 m 0.31 m" in text
    assert len(lines) <= 22, "one screen"
    if sonars == 4:
        assert (code, lines[0]) == (0, "GO"), text
    else:
        assert (code, lines[0]) == (1, "NO-GO    address of rear_right"), text
        assert lines[1].startswith("wrong    address of rear_right: nothing answers at 0x73")


def test_a_running_bridge_is_asked(tmp_path: Path) -> None:
    path, computer = write_airframe(tmp_path, "loopback"), FakeComputer(tmp_path / "computer")
    with (
        kernel_bus([*FOUR, Other(0x44, "000000")]) as testbed,
        LinkEnd(autopilot=Autopilot()) as end,
        running_service(testbed, end.url, tmp_path, "--no-record", airframe=path),
    ):
        end.run_until(lambda: len(end.distances) > 10)
        code, lines = preflight(testbed, computer, path)
        other = tmp_path / "other.yaml"
        other.write_text(path.read_text().replace("vehicle: loopback", "vehicle: another"))
        wrong_file, said_of_it = preflight(testbed, computer, other)
        end.autopilot = None
        end.run_until(lambda: end.of("HEARTBEAT")[-1].system_status == MAV_STATE_CRITICAL)
        without, said = preflight(testbed, computer, path)
    text = " ".join(" ".join(lines).split())
    assert (code, lines[0]) == (0, "GO"), text
    assert "heights: those of return and mission were not read, as the bridge has the link -> above 7.65 m" in text
    assert (wrong_file, said_of_it[0]) == (1, "NO-GO    running bridge")
    assert said_of_it[1].startswith("wrong    running bridge: it flies another airframe, or another version")
    assert (without, said[0]) == (1, "NO-GO    autopilot")
    assert said[1] == "wrong    autopilot: Range: no autopilot, nobody gets the distances"
