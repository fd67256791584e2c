"""Look up a host's IPv4 address without blocking; the operating system's look-up may take many seconds."""

import ipaddress
import socket
import threading
from contextlib import suppress

from msp_range.mavlink.transport.url import NetworkUrl


class Resolver:
    """Looks up a URL's host in a separate thread, each time that a new connection needs the address.

    The look-up has no time limit; the operating system gives up after some 10 s.
    """

    def __init__(self, url: NetworkUrl) -> None:
        self._host, self._port = url.host, url.port
        self._thread: threading.Thread | None = None
        self._answer: str | OSError = self._host

    def address(self) -> tuple[str, int] | None:
        """Return the numeric address and the port, or None while the look-up is running: call again later.

        Raises
        ------
        OSError
            The look-up failed. The next call starts another.
        """
        with suppress(ValueError):
            return str(ipaddress.IPv4Address(self._host)), self._port
        if self._thread is None:
            self._thread = threading.Thread(target=self._look_up, name=f"look up {self._host}", daemon=True)
            self._thread.start()
        if self._thread.is_alive():
            return None
        self._thread = None
        if isinstance(self._answer, OSError):
            raise self._answer
        return self._answer, self._port

    def _look_up(self) -> None:
        try:
            self._answer = str(socket.getaddrinfo(self._host, None, socket.AF_INET)[0][4][0])
        except (OSError, UnicodeError) as error:
            why = getattr(error, "strerror", None) or error
            self._answer = OSError(f"cannot look up {self._host!r}: {why}")
