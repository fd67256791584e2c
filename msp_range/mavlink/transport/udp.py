"""MAVLink over UDP: one datagram a frame, to a fixed address or to whoever has been heard.

UDP knows no connection. A frame counts as sent when the operating system took it.
"""

import errno
import socket
from abc import abstractmethod

from msp_range.clock import Clock
from msp_range.mavlink.transport.base import RECEIVE_BOUND_BYTES, Reconnecting
from msp_range.mavlink.transport.resolve import Resolver
from msp_range.mavlink.transport.url import NetworkUrl

#: ``udpin`` answers whom it heard within this time: ten heartbeats of a MAVLink component.
PEER_HEARD_S = 10.0
#: A computer that scans ports must not multiply the work of every send.
MOST_PEERS = 16
#: ``udpout`` counts as not connected for this long after a refusal: longer than the bridge's heartbeat takes.
REFUSED_FOR_S = 1.5

_DATAGRAM_BYTES = 65535
#: Empty datagrams never reach the bound in bytes.
_MOST_DATAGRAMS = 64
#: The operating system has no room just now: this frame is lost, the socket is good.
_NO_ROOM = (errno.EAGAIN, errno.ENOBUFS)


class _Udp(Reconnecting):
    """What both kinds of UDP link share: one socket, and the datagrams that have arrived on it."""

    def __init__(self, url: NetworkUrl, clock: Clock) -> None:
        super().__init__(str(url), clock)
        self._port = url.port
        self._resolver = Resolver(url.host)
        self._socket: socket.socket | None = None
        self._try_open()

    def receive(self) -> bytes:
        """Return the datagrams that have arrived, joined."""
        if self._socket is None:
            self._try_open()
        received: list[bytes] = []
        count = 0
        for _ in range(_MOST_DATAGRAMS):
            if self._socket is None or count >= RECEIVE_BOUND_BYTES:
                break
            try:
                datagram, peer = self._socket.recvfrom(_DATAGRAM_BYTES)
            except BlockingIOError:
                break
            except OSError as error:
                self._receive_failed(error)
            else:
                received.append(datagram)
                count += len(datagram)
                self._heard(peer)
        return b"".join(received)

    def _receive_failed(self, error: OSError) -> None:
        self._lost(error)

    def _heard(self, peer: tuple[str, int]) -> None:
        """Note whom a datagram came from."""

    def _open(self) -> bool:
        host = self._resolver.address()
        if host is None:
            return False
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._attach(self._socket, (host, self._port))
        return True

    @abstractmethod
    def _attach(self, udp: socket.socket, address: tuple[str, int]) -> None:
        """Connect or bind the new socket."""

    def _release(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None


class UdpOut(_Udp):
    """``udpout``: a connected socket, so that a send is one cheap system call and a missing peer is noticed."""

    def __init__(self, url: NetworkUrl, clock: Clock) -> None:
        self._refused_at_s = float("-inf")
        super().__init__(url, clock)

    @property
    def connected(self) -> bool:
        """True where there is a route and nobody has refused within the last 1.5 s."""
        return self._socket is not None and self._clock.now() - self._refused_at_s > REFUSED_FOR_S

    def send(self, frame: bytes) -> bool:
        """Send one datagram; False without a route, and where the operating system has no room."""
        if self._socket is None:
            self._try_open()
        udp = self._socket
        if udp is None:
            self.stats.dropped_frames += 1
            return False
        try:
            udp.send(frame)
        except OSError as error:
            return self._send_again(udp, frame, error)
        self.stats.sent_frames += 1
        return True

    def _send_again(self, udp: socket.socket, frame: bytes, error: OSError) -> bool:
        if error.errno == errno.ECONNREFUSED:
            # The refusal answers an earlier frame, and this one has not been sent.
            self._was_refused()
            try:
                udp.send(frame)
                self.stats.sent_frames += 1
                return True
            except OSError as second_error:
                error = second_error
        self.stats.dropped_frames += 1
        if error.errno not in (*_NO_ROOM, errno.ECONNREFUSED):
            self._lost(error)
        return False

    def _receive_failed(self, error: OSError) -> None:
        if error.errno == errno.ECONNREFUSED:
            self._was_refused()
        else:
            self._lost(error)

    def _was_refused(self) -> None:
        self.stats.refused += 1
        self._refused_at_s = self._clock.now()

    def _attach(self, udp: socket.socket, address: tuple[str, int]) -> None:
        udp.connect(address)


class UdpIn(_Udp):
    """``udpin``: a bound socket that sends every frame to every peer heard within the last 10 s."""

    def __init__(self, url: NetworkUrl, clock: Clock) -> None:
        self._heard_at_s: dict[tuple[str, int], float] = {}
        super().__init__(url, clock)

    @property
    def connected(self) -> bool:
        """True where a peer has been heard within the last 10 s."""
        self._forget_silent_peers()
        return self._socket is not None and bool(self._heard_at_s)

    def send(self, frame: bytes) -> bool:
        """Send one datagram to each peer; False where none of them got it."""
        self._forget_silent_peers()
        sent = 0
        for peer in self._heard_at_s:
            if self._socket is None:
                break
            try:
                self._socket.sendto(frame, peer)
                sent += 1
            except OSError as error:  # one peer's network may be down while another's is up
                if error.errno not in _NO_ROOM:
                    self._remember(error)
        self.stats.sent_frames += sent
        self.stats.dropped_frames += max(len(self._heard_at_s), 1) - sent
        return sent > 0

    def _heard(self, peer: tuple[str, int]) -> None:
        self._heard_at_s.pop(peer, None)  # so that the peers stay in the order in which they were heard
        self._heard_at_s[peer] = self._clock.now()
        if len(self._heard_at_s) > MOST_PEERS:
            del self._heard_at_s[next(iter(self._heard_at_s))]

    def _forget_silent_peers(self) -> None:
        oldest_s = self._clock.now() - PEER_HEARD_S
        while self._heard_at_s and self._heard_at_s[peer := next(iter(self._heard_at_s))] < oldest_s:
            del self._heard_at_s[peer]

    def _attach(self, udp: socket.socket, address: tuple[str, int]) -> None:
        # Not SO_REUSEADDR: on Linux it lets a second program take the port's datagrams away unnoticed.
        udp.bind(address)
