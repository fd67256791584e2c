"""The interface of a transport, and the schedule of its reopening after a failure."""

import socket
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from io import FileIO
from typing import Any, Protocol

from msp_range.clock import Clock
from msp_range.mavlink.transport.url import TransportUrl

RETRY_FIRST_S = 0.5
RETRY_LONGEST_S = 5.0

RECEIVE_BOUND_BYTES = 8192
"""Bytes after which one ``receive`` returns although there may be more: about 160 messages, 6 ms of parsing."""


@dataclass(slots=True)
class TransportStats:
    """Counters of frames since the start of the program.

    With several peers (``udpin``, ``tcpin``) a frame counts once for each of them, and one that found no peer counts
    as dropped once.
    """

    sent_frames: int = 0
    """Frames accepted completely by the operating system; they may not have arrived."""
    dropped_frames: int = 0
    """Frames dropped: no peer, no link, too late, or too many waiting."""
    refused: int = 0
    """Number of refusals by a UDP peer's computer because nothing listens there."""
    reconnects: int = 0
    """Number of times that the link was reopened."""


class Transport(Protocol):
    """The bytes of a MAVLink link. No method blocks, and none raises after opening."""

    description: str
    """The URL."""
    stats: TransportStats
    """Counters of frames."""

    @property
    def last_error(self) -> str | None:
        """The reason why the link is down, or the last error; None after the next successful opening."""

    @property
    def connected(self) -> bool:
        """Whether there is a peer, as far as known."""

    @property
    def quiet_until_s(self) -> float:
        """Time before which nothing arrives [s]; minus infinity if unknown, as on every real link."""

    @property
    def files(self) -> Sequence[int]:
        """Files that can be read as soon as something has arrived; none: ask again and again."""

    def send(self, frame: bytes) -> bool:
        """Send a complete frame now or within its deadline; False if it was dropped at once."""

    def receive(self) -> bytes:
        """Return the bytes that have arrived, and maintain the connection; call it often."""

    def close(self) -> None:
        """Release the link; afterwards ``send`` drops and ``receive`` returns nothing."""


class Wrapped:
    """A transport on top of another one, which it passes everything on to; subclasses look at what passes."""

    description: str
    stats: TransportStats
    last_error: str | None
    connected: bool
    quiet_until_s: float
    files: Sequence[int]

    def __init__(self, transport: Transport) -> None:
        self._transport = transport

    def __getattr__(self, name: str) -> Any:
        return getattr(self._transport, name)

    def send(self, frame: bytes) -> bool:
        """Send by the other one."""
        return self._transport.send(frame)

    def receive(self) -> bytes:
        """What the other one has received."""
        return self._transport.receive()

    def close(self) -> None:
        """Release the other one."""
        self._transport.close()


class Reconnecting(ABC):
    """Opens at once, then 0.5 s after a failure, with twice the delay after each further one, up to 5 s.

    Subclasses implement opening, and make what that and closing need before they call this class's constructor.
    """

    last_error: str | None = None
    quiet_until_s = _open_at_s = float("-inf")
    _retry_delay_s = RETRY_FIRST_S
    _handle: socket.socket | FileIO | None = None
    _is_open = _was_open = False

    def __init__(self, url: TransportUrl, clock: Clock) -> None:
        self.description = str(url)
        self.stats = TransportStats()
        self._url = url
        self._clock = clock
        self._try_open()

    @abstractmethod
    def _open(self) -> bool:
        """Open without waiting: False for 'not yet, call again', OSError where it failed."""

    def _release(self) -> None:
        """Close what `_open` opened, also partly; may be called repeatedly."""
        if self._handle is not None:
            self._handle.close()
            self._handle = None
        self._is_open = False

    @property
    def connected(self) -> bool:
        """True while it is open."""
        return self._is_open

    @property
    def files(self) -> Sequence[int]:
        """What is open; none, as long as nothing is: `receive` opens it."""
        return () if self._handle is None else (self._handle.fileno(),)

    def close(self) -> None:
        """Release the link; it is not opened again."""
        self._open_at_s = float("inf")
        self._release()

    def _try_open(self) -> None:
        """Open where nothing is open and an attempt is due."""
        try:
            if self._is_open or self._clock.now() < self._open_at_s or not self._open():
                return
        except OSError as error:
            self._lost(error)
            return
        self._retry_delay_s = RETRY_FIRST_S
        self.last_error = None
        self.stats.reconnects += self._was_open
        self._is_open = self._was_open = True

    def _lost(self, error: OSError) -> None:
        self._release()
        self._remember(error)
        self._open_at_s = self._clock.now() + self._retry_delay_s
        self._retry_delay_s = min(2 * self._retry_delay_s, RETRY_LONGEST_S)

    def _remember(self, error: OSError) -> None:
        self.last_error = f"{self.description}: {error.strerror or error}"
