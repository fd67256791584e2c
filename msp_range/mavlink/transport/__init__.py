"""The byte transports of the MAVLink link: frames go out and bytes come in, and no call ever blocks or raises.

A URL, written as pymavlink writes it, becomes a `Transport` of one of five kinds. All of them open in the background,
come back by themselves after a loss (`base.Reconnecting`) and drop a frame rather than wait for somebody to take it.
"""

from collections.abc import Callable

from msp_range.clock import Clock
from msp_range.mavlink.transport.base import Transport, TransportStats, Wrapped
from msp_range.mavlink.transport.tcp import TcpIn, TcpOut
from msp_range.mavlink.transport.udp import UdpIn, UdpOut
from msp_range.mavlink.transport.url import NetworkUrl, parse_url

_NETWORK: dict[str, Callable[[NetworkUrl, Clock], Transport]] = {
    "udpin": UdpIn,
    "udpout": UdpOut,
    "tcp": TcpOut,
    "tcpin": TcpIn,
}


def open_transport(url: str, clock: Clock) -> Transport:
    """Start the transport that ``url`` names.

    The first attempt to open is made at once. Where it fails (no such device, port in use, nobody there) nothing is
    raised: ``last_error`` says why, and ``send`` and ``receive`` try again when it is due.

    Parameters
    ----------
    url
        As `parse_url` reads it.
    clock
        Deadlines and back-off are counted on it.

    Raises
    ------
    ValueError
        The text is not a URL of a known kind.
    """
    found = parse_url(url)
    if isinstance(found, NetworkUrl):
        return _NETWORK[found.kind](found, clock)
    # Needs fcntl and termios, which virtual flights on other systems than Linux do not have.
    from msp_range.mavlink.transport.serial import Serial

    return Serial(found, clock)
