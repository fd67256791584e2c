"""MAVLink over UDP: one datagram per frame, to a fixed address or to every sender of frames.

UDP has no connections. A frame counts as sent when the operating system has accepted it.
"""

import errno
import socket

from msp_range.clock import Clock
from msp_range.mavlink.transport.base import RECEIVE_BOUND_BYTES
from msp_range.mavlink.transport.network import Address, Networked
from msp_range.mavlink.transport.peer import Peer, longest_silent
from msp_range.mavlink.transport.url import NetworkUrl

MOST_PEERS = 4
"""Largest number of peers of ``udpin``: the autopilot and three ground stations or routers. Each costs a system call
per frame, so with more a port scan would be costly, and with fewer a second ground station would be left out."""
REFUSED_FOR_S = 1.5
"""``udpout`` counts as not connected for this long after a refusal [s]: longer than the bridge's heartbeat takes."""

_MOST_DATAGRAMS = 200
"""Largest number of datagrams per ``receive``: 40,000 a second at the link's 5 ms. With fewer a flood fills the
socket's buffer, which holds some 250, and the autopilot's own datagrams are lost; more make one call longer (200 take
0.6 ms on a desktop computer)."""
_NO_ROOM = (errno.EAGAIN, errno.ENOBUFS)
"""The operating system's buffer is full: this frame is lost, but the socket works."""


class _Udp(Networked):
    """Common part of both kinds of UDP link: one socket, and the received datagrams."""

    _kind = socket.SOCK_DGRAM
    _refused_at_s = float("-inf")

    def receive(self) -> bytes:
        """Return the datagrams that have arrived, joined."""
        received = bytearray()
        count = 0
        self._try_open()
        for _ in range(_MOST_DATAGRAMS):
            if self._handle is None or count >= RECEIVE_BOUND_BYTES:
                break
            try:
                datagram, peer = self._handle.recvfrom(RECEIVE_BOUND_BYTES)
            except BlockingIOError:
                break
            except ConnectionRefusedError:
                self._was_refused()
            except OSError as error:
                self._lost(error)
            else:
                count += len(datagram)
                received += self._accept(datagram, peer)
        return bytes(received)

    def _was_refused(self) -> None:
        self.stats.refused += 1
        self._refused_at_s = self._clock.now()

    def _accept(self, datagram: bytes, address: Address) -> bytes:
        """The part of a datagram that is passed to the link."""
        return datagram


class UdpOut(_Udp):
    """``udpout``: a connected socket, so that sending is one cheap system call and a missing peer is detected."""

    @property
    def connected(self) -> bool:
        """True if there is a route and no refusal within the last 1.5 s."""
        return super().connected and self._clock.now() - self._refused_at_s > REFUSED_FOR_S

    def send(self, frame: bytes) -> bool:
        """Send one datagram; False without a route or if the operating system's buffer is full."""
        self._try_open()
        # A refusal answers an earlier frame, and this one has not been sent: once more.
        for _ in range(2):
            if self._handle is None:
                break
            try:
                self._handle.send(frame)
                self.stats.sent_frames += 1
                return True
            except ConnectionRefusedError:
                self._was_refused()
            except OSError as error:
                if error.errno not in _NO_ROOM:
                    self._lost(error)
                break
        self.stats.dropped_frames += 1
        return False

    def _attach(self, handle: socket.socket) -> bool:
        handle.connect(self._address)
        return True


class UdpIn(_Udp):
    """``udpin``: a bound socket that sends every frame to all peers, whose number is limited.

    A peer is an address from which a valid frame came within the last 10 s. If the maximum number is reached, only
    an autopilot is added, in place of a peer that is not one, or else that is not the first one.
    """

    def __init__(self, url: NetworkUrl, clock: Clock) -> None:
        self._peers: dict[Address, Peer] = {}
        super().__init__(url, clock)

    @property
    def connected(self) -> bool:
        """True if there is a peer."""
        self._forget_silent_peers()
        return super().connected and bool(self._peers)

    def send(self, frame: bytes) -> bool:
        """Send one datagram to each peer; False if none was sent."""
        self._forget_silent_peers()
        sent = 0
        for address in self._peers:
            if self._handle is None:
                break
            try:
                self._handle.sendto(frame, address)
                sent += 1
            except OSError as error:  # one peer's network may be down while another's is up
                if error.errno not in _NO_ROOM:
                    self._remember(error)
        self.stats.sent_frames += sent
        self.stats.dropped_frames += max(len(self._peers), 1) - sent
        return sent > 0

    def _accept(self, datagram: bytes, address: Address) -> bytes:
        now_s = self._clock.now()
        peer = self._peers.get(address) or Peer(now_s)
        frames = peer.read(datagram, now_s)
        if frames and address not in self._peers:
            self._forget_silent_peers()
            if len(self._peers) >= MOST_PEERS:
                if not peer.is_autopilot(now_s):
                    return b""
                del self._peers[longest_silent(self._peers, now_s)]
            self._peers[address] = peer
        return frames

    def _forget_silent_peers(self) -> None:
        now_s = self._clock.now()
        for address in [each for each, peer in self._peers.items() if peer.is_silent(now_s)]:
            del self._peers[address]

    def _attach(self, handle: socket.socket) -> bool:
        # Not SO_REUSEADDR: on Linux it lets a second program take the port's datagrams away unnoticed.
        handle.bind(self._address)
        return True
