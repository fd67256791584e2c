"""Messages to systemd from a service of its own (sd_notify(3))."""

import os
import socket
from contextlib import suppress

LONGEST = 1000
"""Characters of a message; systemd drops those of over 4 kB."""


def notify_systemd(state: str) -> None:
    """Send a state such as READY=1 to systemd; without systemd, or with its socket full or gone, nothing happens.

    WATCHDOG=1 comes from the polling loop. An unplugged adapter, a full disk or a silent autopilot do not stop the
    loop, so the watchdog is still fed: a restart would not help. Anything else that stops the loop causes one, apart
    from a transfer that the kernel has not given up, see `msp_range.service.transfers_watched`. STATUS=... is the
    reason why a service cannot start: `systemctl status` and the page show it.
    """
    address = os.environ.get("NOTIFY_SOCKET")
    if address:
        with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as sender:
            to = "\0" + address[1:] if address.startswith("@") else address
            sender.sendto(state[:LONGEST].encode(), to)
