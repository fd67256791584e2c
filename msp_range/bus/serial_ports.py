"""Serial ports: opened raw with 8 data bits, no parity, one stop bit, no flow control, for one program alone.

The MAVLink link opens its port by `open_port` too. fcntl and termios exist on Linux only.
"""

import errno
import fcntl
import os
import termios
from contextlib import suppress
from io import FileIO

from msp_range.bus.base import BusError


def open_port(path: str, baud: int) -> FileIO:
    """Open a device file without waiting for anything.

    Raises
    ------
    OSError
        There is no such port, it may not be opened, another program has it, or it does not have this rate.
    """
    speed = getattr(termios, f"B{baud}", None)
    if speed is None:
        raise OSError(errno.EINVAL, f"serial ports have no rate of {baud} baud")
    # O_NONBLOCK: do not wait for a carrier; O_NOCTTY: a ^C that arrives must not end the bridge.
    port = FileIO(os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK), "r+")
    mode = termios.CS8 | termios.CREAD | termios.CLOCAL
    try:
        # Two locks: root respects flock only, which others take if they ask for it (exclusive=True in pyserial);
        # TIOCEXCL makes every later open fail that is not root's.
        fcntl.flock(port, fcntl.LOCK_EX | fcntl.LOCK_NB)
        fcntl.ioctl(port, termios.TIOCEXCL)
        control = termios.tcgetattr(port)[6]
        # With VMIN 0 'nothing has arrived' and 'the device is gone' would look the same.
        control[termios.VMIN] = 1
        control[termios.VTIME] = 0
        termios.tcsetattr(port, termios.TCSANOW, [0, 0, mode, 0, speed, speed, control])
        if termios.tcgetattr(port)[5] != speed:
            raise OSError(errno.EINVAL, "the device does not have this baud rate")
    except BlockingIOError:
        port.close()
        raise OSError(errno.EBUSY, "the port is in use by another program") from None
    except OSError:
        port.close()
        raise
    except termios.error as error:  # not an OSError, though it has the same two arguments
        port.close()
        raise OSError(*error.args) from None
    return port


class SerialPorts:
    """The ports of range finders, by their address ``serial:PATH:BAUD``: the part of a `Bus` that is no I2C.

    A port that fails (unplugged) is closed, and opened again by the next write.
    """

    def __init__(self) -> None:
        self._ports: dict[str, FileIO] = {}

    def write(self, address: str, data: bytes) -> None:
        """Drop what has arrived, and send ``data``; opens the port."""
        try:
            if address not in self._ports:
                path, _, baud = address.removeprefix("serial:").rpartition(":")
                self._ports[address] = open_port(path, int(baud))
            termios.tcflush(self._ports[address], termios.TCIFLUSH)
            if os.write(self._ports[address].fileno(), data) != len(data):
                raise OSError(errno.EIO, "the port took a part of it only")
        except (OSError, termios.error) as error:
            raise self._failed("write", address, error.args[0]) from None

    def read(self, address: str, count: int) -> bytes:
        """Bytes that have arrived."""
        if address not in self._ports:
            raise BusError(errno.ENODEV, "read", address)
        try:
            if arrived := os.read(self._ports[address].fileno(), count):
                return arrived
        except BlockingIOError:
            raise BusError(errno.EAGAIN, "read", address) from None
        except OSError as error:
            raise self._failed("read", address, error.errno) from None
        raise self._failed("read", address, errno.EIO)

    def close(self) -> None:
        """Release all ports."""
        while self._ports:
            self._ports.popitem()[1].close()

    def _failed(self, verb: str, address: str, number: int | None) -> BusError:
        """The error, where the port has been closed."""
        if address in self._ports:
            with suppress(OSError):
                self._ports.pop(address).close()
        return BusError(number or errno.EIO, verb, address)
