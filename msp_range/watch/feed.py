"""The bridge's end of the socket: everything that is recorded goes to the watchers too, and a status twice a second.

One packet is one JSON object ``{"topic", "time_s", "message"}``; topics are those of `msp_range.recording.topics`, and
``/airframe`` (once, at the start), ``/status`` and ``/autopilot``. A watcher that does not keep up loses
packets, never the bridge time. A watcher may send ``{"mark": "text"}``, which goes into the recording; nothing else.
"""

import os
import select
import socket
import struct
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import orjson

from msp_range.errors import UserError
from msp_range.input_file import printable

MOST_WATCHERS = 8
"""Most watchers at a time: a page's process and some terminals. Each costs the bridge a system call a packet. When all
places are taken, the user with most of them loses one to a user with fewer."""
LONGEST_MARK = 100
"""Characters of a mark; longer ones are cut."""
MARKS_PER_S = 2.0
"""Marks are refused above this rate, so that nobody fills the recording with them [1/s]."""
_CREDENTIALS = struct.Struct("iII")
"""Process, user and group, struct ucred of unix(7)."""


class FeedError(UserError):
    """The socket cannot be made; the message says why."""


class Feed:
    """A Unix socket on which watchers get packets.

    Parameters
    ----------
    path
        Path of the socket. Its folder is made if it is missing, for this user alone; a socket that nobody listens on
        any more is replaced.
    greeting
        Gives the message of ``/airframe``, which each watcher gets first.
    on_mark
        Called with (time [s], text) for each mark.

    Raises
    ------
    FeedError
        The folder cannot be used, or another bridge listens there.
    """

    def __init__(
        self, path: Path, greeting: Callable[[], dict[str, Any]], on_mark: Callable[[float, str], None]
    ) -> None:
        self.path = path
        self._greeting = greeting
        self._on_mark = on_mark
        self._watchers: list[socket.socket] = []
        self._next_mark_s = float("-inf")
        self._server = _listening(path)

    @property
    def is_watched(self) -> bool:
        """Whether somebody watches; if not, nothing has to be made for them."""
        return bool(self._watchers)

    def publish(self, topic: str, time_s: float, message: dict[str, Any]) -> None:
        """Send one message to all watchers; those that cannot take it now lose it."""
        if not self._watchers:
            return
        packet = _packet(topic, time_s, message)
        for watcher in [*self._watchers]:
            try:
                watcher.send(packet)
            except BlockingIOError:  # it does not keep up
                pass
            except OSError:
                self._forget(watcher)

    def service(self, now_s: float) -> None:
        """Greet new watchers and receive marks; one system call if there is nothing to do."""
        # The server comes last: a watcher that loses its place to a new one has been read by then.
        readable, _, _ = select.select([*self._watchers, self._server], (), (), 0.0)
        for ready in readable:
            if ready is self._server:
                with suppress(OSError):  # It has gone already, or there are too many open files.
                    self._greet(ready.accept()[0], now_s)
            else:
                self._receive(ready, now_s)

    def close(self) -> None:
        """End all connections and remove the socket."""
        for watcher in self._watchers:
            watcher.close()
        self._watchers.clear()
        self._server.close()
        self.path.unlink(missing_ok=True)

    def _greet(self, watcher: socket.socket, now_s: float) -> None:
        watcher.setblocking(False)
        try:
            if len(self._watchers) == MOST_WATCHERS:
                self._make_room(_user_of(watcher))
            watcher.send(_packet("/airframe", now_s, self._greeting()))
        except OSError:  # too many, or it has gone already
            watcher.close()
        else:
            self._watchers.append(watcher)

    def _make_room(self, user: int) -> None:
        """Take a place from the user with most of them; raises ConnectionRefusedError if ``user`` has as many."""
        places = Counter(map(_user_of, self._watchers))
        most, count = places.most_common(1)[0]
        if places[user] + 1 >= count:
            raise ConnectionRefusedError
        self._forget(next(watcher for watcher in self._watchers if _user_of(watcher) == most))

    def _receive(self, watcher: socket.socket, now_s: float) -> None:
        try:
            packet = watcher.recv(4096)
        except OSError:
            packet = b""
        if not packet:
            self._forget(watcher)
            return
        try:
            text = orjson.loads(packet)["mark"]
        except (ValueError, KeyError, TypeError):
            return
        if isinstance(text, str) and text and now_s >= self._next_mark_s:
            self._next_mark_s = now_s + 1.0 / MARKS_PER_S
            self._on_mark(now_s, printable(text)[:LONGEST_MARK])

    def _forget(self, watcher: socket.socket) -> None:
        watcher.close()
        self._watchers.remove(watcher)


def _user_of(watcher: socket.socket) -> int:
    """The user whose program connected."""
    credentials = watcher.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    user: int = _CREDENTIALS.unpack(credentials)[1]
    return user


def _packet(topic: str, time_s: float, message: dict[str, Any]) -> bytes:
    return orjson.dumps({"topic": topic, "time_s": time_s, "message": message})


def _listening(path: Path) -> socket.socket:
    """A server on ``path``, which everybody on this computer may connect to where the folder lets them."""
    try:
        path.parent.mkdir(mode=0o700, exist_ok=True)
        # In a folder such as /tmp somebody else may have made it, and could replace the socket.
        if path.parent.stat().st_uid not in (0, os.geteuid()):
            raise FeedError(f"{path.parent}: belongs to another user; nobody can watch this bridge")
        if path.is_socket():
            _remove_if_left_behind(path)
        server = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK)
        try:
            server.bind(str(path))
            path.chmod(0o666)
            server.listen(MOST_WATCHERS)
        except OSError:
            server.close()
            raise
    except OSError as error:
        raise FeedError(f"{path}: {error.strerror or error}; nobody can watch this bridge") from None
    return server


def _remove_if_left_behind(path: Path) -> None:
    """Remove the socket of a bridge that was killed."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK) as asking:
        if asking.connect_ex(str(path)) == 0:
            raise FeedError(f"{path}: another bridge is watched there; --socket names another place")
    path.unlink()
