"""MAVLink over TCP, as a client of one server (``tcp``) and as a server of several clients (``tcpin``)."""

import errno
import os
import socket
from collections.abc import Sequence
from contextlib import suppress

from msp_range.clock import Clock
from msp_range.mavlink.transport.base import RECEIVE_BOUND_BYTES
from msp_range.mavlink.transport.network import Networked
from msp_range.mavlink.transport.peer import PEER_SILENT_S, Peer, longest_silent
from msp_range.mavlink.transport.stream import FrameStream, StreamTransport
from msp_range.mavlink.transport.url import NetworkUrl

CONNECT_DEADLINE_S = 4.0
"""Linux requests a connection after 0, 1 and 3 s; without an answer by then a new attempt starts."""
STUCK_AFTER_S = 5.0
"""Time without accepted or acknowledged bytes after which a peer is dropped."""
MOST_CLIENTS = 8

_SEND_BUFFER_BYTES = 8192
"""Limit of the kernel's buffer for a peer that does not read, because such frames arrive late or never: with this some
40 kB of small frames, without it 1 MB and more [bytes; the kernel doubles it]."""


def _prepare(tcp: socket.socket) -> None:
    tcp.setblocking(False)
    tcp.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    tcp.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
    # A peer without power sends nothing; without this the kernel would keep trying for 15 minutes.
    tcp.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, int(STUCK_AFTER_S * 1000))


class TcpOut(Networked, StreamTransport):
    """``tcp``: a client of one server."""

    def _attach(self, handle: socket.socket) -> bool:
        _prepare(handle)
        try:
            # Called again during the attempt, it says how that stands.
            handle.connect(self._address)
        except BlockingIOError:
            if self._clock.now() > self._made_s + CONNECT_DEADLINE_S:
                raise TimeoutError(f"no answer within {CONNECT_DEADLINE_S:.0f} s") from None
            return False
        if handle.getsockname() == handle.getpeername():
            # A free port on this computer can be given to the socket itself, and it is then connected to itself.
            raise OSError(errno.ECONNREFUSED, os.strerror(errno.ECONNREFUSED))
        self._stream = FrameStream(handle.send, self._clock, self.stats, STUCK_AFTER_S)
        return True


class _Client(Peer):
    """An accepted connection and its output."""

    def __init__(self, stream: FrameStream, now_s: float) -> None:
        super().__init__(now_s)
        self.stream = stream


class TcpIn(Networked):
    """``tcpin``: a server; every frame goes to every client, and whole frames of all clients are received.

    A client that sends no valid frame for 10 s is dropped. If the maximum number is reached, a new client
    replaces the longest silent one that is not an autopilot, or else one that is not the first autopilot.
    """

    def __init__(self, url: NetworkUrl, clock: Clock) -> None:
        self._clients: dict[socket.socket, _Client] = {}
        super().__init__(url, clock)

    @property
    def connected(self) -> bool:
        """True while there is a client."""
        return bool(self._clients)

    @property
    def files(self) -> Sequence[int]:
        """All sockets; none while frames wait, which `receive` writes."""
        if any(client.stream.waiting for client in self._clients.values()):
            return ()
        return (*super().files, *(tcp.fileno() for tcp in self._clients))

    def send(self, frame: bytes) -> bool:
        """Send a frame to every client, now or within 0.25 s; False if no client can get it."""
        taken = False
        if not self._clients:
            self.stats.dropped_frames += 1
        for tcp, client in self._clients.copy().items():
            try:
                taken = client.stream.send(frame) or taken
            except OSError as error:
                self._drop(tcp, error)
        return taken

    def receive(self) -> bytes:
        """Return the complete frames that have arrived; accept clients, and write waiting frames."""
        self._try_open()
        if self._handle is not None:
            self._accept(self._handle)
        now_s = self._clock.now()
        received = b""
        for tcp, client in self._clients.copy().items():
            try:
                client.stream.flush()
                with suppress(BlockingIOError):
                    arrived = tcp.recv(RECEIVE_BOUND_BYTES // len(self._clients))
                    if not arrived:
                        raise ConnectionError("a client has left")
                    received += client.read(arrived, now_s)
                if client.is_silent(now_s):
                    raise TimeoutError(f"a client has sent no MAVLink for {PEER_SILENT_S:.0f} s")
            except OSError as error:
                self._drop(tcp, error)
        return received

    def _attach(self, handle: socket.socket) -> bool:
        handle.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        handle.bind(self._address)
        handle.listen()
        return True

    def _release(self) -> None:
        for tcp in self._clients.copy():
            self._drop(tcp)
        super()._release()

    def _accept(self, listener: socket.socket) -> None:
        for _ in range(MOST_CLIENTS):
            now_s = self._clock.now()
            try:
                tcp, _ = listener.accept()
                _prepare(tcp)
            except BlockingIOError:
                return
            except OSError as error:  # the client has gone again, or this program has no file handles left
                self._remember(error)
                return
            if len(self._clients) >= MOST_CLIENTS:
                self._drop(longest_silent(self._clients, now_s))
            self._clients[tcp] = _Client(FrameStream(tcp.send, self._clock, self.stats, STUCK_AFTER_S), now_s)
            self.last_error = None

    def _drop(self, tcp: socket.socket, error: OSError | None = None) -> None:
        tcp.close()
        self._clients.pop(tcp).stream.abandon()
        if error is not None:
            self._remember(error)
