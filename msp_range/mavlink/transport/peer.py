"""One of several senders on a link (``udpin``, ``tcpin``): its own parser, and what its frames show about it.

What does not speak MAVLink gets nothing and costs nothing, and no newcomer takes the place of the autopilot.
"""

from collections.abc import Iterable
from typing import TypeVar

from msp_range.mavlink.frames import FrameReader

PEER_SILENT_S = 10.0
"""A peer without a valid frame for this long is no longer one [s]: ten heartbeats of a MAVLink component. Shorter drops
a ground station behind a bad radio, longer keeps a place from those that send."""


class Peer:
    """A sender of frames.

    Parameters
    ----------
    now_s
        When it came [s].
    """

    def __init__(self, now_s: float) -> None:
        self._frames = FrameReader()
        self.last_frame_s = now_s
        self._last_autopilot_s = float("-inf")

    def read(self, arrived: bytes, now_s: float) -> bytes:
        """The valid frames that these bytes complete, joined; bytes that belong to none are dropped."""
        frames = self._frames.read(arrived)
        if not frames:
            return b""
        self.last_frame_s = now_s
        if any(frame.is_autopilot_heartbeat for frame in frames):
            self._last_autopilot_s = now_s
        return b"".join(frame.data for frame in frames)

    def is_silent(self, now_s: float) -> bool:
        """True where it has sent no valid frame for too long."""
        return now_s - self.last_frame_s > PEER_SILENT_S

    def is_autopilot(self, now_s: float) -> bool:
        """True while heartbeats of an autopilot come from it."""
        return now_s - self._last_autopilot_s <= PEER_SILENT_S


SomePeer = TypeVar("SomePeer", bound=Peer)


def longest_silent(peers: Iterable[SomePeer], now_s: float) -> SomePeer | None:
    """The one to give up for a newcomer, never an autopilot; None where all are."""
    others = [peer for peer in peers if not peer.is_autopilot(now_s)]
    return min(others, key=lambda peer: peer.last_frame_s, default=None)
