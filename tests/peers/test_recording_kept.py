"""What is left of a recording when the program is killed or the power is cut: all but the last second.

Times are real. The program is `msp-range run` on an emulated kernel's bus, and what it sent is known at the other end.
"""

import os
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from msp_range.recording.reader import Recording
from tests.support.kernel_bus import kernel_bus
from tests.support.service import LinkEnd, running_service, sonars

STEADY = sonars(forward_cm=[120], slanted_cm=[300], down_cm=[300])
MOST_LOST_S = 1.0
FLOWN = 25
"""Distances before a cut, at 10 a second: a recording that is kept only now and then would not have most of them."""


def sent_frames(recording: Path) -> list[bytes]:
    return [bytes.fromhex(each.message["hex"]) for each in Recording(recording) if each.topic == "/mavlink/sent"]


def lost_s(end: LinkEnd, recording: Path, end_s: float) -> float:
    """How much of the flight before ``end_s`` is not in the recording [s]."""
    kept = set(sent_frames(recording))
    distances = [each for each in end.arrived if each.distance is not None and each.time_s <= end_s]
    missing = [each for each in distances if each.frame not in kept]
    # Only of the end.
    assert [each.frame in kept for each in distances] == [True] * (len(distances) - len(missing)) + [False] * len(
        missing
    )
    loss = end_s - max(each.time_s for each in distances if each.frame in kept)
    print("LOSS", loss)
    return loss


@pytest.mark.parametrize("extra_s", [0.0, 0.17, 0.34])
def test_a_killed_program_loses_less_than_a_second(extra_s: float, tmp_path: Path) -> None:
    with kernel_bus(STEADY) as testbed, LinkEnd() as end:
        with running_service(testbed, end.url, tmp_path, "--record", str(tmp_path / "flights")) as service:
            end.run_until(lambda: len(end.distances) >= FLOWN)
            end.run_for(extra_s)
            killed_s = time.monotonic()
            assert service.stop(signal.SIGKILL) == -signal.SIGKILL
        end.run_for(0.05)
    (recording,) = (tmp_path / "flights").iterdir()
    assert lost_s(end, recording, killed_s) < MOST_LOST_S


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
        assert lost_s(end, recording, cut_s) < MOST_LOST_S
    finally:
        subprocess.run(["umount", after], check=True)
