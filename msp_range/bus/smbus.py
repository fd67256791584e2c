"""The kernel's I2C bus through smbus2, and the serial ports next to it.

Every transfer is one ``I2C_RDWR`` call with one message: SMBus register reads would write a byte first and so
start a new measurement, and calls of ``write_byte`` from two threads can go to the wrong address.

Two programs that poll the same sensors would trigger each other's measurements and read each other's answers. Therefore
the device file is locked (flock) while it is open. The lock is released when the process ends, for whatever reason.

smbus2 and fcntl exist on Linux only, so they are imported where the bus is used.
"""

import errno
import os
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msp_range.bus.base import Address, BusError

if TYPE_CHECKING:
    from smbus2 import SMBus

    from msp_range.bus.serial_ports import SerialPorts


_Prepared = tuple[Any, Callable[[], object]]
"""A message of smbus2, and the call that sends it on the open device file."""


def bus_of(text: str) -> int | str:
    """Bus number, or path, from the command line."""
    return int(text) if text.isdecimal() else text


class BusNotOpened(BusError):
    """The bus has not been there since the program started, or may not be opened; the text says what to do."""

    never_opened = True

    def __init__(self, path: Path, number: int, text: str) -> None:
        super().__init__(number, f"open {path}", 0)
        self._text = f"{path}: {text}"

    def __str__(self) -> str:
        return self._text


class BusInUse(BusNotOpened):
    """Another process uses the bus: one of these commands, because other programs do not use the lock."""

    never_opened = False
    bus_at_fault = True


class KernelBus:
    """``/dev/i2c-N`` and this computer's serial ports as a Bus, locked against other processes that use this class.

    Parameters
    ----------
    bus
        Bus number, or the path of the device file. It is opened at the first transfer, so that a missing bus is a
        temporary fault and does not end the program.

    Attributes
    ----------
    waiting : Lock
        Free only while the program's thread waits for a transfer. Another thread that gets it may do what that thread
        could do, which cannot go on before it is released.
    """

    def __init__(self, bus: int | str) -> None:
        self._bus = bus
        self._smbus: SMBus | None = None
        self._was_open = False
        self.waiting = threading.Lock()
        self.waiting.acquire()
        self._prepared: dict[tuple[int, bytes | int], _Prepared] = {}
        self._ports: SerialPorts | None = None

    @property
    def path(self) -> Path:
        """The device file."""
        return Path(f"/dev/i2c-{self._bus}" if isinstance(self._bus, int) else self._bus)

    def write(self, address: Address, data: bytes) -> None:
        """Send ``data`` to ``address`` as one message."""
        if isinstance(address, str):
            self._serial.write(address, data)
        else:
            self._transfer("write", address, data)

    def read(self, address: Address, count: int) -> bytes:
        """Read ``count`` bytes from ``address`` as one message."""
        if isinstance(address, str):
            return self._serial.read(address, count)
        return bytes(self._transfer("read", address, count))

    @property
    def _serial(self) -> "SerialPorts":
        if self._ports is None:
            from msp_range.bus.serial_ports import SerialPorts

            self._ports = SerialPorts()
        return self._ports

    def _transfer(self, verb: str, address: int, content: bytes | int) -> Any:
        """Write ``content``, or read as many bytes as it says; returns the message of smbus2."""
        message, send = self._prepared.get((address, content)) or self._prepare(verb, address, content)
        self.waiting.release()
        try:
            send()
        except OSError as error:
            raise BusError(error.errno or errno.EIO, verb, address) from None
        finally:
            self.waiting.acquire()
        return message

    def _prepare(self, verb: str, address: int, content: bytes | int) -> "_Prepared":
        """Make a message and its call, once: smbus2 makes them anew for each, which takes as long as all else here."""
        from fcntl import ioctl

        from smbus2.smbus2 import I2C_RDWR, i2c_msg, i2c_rdwr_ioctl_data

        if self._smbus is None:
            self.reopen()
        smbus: Any = self._smbus
        message: Any = getattr(i2c_msg, verb)(address, content)
        prepared = message, partial(ioctl, smbus.fd, I2C_RDWR, i2c_rdwr_ioctl_data.create(message))
        self._prepared[address, content] = prepared
        return prepared

    def busy_s(self, address: Address) -> float | None:
        """Unknown on I2C; a serial port can always be read."""
        return 0.0 if isinstance(address, str) else None

    def reopen(self) -> None:
        """Close and open the device file; raises BusInUse if another process has locked it."""
        import fcntl

        from smbus2 import SMBus

        self._close_i2c()
        try:
            smbus: Any = SMBus(str(self.path))
        except OSError as error:
            number = error.errno or errno.EIO
            if self._was_open:
                raise BusError(number, f"open {self.path}", 0) from None
            how = "'msp-range doctor' finds out what is missing"
            absent = f"no such I2C bus; enable I2C, or name another bus ({how})"
            refused = f"cannot be opened: {os.strerror(number)} ({how})"
            raise BusNotOpened(self.path, number, absent if number == errno.ENOENT else refused) from None
        try:
            fcntl.flock(smbus.fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            holder = _holder(os.fstat(smbus.fd))
            smbus.close()
            text = f"in use by {holder}; two programs on one bus would disturb each other. Stop it first"
            raise BusInUse(self.path, errno.EBUSY, text) from None
        self._smbus = smbus
        self._was_open = True

    def claim(self) -> None:
        """Open and lock the device file now if it exists; raises BusInUse if another process uses it."""
        try:
            self.reopen()
        except BusInUse:
            raise
        except BusError:
            pass  # the first transfer tries again, and reports it

    def close(self) -> None:
        """Close the device file and all ports."""
        self._close_i2c()
        if self._ports is not None:
            self._ports.close()

    def _close_i2c(self) -> None:
        self._prepared.clear()
        if self._smbus is not None:
            self._smbus.close()
            self._smbus = None


def _holder(file: os.stat_result) -> str:
    """The process that has locked a file, from /proc/locks, with its command if this user may see it."""
    place = f"{os.major(file.st_dev):02x}:{os.minor(file.st_dev):02x}:{file.st_ino}"
    try:
        locks = [line.split() for line in Path("/proc/locks").read_text().splitlines()]
        process = next(words[4] for words in locks if words[1] == "FLOCK" and words[5] == place)
    except (OSError, StopIteration):
        return "another process"
    try:
        command = Path(f"/proc/{process}/cmdline").read_bytes().decode(errors="replace").replace("\0", " ").strip()
    except OSError:
        return f"process {process}"
    return f"process {process} ({command})"
