"""What the tests of the transports share: a clock to step, frames with numbers, and peers' small habits."""

import contextlib
import itertools
import os
import random
import resource
import socket
import struct
import time
from collections.abc import Callable, Iterator, Sequence

from pymavlink.dialects.v20 import common

from msp_range.clock import Clock
from msp_range.mavlink.transport import Transport, open_transport
from tests.support.waiting import LIMIT_S, until

FRAME_BYTES = 52
_HEADER_BYTES = 10
_CHECKSUM_BYTES = 2


class StepClock:
    """A clock that stands still until it is stepped."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def now(self) -> float:
        return self.now_s

    def sleep_until(self, time_s: float, files: Sequence[int] = ()) -> bool:
        self.now_s = max(self.now_s, time_s)
        return False

    def utc(self) -> float:
        return self.now_s


def numbered_frame(number: int) -> bytes:
    """A valid MAVLink 2 frame of 52 bytes, a DISTANCE_SENSOR by its id, with a number in it."""
    payload_bytes = FRAME_BYTES - _HEADER_BYTES - _CHECKSUM_BYTES
    payload = struct.pack("<I", number) + bytes((number + i) % 256 for i in range(payload_bytes - 4))
    body = struct.pack("<BBBBBBBHB", 0xFD, payload_bytes, 0, 0, number % 256, 1, 191, 132, 0) + payload
    covered = body[1:] + bytes([common.MAVLink_distance_sensor_message.crc_extra])
    return body + struct.pack("<H", common.x25crc(covered).crc)


def frame_numbers(received: bytes) -> list[int]:
    """The numbers of frames that follow each other without a byte between; a torn one is an AssertionError."""
    assert len(received) % FRAME_BYTES == 0, f"{len(received)} bytes are no whole number of frames"
    numbers: list[int] = []
    for start in range(0, len(received), FRAME_BYTES):
        frame = received[start : start + FRAME_BYTES]
        number = struct.unpack_from("<I", frame, _HEADER_BYTES)[0]
        assert frame == numbered_frame(number), f"torn or damaged frame at byte {start}, after {numbers[-3:]}"
        numbers.append(number)
    return numbers


@contextlib.contextmanager
def opened(url: str, clock: Clock) -> Iterator[Transport]:
    transport = open_transport(url, clock)
    try:
        yield transport
    finally:
        transport.close()


def received_by(transport: Transport, count: int) -> bytes:
    """Call ``receive`` until ``count`` bytes have come."""
    received = bytearray()

    def enough() -> bool:
        received.extend(transport.receive())
        return len(received) >= count

    until(enough)
    return bytes(received)


def check_passes(link: Transport, number: int, read: Callable[[int], bytes]) -> None:
    """A frame that is sent now arrives, and nothing else."""
    assert link.send(numbered_frame(number))
    assert frame_numbers(read(FRAME_BYTES)) == [number]


def read_exactly(tcp: socket.socket, count: int) -> bytes:
    tcp.settimeout(LIMIT_S)
    received = b""
    while len(received) < count:
        chunk = tcp.recv(count - len(received))
        assert chunk, f"closed after {len(received)} of {count} bytes"
        received += chunk
    return received


_WORKER = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
_PORTS = 1_000
"""Of each process of the tests, from 10,000 on: below those that the kernel gives to whoever asks for any, which may
give the same one to another process before a test has bound it."""
_next_ports = itertools.count(random.Random().randrange(_PORTS))
"""From any on: a child of such a process, which has its environment and often the next number, asks for others."""


def free_port(kind: socket.SocketKind) -> int:
    """A loopback port that nobody uses now, and no other process of the tests asks for."""
    for number in _next_ports:
        port = 10_000 + _PORTS * _WORKER + number % _PORTS
        with socket.socket(socket.AF_INET, kind) as probe, contextlib.suppress(OSError):
            probe.bind(("127.0.0.1", port))
            return port
    raise AssertionError


class SendTimer:
    """Sends frames, and keeps how long each call had this thread wait."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport
        self.waited_s: list[float] = []

    def send(self, frame: bytes) -> bool:
        before, start_s = _waits(), time.perf_counter()
        taken = self._transport.send(frame)
        took_s = time.perf_counter() - start_s
        self.waited_s.append(took_s if _waits() > before else 0.0)
        return taken

    def check(self) -> None:
        """99 of 100 within 20 ms, and none half a second."""
        ordered = sorted(self.waited_s)
        assert ordered[int(0.99 * (len(ordered) - 1))] < 0.02
        assert ordered[-1] < 0.5


def _waits() -> int:
    """How often this thread has given the processor up by itself: a busy computer, which takes it away, adds none."""
    return resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw
