"""The kernel's I2C bus through smbus2.

Every transfer is one ``I2C_RDWR`` call with one message: SMBus register reads would write a byte first and so start a
new ranging, and calls of ``write_byte`` from two threads can go to the wrong address.
"""

import errno
from pathlib import Path

from smbus2 import SMBus, i2c_msg

from msp_range.bus.base import BusError


class KernelBus:
    """``/dev/i2c-N`` as a Bus.

    Parameters
    ----------
    bus
        Bus number, or the path of the device file. It is opened at the first transfer, so that a bus that is not
        there yet is a fault that can heal and not the end of the program.
    """

    def __init__(self, bus: int | str) -> None:
        self._bus = bus
        self._smbus: SMBus | None = None

    @property
    def path(self) -> Path:
        """The device file."""
        return Path(f"/dev/i2c-{self._bus}" if isinstance(self._bus, int) else self._bus)

    def write(self, address: int, data: bytes) -> None:
        """Send ``data`` to ``address`` as one message."""
        self._transfer(i2c_msg.write(address, data), "write", address)

    def read(self, address: int, count: int) -> bytes:
        """Read ``count`` bytes from ``address`` as one message."""
        message = i2c_msg.read(address, count)
        self._transfer(message, "read", address)
        return bytes(message)

    def _transfer(self, message: i2c_msg, verb: str, address: int) -> None:
        if self._smbus is None:
            self.reopen()
        assert self._smbus is not None
        try:
            self._smbus.i2c_rdwr(message)
        except OSError as error:
            raise BusError(error.errno or errno.EIO, verb, address) from None

    def reopen(self) -> None:
        """Close and open the device file."""
        self.close()
        try:
            self._smbus = SMBus(str(self.path))
        except OSError as error:
            raise BusError(error.errno or errno.EIO, f"open {self.path}", 0) from None

    def close(self) -> None:
        """Close the device file."""
        if self._smbus is not None:
            self._smbus.close()
            self._smbus = None
