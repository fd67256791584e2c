"""What an owner may find at the far end of the link: autopilots on a cable, UDP or TCP, and cables with a fault.

Each far end is a context manager that gives the URL by which a program of this computer reaches it.
"""

import os
import pty
import random
import select
import socket
import threading
import time
import tty
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tests.support.mavlink_ends import Component
from tests.support.parameter_autopilot import ParameterAutopilot
from tests.support.transports import free_port

BAROMETER_C, OUTSIDE_C = 36.5, 21.5
"""What the autopilot reports of its barometer's chip and of its airspeed sensor [deg C]."""

MakeAutopilot = Callable[[str], ParameterAutopilot]


class StreamingAutopilot(ParameterAutopilot):
    """An autopilot that also streams the temperatures of its barometer and its airspeed sensor, as most do."""

    def _send_heartbeat(self) -> None:
        super()._send_heartbeat()
        self._connection.mav.scaled_pressure_send(0, 1013.0, 0.0, round(BAROMETER_C * 100), round(OUTSIDE_C * 100))


class DeafAutopilot(StreamingAutopilot):
    """An autopilot whose RX pin is not connected: it streams, and nothing that is sent reaches it."""

    def _take(self, message: Any) -> None:
        """Receive nothing."""


class SigningAutopilot(StreamingAutopilot):
    """An autopilot with a key for MAVLink signing: it signs all messages, and drops what is not signed with it."""

    def __init__(self, url: str, values: Mapping[str, float] | None = None, **options: Any) -> None:
        super().__init__(url, values, **options)
        self._connection.setup_signing(bytes(range(32)), sign_outgoing=True)


@contextmanager
def on_cable(make: MakeAutopilot) -> Iterator[str]:
    """An autopilot at the other end of a serial cable."""
    with (
        make("udpin:127.0.0.1:0") as autopilot,
        _serial_port() as (path, master),
        socket.socket(type=socket.SOCK_DGRAM) as far,
    ):
        far.connect(("127.0.0.1", autopilot.port))
        with _carrying(master, far):
            yield f"serial:{path}:921600"


@contextmanager
def by_udp(make: MakeAutopilot) -> Iterator[str]:
    """An autopilot that listens on a UDP port of this computer."""
    with make("udpin:127.0.0.1:0") as autopilot:
        yield f"udpout:127.0.0.1:{autopilot.port}"


@contextmanager
def by_udp_towards_here(make: MakeAutopilot) -> Iterator[str]:
    """An autopilot that sends to a UDP port of this computer; the URL sends to the same port, and does not listen."""
    port = free_port(socket.SOCK_DGRAM)
    with make(f"udpout:127.0.0.1:{port}"):
        yield f"udpout:127.0.0.1:{port}"


@contextmanager
def by_tcp(make: MakeAutopilot) -> Iterator[str]:
    """An autopilot that listens on a TCP port of this computer."""
    with make("tcpin:127.0.0.1:0") as autopilot:
        yield f"tcp:127.0.0.1:{autopilot.port}"


@contextmanager
def silent_cable() -> Iterator[str]:
    """A serial port with nothing on its pins."""
    with _serial_port() as (path, _):
        yield f"serial:{path}:921600"


@contextmanager
def cable_at_other_baud(sent_baud: int, read_baud: int) -> Iterator[str]:
    """An autopilot that sends at another baud rate than the one that the port is read with."""
    autopilot, chance = Component(), random.Random(1)

    def send() -> None:
        # A heartbeat, and other messages of a stream; what nobody reads is lost, as on a wire.
        with suppress(BlockingIOError):
            os.write(master, misread(autopilot.heartbeat() + chance.randbytes(60), sent_baud, read_baud))
        time.sleep(0.1)

    with _serial_port() as (path, master), _repeating(send):
        yield f"serial:{path}:{read_baud}"


def misread(data: bytes, sent_baud: int, read_baud: int) -> bytes:
    """The bytes that a serial port makes of a signal at another baud rate.

    A line with one start bit, eight data bits and one stop bit, read in the middle of what the reader takes for bits.
    Linux reports a byte without a stop bit as zero.

    Examples
    --------
    >>> misread(b"range", 57600, 57600)
    b'range'
    >>> misread(b"U", 57600, 115200).hex()
    '00e6'
    """
    levels = [1]
    for byte in data:
        levels += [0, *((byte >> bit) & 1 for bit in range(8)), 1]
    end_s = len(levels) / sent_baud

    def level(time_s: float) -> int:
        return levels[min(int(time_s * sent_baud), len(levels) - 1)] if time_s < end_s else 1

    seen = bytearray()
    step_s = 0.05 / max(sent_baud, read_baud)
    time_s = 0.0
    while time_s < end_s:
        if level(time_s):
            time_s += step_s
            continue
        byte = sum(level(time_s + (1.5 + bit) / read_baud) << bit for bit in range(8))
        seen.append(byte if level(time_s + 9.5 / read_baud) else 0)
        time_s += 9.5 / read_baud
        while time_s < end_s and not level(time_s):
            time_s += step_s
    return bytes(seen)


@contextmanager
def _serial_port() -> Iterator[tuple[str, int]]:
    """A serial port of this computer: its path, and the far end of its cable."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    try:
        # Below umockdev no ioctl of a serial port reaches one whose path begins with /dev.
        with TemporaryDirectory(prefix="msp-") as folder:
            port = Path(folder) / "port"
            port.symlink_to(os.ttyname(slave))
            yield str(port), master
    finally:
        os.close(master)
        os.close(slave)


@contextmanager
def _carrying(master: int, far: socket.socket) -> Iterator[None]:
    """Carry bytes between the end of a cable and a connected socket."""

    def carry() -> None:
        for ready in select.select([master, far.fileno()], [], [], 0.05)[0]:
            # A buffer that nobody empties loses what comes, and so does a port where nobody listens yet.
            with suppress(BlockingIOError, ConnectionRefusedError):
                if ready != master:
                    os.write(master, far.recv(4096))
                else:
                    far.send(os.read(master, 4096))

    # The far end learns an address by its first datagram.
    far.send(b"\0")
    with _repeating(carry):
        yield


@contextmanager
def _repeating(work: Callable[[], None]) -> Iterator[None]:
    """Do something again and again in a thread."""
    stop = threading.Event()

    def run() -> None:
        while not stop.is_set():
            work()

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
