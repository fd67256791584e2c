"""What is left of a recording when the program is killed or the power is cut: all but the last second. And its return.

Times are real. The program is `msp-range run` on an emulated kernel's bus, and what it sent is known at the other end.
"""

import itertools
import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from msp_range.recording.reader import Recording
from tests.support.kernel_bus import kernel_bus
from tests.support.service import LinkEnd, running_service, sonars
from tests.support.slow import slow

STEADY = sonars(forward_cm=[120], slanted_cm=[300], down_cm=[300])
MOST_LOST_S = 1.0
FLOWN = 15
"""Distances before a cut, at 10 a second: a recording that is kept only now and then would not have most of them."""


def sent_frames(recording: Path) -> list[bytes]:
    return [bytes.fromhex(each.message["hex"]) for each in Recording(recording) if each.topic == "/mavlink/sent"]


def lost_s(end: LinkEnd, recording: Path, end_s: float) -> float:
    """How much of the flight before ``end_s`` is not in the recording [s]."""
    frames = set(sent_frames(recording))
    distances = [each for each in end.arrived if each.distance is not None and each.time_s <= end_s]
    kept = [each for each in distances if each.frame in frames]
    # Only the end is missing.
    assert kept == distances[: len(kept)]
    return end_s - kept[-1].time_s


@contextmanager
def busy_computer(folder: Path, end: LinkEnd) -> Iterator[Callable[[], float]]:
    """How much longer [s] than on an idle one it took to keep a file of one's own, and to send distances."""
    syncs_s, stop = [0.0], threading.Event()

    def keep() -> None:
        with (folder / "probe").open("wb", buffering=0) as file:
            while not stop.wait(0.1):
                start_s = time.monotonic()
                file.write(b"x" * 3000)
                os.fdatasync(file.fileno())
                syncs_s.append(time.monotonic() - start_s)

    def late_s() -> float:
        times_s = [each.time_s for each in end.arrived if each.distance is not None]
        longest_s = max(after - before for before, after in itertools.pairwise(times_s))
        return 2 * max(max(syncs_s) - 0.15, 0.0) + max(longest_s - 0.25, 0.0)

    thread = threading.Thread(target=keep)
    thread.start()
    try:
        yield late_s
    finally:
        stop.set()
        thread.join()


@pytest.mark.parametrize("extra_s", [0.17, *slow(0.0, 0.34)])
def test_a_killed_program_loses_less_than_a_second(extra_s: float, tmp_path: Path) -> None:
    with kernel_bus(STEADY) as testbed, LinkEnd() as end, busy_computer(tmp_path, end) as late_s:
        with running_service(testbed, end.url, tmp_path, "--record", str(tmp_path / "flights")) as service:
            end.run_until(lambda: len(end.distances) >= FLOWN)
            end.run_for(extra_s)
            killed_s = time.monotonic()
            assert service.stop(signal.SIGKILL) == -signal.SIGKILL
        end.run_for(0.05)
    (recording,) = (tmp_path / "flights").iterdir()
    assert lost_s(end, recording, killed_s) < MOST_LOST_S + late_s()


@pytest.mark.slow
def test_a_folder_that_goes_away_is_reported_and_made_again(tmp_path: Path) -> None:
    folder = tmp_path / "flights"
    with (
        kernel_bus(STEADY) as testbed,
        LinkEnd() as end,
        running_service(testbed, end.url, tmp_path, "--record", str(folder)) as service,
    ):
        end.run_until(lambda: len(end.distances) >= FLOWN)
        folder.rename(tmp_path / "taken out")
        end.run_until(lambda: "Range: not recording, folder gone" in [each.text for each in end.of("STATUSTEXT")])
        end.run_until(lambda: "Range: recording again" in [each.text for each in end.of("STATUSTEXT")])
        again = len(end.distances)
        end.run_until(lambda: len(end.distances) >= again + FLOWN)
        assert service.stop() == 0
        events = [each["event"] for each in service.log() if each["event"].startswith("recording")]
        assert events == ["recording", "recording stopped", "recording"]
    (before,) = (tmp_path / "taken out").iterdir()
    assert len(sent_frames(before)) > FLOWN / 2
    (after,) = folder.iterdir()
    assert len(sent_frames(after)) > FLOWN


@contextmanager
def mounted_disk(folder: Path) -> Iterator[tuple[Path, Path]]:
    """(image, folder) of a disk of 64 MB with ext4; skips the test where nothing may be mounted."""
    image, place = folder / "disk.img", folder / "disk"
    place.mkdir()
    with image.open("wb") as file:
        file.truncate(64 * 2**20)
    if os.geteuid() != 0:
        pytest.skip("mounting a disk needs root")
    subprocess.run(["mkfs.ext4", "-q", image], check=True)
    mount(image, place)
    try:
        yield image, place
    finally:
        subprocess.run(["umount", place], check=True)


def mount(image: Path, place: Path) -> None:
    place.mkdir(exist_ok=True)
    done = subprocess.run(["mount", "-o", "loop", image, place], capture_output=True, text=True)
    if done.returncode != 0:
        pytest.skip(f"no disk can be mounted here: {done.stderr.strip()}")


def test_a_disk_as_it_is_when_the_power_is_cut(tmp_path: Path) -> None:
    """A copy of a mounted disk, taken in flight, is what a power cut leaves; mounting it replays its journal."""
    copy, after = tmp_path / "cut.img", tmp_path / "after"
    with (
        mounted_disk(tmp_path) as (image, place),
        kernel_bus(STEADY) as testbed,
        LinkEnd() as end,
        busy_computer(tmp_path, end) as late_s,
        running_service(testbed, end.url, tmp_path, "--record", str(place / "flights")) as service,
    ):
        end.run_until(lambda: len(end.distances) >= FLOWN)
        # It stands still while the disk is copied, so that the copy is of one moment.
        service.process.send_signal(signal.SIGSTOP)
        cut_s = time.monotonic()
        end.run_for(0.1)
        subprocess.run(["cp", "--sparse=always", image, copy], check=True)
        service.process.send_signal(signal.SIGCONT)
        assert service.stop() == 0
    mount(copy, after)
    try:
        (recording,) = (after / "flights").iterdir()
        assert lost_s(end, recording, cut_s) < MOST_LOST_S + late_s()
    finally:
        subprocess.run(["umount", after], check=True)
