"""What every transport is to the link, and when one that failed is opened again."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Protocol

from msp_range.clock import Clock

RETRY_FIRST_S = 0.5
RETRY_LONGEST_S = 5.0

#: Bytes after which one ``receive`` returns although there may be more: about 160 messages, 6 ms of parsing.
RECEIVE_BOUND_BYTES = 8192


@dataclass(slots=True)
class TransportStats:
    """What became of the frames, counted from the start of the program.

    With several peers (``udpin``, ``tcpin``) a frame counts once for each of them, and one that found no peer counts
    as dropped once.
    """

    sent_frames: int = 0
    """Frames taken whole by the operating system, which says nothing about their arrival."""
    dropped_frames: int = 0
    """Frames given up: no peer, no link, too late, or too many waiting."""
    refused: int = 0
    """Times that a UDP peer's computer said that nobody listens there."""
    reconnects: int = 0
    """Times that the link was opened again after its first opening."""


class Transport(Protocol):
    """One MAVLink link as bytes. No method blocks, and none raises after the opening."""

    @property
    def description(self) -> str:
        """The URL."""
        ...

    @property
    def stats(self) -> TransportStats:
        """What became of the frames."""
        ...

    @property
    def last_error(self) -> str | None:
        """Why the link is down or what went wrong last; None from the next opening that succeeds."""
        ...

    @property
    def connected(self) -> bool:
        """Whether somebody is there, as far as can be known."""
        ...

    @property
    def quiet_until_s(self) -> float:
        """Nothing arrives before this time [s]; minus infinity where that is not known, as on every real link."""
        ...

    def send(self, frame: bytes) -> bool:
        """Send one whole frame now or within its deadline; False where it was dropped at once."""
        ...

    def receive(self) -> bytes:
        """Return what has arrived, ``b""`` for nothing, and look after the connection: call it often."""
        ...

    def close(self) -> None:
        """Release the link; afterwards ``send`` drops and ``receive`` returns nothing."""
        ...


class Nowhere:
    """A transport that takes every frame and brings none: for a bridge that nobody listens to."""

    description = "nowhere"
    last_error = None
    connected = True
    quiet_until_s = float("inf")

    def __init__(self) -> None:
        self.stats = TransportStats()

    def send(self, frame: bytes) -> bool:
        """Count the frame."""
        self.stats.sent_frames += 1
        return True

    def receive(self) -> bytes:
        """Nothing."""
        return b""

    def close(self) -> None:
        """Nothing to release."""


class Reconnecting(ABC):
    """Opens at once, 0.5 s after a failure, twice as long after each further one, at most 5 s apart.

    Subclasses say how to open and how to let go.
    """

    quiet_until_s = float("-inf")

    def __init__(self, description: str, clock: Clock) -> None:
        self.description = description
        self.stats = TransportStats()
        self.last_error: str | None = None
        self._clock = clock
        self._open_at_s = float("-inf")
        self._retry_delay_s = RETRY_FIRST_S
        self._was_open = False

    @abstractmethod
    def _open(self) -> bool:
        """Open without waiting: False for 'not yet, call again', OSError where it failed."""

    @abstractmethod
    def _release(self) -> None:
        """Close what `_open` opened, also half-way; called again, do nothing."""

    def close(self) -> None:
        """Release the link; it is not opened again."""
        self._open_at_s = float("inf")
        self._release()

    def _try_open(self) -> None:
        if self._clock.now() < self._open_at_s:
            return
        try:
            if not self._open():
                return
        except OSError as error:
            self._lost(error)
            return
        self._retry_delay_s = RETRY_FIRST_S
        self.last_error = None
        self.stats.reconnects += self._was_open
        self._was_open = True

    def _lost(self, error: OSError) -> None:
        self._release()
        self._remember(error)
        self._open_at_s = self._clock.now() + self._retry_delay_s
        self._retry_delay_s = min(2 * self._retry_delay_s, RETRY_LONGEST_S)

    def _remember(self, error: OSError) -> None:
        self.last_error = f"{self.description}: {error.strerror or error}"
