"""Thermometer files: what is read, what is refused, and that the loop never waits for any of it."""

import os
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest

from msp_range.clock import SystemClock, VirtualClock
from msp_range.correction.air_temperature import AirTemperature
from msp_range.correction.temperature import FileSource, TemperatureParameters
from msp_range.correction.thermometer import HANGS_S, LoopReader, Sample, ThreadReader, read_thermometer
from tests.support.waiting import LIMIT_S, until


def source(path: Path | str, **limits: float) -> FileSource:
    return FileSource.model_validate({"source": "file", "path": str(path), **limits})


def test_a_number_that_varies_from_boot_to_boot(tmp_path: Path) -> None:
    named = source(tmp_path / "hwmon*" / "temp1_input")
    with pytest.raises(FileNotFoundError):
        read_thermometer(named)
    (tmp_path / "hwmon3").mkdir()
    (tmp_path / "hwmon3" / "temp1_input").write_text("15500\n")
    assert read_thermometer(named) == 15500.0


@pytest.mark.parametrize("content", ["", "warm", "nan", "inf", "2" * 70, "21000\n" + " " * 80, "21 22"])
def test_a_file_that_holds_no_single_number_is_refused(tmp_path: Path, content: str) -> None:
    (tmp_path / "temp1_input").write_text(content)
    with pytest.raises(ValueError, match="expected a number"):
        read_thermometer(source(tmp_path / "temp1_input"))


def test_pipes_devices_and_folders_are_refused_at_once(tmp_path: Path) -> None:
    """A pipe that nobody writes to would hold the reader for ever, and /dev/zero never ends."""
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero"), tmp_path):
        with pytest.raises(OSError, match=r"found a (pipe|device|directory), expected a file: "):
            read_thermometer(source(path))


def test_in_the_loop_a_file_is_read_once_a_period() -> None:
    reads: list[float] = []

    def read(named: object) -> float:
        reads.append(0.0)
        return 1000.0 * len(reads)

    reader = LoopReader(read)
    named = source("temp1_input", period_s=2.0)
    taken = [reader.newest(named, now_s) for now_s in (0.0, 1.9, 2.0, 3.9, 4.0)]
    assert [each and each.reported_c for each in taken] == [1.0, None, 2.0, None, 3.0]


@pytest.fixture
def threaded() -> Iterator[Callable[..., ThreadReader]]:
    """Makes readers, and ends them."""
    made: list[ThreadReader] = []

    def make(read: Callable[[FileSource], float], on_error: Callable[[str], object] = print) -> ThreadReader:
        made.append(ThreadReader(SystemClock(), read, on_error))
        return made[-1]

    yield make
    for each in made:
        each.close()


def test_a_slow_file_costs_the_loop_nothing(threaded: Callable[..., ThreadReader]) -> None:
    """No read ends before the loop has gone on, and its value is as old as its beginning."""
    begun_s: list[float] = []
    samples: list[Sample] = []
    may_end = threading.Semaphore(0)

    def read(named: FileSource) -> float:
        begun_s.append(time.monotonic())
        assert may_end.acquire(timeout=LIMIT_S), "the loop waits for the file"
        return 21500.0

    reader, named = threaded(read), source("temp1_input", period_s=0.01)

    def has(count: int) -> bool:
        """So many values, while the next one is being read."""
        sample = reader.newest(named, time.monotonic())
        samples.extend([sample] if sample is not None else [])
        return len(samples) == count and len(begun_s) == count + 1

    for count in range(4):
        until(partial(has, count))
        may_end.release()
    may_end.release(1000)
    assert {each.reported_c for each in samples} == {21.5}
    times_s = [each.time_s for each in samples]
    assert all(time_s <= at_s for time_s, at_s in zip(times_s, begun_s, strict=False))
    assert all(time_s >= before_s for time_s, before_s in zip(times_s[1:], begun_s, strict=False))


def test_a_read_that_never_ends_is_reported_and_its_value_grows_old(threaded: Callable[..., ThreadReader]) -> None:
    ends = threading.Event()
    reads = 0

    def read(named: FileSource) -> float:
        nonlocal reads
        reads += 1
        if reads > 1:
            ends.wait()
        return 21500.0

    reader = threaded(read)
    named = {"source": "file", "path": "temp1_input", "period_s": 0.01}
    start_s = time.monotonic()
    air = AirTemperature(TemperatureParameters.model_validate({"sources": [named]}), start_s, reader, 7.65)

    def texts(later_s: float) -> list[str]:
        now_s = time.monotonic() + later_s
        air.now(now_s)
        return [each.text for each in air.conditions(now_s) if each.text is not None]

    until(lambda: air.now(time.monotonic()).temperature_c == 21.5 and reads == 2)
    assert texts(0.0) == []
    assert texts(HANGS_S + 0.1) == ["Range: thermometer file does not answer"]
    assert texts(60.0) == ["Range: no air temperature, using 22 C", "Range: thermometer file does not answer"]
    assert air.now(time.monotonic() + 300.0).std_c > 6.0
    ends.set()
    until(lambda: not reader.hangs(time.monotonic() + 60.0) or reads > 3)
    assert texts(0.0) == []


def test_what_is_wrong_with_a_file_is_logged_once(tmp_path: Path, threaded: Callable[..., ThreadReader]) -> None:
    logged: list[str] = []
    reader = threaded(read_thermometer, logged.append)
    broken, good = source(tmp_path / "pipe", period_s=0.01), source(tmp_path / "good", period_s=0.01)
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "good").write_text("20000")
    reader.newest(broken, 0.0)
    until(lambda: reader.newest(good, 0.0) is not None and bool(logged))
    until(lambda: reader.newest(good, 0.0) is not None)
    assert logged == [f"{tmp_path}/pipe: found a pipe, expected a file"]


def test_a_value_is_taken_once() -> None:
    reader = LoopReader(lambda named: 20000.0)
    named = source("temp1_input")
    clock = VirtualClock(5.0)
    assert reader.newest(named, clock.now()) is not None
    assert reader.newest(named, clock.now()) is None
