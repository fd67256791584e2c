"""One of several senders on a link (``udpin``, ``tcpin``), with its own parser and its state.

Senders without MAVLink get nothing and cost nothing, and no new sender can replace the first autopilot.
"""

from collections.abc import Mapping
from typing import TypeVar

from msp_range.mavlink.frames import FrameReader

PEER_SILENT_S = 10.0
"""Time without a valid frame after which a peer is dropped [s]: ten heartbeats of a MAVLink component. Shorter drops a
ground station behind a bad radio, longer blocks the place for others."""


class Peer:
    """A sender of frames.

    Parameters
    ----------
    now_s
        Time of its first bytes [s].
    """

    first_autopilot_s, _last_autopilot_s = float("inf"), float("-inf")

    def __init__(self, now_s: float) -> None:
        self._frames = FrameReader()
        self.last_frame_s = now_s

    def read(self, arrived: bytes, now_s: float) -> bytes:
        """The valid frames completed by these bytes, joined; other bytes are dropped."""
        frames = self._frames.read(arrived)
        if not frames:
            return b""
        self.last_frame_s = now_s
        if any(frame.is_autopilot_heartbeat for frame in frames):
            self.first_autopilot_s = min(self.first_autopilot_s, now_s)
            self._last_autopilot_s = now_s
        return b"".join(frame.data for frame in frames)

    def is_silent(self, now_s: float) -> bool:
        """True if it has sent no valid frame for too long."""
        return now_s - self.last_frame_s > PEER_SILENT_S

    def is_autopilot(self, now_s: float) -> bool:
        """True while it sends heartbeats of an autopilot."""
        return now_s - self._last_autopilot_s <= PEER_SILENT_S


Place = TypeVar("Place")
"""Where a peer is: its address, or its socket."""


def longest_silent(peers: Mapping[Place, Peer], now_s: float) -> Place:
    """The peer to drop for a new one: no autopilot where there is another, and never the first autopilot."""
    autopilots = [peer for peer in peers.values() if peer.is_autopilot(now_s)]
    first = min(autopilots, key=lambda peer: peer.first_autopilot_s, default=None)
    order = {place: (peer in autopilots, peer is first, peer.last_frame_s) for place, peer in peers.items()}
    return min(order, key=order.__getitem__)
