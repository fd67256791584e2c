"""MAVLink over a serial port."""

import fcntl
import os
import sys
import termios
from contextlib import suppress
from io import FileIO

from msp_range.bus.serial_ports import open_port
from msp_range.mavlink.transport.stream import FRAME_DEADLINE_S, FrameStream, StreamTransport
from msp_range.mavlink.transport.url import SerialUrl

BITS_PER_BYTE = 10
"""Start bit, eight data bits, stop bit."""
UARTS = ("/dev/serial0", "/dev/serial1", "/dev/ttyAMA", "/dev/ttyS")
"""Beginnings of the names of a computer's own serial ports, which may have to be switched on."""


class Serial(StreamTransport):
    """``serial``: a device file, which may vanish (unplugged) and return under the same name."""

    _url: SerialUrl
    _handle: FileIO | None

    def _open(self) -> bool:
        try:
            self._handle = open_port(self._url.path, self._url.baud)
        except FileNotFoundError as error:
            hint = "; on a Raspberry Pi: enable_uart=1 in config.txt" if self._url.path.startswith(UARTS) else ""
            raise OSError(error.errno, f"there is no such port{hint}") from None
        self._stream = FrameStream(self._write, self._clock, self.stats)
        return True

    def _write(self, unwritten: bytes) -> int:
        assert self._handle is not None
        # The kernel buffers up to 4 kB, which is 4 s at 9600 baud: buffered bytes must be sent in time.
        if queued_bytes(self._handle) > int(self._url.baud / BITS_PER_BYTE * FRAME_DEADLINE_S):
            return 0
        return os.write(self._handle.fileno(), unwritten)

    def _release(self) -> None:
        if self._handle is not None:
            with suppress(OSError, termios.error):
                if self._stream is not None and self._stream.blocked_since_s is not None:
                    # Closing would wait for the device to take its bytes, up to 30 s.
                    termios.tcflush(self._handle, termios.TCOFLUSH)
                fcntl.ioctl(self._handle, termios.TIOCNXCL)
        super()._release()


def queued_bytes(file: FileIO) -> int:
    """Bytes that the kernel has buffered; 0 if the driver does not report them."""
    return int.from_bytes(fcntl.ioctl(file, termios.TIOCOUTQ, bytes(4)), sys.byteorder)
