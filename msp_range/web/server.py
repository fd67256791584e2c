"""The page's server: packets of the bridge come in from its socket, batches go out to every browser.

A browser that is slow misses batches. If the bridge ends, the server waits for the next one, and browsers stay.
"""

import asyncio
import json
import signal
import socket
import sys
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from http import HTTPStatus
from importlib.resources import files
from pathlib import Path
from typing import Protocol
from urllib.parse import urlsplit

from prometheus_client import CollectorRegistry, generate_latest
from websockets.asyncio.server import ServerConnection, broadcast, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from msp_range.recording.topics import MOTION_TOPIC, SENT_TOPIC, WITHHELD_TOPIC
from msp_range.watch.client import LONGEST_PACKET, parsed
from msp_range.watch.feed import LONGEST_MARK
from msp_range.watch.newest import GONE, Newest
from msp_range.watch.place import ALL_FAMILIES, Listen
from msp_range.web.access import refusal
from msp_range.web.metrics import BridgeMetrics
from msp_range.web.outage import gone_packet, unit_state

BATCH_S = 0.05
"""Packets of this time go to the browsers together [s]: the eye sees no delay, and a phone wakes 20 times a second."""
HISTORY_PACKETS = 4000
"""Packets that a new browser gets at once: a minute of four sensors. Each takes 400 bytes of memory."""
SLOW_BYTES = 1 << 20
"""A browser with more unsent data than this gets no more until it has read it: ten seconds of four sensors."""
RETRY_S = 0.5
"""Time between two tries to find the bridge [s], and between two questions why it does not run, of 10 ms each."""
NOT_SHOWN = tuple(f'{{"topic":"{topic}"'.encode() for topic in (SENT_TOPIC, WITHHELD_TOPIC, MOTION_TOPIC))
"""Beginnings of packets that the page does not draw: the topic comes first in a packet."""
TYPES = {".html": "text/html", ".css": "text/css", ".js": "text/javascript"}
_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}


class Page:
    """The page of the bridge at a socket.

    Parameters
    ----------
    bridge
        Path of the bridge's socket.
    token
        What a browser must know to see it; None: nothing.
    unit
        Unit of the bridge, see `msp_range.web.outage`; None: it is no service.
    """

    def __init__(self, bridge: Path, token: str | None, unit: str | None = None) -> None:
        self._unit = unit
        self._path = bridge
        self._token = token
        self._bridge: socket.socket | None = None
        self._browsers: set[ServerConnection] = set()
        self._batch: list[bytes] = []
        self._history: deque[bytes] = deque(maxlen=HISTORY_PACKETS)
        self._kept: dict[str, bytes] = {}
        self._newest = Newest()
        self._requests = {"mark": self._mark}
        self._update(gone_packet(None))
        self._registry = CollectorRegistry()
        self._registry.register(BridgeMetrics(self._newest))
        self._files = {file.name: file.read_bytes() for file in (files("msp_range.web") / "static").iterdir()}

    async def serve(self, listen: Listen, on_ready: Callable[[str], None]) -> None:
        """Serve until SIGTERM, SIGINT or the end of standard input.

        Parameters
        ----------
        listen
            Host and port.
        on_ready
            Called with the page's address.

        Raises
        ------
        OSError
            The port is in use.
        """
        stop = asyncio.Event()
        loop = asyncio.get_running_loop()
        for signum in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(signum, stop.set)
        with suppress(PermissionError):  # of a service it is /dev/null
            loop.add_reader(sys.stdin.fileno(), stop.set)
        async with serve(
            self._on_browser,
            None if listen.host == ALL_FAMILIES else listen.host,  # asyncio's '::' would be without IPv4
            listen.port,
            process_request=self._on_request,
            max_size=4096,
            compression=None,
        ):
            token = "" if self._token is None else f"?token={self._token}"
            host = f"[{listen.host}]" if ":" in listen.host else listen.host
            on_ready(f"http://{host}:{listen.port}/{token}")
            tasks = [loop.create_task(each) for each in (self._receive(), self._send(), stop.wait())]
            ended, others = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in others:
                task.cancel()
            for task in ended:
                task.result()  # A page that stands still without a word is worse than one that is started again.

    def _on_request(self, connection: ServerConnection, request: Request) -> Response | None:
        """Answer what is not the live connection."""
        try:
            path = urlsplit(request.path).path
            host, origin = (request.headers.get(name) for name in ("Host", "Origin"))
            # Style and scripts say nothing of the vehicle, and the page loads them without the token.
            target = None if path.endswith((".css", ".js")) else request.path
            refused = refusal(self._token, target, host, origin)
        except (ValueError, LookupError):  # no address, or several of them
            refused = HTTPStatus.BAD_REQUEST, "expected one address each in path, Host and Origin\n"
        if refused is not None:
            return connection.respond(*refused)
        if path == "/live":
            return None
        if path == "/metrics":
            return _response("text/plain; version=0.0.4", generate_latest(self._registry))
        return file_response(connection, path, self._files)

    async def _on_browser(self, browser: ServerConnection) -> None:
        """Send what is known, then let `_send` do the rest; do what it requests."""
        last = [self._kept[GONE]] if GONE in self._kept else []  # any other packet is one of a bridge that runs
        await browser.send(_joined([*self._kept.values(), *self._history, *last]))
        self._browsers.add(browser)
        try:
            async for message in browser:
                self._on_message(message)
        except ConnectionClosed:
            pass
        finally:
            self._browsers.discard(browser)

    def _on_message(self, message: str | bytes) -> None:
        """Do what a browser requests: one JSON object, whose key is the request's name."""
        with suppress(ValueError, KeyError, TypeError, OSError, RecursionError, AttributeError):
            ((name, content),) = json.loads(message).items()
            self._requests[name](content)

    def _mark(self, text: object) -> None:
        if self._bridge is not None:
            self._bridge.send(json.dumps({"mark": str(text)[:LONGEST_MARK]}).encode())

    async def _receive(self) -> None:
        """Packets from the bridge, from the next one when it ends."""
        loop = asyncio.get_running_loop()
        while True:
            with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as connection:
                connection.setblocking(False)
                await loop.sock_connect(connection, str(self._path))
                self._bridge = connection
                self._history.clear()
                while packet := await loop.sock_recv(connection, LONGEST_PACKET):
                    self._update(packet)
            self._bridge = None
            await self._show_outage()
            await asyncio.sleep(RETRY_S)

    async def _show_outage(self) -> None:
        packet = gone_packet(None if self._unit is None else await unit_state(self._unit))
        if self._kept.get(GONE) != packet:
            self._update(packet)

    def _update(self, packet: bytes) -> None:
        if packet.startswith(NOT_SHOWN):
            return
        message = parsed(packet)
        self._newest.update(message)
        if message.topic in ("/airframe", "/status", GONE):
            self._kept = ({} if message.topic == "/airframe" else self._kept) | {message.topic: packet}
        else:
            self._history.append(packet)
        self._batch.append(packet)

    async def _send(self) -> None:
        """A batch to every browser that has taken the earlier ones."""
        while True:
            await asyncio.sleep(BATCH_S)
            if not self._batch:
                continue
            batch, self._batch = _joined(self._batch), []
            ready = [browser for browser in self._browsers if browser.transport.get_write_buffer_size() < SLOW_BYTES]
            broadcast(ready, batch)


class Responds(Protocol):
    """A connection that can refuse a request."""

    def respond(self, status: HTTPStatus, text: str) -> Response:
        """The answer of this status."""


def file_response(connection: Responds, path: str, pages: Mapping[str, bytes]) -> Response:
    """A page's file by the path of the request; ``/`` is page.html."""
    name = "page.html" if path == "/" else path.removeprefix("/")
    if name not in pages:
        return connection.respond(HTTPStatus.NOT_FOUND, f"no page {path}\n")
    return _response(f"{TYPES[Path(name).suffix]}; charset=utf-8", pages[name])


def _joined(packets: list[bytes]) -> str:
    """One JSON array."""
    return (b"[" + b",".join(packets) + b"]").decode()


def _response(kind: str, content: bytes) -> Response:
    headers = Headers({"Content-Type": kind, "Content-Length": str(len(content)), "Connection": "close", **_HEADERS})
    return Response(HTTPStatus.OK.value, HTTPStatus.OK.phrase, headers, content)
