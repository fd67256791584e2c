"""Everything by which a running bridge can be watched: the feed, its status, and the page's process."""

from typing import TYPE_CHECKING, Any

from msp_range.bridge import Bridge
from msp_range.log import Log
from msp_range.mavlink.transport import Transport
from msp_range.recording.topics import MARK_TOPIC
from msp_range.watch.feed import Feed
from msp_range.watch.place import Outputs
from msp_range.watch.view import airframe_message, autopilot_message, status_message

if TYPE_CHECKING:
    from msp_range.recording.flight_recorder import FlightRecorder
    from msp_range.watch.page import PageProcess

STATUS_INTERVAL_S = 0.5
"""Time between two messages of ``/status`` [s]: a fault is seen at most this late. One takes 0.1 ms."""


class Watch:
    """What watchers of one bridge get.

    Parameters
    ----------
    bridge, transport
        What is watched.
    outputs
        Where the socket and the page are.
    now_s
        Now [s].
    log
        Where the page says that it is there, or not any more.
    recorder
        Whose file the status names; None: nothing is recorded.

    Raises
    ------
    FeedError
        The socket cannot be made.
    """

    _page: "PageProcess | None" = None

    def __init__(
        self,
        bridge: Bridge,
        transport: Transport,
        outputs: Outputs,
        now_s: float,
        log: Log,
        recorder: "FlightRecorder | None" = None,
    ) -> None:
        self._bridge = bridge
        self._transport = transport
        self._recorder = recorder
        self._feed = Feed(
            outputs.socket,
            lambda: airframe_message(bridge.airframe),
            lambda now_s, text: bridge.write(MARK_TOPIC, now_s, {"text": text}),
        )
        bridge.show_to(self._feed.publish)
        if outputs.web is not None:
            # Imports subprocess, which a bridge without a page does not need.
            from msp_range.watch.page import PageProcess

            self._page = PageProcess(outputs.web, outputs.socket, now_s, log)
        self._next_status_s = now_s

    def on_message(self, now_s: float, message: Any) -> None:
        """Show what a message of the autopilot says of distances."""
        if self._feed.is_watched and (shown := autopilot_message(message)) is not None:
            self._feed.publish("/autopilot", now_s, shown)

    def service(self, now_s: float) -> None:
        """Do what is due."""
        self._feed.service(now_s)
        if now_s < self._next_status_s:
            return
        self._next_status_s = now_s + STATUS_INTERVAL_S
        if self._feed.is_watched:
            path = None if self._recorder is None else self._recorder.path
            status = status_message(self._bridge, self._transport, path, now_s)
            self._feed.publish("/status", now_s, status)
        if self._page is not None:
            self._page.service(now_s)

    def close(self) -> None:
        """End page and feed."""
        if self._page is not None:
            self._page.close()
        self._feed.close()
