"""The I2C bus as the driver sees it: two verbs, and one error that says what the kernel said."""

import errno as errno_names
import os
from typing import Protocol

from msp_range.errors import UserError

# Not ENODEV (19), although an adapter that was unplugged gives it: others give it where a device does not acknowledge.
_BUS_FAULTS = frozenset({errno_names.ETIMEDOUT, errno_names.ENOENT, errno_names.EBADF, errno_names.EACCES})


class BusError(UserError, OSError):
    """A transfer that failed: BusError(errno, verb, address).

    ``errno`` is the kernel's (121 not acknowledged on a Raspberry Pi, 110 timed out, 5 clock stretch timeout, 6 and
    19 on other adapters, 2 no such bus). The text is made only when somebody reads it: a sensor that ranges does not
    acknowledge, so this is raised many times a second in normal work.
    """

    never_opened = False
    """True if the bus could not be opened since the program started: it is not set up, rather than lost."""

    @property
    def verb(self) -> str:
        """What was tried; OSError has it as its text."""
        return str(self.strerror)

    @property
    def address(self) -> int:
        """7-bit address, 0 where no device was addressed; OSError has it as its file."""
        return int(self.filename)

    @property
    def locked_up(self) -> bool:
        """True if the bus itself, and not a single device, did not respond within the kernel's timeout."""
        return self.errno == errno_names.ETIMEDOUT

    @property
    def bus_at_fault(self) -> bool:
        """True if the bus is locked up, missing, or cannot be opened, so that no device could answer."""
        return self.errno in _BUS_FAULTS

    def __str__(self) -> str:
        name = errno_names.errorcode.get(self.errno or 0, "?")
        words = os.strerror(self.errno or 0)
        where = f" at address 0x{self.address:02x}" if self.address else ""
        return f"I2C {self.verb}{where} failed: errno {self.errno} {name}, {words}"


class Bus(Protocol):
    """Plain I2C transfers: one message each, never a combined register access."""

    def write(self, address: int, data: bytes) -> None:
        """Send ``data`` to the 7-bit ``address``.

        Raises
        ------
        BusError
            The device did not acknowledge, or the bus failed.
        """

    def read(self, address: int, count: int) -> bytes:
        """Return ``count`` bytes from the 7-bit ``address``; raises BusError as `write` does."""

    def busy_s(self, address: int) -> float | None:
        """Time until a device at ``address`` can answer a read [s]; 0: at any time; None: unknown, as on every real
        bus."""

    def reopen(self) -> None:
        """Close and open the bus again after a lock-up; raises BusError if that fails."""

    def close(self) -> None:
        """Release the bus; further calls of `close` do nothing."""
