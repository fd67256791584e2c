"""The wires between the master and the emulated devices, as a Bus of msp_range.

The devices at the address of a transfer answer together, and the master gets what the wired-AND of the open-drain lines
gives. A transfer takes no time on the clock: 24 bits at 50 kHz are 0.5 ms, far below a ranging.
"""

import errno
import math
from collections.abc import Callable, Sequence
from typing import Protocol

from msp_range.bus.base import Address, BusError
from msp_sim.device.device import Fault, NotAcknowledged

ROUNDING_S = 1e-6
"""A sensor is busy for this much longer than stated [s], because the bridge adds the time on a clock with other
roundings. Any value far below the interval between two attempts will do."""


class Device(Protocol):
    """Anything with an address on the bus."""

    address: Address
    also_at: int | None
    """A second address, of kinds that have one while it is changed."""
    faults: tuple[Fault, ...]

    @property
    def busy_until_s(self) -> float:
        """Until when it answers no read [s]."""

    def write(self, data: bytes) -> None:
        """Take ``data``; raises NotAcknowledged where it does not answer."""

    def read(self, count: int) -> bytes:
        """Return ``count`` bytes; raises NotAcknowledged where it does not answer."""


class EmulatedBus:
    """A Bus (see `msp_range.bus.base.Bus`) with emulated devices on it.

    Parameters
    ----------
    devices
        Everything on the bus, in any order; an address may occur more than once.
    now
        The time [s], the same clock as the devices'. Used for faults of the kind "locked_up" only.
    nack_errno
        What the adapter's driver reports where nobody acknowledges: 121 on a Raspberry Pi, 6 or 19 on others.
    reports_busy
        Whether `busy_s` is reported, as far as no device has faults: in virtual time the attempts to read a busy
        sensor are all that happens then.

    Notes
    -----
    Devices that share an address all receive a write, which fails only where none acknowledges it. A read gives the AND
    of their bytes: a line is high only where nobody pulls it low.

    A transfer that fails raises BusError with ``nack_errno`` or, where the bus is locked up, 110.
    """

    def __init__(
        self,
        devices: Sequence[Device],
        now: Callable[[], float],
        nack_errno: int = errno.EREMOTEIO,
        reports_busy: bool = False,
    ) -> None:
        self._devices = tuple(devices)
        self._now = now
        self._nack_errno = nack_errno
        self._lock_ups = [fault for device in devices for fault in device.faults if fault.kind == "locked_up"]
        self._reports_busy = reports_busy and not any(device.faults for device in devices)
        self._closed = False

    def write(self, address: Address, data: bytes) -> None:
        """Send ``data`` to every device at ``address``."""
        self._check_lines("write", address)
        acknowledged = False
        for device in self._at(address):
            try:
                device.write(data)
            except NotAcknowledged:
                continue
            acknowledged = True
        if not acknowledged:
            raise BusError(errno.ENOENT if isinstance(address, str) else self._nack_errno, "write", address)

    def read(self, address: Address, count: int) -> bytes:
        """Return the AND of what the devices at ``address`` send."""
        if self._closed or self._lock_ups:
            self._check_lines("read", address)
        answer: bytes | None = None
        for device in self._at(address):
            try:
                sent = device.read(count)
            except NotAcknowledged:
                continue
            answer = sent if answer is None else bytes(a & b for a, b in zip(answer, sent, strict=True))
        if answer is None:
            raise BusError(errno.EAGAIN if isinstance(address, str) else self._nack_errno, "read", address)
        return answer

    def busy_s(self, address: Address) -> float:
        """For how long no device at ``address`` will answer a read [s]; 0: not reported."""
        if not self._reports_busy:
            return 0.0
        until_s = min([device.busy_until_s for device in self._at(address)], default=-math.inf)
        return max(until_s - self._now() - ROUNDING_S, 0.0)

    def reopen(self) -> None:
        """Open the bus again; a line that is no longer held is then free."""
        now_s = self._now()
        self._lock_ups = [fault for fault in self._lock_ups if now_s < fault.end_s]
        self._closed = False

    def close(self) -> None:
        """Release the bus; the next transfer opens it again."""
        self._closed = True

    def _at(self, address: Address) -> list[Device]:
        return [device for device in self._devices if address in (device.address, device.also_at)]

    def _check_lines(self, verb: str, address: Address) -> None:
        if self._closed:
            self.reopen()
        if self._lock_ups:
            now_s = self._now()
            if any(now_s >= fault.start_s for fault in self._lock_ups):
                raise BusError(errno.ETIMEDOUT, verb, address)
