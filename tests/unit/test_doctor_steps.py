"""Single steps of `msp-range doctor`, on files of a pretended computer and without a bus."""

import os
from pathlib import Path

import pytest

from msp_range.config import load_airframe
from msp_range.doctor.computer import Computer, User
from msp_range.doctor.examination import findings
from msp_range.doctor.finding import while_right
from msp_range.doctor.port import check_port
from msp_range.doctor.sensors import disagreeing
from msp_range.doctor.storage import check_disk
from msp_range.mavlink.transport.url import SerialUrl
from msp_range.pilot_texts import Condition, Text
from msp_range.watch.newest import Newest
from tests.support.fake_computer import FakeComputer

PALLET = Path(__file__).parents[2] / "configs/quad_pallet.yaml"
SENSORS = ("front_left", "front_right", "rear_left", "rear_right")


@pytest.fixture
def files(tmp_path: Path) -> FakeComputer:
    return FakeComputer(tmp_path)


def seen(files: FakeComputer) -> Computer:
    user = User(files.user, 54321, frozenset(files.gids))
    return Computer(files.root, user, lambda: files.utc_s, files.disk)


@pytest.mark.parametrize(
    ("command", "verdict"),
    [
        ("/usr/bin/python3 /usr/bin/mavproxy.py --master=/dev/serial0,921600", "wrong"),
        ("/usr/bin/mavlink-routerd -e 127.0.0.1 /dev/ttyAMA0:921600", "wrong"),
        ("/usr/sbin/gpsd /dev/ttyUSB0", "right"),
        ("/usr/lib/systemd/systemd-logind", "right"),
    ],
)
def test_a_program_of_another_user_is_known_by_its_command(files: FakeComputer, command: str, verdict: str) -> None:
    # Without a folder of what it has open: that of root's processes cannot be read.
    files.write("/proc/800/cmdline", command.replace(" ", "\0") + "\0")
    last = list(while_right(check_port(seen(files), SerialUrl("/dev/serial0", 921600))))[-1]
    assert (last.step, last.verdict) == ("serial port in use", verdict)
    assert verdict == "right" or "process 800" in last.text


@pytest.mark.parametrize(
    ("serial0", "serial1", "path", "is_right"),
    [
        ("ttyS0", "ttyAMA0", "/dev/ttyAMA0", False),
        ("ttyS0", "ttyAMA0", "/dev/serial1", False),
        ("ttyS0", "ttyAMA0", "/dev/ttyS0", True),
        ("ttyAMA0", "ttyS0", "/dev/ttyAMA0", True),
        ("ttyAMA0", None, "/dev/ttyAMA0", True),
    ],
)
def test_the_port_of_bluetooth_is_not_that_of_the_pins(
    files: FakeComputer, serial0: str, serial1: str | None, path: str, is_right: bool
) -> None:
    files.device("/dev/ttyS0")
    files.remove("/dev/serial0")
    files.link("/dev/serial0", serial0)
    if serial1 is not None:
        files.link("/dev/serial1", serial1)
    found = list(while_right(check_port(seen(files), SerialUrl(path, 57600))))
    assert (found[0].verdict == "right") is is_right
    if not is_right:
        assert f"/dev/{serial0}" in found[0].text
        assert "serial:/dev/serial0" in (found[0].remedy or "")


def test_a_missing_port_lists_those_that_are_there(files: FakeComputer) -> None:
    files.write("/proc/device-tree/model", "NVIDIA Jetson Nano Developer Kit\0")
    files.remove("/dev/serial0")
    files.remove("/dev/ttyAMA0")
    (found,) = while_right(check_port(seen(files), SerialUrl("/dev/serial0", 57600)))
    assert "no other serial port" in found.text
    files.device("/dev/ttyTHS1")
    (found,) = while_right(check_port(seen(files), SerialUrl("/dev/serial0", 57600)))
    assert "there is /dev/ttyTHS1" in found.text


def test_a_folder_of_the_service_is_not_taken_away_from_it(files: FakeComputer) -> None:
    files.folder("/var/lib/msp-range", 0o755)
    assert check_disk(seen(files), "/var/lib/msp-range").verdict == "wrong"
    files.write("/etc/passwd", f"msp-range:x:{os.getuid()}:{os.getgid()}::/:/usr/sbin/nologin\n")
    found = check_disk(seen(files), "/var/lib/msp-range")
    assert found.verdict == "unknown"
    assert "chown" not in (found.remedy or "")


@pytest.mark.parametrize(
    ("ranges_m", "names"),
    [
        ((0.24, 1.20, 1.18, 1.21), ["front_left"]),
        ((1.20, 1.18, 1.21, 2.40), ["rear_right"]),
        ((1.20, 1.05, 1.35, 1.21), []),
        ((0.20, 0.20, 0.20, 0.45), []),
        ((0.24, 1.20), []),
    ],
)
def test_a_leg_in_a_beam_is_seen_by_the_others(ranges_m: tuple[float, ...], names: list[str]) -> None:
    found = list(disagreeing(load_airframe(PALLET), dict(zip(SENSORS, ranges_m, strict=False))))
    assert [each.text.split()[0] for each in found] == names
    assert all(each.verdict == "unknown" for each in found)


@pytest.mark.parametrize(
    ("condition", "steps"), [(Text.NO_THERMOMETER, []), (Text.WRONG_THERMOMETER, ["thermometer wrong"])]
)
def test_a_file_without_a_thermometer_is_no_error_of_the_running_bridge(condition: Condition, steps: list[str]) -> None:
    fault = {"what": condition.key, "text": condition.text, "remedy": "", "severity": "warning", "cause": None}
    link = {"connected": True, "autopilot": 1, "url": "", "error": None, "sent": {}}
    status = {"state": "active", "uptime_s": 9.0, "sensors": {}, "link": link, "faults": [fault]}
    newest = Newest(airframe={"vehicle": "pallet"}, status=status)
    assert [each.step for each in findings(newest) if each.verdict == "wrong"] == steps
