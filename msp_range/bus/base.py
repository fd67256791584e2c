"""I2C bus and serial ports as the driver sees them: two verbs, and one error that says what the kernel said."""

import errno as errno_names
import os
from typing import Protocol, TypeAlias

from msp_range.errors import UserError

Address: TypeAlias = int | str
"""Where a device is: a 7-bit address on the I2C bus, or ``serial:PATH:BAUD``, the serial port that it has alone."""


def shown(address: Address) -> str:
    """An address as files and messages write it.

    Examples
    --------
    >>> shown(112), shown("serial:/dev/ttyUSB0:9600")
    ('0x70', 'serial:/dev/ttyUSB0:9600')
    """
    return address if isinstance(address, str) else f"0x{address:02x}"


# Not ENODEV (19), although an adapter that was unplugged gives it: others give it where a device does not acknowledge.
_BUS_FAULTS = frozenset({errno_names.ETIMEDOUT, errno_names.ENOENT, errno_names.EBADF, errno_names.EACCES})


class BusError(UserError, OSError):
    """A transfer that failed: BusError(errno, verb, address).

    ``errno`` is the kernel's (121 not acknowledged on a Raspberry Pi, 110 timed out, 5 clock stretch timeout, 6 and
    19 on other adapters, 2 no such bus; on a serial port 11 nothing received, 5 unplugged just now, 19 not open since
    then, 2 no such port). The text is made only when somebody reads it: a sensor that ranges does not acknowledge, so
    this is raised many times a second in normal work.
    """

    never_opened = False
    """True if the bus could not be opened since the program started: it is not set up, rather than lost."""

    @property
    def verb(self) -> str:
        """What was tried; OSError has it as its text."""
        return str(self.strerror)

    @property
    def address(self) -> Address:
        """Address of the device, 0 where none was addressed; OSError has it as its file."""
        address: Address = self.filename
        return address

    @property
    def locked_up(self) -> bool:
        """True if the bus itself, and not a single device, did not respond within the kernel's timeout."""
        return self.errno == errno_names.ETIMEDOUT

    @property
    def bus_at_fault(self) -> bool:
        """True if the bus is locked up, missing, or cannot be opened, so that no device could answer."""
        return self.errno in _BUS_FAULTS and not isinstance(self.address, str)

    @property
    def calls_for_reopening(self) -> bool:
        """True if the bus should be opened again. A serial port is opened again at each ping until it is there."""
        # An adapter that was unplugged and one whose device does not acknowledge can give the same ENODEV.
        return self.bus_at_fault or (self.errno == errno_names.ENODEV and not isinstance(self.address, str))

    def __str__(self) -> str:
        name = errno_names.errorcode.get(self.errno or 0, "?")
        words = os.strerror(self.errno or 0)
        where = f" at address {shown(self.address)}" if self.address else ""
        bus = "serial" if isinstance(self.address, str) else "I2C"
        return f"{bus} {self.verb}{where} failed: errno {self.errno} {name}, {words}"


class Bus(Protocol):
    """Plain transfers: on I2C one message each, never a combined register access; on a serial port bytes."""

    def write(self, address: Address, data: bytes) -> None:
        """Send ``data`` to ``address``; before that, a serial port drops what has arrived.

        Raises
        ------
        BusError
            The device did not acknowledge, or the bus failed.
        """

    def read(self, address: Address, count: int) -> bytes:
        """Return ``count`` bytes from ``address``; raises BusError as `write` does.

        From a serial port the bytes that have arrived, at most ``count``; without any BusError (EAGAIN).
        """

    def busy_s(self, address: Address) -> float | None:
        """Time until a device at ``address`` can answer a read [s]; 0: at any time; None: unknown, as on a real
        I2C bus. A serial port can be read at any time."""

    def reopen(self) -> None:
        """Close and open the bus again after a lock-up; raises BusError if that fails."""

    def close(self) -> None:
        """Release the bus; further calls of `close` do nothing."""
