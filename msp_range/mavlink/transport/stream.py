"""Frames on a byte stream (TCP, serial): complete, in order, and never late.

A receiver loses two frames if half a frame is followed by another. So a partly written frame is completed before
anything else, and a frame that has not been started within its deadline is dropped: the autopilot needs the newest
range, not all of them.
"""

import os
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from msp_range.clock import Clock
from msp_range.mavlink.transport.base import RECEIVE_BOUND_BYTES, Reconnecting, TransportStats

FRAME_DEADLINE_S = 0.25
"""A frame that has not been started this long after ``send`` is dropped."""
MOST_WAITING_FRAMES = 64


@dataclass
class FrameStream:
    """The output of an open byte stream.

    Parameters
    ----------
    write
        Writes bytes without blocking and returns how many; raises BlockingIOError for none, any other OSError if the
        stream is broken.
    clock
        Clock for the deadlines.
    stats
        Counters of frames.
    stuck_after_s
        Time without progress after which the stream counts as broken [s].

    Attributes
    ----------
    waiting
        What is unwritten of each frame, and its deadline [s].
    blocked_since_s
        When a write was incomplete and none has made progress after it [s]; None: the last write was complete.
    """

    write: Callable[[bytes], int]
    clock: Clock
    stats: TransportStats
    stuck_after_s: float = float("inf")
    waiting: deque[tuple[bytes, float]] = field(default_factory=deque)
    blocked_since_s: float | None = None

    def send(self, frame: bytes) -> bool:
        """Write ``frame``, or keep it until its deadline; False if too many are waiting.

        Raises
        ------
        OSError
            As `flush` does.
        """
        self.waiting.append((frame, self.clock.now() + FRAME_DEADLINE_S))
        self.flush()
        if len(self.waiting) <= MOST_WAITING_FRAMES:
            return True
        self.waiting.pop()
        self.stats.dropped_frames += 1
        return False

    def flush(self) -> None:
        """Write waiting frames as far as possible, and drop late ones.

        Raises
        ------
        OSError
            The stream is broken; TimeoutError if it accepted nothing for too long.
        """
        now_s = self.clock.now()
        while self.waiting:
            unwritten, deadline_s = self.waiting[0]
            if now_s > deadline_s:
                self.waiting.popleft()
                self.stats.dropped_frames += 1
                continue
            try:
                written = self.write(unwritten)
            except BlockingIOError:
                written = 0
            if written:
                self.blocked_since_s = None
                # The rest of a frame follows, however late.
                self.waiting[0] = unwritten[written:], float("inf")
            if written < len(unwritten):
                if self.blocked_since_s is None:
                    self.blocked_since_s = now_s
                elif now_s - self.blocked_since_s > self.stuck_after_s:
                    raise TimeoutError(f"the peer has accepted nothing for {self.stuck_after_s:.0f} s")
                return
            self.waiting.popleft()
            self.stats.sent_frames += 1

    def abandon(self) -> None:
        """Count incomplete frames as dropped, because the stream is closed."""
        self.stats.dropped_frames += len(self.waiting)
        self.waiting.clear()


class StreamTransport(Reconnecting):
    """A transport with one byte stream, which exists from ``_open`` to ``_release``."""

    _stream: FrameStream | None = None

    @property
    def files(self) -> Sequence[int]:
        """The stream; none while frames wait, which `receive` writes."""
        return () if self._stream is None or self._stream.waiting else super().files

    def send(self, frame: bytes) -> bool:
        """Send a frame whole, now or within 0.25 s; False without a link, or with too many frames waiting."""
        self._try_open()
        if self._stream is None:
            self.stats.dropped_frames += 1
            return False
        try:
            return self._stream.send(frame)
        except OSError as error:
            self._lost(error)
            return False

    def receive(self) -> bytes:
        """Return what has arrived; connect, and write waiting frames."""
        self._try_open()
        if self._stream is None or self._handle is None:
            return b""
        try:
            self._stream.flush()
            if received := os.read(self._handle.fileno(), RECEIVE_BOUND_BYTES):
                return received
            raise ConnectionError("the other side has closed the link")
        except BlockingIOError:
            pass
        except OSError as error:
            self._lost(error)
        return b""

    def _release(self) -> None:
        if self._stream is not None:
            self._stream.abandon()
            self._stream = None
        super()._release()
