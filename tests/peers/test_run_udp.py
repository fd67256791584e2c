"""`msp-range run` as users start it: a real process, the stock smbus2 on an emulated kernel's bus, a real link."""

import json
import math
import os
import pty
import re
import signal
import socket
import subprocess
import termios
import time
import tty
from contextlib import suppress
from functools import partial
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any

import pytest
from mcap.reader import make_reader
from pymavlink.dialects.v20 import ardupilotmega
from scipy.spatial.transform import Rotation

from tests.support.kernel_bus import HWMON_FILE, KernelTestbed, kernel_bus
from tests.support.service import (
    AIRFRAME,
    COMMAND,
    FORWARD_ID,
    FUSED_ID,
    SLANTED_ID,
    Autopilot,
    LinkEnd,
    running_service,
    sonars,
)
from tests.support.transports import free_port
from tests.support.waiting import LIMIT_S, until

STEADY = sonars(forward_cm=[120], slanted_cm=[765], down_cm=[300])
COLDER = math.sqrt((20.0 + 273.15) / (22.5 + 273.15))
"""The airframe's air is 20 C, the sensor's 22.5 C: what its readings are multiplied with."""


def of_stream(end: LinkEnd, stream_id: int) -> list[dict[str, Any]]:
    return [each for each in end.distances if each["id"] == stream_id]


def pings(testbed: KernelTestbed) -> int:
    """Range commands that a sensor took."""
    return sum(each.verb == "write" and each.errno == 0 for each in testbed.journal())


def test_what_an_autopilot_receives(tmp_path: Path) -> None:
    recordings = tmp_path / "recordings"
    with kernel_bus(STEADY) as testbed, LinkEnd() as end:
        with running_service(testbed, end.url, tmp_path, "--record", str(recordings)) as service:
            end.run_until(lambda: all(len(of_stream(end, each)) >= 4 for each in (FORWARD_ID, SLANTED_ID, FUSED_ID)))
            end.run_until(lambda: "Range: all 4 sensors good" in [each.text for each in end.of("STATUSTEXT")])
            code = service.stop()
            log = service.log()
        end.run_until(lambda: len(end.arrived) >= log[-1]["frames"]["sent"])
        down_s = [each.time_s for each in testbed.journal() if each.verb == "write" and each.address in (0x72, 0x73)]

    assert {(each.get_srcSystem(), each.get_srcComponent()) for each in end.of(*KINDS)} == {(1, 191)}
    assert {each.message.get_type() for each in end.arrived} <= set(KINDS)
    numbers = [each.message.get_seq() for each in end.arrived]
    assert numbers == list(range(len(numbers)))

    assert end.arrived[0].message.get_type() == "HEARTBEAT"
    for beat in end.of("HEARTBEAT"):
        assert (beat.type, beat.autopilot, beat.mavlink_version) == (
            ardupilotmega.MAV_TYPE_ONBOARD_CONTROLLER,
            ardupilotmega.MAV_AUTOPILOT_INVALID,
            3,
        )
    # A computer that gives the bridge no processor for a second makes it silent, and it says so.
    silence = [each for each in end.of("STATUSTEXT") if re.search("no distance|distance is back", each.text)]
    assert [(each.severity, each.text) for each in end.of("STATUSTEXT") if each not in silence] == [
        (4, "Range: no thermometer, 33 cm off at -4 C, 7.65 m"),
        (6, "Range: all 4 sensors good"),
    ]

    fused, forward, slanted = (of_stream(end, each) for each in (FUSED_ID, FORWARD_ID, SLANTED_ID))
    check_distances(fused, forward, slanted)
    # The echo's time rises as the downward sensors' pings do: two of four slots of 100 ms on an idle computer.
    times_s = [each["time_boot_ms"] / 1e3 for each in fused]
    assert min(off_s(times_s, [each - first_s for each in down_s]) for first_s in down_s) < 0.02

    assert code == 0
    assert [log[0]["event"], log[-1]["event"]] == ["started", "stopped by signal"]
    assert log[-1]["frames"] == {"sent": len(end.arrived), "dropped": 0, "reconnects": 0}
    (recording,) = recordings.glob("*.mcap")
    assert sent_frames(recording) == [each.frame for each in end.arrived if each.distance is not None]


def check_distances(fused: list[dict[str, Any]], forward: list[dict[str, Any]], slanted: list[dict[str, Any]]) -> None:
    """Each field of the three streams, by what the sensors read."""
    for each in fused + forward + slanted:
        assert (each["min_distance"], each["max_distance"], each["type"]) == (19, round(765 * COLDER), 1)
        assert each["horizontal_fov"] == each["vertical_fov"]
    assert {each["current_distance"] for each in fused} == {round(300 * COLDER)}
    assert {each["orientation"] for each in fused} == {25}
    assert {each["current_distance"] for each in forward} == {round(120 * COLDER)}
    assert {each["orientation"] for each in forward} == {0}
    assert all(each["quaternion"] == [0, 0, 0, 0] for each in fused + forward)
    # Nobody knows the air to better than 12 C: 5.9 cm^2 at 1.2 m, 37 at 3 m. A reading has 3.9 on top of that; what the
    # fused stream has yet to learn at its start is the slope: 6 deg by half a metre.
    assert all(6 <= each["covariance"] <= 11 for each in forward)
    assert all(37 <= each["covariance"] <= 67 for each in fused)
    # Two sensors agree at first: 92 % that this is the ground.
    assert {each["signal_quality"] for each in fused[:1]} == {92}
    assert {each["signal_quality"] for each in fused[1:] + forward} == {100}
    # Breakaway 18.0 deg at 100 cm, 14.4 at 150 and 12.6 at 200, and 11.3 from 300 on; the field of view is twice that.
    forward_deg = 2 * (18.0 - 3.6 * (120 * COLDER - 100) / 50)
    assert forward[-1]["horizontal_fov"] == pytest.approx(math.radians(forward_deg), abs=2e-4)
    assert fused[-1]["horizontal_fov"] == pytest.approx(math.radians(2 * 11.3), abs=3e-3)

    mounting = Rotation.from_euler("ZYX", [60, -25, 20], degrees=True).as_quat(scalar_first=True)
    for each in slanted:
        farther_cm = round(765 * COLDER) + 1
        assert (each["current_distance"], each["covariance"], each["signal_quality"]) == (farther_cm, 255, 1)
        assert each["orientation"] == 100
        assert each["quaternion"] == pytest.approx(mounting, abs=1e-6)


def off_s(times_s: list[float], pings_s: list[float]) -> float:
    """How far the times since the first are from the next ping: the median, as a busy computer notes some late [s]."""
    return median(min(abs(time_s - times_s[0] - ping_s) for ping_s in pings_s) for time_s in times_s)


KINDS = ("HEARTBEAT", "STATUSTEXT", "DISTANCE_SENSOR")


def sent_frames(recording: Path) -> list[bytes]:
    """DISTANCE_SENSOR frames of a recording, read with mcap's own reader, which wants it finished."""
    with recording.open("rb") as file:
        reader = make_reader(file)
        assert reader.get_summary() is not None
        frames = [
            bytes.fromhex(json.loads(message.data)["hex"]) for _, _, message in reader.iter_messages("/mavlink/sent")
        ]
    return [frame for frame in frames if int.from_bytes(frame[7:10], "little") == 132]


@pytest.mark.slow
def test_a_late_autopilot_and_its_reboot(tmp_path: Path) -> None:
    """Nobody listens at first; then an autopilot comes, is rebooted, and must receive that a sensor is missing."""
    port = free_port(socket.SOCK_DGRAM)
    missing = "Range down_right: no answer (errno 121)"
    with (
        kernel_bus(STEADY[:3]) as testbed,
        running_service(testbed, f"udpout:127.0.0.1:{port}", tmp_path) as service,
    ):
        until(lambda: pings(testbed) >= 9)

        with LinkEnd(port, Autopilot(system=7, up_s=5000.0)) as end:
            end.run_until(lambda: len([each for each in end.arrived if each.message.get_srcSystem() == 7]) >= 12)
            end.run_until(lambda: missing in [each.text for each in end.of("STATUSTEXT")])
            end.run_until_passes(partial(check_times, end, testbed))

        before = pings(testbed)
        until(lambda: pings(testbed) >= before + 3)
        with LinkEnd(port, Autopilot(system=7, up_s=1.0)) as end:
            end.run_until(lambda: missing in [each.text for each in end.of("STATUSTEXT")])
            count = len(end.arrived)
            end.run_until(lambda: len(end.arrived) >= count + 12)
            end.run_until_passes(partial(check_times, end, testbed))
            assert {each.message.get_srcSystem() for each in end.arrived} == {7}
            assert end.of("HEARTBEAT")[-1].system_status == ardupilotmega.MAV_STATE_CRITICAL
        assert service.stop(signal.SIGINT) == 0
        found = [each for each in service.log() if each["event"] == "autopilot found"]
        assert [each["system"] for each in found] == [7]


def check_times(end: LinkEnd, testbed: KernelTestbed) -> None:
    """The last distances are stamped on the autopilot's clock with the moment of their echo."""
    assert end.autopilot is not None
    front_s = [each.time_s for each in testbed.journal() if each.verb == "write" and each.address == 0x70]
    # The echo of 120 cm: half of the 58 us a centimetre.
    echoes_ms = [end.autopilot.clock_ms(ping_s + 0.5 * 120 * 58e-6) for ping_s in front_s]
    stamps_ms = [each["time_boot_ms"] for each in of_stream(end, FORWARD_ID)]
    assert len(stamps_ms) >= 2
    # Half of the 5 ms between two looks at the link, whole milliseconds, and a computer that is busy.
    assert min(abs(stamps_ms[-1] - echo_ms) for echo_ms in echoes_ms) < 15.0


def test_a_serial_port_that_nobody_drains(tmp_path: Path) -> None:
    """The sensors are polled on, and a reader that comes at last gets whole and new frames."""
    drain, port = pty.openpty()
    with kernel_bus(STEADY) as testbed:
        try:
            fill(port)
            # By another name: umockdev answers for whatever is opened by a name in /dev.
            by_id = tmp_path / "autopilot"
            by_id.symlink_to(os.ttyname(port))
            os.close(port)
            with running_service(testbed, f"serial:{by_id}:115200", tmp_path) as service:
                until(lambda: pings(testbed) >= 1)
                first = pings(testbed)
                until(lambda: pings(testbed) >= first + 15)
                # Most of 15 slots of 100 ms, however busy the computer is, and none lost to the link.
                pings_s = [each.time_s for each in testbed.journal() if each.verb == "write" and each.errno == 0]
                assert median(after_s - before_s for before_s, after_s in pairwise(pings_s)) < 0.2

                os.set_blocking(drain, False)
                parser = ardupilotmega.MAVLink(None)
                parser.robust_parsing = True
                seen: list[Any] = []

                def drained() -> bool:
                    try:
                        seen.extend(parser.parse_buffer(os.read(drain, 65536)) or ())
                    except BlockingIOError:
                        time.sleep(0.005)
                    return [each.get_type() for each in seen].count("DISTANCE_SENSOR") >= 5

                until(drained)
                late_ms = [each.time_boot_ms for each in seen if each.get_type() == "DISTANCE_SENSOR"]
                # Frames that waited longer than their deadline are not sent: nothing is a second old, but for one frame
                # that may have found the last room in the terminal.
                assert late_ms[1] > 1e3 * 1.0
                assert service.stop() == 0
                assert [each["connected"] for each in service.log() if each["event"] == "link"] == [True]
        finally:
            os.close(drain)


def fill(port: int) -> None:
    """Write into a terminal until its buffer takes no more."""
    tty.setraw(port, termios.TCSANOW)
    os.set_blocking(port, False)
    with suppress(BlockingIOError):
        while True:
            os.write(port, b"\0" * 64)
    # The terminal takes what it has to the other end a little later, which makes room once more.
    for _ in range(10):
        time.sleep(0.01)
        with suppress(BlockingIOError):
            while True:
                os.write(port, b"\0")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "airframe.yaml"),
        ("vehicle: [", "airframe.yaml"),
        ("vehicel: x\nlink: {url: 'udpout:127.0.0.1:14550'}\nsensors: []\nsend: {}\n", "vehicle"),
    ],
    ids=["absent", "no YAML", "unknown key"],
)
def test_a_file_that_cannot_be_used(tmp_path: Path, content: str | None, message: str) -> None:
    airframe = tmp_path / "airframe.yaml"
    if content is not None:
        airframe.write_text(content)
    ended = subprocess.run([COMMAND, "run", airframe], capture_output=True, text=True, timeout=LIMIT_S)
    assert ended.returncode == 3
    assert message in ended.stderr
    assert str(airframe) in ended.stderr
    assert "Traceback" not in ended.stderr


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [(["--link", "udpuot:127.0.0.1:1"], 3, "udpout"), (["--record"], 2, "record")],
    ids=["link", "usage"],
)
def test_a_command_line_that_cannot_be_used(options: list[str], code: int, message: str) -> None:
    ended = subprocess.run([COMMAND, "run", AIRFRAME, *options], capture_output=True, text=True, timeout=LIMIT_S)
    assert ended.returncode == code
    assert message in ended.stderr
    assert "Traceback" not in ended.stderr


def test_a_thermometer_that_is_a_pipe_is_logged_and_the_next_one_used(tmp_path: Path) -> None:
    """It held the service for ever; now it is refused in a thread, and the second source has a cold day."""
    os.mkfifo(tmp_path / "pipe")
    sources = f"sources: [{{source: file, path: {tmp_path}/pipe}}, {{source: file, path: {HWMON_FILE}}}]"
    text = AIRFRAME.read_text(encoding="utf-8").replace("../..", str(AIRFRAME.parents[2]))
    assert "  fixed_c: 20\n" in text
    airframe = tmp_path / "cold.yaml"
    airframe.write_text(text.replace("  fixed_c: 20\n", f"  fixed_c: 20\n  {sources}\n"), encoding="utf-8")
    cold_cm = 300 * math.sqrt((273.15 - 10.0) / (273.15 + 22.5))
    with (
        kernel_bus(STEADY, temperature_c=-10.0) as testbed,
        LinkEnd() as end,
        running_service(testbed, end.url, tmp_path, airframe=airframe) as service,
    ):
        end.run_until(
            lambda: [round(each["current_distance"] - cold_cm) for each in of_stream(end, FUSED_ID)][-4:] == [0] * 4
        )
        log = service.log()
    assert [each["error"] for each in log if each["event"] == "thermometer"] == [
        f"{tmp_path}/pipe: found a pipe, expected a file"
    ]
