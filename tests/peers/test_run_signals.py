"""`msp-range run` and what happens around it: SIGHUP, a second process on its bus, a log that is lost."""

import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import yaml

from msp_range.recording.reader import Recording
from tests.support.kernel_bus import KernelTestbed, kernel_bus
from tests.support.service import (
    AIRFRAME,
    COMMAND,
    FUSED_ID,
    Autopilot,
    LinkEnd,
    Service,
    running_service,
    sonars,
)
from tests.support.waiting import LIMIT_S, until

STEADY = sonars(forward_cm=[120], slanted_cm=[300], down_cm=[300])
NEW_ID = 77


def texts(end: LinkEnd) -> list[str]:
    return [each.text for each in end.of("STATUSTEXT")]


def await_text(end: LinkEnd, text: str, times: int = 1) -> None:
    end.run_until(lambda: texts(end).count(text) >= times)


def await_distances(end: LinkEnd, count: int) -> None:
    """So many more."""
    wanted = len(end.distances) + count
    end.run_until(lambda: len(end.distances) >= wanted)


def await_turns(end: LinkEnd) -> None:
    """Until the bridge has received what the autopilot says now: two heartbeats of its own later, one a second."""
    wanted = len(end.of("HEARTBEAT")) + 2
    end.run_until(lambda: len(end.of("HEARTBEAT")) >= wanted)


def with_fused_id(number: int, **first: object) -> str:
    """The airframe file with another id of its fused stream, and other keys of its first sensor."""
    content = yaml.safe_load(AIRFRAME.read_text())
    content["send"]["fused"]["id"] = number
    content["sensors"][0] |= first
    for sensor in content["sensors"]:
        sensor["model"] = str(AIRFRAME.parent / sensor["model"])
    return yaml.safe_dump(content)


@contextmanager
def flying(folder: Path) -> Iterator[tuple[Service, LinkEnd, Path]]:
    """The service on an airframe file of its own, with an autopilot at the other end, when it sends distances."""
    airframe = folder / "airframe.yaml"
    airframe.write_text(with_fused_id(FUSED_ID))
    record = ("--record", str(folder / "flights"))
    with (
        kernel_bus(STEADY) as testbed,
        LinkEnd(autopilot=Autopilot()) as end,
        running_service(testbed, end.url, folder, *record, airframe=airframe) as service,
    ):
        end.run_until(lambda: len(end.distances) >= 5 and "Range: all 4 sensors good" in texts(end))
        yield service, end, airframe


def fused_ids(end: LinkEnd, count: int) -> set[int]:
    """Ids of the downward stream in the last messages."""
    return {each["id"] for each in end.distances[-count:] if each["orientation"] == 25}


def test_sighup_reloads_the_airframe_file(tmp_path: Path) -> None:
    with flying(tmp_path) as (service, end, airframe):
        airframe.write_text(with_fused_id(NEW_ID, position_m=[30, 0, 0]))
        service.process.send_signal(signal.SIGHUP)
        await_text(end, "Range: airframe file reloaded")
        end.run_until(lambda: NEW_ID in fused_ids(end, 4))
        await_distances(end, 8)
        assert fused_ids(end, 8) == {NEW_ID}
        assert service.process.poll() is None
        assert service.stop() == 0
        started = [each for each in service.log() if each["event"] == "started"]
        assert [each["pid"] for each in started] == [service.process.pid] * 2
        (doubt,) = [each["doubt"] for each in service.log() if each["event"] == "airframe file"]
        assert "is it 30 cm, so 0.3?" in doubt
    # What was flown is in its recording.
    recordings = sorted((tmp_path / "flights").iterdir(), key=lambda path: path.stat().st_mtime_ns)
    ids = [yaml.safe_load(Recording(path).files["airframe.yaml"])["send"]["fused"]["id"] for path in recordings]
    assert ids == [FUSED_ID, NEW_ID]
    assert not any(Recording(path).cut for path in recordings)


@pytest.mark.slow
def test_sighup_with_a_file_that_is_not_valid_changes_nothing(tmp_path: Path) -> None:
    with flying(tmp_path) as (service, end, airframe):
        good = airframe.read_text()
        for number, content in enumerate(("vehicle: [", "vehicle: x\n", None), start=1):
            airframe.unlink()
            if content is not None:
                airframe.write_text(content)
            service.process.send_signal(signal.SIGHUP)
            await_text(end, "Range: airframe file not valid, old one flies", number)
            await_distances(end, 8)
            assert fused_ids(end, 8) == {FUSED_ID}
        lines = [each for each in service.log() if each["event"] == "airframe file not reloaded"]
        assert [line["level"] for line in lines] == ["error"] * 3
        for line, found in zip(lines, ("not valid YAML", "sensors", "no such file"), strict=True):
            assert str(airframe) in line["error"]
            assert found in line["error"]
        # A key that cannot be used is such a mistake too.
        key = tmp_path / "signing.key"
        key.write_text("no key")
        airframe.write_text(good.replace("link:", f"link:\n  signing_key: {key}", 1))
        service.process.send_signal(signal.SIGHUP)
        await_text(end, "Range: airframe file not valid, old one flies", 4)
        await_distances(end, 8)
        assert (
            str(key) in [each for each in service.log() if each["event"] == "airframe file not reloaded"][-1]["error"]
        )
        # The next try is as good as the first.
        airframe.write_text(good.replace(f"id: {FUSED_ID}", f"id: {NEW_ID}"))
        service.process.send_signal(signal.SIGHUP)
        end.run_until(lambda: NEW_ID in fused_ids(end, 4))
        assert service.stop() == 0


@pytest.mark.slow
def test_sighup_waits_while_the_vehicle_is_armed(tmp_path: Path) -> None:
    with flying(tmp_path) as (service, end, airframe):
        assert end.autopilot is not None
        end.autopilot.armed = True
        await_turns(end)
        airframe.write_text(with_fused_id(NEW_ID))
        service.process.send_signal(signal.SIGHUP)
        await_text(end, "Range: airframe reload waits for disarming")
        # A link that is lost does not mean that it has landed.
        autopilot = end.autopilot
        end.autopilot = None
        end.run_for(5.5)
        assert fused_ids(end, 30) == {FUSED_ID}
        end.autopilot = autopilot
        await_turns(end)
        assert fused_ids(end, 4) == {FUSED_ID}
        autopilot.armed = False
        end.run_until(lambda: NEW_ID in fused_ids(end, 4))
        assert texts(end).count("Range: airframe reload waits for disarming") <= 2  # and when the autopilot is back
        assert "Range: airframe file reloaded" in texts(end)
        assert service.stop() == 0


def run_second(testbed: KernelTestbed, *arguments: str | Path) -> "subprocess.CompletedProcess[str]":
    return testbed.run([COMMAND, *arguments])


def test_the_second_process_on_a_bus_names_the_first_and_ends(tmp_path: Path) -> None:
    with kernel_bus(STEADY) as testbed, LinkEnd() as end, LinkEnd() as other:
        with running_service(testbed, end.url, tmp_path) as service:
            await_distances(end, 5)
            second = ["run", AIRFRAME, "--bus", "1", "--link", other.url, "--record", str(tmp_path / "second")]
            for arguments in (second, ["scan", "--bus", "/dev/i2c-1"]):
                done = run_second(testbed, *arguments)
                assert done.returncode == 3, done.stderr
                assert f"/dev/i2c-1: in use by process {service.process.pid} (" in done.stderr
                assert f"msp-range run {AIRFRAME}" in done.stderr
                assert len(done.stderr.splitlines()) == 1
            # It touched nothing; on the loopback what was sent has come.
            other.run_for(0.05)
            assert not other.arrived
            assert not (tmp_path / "second").exists()
            await_distances(end, 5)
            service.stop(signal.SIGKILL)
        # The lock went with the process.
        folder = tmp_path / "third"
        folder.mkdir()
        with LinkEnd() as end, running_service(testbed, end.url, folder) as service:
            await_distances(end, 5)
            assert service.stop() == 0


def test_a_bus_that_is_not_there_yet_is_no_reason_to_end(tmp_path: Path) -> None:
    with kernel_bus(STEADY) as testbed, LinkEnd() as end:
        log = tmp_path / "log.jsonl"
        with log.open("w") as stream:
            command: list[str | Path] = [COMMAND, "run", AIRFRAME, "--bus", "9", "--link", end.url, "--log", "json"]
            process = testbed.popen(command, stderr=stream)
        await_text(end, "Range: no I2C bus: enable I2C (errno 2)")
        process.send_signal(signal.SIGTERM)
        assert process.wait(LIMIT_S) == 0


def test_a_log_that_nobody_takes_does_not_end_the_flight(tmp_path: Path) -> None:
    """A terminal that was closed, a full disk under the log."""
    with kernel_bus(STEADY) as testbed, LinkEnd() as end:
        reading, writing = os.pipe()
        command: list[str | Path] = [COMMAND, "run", AIRFRAME, "--bus", "1", "--link", end.url]
        process = testbed.popen(command, stderr=writing)
        os.close(writing)
        until(lambda: bool(os.read(reading, 1)))
        os.close(reading)
        await_text(end, "Range: all 4 sensors good")  # which is logged
        await_distances(end, 5)
        assert process.poll() is None
        process.send_signal(signal.SIGTERM)
        process.wait(LIMIT_S)
