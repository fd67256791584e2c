"""The text of a link, as pymavlink writes it, becomes what it means. Nothing is opened here.

Addresses are IPv4 or names, as in pymavlink. The default baud rate is that of ArduPilot's SERIAL1_BAUD and PX4's
TELEM1, 57600.
"""

import ipaddress
import re
from typing import NamedTuple

DEFAULT_BAUD = 57600

# fmt: off
BAUD_RATES = (
    50, 75, 110, 134, 150, 200, 300, 600, 1200, 1800, 2400, 4800, 9600, 19200, 38400, 57600, 115200, 230400, 460800,
    500000, 576000, 921600, 1000000, 1152000, 1500000, 2000000, 2500000, 3000000, 3500000, 4000000,
)
# fmt: on
"""Rates of a serial port that may be named [baud]: those for which Linux has a constant."""

_EXAMPLES = {
    "udpin": "udpin:0.0.0.0:14550",
    "udpout": "udpout:192.168.2.1:14550",
    "tcp": "tcp:127.0.0.1:5760",
    "tcpin": "tcpin:0.0.0.0:5760",
    "serial": "serial:/dev/serial/by-id/usb-ArduPilot_Pixhawk1-if00:57600",
}


class NetworkUrl(NamedTuple):
    """A UDP or TCP link; ``in`` kinds wait on an address of this computer, the others go to ``host``."""

    kind: str
    host: str
    port: int

    def __str__(self) -> str:
        return f"{self.kind}:{self.host}:{self.port}"


class SerialUrl(NamedTuple):
    """A serial device file and its rate [baud]."""

    path: str
    baud: int

    def __str__(self) -> str:
        return f"serial:{self.path}:{self.baud}"


TransportUrl = NetworkUrl | SerialUrl


def parse_url(text: str) -> TransportUrl:
    """Return what a link's URL means.

    Parameters
    ----------
    text
        ``udpin:HOST:PORT``, ``udpout:HOST:PORT``, ``tcp:HOST:PORT``, ``tcpin:HOST:PORT``, ``serial:PATH:BAUD`` with
        an optional ``:BAUD``, or ``PATH`` and ``PATH,BAUD`` with a PATH that begins with ``/``. A serial PATH may
        hold colons.

    Raises
    ------
    ValueError
        Says what was found, what was expected, and gives an example.

    Examples
    --------
    >>> parse_url("udpout:192.168.2.1:14550")
    NetworkUrl(kind='udpout', host='192.168.2.1', port=14550)
    >>> parse_url("serial:/dev/serial/by-path/pci-0000:00:14.0-usb-0:3:1.0")
    SerialUrl(path='/dev/serial/by-path/pci-0000:00:14.0-usb-0:3:1.0', baud=57600)
    """
    kind, colon, rest = text.partition(":")
    if text.startswith("/"):
        path, comma, baud = text.partition(",")
        return SerialUrl(path, _baud(text, baud) if comma else DEFAULT_BAUD)
    if not colon or kind not in _EXAMPLES:
        kinds = f"one of {', '.join(_EXAMPLES)}, each followed by a colon"
        how = "udpout sends to an address, udpin waits to be sent to"
        raise _wrong(text, f"{kind!r} as its kind", f"{kinds} ({how})", "udpout")
    return _serial(text, rest) if kind == "serial" else _network(text, kind, rest)


def _network(text: str, kind: str, rest: str) -> NetworkUrl:
    host, colon, port = rest.rpartition(":")
    if not colon:
        raise _wrong(text, f"{rest!r} after the kind", f"{kind}:HOST:PORT", kind)
    if not re.fullmatch(r"[0-9]{1,5}", port) or not 1 <= int(port) <= 65535:
        raise _wrong(text, f"port {port!r}", "a whole number from 1 to 65535", kind)
    if re.fullmatch(r"[0-9.]+", host):
        try:
            ipaddress.IPv4Address(host)
        except ValueError as error:
            raise _wrong(text, f"host {host!r} ({error})", "an IPv4 address or a name", kind) from None
    elif not re.fullmatch(r"[A-Za-z0-9_-]{1,63}(\.[A-Za-z0-9_-]{1,63})*\.?", host):
        everywhere = ", 0.0.0.0 for all of this computer's addresses" if kind.endswith("in") else ""
        raise _wrong(text, f"host {host!r}", f"an IPv4 address or a name{everywhere}", kind)
    return NetworkUrl(kind, host, int(port))


def _serial(text: str, rest: str) -> SerialUrl:
    path, colon, tail = rest.rpartition(":")
    # A by-path name ends in the USB configuration and interface, "...:1.0" or "...:1.0-port0", which is no rate.
    if not colon or "." in tail or "/" in tail:
        path, baud = rest, DEFAULT_BAUD
    else:
        baud = _baud(text, tail)
    if not path.startswith("/"):
        raise _wrong(text, f"path {path!r}", "the full path of a device file, beginning with /", "serial")
    return SerialUrl(path, baud)


def _baud(text: str, baud: str) -> int:
    if not re.fullmatch(r"[0-9]{1,9}", baud) or int(baud) not in BAUD_RATES:
        known = ", ".join(map(str, BAUD_RATES))
        raise _wrong(text, f"baud rate {baud!r}", f"one of {known}", "serial")
    return int(baud)


def _wrong(text: str, found: str, expected: str, kind: str) -> ValueError:
    return ValueError(f"link {text!r}: found {found}; expected {expected}, for example {_EXAMPLES[kind]}")
