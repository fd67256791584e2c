"""The newest state of a watched bridge, from its packets."""

from collections import deque
from dataclasses import dataclass, field
from typing import Any

from msp_range.recording.topics import FUSED_TOPIC, HEALTH_TOPIC, RANGE_PREFIX, Message

GONE = "/gone"
"""Topic of the packet that the page's server makes when the bridge has ended."""
FRESH_S = 2.0
"""A fused distance that is older is not shown as the present one [s]; the bridge makes several a second."""
TEXTS_KEPT = 50
"""Reports to the pilot that are remembered."""


@dataclass
class Newest:
    """What was received last."""

    airframe: dict[str, Any] = field(default_factory=dict)
    status: dict[str, Any] = field(default_factory=dict)
    """Messages of ``/airframe`` and ``/status``; empty before the first."""
    readings: dict[str, dict[str, Any]] = field(default_factory=dict)
    """The last record of each sensor."""
    fused: tuple[float, dict[str, Any]] | None = None
    """The last fused distance, and its time [s]."""
    received: dict[str, dict[str, Any]] = field(default_factory=dict)
    """The last message of ``/autopilot`` of each kind."""
    texts: deque[tuple[float, dict[str, Any]]] = field(default_factory=lambda: deque(maxlen=TEXTS_KEPT))
    """(time [s], message) of the last reports to the pilot, the oldest first."""
    time_s: float = 0.0
    """Time of the last packet [s]."""

    @property
    def state(self) -> str:
        """State of the bridge by its own verdict; 'unknown' where there is no status of a bridge that runs."""
        return str(self.status.get("state", "unknown"))

    @property
    def distance(self) -> dict[str, Any] | None:
        """The present fused distance; None where the last one is too old."""
        if self.fused is None or self.time_s - self.fused[0] > FRESH_S:
            return None
        return self.fused[1]

    def update(self, packet: Message) -> None:
        """Update with one packet."""
        topic, self.time_s, message = packet
        if topic.startswith(RANGE_PREFIX):
            self.readings[topic.removeprefix(RANGE_PREFIX)] = message
        elif topic == FUSED_TOPIC:
            self.fused = self.time_s, message
        elif topic == "/airframe":
            self.airframe = message
        elif topic == "/status":
            self.status = message
        elif topic == "/autopilot":
            self.received[message["kind"]] = message
        elif topic == HEALTH_TOPIC:
            self.texts.append((self.time_s, message))
        elif topic == GONE:
            self.status = {}
