"""The interface of a kind of range finder: a `Driver`, in a file of its own and with a line in `sensors.table`.

A driver contains everything specific to its kind: how to ping and read it, what its answers mean, how a faulty bus
changes them, its default address, how its address is changed, and how it behaves in a replay.
"""

from abc import abstractmethod
from typing import Any, ClassVar, NamedTuple, Protocol

from msp_range.bus import Address, Bus, BusError
from msp_range.clock import Clock
from msp_range.errors import UserError
from msp_range.reading import Decoded

POLL_INTERVAL_S = 0.003
"""Time between two attempts to read a sensor that is still measuring [s]. On average it delays a distance by half of it
(goal: 5 ms in 99 of 100). With less, bus and processor are busier: with 2 ms these attempts were a sixth of the cost of
a flight."""
OTHERS = {
    0x62: "also the address of an SCD4x",
    0x70: "also the address of an SHTC3, a PCA9685 (all call) or a TCA9548A",
    0x71: "also an address of a TCA9548A",
    0x76: "also an address of a BME280",
    0x77: "also an address of a BME280",
}
"""Devices that are often on the same bus, by the 7-bit address that they share with range finders, from their data
sheets: a hint in the output of a scan."""


class AddressError(UserError, ValueError):
    """An address change that was refused or did not succeed."""


class RangeSensor(Protocol):
    """One range finder on a bus: ping it, then read until it answers."""

    address: Address
    """Its 7-bit address on the bus, or its serial port."""

    @abstractmethod
    def ping(self) -> None:
        """Start a measurement, or ask for the next one; raises BusError if the sensor does not acknowledge."""

    @abstractmethod
    def answer(self) -> Decoded:
        """The measurement's result; raises BusError while there is none."""


class FoundDevice(NamedTuple):
    """A device that acknowledged."""

    address: int
    """7-bit address."""
    ranged: bool
    """True if it behaved like its driver's kind of sensor and its answer can be a range."""
    answer: str
    """Its answer in words."""


class RecordedPing(NamedTuple):
    """A recorded ping and its answer."""

    ping_s: float
    """Time of the ping [s]."""
    word: float | None
    """The sensor's answer [cm]; None if there was none."""
    ready_s: float
    """Time from the ping until the sensor answers again [s]. Zero without an answer: the ping was not acknowledged."""


class Playback(Protocol):
    """The behaviour of one sensor in a replay of its recorded answers; made by its driver."""

    first_raw: int
    """Its answer before its first ping."""

    def starts(self, data: bytes, ranging: bool) -> bool | None:
        """Whether writing ``data`` starts a measurement, depending on whether one is running; None: not
        acknowledged."""

    def answer(self, count: int, raw: Any, ranging: bool) -> bytes | None:
        """``count`` bytes of the answer that was recorded as ``raw`` [cm], an int from a driver of whole centimetres;
        None: not acknowledged."""


class Driver(RangeSensor):
    """A kind of range finder; an object of the class is one such sensor on a bus, a `RangeSensor`.

    Parameters
    ----------
    bus
        The bus.
    address
        Its 7-bit address, or its serial port.
    """

    is_serial: ClassVar[bool] = False
    """Whether it is on a serial port of its own, see `SerialDriver`."""
    per_cm: ClassVar[int] = 1
    """Steps of its answers in a centimetre."""
    part: ClassVar[str]
    """The part's name with its article, for messages."""
    default_address: ClassVar[int]
    """7-bit address when delivered."""
    keeps_address: ClassVar[bool]
    """Whether a changed address is kept without power."""
    busy_s: ClassVar[float]
    """Time for which it may not acknowledge while it measures [s]; 0 if it always acknowledges."""
    stretches_clock: ClassVar[bool] = False
    """Whether it holds the bus clock low while it is not ready; not every computer waits for that."""

    def __init__(self, bus: Bus, address: Address) -> None:
        self._bus = bus
        self.address = address

    @classmethod
    def ignores_address(cls, address: int) -> bool:
        """Whether such a sensor cannot be given this 7-bit address."""
        return False

    @classmethod
    @abstractmethod
    def identify(cls, bus: Bus, clock: Clock, address: int) -> FoundDevice:
        """Trigger one measurement of the device at ``address``, and report whether it is such a sensor."""

    @classmethod
    @abstractmethod
    def move(cls, bus: Bus, clock: Clock, old: int, new: int) -> None:
        """Give the sensor at ``old`` the address ``new``, and wait until it answers there. Without checks."""

    @classmethod
    def garbled_from(cls, raw: int) -> tuple[int, ...]:
        """Answers [cm] that a bus fault would change into ``raw``; none if the driver knows no such fault."""
        return ()

    @staticmethod
    @abstractmethod
    def playback() -> Playback:
        """The behaviour of such a sensor in a replay; a driver names the class."""


class SerialDriver(Driver):
    """A kind of range finder on a serial port of its own, which measures by itself and sends each range.

    A ping drops what has arrived, so that the answer is what the sensor sends after it, and nothing old is read as new.
    Such a sensor has no address to find or to change.
    """

    is_serial = True
    default_address = 0
    keeps_address = True
    busy_s = 0.0

    def ping(self) -> None:
        """Drop what has arrived."""
        self._bus.write(self.address, b"")

    @classmethod
    def identify(cls, bus: Bus, clock: Clock, address: int) -> FoundDevice:
        """Nothing at an address of the bus is such a sensor."""
        return FoundDevice(address, False, f"not {cls.part}: that is on a serial port")

    @classmethod
    def move(cls, bus: Bus, clock: Clock, old: int, new: int) -> None:
        """Refuse."""
        raise AddressError(f"{cls.part} is on a serial port, and has no address")


def acknowledges(bus: Bus, address: int) -> bool:
    """Whether a device acknowledges a read of one byte; raises BusError if the bus itself does not work."""
    try:
        bus.read(address, 1)
    except BusError as error:
        if error.bus_at_fault:
            raise
        return False
    return True


def stranger(address: int, why: str) -> FoundDevice:
    """A device that is not such a sensor, with other devices that often have this address."""
    return FoundDevice(address, False, f"{why}; {OTHERS.get(address, '')}".rstrip("; "))
