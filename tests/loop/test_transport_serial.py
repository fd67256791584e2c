"""serial on real pseudo-terminals: raw bytes, nobody draining, unplugged and plugged in again."""

import fcntl
import os
import pty
import struct
import termios
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from msp_range.clock import SystemClock
from msp_range.mavlink.transport import serial
from tests.support.transports import (
    FRAME_BYTES,
    SendTimer,
    StepClock,
    check_passes,
    frame_numbers,
    numbered_frame,
    opened,
    received_by,
)
from tests.support.waiting import until

TIOCGEXCL = 0x80045440  # Linux, asm-generic/ioctls.h; not in Python's termios


class Device:
    """A pseudo-terminal as a serial device that can be pulled out; its own end is ``master``."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.plug_in()

    def plug_in(self) -> None:
        self.master, slave = pty.openpty()
        os.set_blocking(self.master, False)
        self.path.unlink(missing_ok=True)
        self.path.symlink_to(os.ttyname(slave))
        os.close(slave)

    def unplug(self) -> None:
        os.close(self.master)
        self.path.unlink()

    def read(self) -> bytes:
        received = b""
        try:
            while True:
                received += os.read(self.master, 65536)
        except BlockingIOError:
            return received

    def read_exactly(self, count: int) -> bytes:
        received = bytearray()

        def enough() -> bool:
            received.extend(self.read())
            return len(received) >= count

        until(enough)
        return bytes(received)


@pytest.fixture
def device(tmp_path: Path) -> Iterator[Device]:
    device = Device(tmp_path / "ttyACM0")
    yield device
    if device.path.is_symlink():
        device.unplug()


def test_every_byte_passes_unchanged_both_ways(device: Device) -> None:
    every_byte = bytes(range(256))
    with opened(f"serial:{device.path}:115200", SystemClock()) as link:
        assert link.connected
        assert link.receive() == b""
        assert link.send(every_byte)
        assert device.read_exactly(256) == every_byte
        os.write(device.master, every_byte)
        assert received_by(link, 256) == every_byte
        assert device.read() == b""  # no echo
        assert link.stats.sent_frames == 1
        assert link.last_error is None


@pytest.mark.parametrize("baud", [57600, 921600])
def test_the_port_is_8n1_at_the_rate_asked_for_and_exclusive(device: Device, baud: int) -> None:
    with opened(f"serial:{device.path}:{baud}", StepClock()):
        iflag, oflag, cflag, lflag, ispeed, ospeed, _ = termios.tcgetattr(device.master)
        assert ispeed == ospeed == getattr(termios, f"B{baud}")
        assert (iflag, oflag, lflag) == (0, 0, 0)
        assert cflag & (termios.CSIZE | termios.PARENB | termios.CSTOPB | termios.CRTSCTS) == termios.CS8
        assert exclusive(device.path)
    assert not exclusive(device.path)


def exclusive(path: Path) -> bool:
    """Whether the port is marked as one program's only (root may open it all the same, and does so here)."""
    try:
        file = os.open(path, os.O_RDWR | os.O_NOCTTY)
    except OSError:
        return True
    try:
        return bool(struct.unpack("i", fcntl.ioctl(file, TIOCGEXCL, bytes(4)))[0])
    finally:
        os.close(file)


def test_a_port_that_nobody_drains_stops_nothing_and_tears_no_frame(device: Device) -> None:
    clock = StepClock()
    with opened(f"serial:{device.path}:921600", clock) as link:
        timer = SendTimer(link)
        for number in range(5000):
            timer.send(numbered_frame(number))
            clock.now_s += 0.01
            if number % 10 == 0:
                link.receive()
        timer.check()
        assert link.connected
        assert link.stats.dropped_frames > 4000
        in_kernel = link.stats.sent_frames
        received = bytearray()
        number = 5000

        def all_has_arrived() -> bool:
            nonlocal number
            received.extend(device.read())
            if number < 5020:
                number += link.send(numbered_frame(number))
            assert link.receive() == b""
            return received.endswith(numbered_frame(5019))

        until(all_has_arrived)
        numbers = frame_numbers(bytes(received))
        assert numbers == sorted(set(numbers))
        # Of what waited, a frame that had been begun was finished, and the last 0.25 s, 25 frames, were still sent.
        assert numbers[in_kernel + 1] >= 5000 - 25
        assert numbers[in_kernel + 1 :] == list(range(numbers[in_kernel + 1], 5020))
        assert link.stats.sent_frames == len(numbers)
        assert link.stats.sent_frames + link.stats.dropped_frames >= 5020


def test_frames_do_not_queue_up_in_the_kernel_for_longer_than_their_deadline(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    queued = 0
    monkeypatch.setattr(serial, "queued_bytes", lambda _: queued)  # a pseudo-terminal's driver does not report it
    clock = StepClock()
    with opened(f"serial:{device.path}:9600", clock) as link:
        queued = 960 // 4
        assert link.send(numbered_frame(0))
        queued += 1
        assert link.send(numbered_frame(1))
        clock.now_s += 0.2
        assert link.send(numbered_frame(2))
        assert frame_numbers(device.read_exactly(FRAME_BYTES)) == [0]
        clock.now_s += 0.1
        queued = 0
        assert link.receive() == b""
        assert frame_numbers(device.read_exactly(FRAME_BYTES)) == [2]
        assert link.stats.dropped_frames == 1


def test_unplugged_and_plugged_in_again_under_the_same_name(device: Device) -> None:
    clock = StepClock()
    with opened(f"serial:{device.path}:57600", clock) as link:
        assert link.send(numbered_frame(0))
        device.unplug()
        timer = SendTimer(link)
        for number in range(1, 100):
            assert not timer.send(numbered_frame(number)) or number == 1
            assert link.receive() == b""
        timer.check()
        assert not link.connected
        assert link.last_error is not None
        clock.now_s += 0.5
        assert link.receive() == b""
        assert link.last_error == f"serial:{device.path}:57600: there is no such port"
        device.plug_in()
        clock.now_s += 1.0
        check_passes(link, 100, device.read_exactly)
        os.write(device.master, numbered_frame(7))
        assert frame_numbers(received_by(link, FRAME_BYTES)) == [7]
        assert link.last_error is None
        assert link.stats.reconnects == 1


def test_unplugged_with_half_a_frame_written(device: Device) -> None:
    clock = StepClock()
    with opened(f"serial:{device.path}:57600", clock) as link:
        for number in range(1000):
            link.send(numbered_frame(number))
            clock.now_s += 0.01
        device.unplug()
        assert link.receive() == b""
        assert not link.connected
        device.plug_in()
        clock.now_s += 0.5
        check_passes(link, 2000, device.read_exactly)
        assert link.stats.sent_frames + link.stats.dropped_frames == 1001


@pytest.mark.parametrize("frames", [1, 1000])
def test_closing_does_not_wait_for_a_device_that_takes_nothing(
    device: Device, frames: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The kernel's close waits for what a real port has not sent, so that is thrown away, but only if it is stuck."""
    flushed: list[int] = []
    monkeypatch.setattr(termios, "tcflush", lambda _, queue: flushed.append(queue))
    with opened(f"serial:{device.path}:57600", StepClock()) as link:
        for number in range(frames):
            link.send(numbered_frame(number))
    assert flushed == ([] if frames == 1 else [termios.TCOFLUSH])


@pytest.fixture
def count_openings(monkeypatch: pytest.MonkeyPatch) -> Callable[[], int]:
    real = os.open
    count = 0

    def counted(path: str, flags: int, *mode: int) -> int:
        nonlocal count
        count += str(path).endswith("ttyACM0")
        return real(path, flags, *mode)

    monkeypatch.setattr(os, "open", counted)
    return lambda: count


def test_a_missing_device_is_looked_for_less_and_less_often(tmp_path: Path, count_openings: Callable[[], int]) -> None:
    clock = StepClock()
    path = tmp_path / "ttyACM0"

    def openings_after_s(duration_s: float) -> list[float]:
        """When it was tried, in steps of 1/8 s from now."""
        times_s = []
        for step in range(int(duration_s * 8) + 1):
            before = count_openings()
            assert not link.send(b"x")
            assert link.receive() == b""
            if count_openings() > before:
                times_s.append(step / 8)
            clock.now_s += 1 / 8
        return times_s

    with opened(f"serial:{path}", clock) as link:
        assert link.last_error == f"serial:{path}:57600: there is no such port"
        assert openings_after_s(18.0) == [0.5, 1.5, 3.5, 7.5, 12.5, 17.5]
        device = Device(path)
        clock.now_s += 5.0
        assert link.receive() == b""
        assert link.connected
        device.unplug()
        assert link.receive() == b""
        assert openings_after_s(4.0) == [0.5, 1.5, 3.5]


def test_a_port_in_use_by_another_program_is_reported_and_opened_when_free(device: Device) -> None:
    clock = StepClock()
    other = os.open(device.path, os.O_RDWR | os.O_NOCTTY)
    fcntl.flock(other, fcntl.LOCK_EX)
    with opened(f"serial:{device.path}", clock) as link:
        assert not link.send(numbered_frame(0))
        assert link.last_error == f"serial:{device.path}:57600: the port is in use by another program"
        os.close(other)
        clock.now_s += 0.5
        check_passes(link, 1, device.read_exactly)


def test_a_file_that_is_no_terminal_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "ttyACM0"
    path.write_bytes(b"")
    with opened(f"serial:{path}", StepClock()) as link:
        assert not link.send(numbered_frame(0))
        assert not link.connected
        assert link.last_error == f"serial:{path}:57600: Inappropriate ioctl for device"
    assert path.read_bytes() == b""


def test_a_device_that_vanishes_while_it_is_set_up_is_tried_again(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise termios.error(5, "Input/output error")

    clock = StepClock()
    monkeypatch.setattr(termios, "tcsetattr", fail)
    with opened(f"serial:{device.path}", clock) as link:
        assert link.last_error == f"serial:{device.path}:57600: Input/output error"
        monkeypatch.undo()
        clock.now_s += 0.5
        assert link.send(numbered_frame(0))


def test_a_rate_that_the_device_does_not_accept_is_reported(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(termios, "tcsetattr", lambda *_: None)
    with opened(f"serial:{device.path}:921600", StepClock()) as link:
        assert not link.connected
        assert link.last_error == f"serial:{device.path}:921600: the device does not have this baud rate"


def test_a_closed_link_stays_closed(device: Device) -> None:
    clock = StepClock()
    with opened(f"serial:{device.path}", clock) as link:
        link.close()
        link.close()
        clock.now_s += 100.0
        assert not link.send(numbered_frame(0))
        assert link.receive() == b""
        assert not link.connected
