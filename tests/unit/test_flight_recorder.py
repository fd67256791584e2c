"""The recording of a vehicle: new files by time, size and a set clock; a disk that is gone, full or hangs, and returns.

Time is virtual, the disk is real. It is made slow or broken where the operating system is called.
"""

import errno
import itertools
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from msp_range.clock import VirtualClock
from msp_range.recording import background_file, flight_recorder
from msp_range.recording.flight_recorder import (
    EARLIEST_UTC_S,
    FILE_LASTS_S,
    RETRY_S,
    START_FREE_BYTES,
    FlightRecorder,
)
from msp_range.recording.reader import Recording
from msp_range.recording.writer import HUNG_AFTER_S
from tests.support import bench
from tests.support.bench import START_S
from tests.support.waiting import LIMIT_S, until

UTC_S = 1_791_210_600.0
"""2026-10-05 14:30:00."""


class ComputerClock(VirtualClock):
    """A virtual clock that knows the date; ``utc_s`` may be set."""

    def __init__(self, utc_s: float = UTC_S) -> None:
        super().__init__()
        self.utc_at_start_s = utc_s

    def utc(self) -> float:
        return self.utc_at_start_s + self.now()


class Flight:
    """A recorder that is given a message each tenth of a second, and what it reports.

    Each 0.2 s it is asked what is due, and then the disk has the time that it needs, but where it ``hangs``.
    """

    def __init__(self, folder: Path, clock: ComputerClock | None = None) -> None:
        self.hangs = False
        self.folder = folder
        self.clock = clock or ComputerClock()
        self.opened: list[Path] = []
        self.failures: list[str] = []
        self.faults: list[tuple[float, str | None]] = []
        """Every change of the fault, and when [s]."""
        self.recorder = FlightRecorder(
            folder, "quad 1", self.clock, on_file=self.opened.append, on_failure=self.failures.append
        )
        self.count = 0

    def fly(self, to_s: float) -> "Flight":
        while self.clock.now() < to_s - 0.05:
            self.count += 1
            now_s = self.count / 10
            self.clock.sleep_until(now_s)
            self.recorder.write("/fused", now_s, {"time_s": now_s})
            if self.count % 2 == 0:
                self.recorder.flush_if_due(now_s)
                before = self.faults[-1][1] if self.faults else None
                if self.recorder.fault != before:
                    self.faults.append((now_s, self.recorder.fault))
                if not self.hangs:
                    until(self._is_idle)
        return self

    def _is_idle(self) -> bool:
        recorder = self.recorder._recorder
        return recorder is None or recorder.file.has_ended or not recorder.file._given_s

    def times_s(self) -> list[list[float]]:
        """What was recorded, file by file in the order of their names."""
        return [
            [each.message["time_s"] for each in Recording(path)] for path in sorted(self.folder.glob("quad_1-*.mcap"))
        ]


@pytest.fixture(autouse=True)
def real_time(monkeypatch: pytest.MonkeyPatch) -> VirtualClock:
    """What counts as real time of the disk: it stands still unless a test moves it, and the disk takes no rest."""
    clock = VirtualClock()
    monkeypatch.setattr(background_file, "REST_S", 0.0)
    monkeypatch.setattr(background_file, "SystemClock", lambda: clock)
    return clock


def recording_threads() -> set[threading.Thread]:
    return {thread for thread in threading.enumerate() if thread.name == "recording"}


def whole(times: list[list[float]]) -> list[float]:
    return [time_s for file in times for time_s in file]


def tenths(from_s: float, to_s: float) -> list[float]:
    return [count / 10 for count in range(round(10 * from_s) + 1, round(10 * to_s) + 1)]


def test_files_are_named_by_the_date_and_follow_each_other_after_an_hour(tmp_path: Path) -> None:
    flight = Flight(tmp_path).fly(10.0)
    flight.clock.sleep_until(FILE_LASTS_S)
    flight.count = round(10 * FILE_LASTS_S)
    flight.fly(FILE_LASTS_S + 10.0)
    flight.recorder.close()
    names = ["quad_1-20261005T143000Z.mcap", "quad_1-20261005T153000Z.mcap"]
    assert sorted(path.name for path in tmp_path.iterdir()) == names
    assert [path.name for path in flight.opened] == names
    first, second = flight.times_s()
    assert first + second == tenths(0, 10) + tenths(FILE_LASTS_S, FILE_LASTS_S + 10)
    assert second[0] == pytest.approx(FILE_LASTS_S + 0.3)
    assert not any(Recording(path).cut for path in flight.opened)
    assert flight.faults == []
    assert flight.failures == []


def test_a_new_file_begins_at_a_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flight_recorder, "FILE_BYTES", 5000)
    flight = Flight(tmp_path).fly(30.0)
    flight.recorder.close()
    assert len(flight.opened) > 3
    # A chunk of half a second lies above the limit, and the index at the end.
    assert all(path.stat().st_size < 9000 for path in flight.opened)
    assert whole(flight.times_s()) == tenths(0, 30)


def test_every_file_holds_the_airframe(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flight_recorder, "FILE_LASTS_S", 1.0)
    clock = ComputerClock()
    recorder = FlightRecorder(tmp_path, "quad", clock, files={"airframe.yaml": "vehicle: quad\n"})
    for count in range(1, 30):
        clock.sleep_until(count / 10)
        recorder.write("/fused", count / 10, {"time_s": count / 10})
        recorder.flush_if_due(count / 10)
    recorder.close()
    assert [Recording(path).files for path in tmp_path.iterdir()] == [{"airframe.yaml": "vehicle: quad\n"}] * 3


def test_a_computer_whose_clock_is_wrong_at_the_start(tmp_path: Path) -> None:
    """Without a date the names count; when the clock is set a file begins that has one."""
    for _ in range(2):
        Flight(tmp_path, ComputerClock(utc_s=120.0)).fly(1.0).recorder.close()
    flight = Flight(tmp_path, ComputerClock(utc_s=120.0)).fly(5.0)
    flight.clock.utc_at_start_s = UTC_S
    flight.fly(10.0)
    # A correction of a second is no reason for another.
    flight.clock.utc_at_start_s += 1.0
    flight.fly(15.0).recorder.close()
    assert [path.name for path in flight.opened] == ["quad_1-undated-0003.mcap", "quad_1-20261005T143005Z.mcap"]
    assert len(list(tmp_path.iterdir())) == 4
    assert whole([[each.message["time_s"] for each in Recording(path)] for path in flight.opened]) == tenths(0, 15)
    assert Recording(flight.opened[1]).utc_s(10.0) == pytest.approx(UTC_S + 10.0)


def test_undated_files_keep_their_order_where_some_were_deleted(tmp_path: Path) -> None:
    for _ in range(3):
        Flight(tmp_path, ComputerClock(utc_s=120.0)).fly(1.0).recorder.close()
    (tmp_path / "quad_1-undated-0001.mcap").unlink()
    Flight(tmp_path, ComputerClock(utc_s=EARLIEST_UTC_S - 10.0)).fly(1.0).recorder.close()
    assert sorted(path.name[-9:] for path in tmp_path.iterdir()) == ["0002.mcap", "0003.mcap", "0004.mcap"]


def test_a_recording_of_the_same_second_gets_a_name_of_its_own(tmp_path: Path) -> None:
    flights = [Flight(tmp_path).fly(1.0) for _ in range(3)]
    for flight in flights:
        flight.recorder.close()
    assert len({flight.opened[0] for flight in flights}) == 3


@pytest.mark.parametrize("vehicle", ["a/../b", "C:\\quad?", "q" * 300, "Möwe 4", "."])
def test_any_vehicle_has_a_name_that_a_file_can_have(vehicle: str, tmp_path: Path) -> None:
    recorder = FlightRecorder(tmp_path / "flights", vehicle, ComputerClock())
    recorder.close()
    (path,) = (tmp_path / "flights").iterdir()
    assert path.is_file()
    assert not set(path.name) & set('/\\:?*"<>|')


def test_a_folder_that_cannot_be_made_at_the_start(tmp_path: Path) -> None:
    folder = tmp_path / "disk" / "flights"
    folder.parent.write_text("not mounted")
    flight = Flight(folder).fly(12.0)
    assert [fault for _, fault in flight.faults] == ["folder gone"]
    assert flight.recorder.path is None
    assert flight.failures == [f"{folder}: recording stopped: Not a directory; nothing is kept"]
    folder.parent.unlink()
    flight.fly(20.0)
    assert [fault for _, fault in flight.faults] == ["folder gone", None]
    flight.recorder.close()
    (times_s,) = flight.times_s()
    assert times_s[-1] == 20.0
    # It was tried again after 5 s each time.
    assert times_s[0] < 12.0 + RETRY_S + 0.5


def test_a_folder_that_goes_away_in_flight(tmp_path: Path) -> None:
    folder = tmp_path / "flights"
    flight = Flight(folder).fly(5.0)
    folder.rename(tmp_path / "taken out")
    flight.fly(15.0)
    assert [fault for _, fault in flight.faults] == ["folder gone", None]
    assert flight.faults[0][0] == pytest.approx(5.0, abs=1.5)
    assert flight.faults[1][0] == pytest.approx(5.0 + RETRY_S, abs=2.0)
    assert "quad_1-20261005T143000Z.mcap: recording stopped: No such file or directory" in flight.failures[0]
    flight.recorder.close()
    (times_s,) = flight.times_s()
    assert times_s[-1] == 15.0
    # What was recorded before can be read where it is now.
    (before,) = (tmp_path / "taken out").iterdir()
    assert [each.time_s for each in Recording(before)][:40] == pytest.approx(tenths(0, 4))


def test_a_disk_that_is_full_at_the_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file is not even made; else there would be an empty one each five seconds."""
    free = {"bytes": START_FREE_BYTES - 4096}
    statvfs = os.statvfs

    def nearly_full(path: Any) -> os.statvfs_result:
        found = list(statvfs(path))
        found[4] = free["bytes"] // found[1]  # f_bavail, in units of f_frsize
        return os.statvfs_result(found)

    monkeypatch.setattr(os, "statvfs", nearly_full)
    flight = Flight(tmp_path).fly(30.0)
    assert [fault for _, fault in flight.faults] == ["disk full"]
    assert flight.failures == [f"{tmp_path}: recording stopped: No space left on device; nothing is kept"]
    assert list(tmp_path.iterdir()) == []
    free["bytes"] = START_FREE_BYTES + 4096
    flight.fly(40.0)
    assert [fault for _, fault in flight.faults] == ["disk full", None]
    flight.recorder.close()


class BrokenDisk:
    """An os.fdatasync that fails while ``error`` is set, of ``only`` one file if any, and hangs from `hang` to `go_on`.

    A bridge that waited for it would wait until that is an AssertionError.
    """

    def __init__(self) -> None:
        self.error: int | None = None
        self.only: Path | None = None
        self._works = threading.Event()
        self._works.set()
        self._fdatasync = os.fdatasync

    def hang(self) -> None:
        self._works.clear()

    def go_on(self) -> None:
        self._works.set()

    def fdatasync(self, descriptor: int) -> None:
        assert self._works.wait(LIMIT_S)
        if self.error is not None and (self.only is None or os.path.samestat(self.only.stat(), os.fstat(descriptor))):
            raise OSError(self.error, os.strerror(self.error))
        self._fdatasync(descriptor)


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> Iterator[BrokenDisk]:
    broken = BrokenDisk()
    monkeypatch.setattr(os, "fdatasync", broken.fdatasync)
    yield broken
    broken.go_on()


@pytest.mark.parametrize(
    ("error", "fault"),
    [
        (errno.ENOSPC, "disk full"),
        (errno.EIO, "disk error (errno 5)"),
        (errno.EROFS, "disk is read-only"),
        (errno.EDQUOT, "disk full"),
        (errno.EPERM, "no permission"),
        (4095, "disk error (errno 4095)"),
    ],
)
def test_a_disk_that_fails_in_flight_and_works_again(error: int, fault: str, tmp_path: Path, disk: BrokenDisk) -> None:
    flight = Flight(tmp_path).fly(5.0)
    disk.error = error
    flight.fly(20.0)
    disk.error = None
    flight.fly(30.0)
    assert [each for _, each in flight.faults] == [fault, None]
    assert len(f"Range: not recording, {fault}") <= 50  # a STATUSTEXT
    assert flight.faults[0][0] == pytest.approx(5.0, abs=1.5)
    assert flight.faults[1][0] < 20.0 + RETRY_S + 2.0
    # Reported once, although it was tried again and again.
    assert len(flight.failures) == 1
    assert os.strerror(error) in flight.failures[0]
    assert len(flight.opened) == 2
    flight.recorder.close()
    before, after = flight.times_s()
    assert before[:40] == tenths(0, 4)
    assert after[-1] == 30.0
    # Neither tries nor gaps: what was recorded since the last try is there.
    assert after == tenths(after[0] - 0.1, 30.0)


def test_a_disk_that_hangs_is_reported_after_ten_seconds_and_used_again_when_it_answers(
    tmp_path: Path, disk: BrokenDisk, real_time: VirtualClock
) -> None:
    others = recording_threads()
    flight = Flight(tmp_path).fly(5.0)
    disk.hang()
    flight.hangs = True
    for second in range(6, 66):
        real_time.sleep_until(second - 5.0)
        flight.fly(second)
    assert [each for _, each in flight.faults] == ["disk does not answer"]
    assert flight.faults[0][0] == pytest.approx(5.0 + HUNG_AFTER_S, abs=2.0)
    assert "the disk does not answer" in flight.failures[0]
    # However long it lasts: one thread waits.
    assert len(recording_threads() - others) == 1
    disk.go_on()
    until(lambda: recording_threads() == others)
    flight.hangs = False
    flight.fly(80.0)
    assert [each for _, each in flight.faults] == ["disk does not answer", None]
    flight.recorder.close()
    before, after = flight.times_s()
    # Nothing is lost of the time before the report.
    assert before == tenths(0, before[-1])
    assert before[-1] >= 5.0 + HUNG_AFTER_S
    assert after == tenths(after[0] - 0.1, 80.0)
    assert after[0] < 65.0 + RETRY_S


def test_an_older_file_that_does_not_end_well_is_not_the_end_of_the_recording(tmp_path: Path, disk: BrokenDisk) -> None:
    flight = Flight(tmp_path).fly(10.0)
    older = flight.recorder._recorder
    assert older is not None
    flight.clock.sleep_until(FILE_LASTS_S)
    # The next file is made at the same time.
    disk.error, disk.only = errno.EIO, flight.opened[0]
    flight.recorder.flush_if_due(FILE_LASTS_S)
    until(lambda: older.file.has_ended)
    disk.error = None
    flight.count = round(10 * FILE_LASTS_S)
    flight.fly(FILE_LASTS_S + 10.0)
    assert len(flight.failures) == 1
    assert flight.faults == []
    assert flight.recorder.path == flight.opened[1]
    flight.recorder.close()


def test_a_bridge_never_waits_for_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Here not even for the file to be made: 20 s of flight are over while the disk makes it."""
    clock = VirtualClock(START_S)
    monkeypatch.setattr(bench, "VirtualClock", lambda start_s: clock)
    released = threading.Event()
    new_recording = flight_recorder.new_recording

    def slow_new_recording(*args: Any) -> Any:
        assert released.wait(LIMIT_S), "the bridge waits for the disk"
        return new_recording(*args)

    monkeypatch.setattr(flight_recorder, "new_recording", slow_new_recording)
    recorder = FlightRecorder(tmp_path / "flights", "quad", clock)
    flight = bench.Bench(bench.airframe(), 300, recorder=recorder).fly(20.0)
    assert not (tmp_path / "flights").exists()
    assert len(flight.distances_cm()) == 199
    released.set()
    recorder.close()
    (path,) = (tmp_path / "flights").iterdir()
    readings = [each for each in Recording(path) if each.topic.startswith("/range/")]
    assert len(readings) == len(flight.steps)


class SlowDisk:
    """An os.fdatasync that takes 0.3 s of virtual time; what it was asked for is kept when it comes back."""

    def __init__(self, clock: VirtualClock) -> None:
        self.kept: list[tuple[float, int]] = [(0.0, 0)]
        """When it came back [s], and the size of the file that is safe then."""
        self._clock = clock
        self._fdatasync = os.fdatasync
        self._due_s: float | None = None
        self._done = threading.Semaphore(0)

    def fdatasync(self, descriptor: int) -> None:
        size = os.fstat(descriptor).st_size
        self._fdatasync(descriptor)
        self._due_s = self._clock.now() + 0.3
        assert self._done.acquire(timeout=LIMIT_S)
        self.kept.append((self._clock.now(), size))
        self._due_s = None

    def work(self, recorder: FlightRecorder) -> None:
        """Come back where it is time, and begin where there is something to do."""
        if self._due_s is not None and self._clock.now() >= self._due_s:
            count = len(self.kept)
            self._done.release()
            until(lambda: len(self.kept) > count)
        file = recorder._recorder
        assert file is not None
        until(lambda: self._due_s is not None or not file.file._given_s)


def test_a_power_cut_costs_less_than_a_second_on_a_slow_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = ComputerClock()
    disk = SlowDisk(clock)
    monkeypatch.setattr(os, "fdatasync", disk.fdatasync)
    recorder = FlightRecorder(tmp_path / "flights", "quad", clock)
    for count in range(1, 400):
        clock.sleep_until(0.05 * count)
        recorder.write("/health", clock.now(), {"text": str(count)})
        # As the bridge does.
        if count % 5 == 0:
            recorder.flush_if_due(clock.now())
        disk.work(recorder)
    (path,) = (tmp_path / "flights").iterdir()
    written, cut = path.read_bytes(), tmp_path / "cut.mcap"
    losses_s = []
    for (_, size), (next_s, _) in itertools.pairwise(disk.kept):
        cut.write_bytes(written[:size])
        # The power fails just before the next one comes back.
        losses_s.append(next_s - max((each.time_s for each in Recording(cut)), default=0.0))
    assert len(losses_s) > 30
    assert 0.7 < max(losses_s) < 1.0
    for _ in range(10):
        disk._done.release()
    recorder.close()


@pytest.mark.slow
def test_memory_does_not_grow_over_hours(tmp_path: Path) -> None:
    """Resident memory after each of three hours of chunks, in a process of its own."""
    code = """if True:
        import sys, time
        from pathlib import Path
        from msp_range.clock import VirtualClock
        from msp_range.recording import background_file
        from msp_range.recording.flight_recorder import FlightRecorder

        background_file.REST_S = 0.0  # an hour takes a second here
        clock = VirtualClock()
        recorder = FlightRecorder(Path(sys.argv[1]), "quad", clock)
        topics = [f"/range/{name}" for name in "abcd"] + ["/fused", "/mavlink/sent", "/attitude"]
        for count in range(1, 3 * 7200 + 1):
            now_s = count / 2
            clock.sleep_until(now_s)
            for topic in topics:
                recorder.write(topic, now_s, {"time_s": now_s})
            recorder.flush_if_due(now_s)
            # The disk keeps pace, as it does in a flight that takes hours.
            while len(recorder._recorder.file._given_s) > 2:
                time.sleep(0.0005)
            if count % 3600 == 0:
                pages = int(Path("/proc/self/statm").read_text().split()[1])
                print(pages * 4096)
        recorder.close()
    """
    done = subprocess.run([sys.executable, "-c", code, tmp_path], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    resident_mb = [int(line) / 1e6 for line in done.stdout.splitlines()]
    assert len(resident_mb) == 6
    assert len(list(tmp_path.iterdir())) >= 3
    # Twice what the parts of memory that are given back now and then make; an index that is kept would be 15 MB by now.
    assert max(resident_mb[1:]) - resident_mb[0] < 8.0
