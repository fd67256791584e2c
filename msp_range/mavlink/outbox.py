"""Timing of messages: fused ones are sent at once, those of single streams spaced out after them.

PX4 keeps one unread message per link, so of several in one burst only the last is seen. Therefore single streams wait
until `SPACING_S` after the previous message.
"""

from collections.abc import Callable
from typing import Any

SPACING_S = 0.020


class Outbox:
    """Messages of the single streams that wait for their turn.

    Parameters
    ----------
    send
        Sends a message now.

    Attributes
    ----------
    next_event_s
        When `send_due` has something to do [s]; infinite if nothing waits.
    """

    def __init__(self, send: Callable[[Any], object]) -> None:
        self._send = send
        self._waiting: dict[int, Any] = {}
        self._free_s = float("-inf")
        self.next_event_s = float("inf")

    def send_now(self, now_s: float, message: Any) -> None:
        """Send a message before all waiting ones."""
        self._send(message)
        self._free_s = now_s + SPACING_S
        self._plan()

    def put(self, stream_id: int, message: Any) -> None:
        """Queue a message; it replaces a waiting one of the same stream."""
        self._waiting[stream_id] = message
        self._plan()

    def send_due(self, now_s: float) -> None:
        """Send the next waiting message if it is due."""
        if now_s >= self.next_event_s:
            self.send_now(now_s, self._waiting.pop(next(iter(self._waiting))))

    def _plan(self) -> None:
        self.next_event_s = self._free_s if self._waiting else float("inf")
