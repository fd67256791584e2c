"""MAVLink over a serial port: raw, 8 data bits, no parity, one stop bit, no flow control, exclusive use."""

import fcntl
import os
import sys
import termios
from contextlib import suppress
from io import FileIO

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
        # O_NONBLOCK: do not wait for a carrier; O_NOCTTY: a ^C that arrives must not end the bridge.
        try:
            self._handle = FileIO(os.open(self._url.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK), "r+")
        except FileNotFoundError as error:
            hint = "; on a Raspberry Pi: enable_uart=1 in config.txt" if self._url.path.startswith(UARTS) else ""
            raise OSError(error.errno, f"there is no such port{hint}") from None
        port, speed = self._handle, getattr(termios, f"B{self._url.baud}")
        mode = termios.CS8 | termios.CREAD | termios.CLOCAL
        try:
            # This is the lock of pyserial and most terminal programs, and the only one that root respects.
            fcntl.flock(port, fcntl.LOCK_EX | fcntl.LOCK_NB)
            fcntl.ioctl(port, termios.TIOCEXCL)
            control = termios.tcgetattr(port)[6]
            # With VMIN 0 'nothing has arrived' and 'the device is gone' would look the same.
            control[termios.VMIN] = 1
            control[termios.VTIME] = 0
            termios.tcsetattr(port, termios.TCSANOW, [0, 0, mode, 0, speed, speed, control])
            if termios.tcgetattr(port)[5] != speed:
                raise OSError("the device does not have this baud rate")
        except BlockingIOError:
            raise OSError("the port is in use by another program") from None
        except termios.error as error:  # not an OSError, though it has the same two arguments
            raise OSError(*error.args) from None
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
