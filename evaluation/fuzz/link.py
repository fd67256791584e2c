"""Bytes that are no MAVLink, nearly MAVLink, or MAVLink with impossible content, at the bridge over each kind of link.

The whole bridge works on emulated sensors in virtual time; what arrives comes through real sockets and a real
pseudo-terminal. A finding is an exception, a step of the bridge that takes more than 2 s of processor time, memory that
grows by more than 20 MB, and a bridge that no longer polls.
"""

import contextlib
import gc
import os
import pty
import socket
import time
import traceback
from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path
from random import Random

from evaluation.fuzz.base import FuzzResult
from evaluation.memory import memory_mb
from msp_range.bridge import Bridge
from msp_range.clock import VirtualClock
from msp_range.config import load_airframe
from msp_range.mavlink.dialect import dialect
from msp_range.mavlink.transport import open_transport
from msp_sim.device.bus import EmulatedBus
from msp_sim.device.mb1242 import EmulatedMB1242
from tests.support.shipped import CONFIGS
from tests.support.transports import free_port

AREA = "link"
SLOW_S = 2.0
GROWTH_MB = 20.0
WARM_UP_CASES = 300
"""Cases before growth is measured: caches and the frames that the link keeps fill first."""
MAX_FAILURES = 20
FLOWN_S = 0.25
"""Virtual time after each case: two pings."""

AUTOPILOT, BRIDGE, GROUND_STATION = (7, 1), (7, 191), (255, 190)
SENDERS = (AUTOPILOT, AUTOPILOT, BRIDGE, GROUND_STATION, (8, 1), (7, 154), (0, 0))
LIKELY = ("HEARTBEAT", "ATTITUDE", "SYSTEM_TIME", "TIMESYNC", "PING", "COMMAND_LONG", "COMMAND_INT", "COMMAND_ACK")
"""What the bridge listens to; the others are drawn from all of the dialect."""


def fuzz(seconds: float, seed: int, fewest: int = 1) -> FuzzResult:
    """Let made-up bytes arrive until the time is over.

    Parameters
    ----------
    seconds
        How long; at least one case over each kind of link.
    seed
        The same seed gives the same bytes.
    fewest
        So many cases at least, also where a busy computer takes longer for them.
    """
    rng = Random(seed)
    failures: list[str] = []
    slowest_s = 0.0
    warm_mb = None
    start_s = time.monotonic()
    cases = 0
    with contextlib.ExitStack() as stack:
        flights = {
            (kind, make): stack.enter_context(_flying(kind)) for kind in _FAR_ENDS for make in (made_up, never_ending)
        }
        while cases < fewest or time.monotonic() - start_s < seconds:
            for (kind, make), flight in flights.items():
                cases += 1
                content = make(rng)
                found, spent_s = flight.try_case(content, rng)
                slowest_s = max(slowest_s, spent_s)
                if spent_s > SLOW_S:
                    found = found or f"a step took {spent_s:.1f} s"
                if found is not None:
                    failures.append(f"{AREA}, {kind}, seed {seed}, case {cases}: {found}; bytes: {content[:100].hex()}")
                    flights[kind, make] = stack.enter_context(_flying(kind))
                if cases == WARM_UP_CASES:
                    warm_mb = _resident_mb()
            if len(failures) >= MAX_FAILURES:
                break
    growth_mb = _resident_mb() - warm_mb if warm_mb is not None else 0.0
    if growth_mb > GROWTH_MB:
        failures.append(f"{AREA}: memory grew by {growth_mb:.1f} MB, expected at most {GROWTH_MB:.0f}")
    return FuzzResult(AREA, cases, time.monotonic() - start_s, growth_mb, slowest_s, failures)


def made_up(rng: Random) -> bytes:
    """Up to some 10 kB of one kind of bytes, or of several."""
    parts = [rng.choice(_PARTS)(rng) for _ in range(rng.choice((1, 1, 3, 20)))]
    return b"".join(parts)[: rng.choice((300, 2000, 12_000))]


def never_ending(rng: Random) -> bytes:
    """12 kB that begin and end inside a frame: a parser that frees its buffer at the end of one never does."""
    payload_bytes = rng.choice((40, 255))
    start = bytes((0xFD, payload_bytes, 0))
    return (bytes(payload_bytes + 9) + start) * (12_000 // (payload_bytes + 12))


def valid_frame(rng: Random) -> bytes:
    """Any message with a good checksum and any content, of either version."""
    name = rng.choice(LIKELY) if rng.random() < 0.7 else None
    kind = getattr(dialect, f"MAVLINK_MSG_ID_{name}") if name else rng.choice(sorted(dialect.mavlink_map))
    definition = dialect.mavlink_map[kind]
    payload = rng.randbytes(definition.unpacker.size) if rng.random() < 0.6 else bytes(definition.unpacker.size)
    message = dialect.MAVLink_message(kind, definition.msgname)
    mav = dialect.MAVLink(None, *rng.choice(SENDERS))
    version_1 = kind < 256 and rng.random() < 0.3
    frame: bytes = message._pack(mav, definition.crc_extra, payload, force_mavlink1=version_1)
    return frame


def _heartbeat(rng: Random) -> bytes:
    autopilot = rng.choice((dialect.MAV_AUTOPILOT_ARDUPILOTMEGA, dialect.MAV_AUTOPILOT_PX4, rng.randrange(256)))
    mav = dialect.MAVLink(None, *rng.choice((AUTOPILOT, AUTOPILOT, (rng.randrange(256), 1))))
    frame: bytes = dialect.MAVLink_heartbeat_message(2, autopilot, 0, 0, 4, 3).pack(mav)
    return frame


def _damaged(rng: Random) -> bytes:
    """Valid frames with bits flipped, cut, doubled and put into each other."""
    stream = bytearray(b"".join(valid_frame(rng) for _ in range(rng.randrange(1, 6))))
    for _ in range(rng.randrange(1, 8)):
        at = rng.randrange(len(stream))
        what = rng.randrange(4)
        if what == 0:
            stream[at] ^= 1 << rng.randrange(8)
        elif what == 1:
            del stream[at : at + rng.randrange(1, 40)]
        elif what == 2:
            stream[at:at] = stream[max(0, at - 60) : at]
        else:
            stream[at:at] = rng.randbytes(rng.randrange(1, 20))
        if not stream:
            break
    return bytes(stream)


def _headers(rng: Random) -> bytes:
    """Starts of frames that promise much and hold nothing, near to each other."""
    start = rng.choice((b"\xfd", b"\xfe")) + bytes((rng.choice((0, 1, 9, 255)), rng.choice((0, 1, 2, 255))))
    return (start + rng.randbytes(rng.choice((0, 4, 9)))) * rng.randrange(1, 1000)


_PARTS = (
    lambda rng: rng.randbytes(rng.randrange(1, 4000)),
    lambda rng: bytes([rng.choice((0, 0xFD, 0xFE, 0xFF))]) * rng.randrange(1, 9000),
    valid_frame,
    lambda rng: valid_frame(rng) * rng.randrange(1, 100),
    lambda rng: b"".join(valid_frame(rng) for _ in range(rng.randrange(1, 100))),
    lambda rng: valid_frame(rng)[: rng.randrange(1, 20)],
    _damaged,
    _headers,
    _heartbeat,
)


class _FarEnd(ABC):
    """Who sends over one kind of link, and takes what comes back."""

    url: str

    @abstractmethod
    def send(self, content: bytes, rng: Random) -> None:
        """Let these bytes arrive, cut in some way."""

    @abstractmethod
    def drain(self) -> None:
        """Take what the bridge has sent."""

    @abstractmethod
    def close(self) -> None:
        """Release everything."""


class _Datagrams(_FarEnd):
    """Datagrams to ``udpin`` from several sockets, or to ``udpout`` from where it sends to."""

    def __init__(self, kind: str) -> None:
        self._sockets = [_udp() for _ in range(8 if kind == "udpin" else 1)]
        if kind == "udpin":
            self._target: tuple[str, int] | None = ("127.0.0.1", free_port(socket.SOCK_DGRAM))
            self.url = f"udpin:127.0.0.1:{self._target[1]}"
        else:
            self._target = None
            self.url = f"udpout:127.0.0.1:{self._sockets[0].getsockname()[1]}"

    def send(self, content: bytes, rng: Random) -> None:
        if self._target is None:
            return
        for piece in _cut(content, rng, 1500):
            with contextlib.suppress(OSError):
                rng.choice(self._sockets).sendto(piece, self._target)

    def drain(self) -> None:
        for each in self._sockets:
            with contextlib.suppress(OSError):
                while True:
                    _, sender = each.recvfrom(65535)
                    if self._target is None:
                        self._target = sender

    def close(self) -> None:
        for each in self._sockets:
            each.close()


class _Connections(_FarEnd):
    """A server that ``tcp`` connects to, or clients of ``tcpin`` that come and go."""

    def __init__(self, kind: str) -> None:
        self._server: socket.socket | None = None
        self._open: list[socket.socket] = []
        if kind == "tcp":
            self._server = socket.create_server(("127.0.0.1", 0))
            self._server.setblocking(False)
            self._port = self._server.getsockname()[1]
        else:
            self._port = free_port(socket.SOCK_STREAM)
        self.url = f"{kind}:127.0.0.1:{self._port}"

    def send(self, content: bytes, rng: Random) -> None:
        if self._server is not None:
            with contextlib.suppress(BlockingIOError):
                self._add(self._server.accept()[0])
        elif len(self._open) < 12:
            with contextlib.suppress(OSError):
                self._add(socket.create_connection(("127.0.0.1", self._port), timeout=1.0))
        if self._open and rng.random() < 0.02:
            self._open.pop(rng.randrange(len(self._open))).close()
        for piece in _cut(content, rng, 4000):
            if self._open:
                with contextlib.suppress(OSError):
                    rng.choice(self._open).send(piece)

    def drain(self) -> None:
        for each in self._open.copy():
            try:
                while each.recv(65536):
                    pass
                raise ConnectionError
            except BlockingIOError:
                continue
            except OSError:
                each.close()
                self._open.remove(each)

    def close(self) -> None:
        for each in [*self._open, *([self._server] if self._server else [])]:
            each.close()

    def _add(self, connection: socket.socket) -> None:
        connection.setblocking(False)
        self._open.append(connection)


class _Terminal(_FarEnd):
    """The other end of a serial port."""

    def __init__(self, kind: str) -> None:
        self._master, self._slave = pty.openpty()
        os.set_blocking(self._master, False)
        self.url = f"{kind}:{os.ttyname(self._slave)}:57600"

    def send(self, content: bytes, rng: Random) -> None:
        for piece in _cut(content, rng, 4000):
            with contextlib.suppress(BlockingIOError):
                os.write(self._master, piece)

    def drain(self) -> None:
        with contextlib.suppress(BlockingIOError):
            while os.read(self._master, 65536):
                pass

    def close(self) -> None:
        os.close(self._master)
        os.close(self._slave)


_FAR_ENDS: dict[str, type[_Datagrams] | type[_Connections] | type[_Terminal]] = {
    "udpin": _Datagrams,
    "udpout": _Datagrams,
    "tcp": _Connections,
    "tcpin": _Connections,
    "serial": _Terminal,
}


class _Flight:
    """A bridge in virtual time and the far end of its link."""

    def __init__(self, kind: str) -> None:
        self._far_end: _FarEnd = _FAR_ENDS[kind](kind)
        self._clock = VirtualClock(100.0)
        sonars = [EmulatedMB1242(address, self._clock.now, lambda _: 300) for address in range(0x70, 0x74)]
        self._transport = open_transport(self._far_end.url, self._clock)
        airframe = load_airframe(CONFIGS / "quad_pallet.yaml")
        self._bridge = Bridge(airframe, EmulatedBus(sonars, self._clock.now), self._clock, self._transport)

    def try_case(self, content: bytes, rng: Random) -> tuple[str | None, float]:
        """What went wrong, and the longest step [s of processor time]."""
        self._far_end.drain()
        self._far_end.send(content, rng)
        longest_s = 0.0
        readings = 0
        end_s = self._clock.now() + FLOWN_S
        while self._clock.now() < end_s:
            start_s = time.thread_time()
            try:
                readings += len(self._bridge.step())
            except Exception as error:
                place = traceback.extract_tb(error.__traceback__)[-1]
                return f"{error!r} in {Path(place.filename).name}:{place.lineno} {place.name}", longest_s
            longest_s = max(longest_s, time.thread_time() - start_s)
        return None if readings else f"no reading in {FLOWN_S} s", longest_s

    def close(self) -> None:
        self._transport.close()
        self._far_end.close()


@contextlib.contextmanager
def _flying(kind: str) -> Iterator[_Flight]:
    flight = _Flight(kind)
    try:
        yield flight
    finally:
        flight.close()


def _udp() -> socket.socket:
    udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    udp.bind(("127.0.0.1", 0))
    udp.setblocking(False)
    return udp


def _cut(content: bytes, rng: Random, longest: int) -> Iterator[bytes]:
    start = 0
    while start < len(content):
        stop = start + rng.randrange(1, longest)
        yield content[start:stop]
        start = stop


def _resident_mb() -> float:
    gc.collect()
    return memory_mb()
