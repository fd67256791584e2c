"""What UDP and TCP have in common: a socket, and the IPv4 address of a host, which may have to be looked up."""

import socket
import threading
from abc import abstractmethod

from msp_range.mavlink.transport.base import Reconnecting
from msp_range.mavlink.transport.url import NetworkUrl

Address = tuple[str, int]
"""A numeric IPv4 address and a port."""


class Networked(Reconnecting):
    """A link with a socket for one address.

    A host's name is looked up each time that a new socket needs the address, in a separate thread: the operating
    system's look-up has no time limit and may take many seconds; it gives up after some 10 s.
    """

    _url: NetworkUrl
    _handle: socket.socket | None
    _kind = socket.SOCK_STREAM
    _looks_up: threading.Thread | None = None
    _answer: str | OSError

    def _open(self) -> bool:
        if self._handle is None:
            address = self._found()
            if address is None:
                return False
            self._address, self._made_s = address, self._clock.now()
            self._handle = socket.socket(socket.AF_INET, self._kind)
            self._handle.setblocking(False)
        return self._attach(self._handle)

    @abstractmethod
    def _attach(self, handle: socket.socket) -> bool:
        """Connect or bind the socket, as `_open`."""

    def _found(self) -> Address | None:
        """The numeric address and the port, or None while the look-up is running: call again later.

        Raises
        ------
        OSError
            The look-up failed. The next call starts another.
        """
        host, port = self._url.host, self._url.port
        # Digits and dots are an address: `parse_url` refuses a name of them.
        if host.replace(".", "").isdigit():
            return host, port
        if self._looks_up is None:
            self._looks_up = threading.Thread(target=self._look_up, name=f"look up {host}", daemon=True)
            self._looks_up.start()
        if self._looks_up.is_alive():
            return None
        self._looks_up = None
        if isinstance(self._answer, OSError):
            raise self._answer
        return self._answer, port

    def _look_up(self) -> None:
        host = self._url.host
        try:
            self._answer = str(socket.getaddrinfo(host, None, socket.AF_INET)[0][4][0])
        except (OSError, UnicodeError) as error:
            self._answer = OSError(f"cannot look up {host!r}: {getattr(error, 'strerror', None) or error}")
