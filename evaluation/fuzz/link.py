"""Bytes that are no MAVLink, nearly MAVLink, or MAVLink with impossible content, at the bridge over each kind of link.

The whole bridge works on emulated sensors in virtual time; what arrives comes through real sockets and a real
pseudo-terminal. A bridge that no longer polls is a finding too.
"""

import contextlib
import os
import pty
import socket
from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path
from random import Random

from evaluation.fuzz import base
from msp_range.bridge import Bridge
from msp_range.clock import VirtualClock
from msp_range.config import load_airframe
from msp_range.mavlink.dialect import dialect
from msp_range.mavlink.transport import open_transport
from msp_sim.device.bus import EmulatedBus
from msp_sim.device.mb1242 import EmulatedMB1242
from tests.support.shipped import CONFIGS
from tests.support.transports import free_port

FLOWN_S = 0.25
"""Virtual time after each case: two pings."""

AUTOPILOT, BRIDGE, GROUND_STATION = (7, 1), (7, 191), (255, 190)
SENDERS = (AUTOPILOT, AUTOPILOT, BRIDGE, GROUND_STATION, (8, 1), (7, 154), (0, 0))
LIKELY = ("HEARTBEAT", "ATTITUDE", "SYSTEM_TIME", "TIMESYNC", "PING", "COMMAND_LONG", "COMMAND_INT", "COMMAND_ACK")
"""What the bridge listens to; the others are drawn from all of the dialect."""


def fuzz(seconds: float, seed: int) -> base.FuzzResult:
    """Let made-up bytes arrive for so long [s]."""
    return base.run("link", seconds, seed, _case, prepare)


def _case(rng: Random) -> bytes:
    """Which kind of link, a seed of how the bytes are cut, and the bytes."""
    kind = rng.randrange(len(_FAR_ENDS))
    return bytes([kind]) + rng.randbytes(4) + rng.choice((made_up, never_ending))(rng)


def prepare(folder: Path) -> base.Check:
    """The check: let bytes arrive at a bridge that flies, and that has to poll on whatever they are."""
    flights: dict[str, _Flight] = {}

    def check(data: bytes) -> None:
        kind = list(_FAR_ENDS)[data[0]]
        flight = flights.pop(kind, None) or _Flight(kind)
        try:
            flight.receive(data[5:], Random(data[1:5]))
        except BaseException:
            flight.close()
            raise
        flights[kind] = flight

    for number in range(len(_FAR_ENDS)):
        check(bytes([number]) + bytes(4))
    return check


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

    def receive(self, content: bytes, rng: Random) -> None:
        """Let bytes arrive, and fly on."""
        self._far_end.drain()
        self._far_end.send(content, rng)
        readings = 0
        end_s = self._clock.now() + FLOWN_S
        while self._clock.now() < end_s:
            readings += len(self._bridge.step())
        assert readings, f"no reading in {FLOWN_S} s"

    def close(self) -> None:
        self._transport.close()
        self._far_end.close()


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
