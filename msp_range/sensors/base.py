"""What a kind of range finder is to the bridge: a `Driver`, in one file of its own and one line of `sensors.table`.

A driver holds everything that is particular to its kind: how it is pinged and asked, what its answers mean and which of
them a faulty bus makes of others, where it answers on the bus, how its address is changed, and how it behaves while a
record of its answers is played.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, NamedTuple, Protocol

from msp_range.bus import Bus, BusError
from msp_range.clock import Clock
from msp_range.reading import Status

POLL_INTERVAL_S = 0.003
"""Between two tries to read a sensor that still ranges [s]. A distance goes out by half of it later on average and by
all of it at most; 5 ms is the goal for 99 of 100. With less, bus and processor are busier with tries: with 2 ms they
were a sixth of what a flight costs."""
OTHERS = {
    0x62: "also the address of an SCD4x",
    0x70: "also the address of an SHTC3, a PCA9685 (all call) or a TCA9548A",
    0x71: "also an address of a TCA9548A",
    0x76: "also an address of a BME280",
    0x77: "also an address of a BME280",
}
"""Devices that are often on the same bus, by the 7-bit address that they share with range finders, from their data
sheets: a hint for the reader of a scan."""


class AddressError(ValueError):
    """An address change that was refused, or whose outcome is not the one wanted."""


class Decoded(NamedTuple):
    """What an answer says.

    Attributes
    ----------
    status
        What the answer means.
    range_m
        Distance [m] as the sensor reports it, uncorrected; None unless ``status.has_range``.
    raw
        The answer as a number; None where there was none.
    suspect
        The value is legal, but also known as a fault code.
    """

    status: Status
    range_m: float | None
    raw: int | None
    suspect: bool = False


class RangeSensor(Protocol):
    """One range finder on a bus: ping it, and ask for the answer until it gives one."""

    @property
    def address(self) -> int:
        """Its 7-bit address on the bus."""
        ...

    def ping(self) -> None:
        """Start a ranging; raises BusError where the sensor does not acknowledge."""
        ...

    def answer(self, since_ping_s: float) -> Decoded:
        """The ranging's result, ``since_ping_s`` after the ping; raises BusError while there is none."""
        ...


@dataclass(frozen=True, slots=True)
class FoundDevice:
    """A device that acknowledged.

    Attributes
    ----------
    address
        7-bit address.
    ranged
        True where it behaved as its driver's kind of sensor does, and answered what can be a range.
    answer
        What it answered, in words.
    """

    address: int
    ranged: bool
    answer: str


class RecordedPing(NamedTuple):
    """One ping and what came of it.

    Attributes
    ----------
    ping_s
        Time of the ping [s].
    word
        The sensor's 16-bit answer; None where there was none.
    ready_s
        From the ping until the sensor answers again [s]. Zero and no answer: the ping was not acknowledged.
    """

    ping_s: float
    word: int | None
    ready_s: float

    @property
    def acknowledged(self) -> bool:
        """Whether the sensor took the range command."""
        return self.word is not None or self.ready_s > 0


class Playback(Protocol):
    """How one sensor takes part in transfers while a record of it is played; its driver knows.

    Attributes
    ----------
    first_raw
        What it answers before its first ping.
    """

    first_raw: int

    def starts(self, data: bytes, ranging: bool) -> bool | None:
        """Whether ``data``, written while it is ``ranging`` or not, starts a ranging; None: not acknowledged."""
        ...

    def answer(self, count: int, raw: int, ranging: bool) -> bytes | None:
        """``count`` bytes of the answer that was recorded as ``raw``; None: not acknowledged."""
        ...


class Driver(ABC):
    """One kind of range finder; an object of it is one such sensor on a bus, a `RangeSensor`.

    Parameters
    ----------
    bus
        Where it answers.
    address
        Its 7-bit address there.

    Attributes
    ----------
    part
        The part's name with its article, for messages.
    default_address
        7-bit address that it has from the factory.
    keeps_address
        Whether a changed address outlasts its power.
    busy_s
        For how long it may not acknowledge while it ranges [s]; 0 where it always does.
    """

    part: ClassVar[str]
    default_address: ClassVar[int]
    keeps_address: ClassVar[bool]
    busy_s: ClassVar[float]

    def __init__(self, bus: Bus, address: int) -> None:
        self._bus = bus
        self.address = address

    @abstractmethod
    def ping(self) -> None:
        """Start a ranging; raises BusError where the sensor does not acknowledge."""

    @abstractmethod
    def answer(self, since_ping_s: float) -> Decoded:
        """The ranging's result, ``since_ping_s`` after the ping; raises BusError while there is none."""

    @classmethod
    def ignores_address(cls, address: int) -> bool:
        """Whether such a sensor cannot be given this 7-bit address."""
        return False

    @classmethod
    @abstractmethod
    def identify(cls, bus: Bus, clock: Clock, address: int) -> FoundDevice:
        """Let the device at ``address`` range once, and report whether it is such a sensor."""

    @classmethod
    @abstractmethod
    def move(cls, bus: Bus, clock: Clock, old: int, new: int) -> None:
        """Give the sensor at ``old`` the address ``new``; returns when it can be asked there. Checks nothing."""

    @classmethod
    def garbled_from(cls, raw: int) -> tuple[int, ...]:
        """Answers [cm] of which a fault of the bus would make ``raw``; none where the driver knows of no such fault."""
        return ()

    @classmethod
    @abstractmethod
    def recorded_ping(cls, echo_s: float, raw: int | None) -> RecordedPing:
        """The ping of an answer of which only ``raw`` and the time of its echo [s] were recorded."""

    @classmethod
    @abstractmethod
    def playback(cls) -> Playback:
        """How such a sensor takes part in transfers while a record of it is played."""


def acknowledges(bus: Bus, address: int) -> bool:
    """Whether a device acknowledges a read of one byte; raises BusError where the bus itself does not work."""
    try:
        bus.read(address, 1)
    except BusError as error:
        if error.bus_at_fault:
            raise
        return False
    return True


def stranger(address: int, why: str) -> FoundDevice:
    """A device that is another kind of sensor or none, and what else is often at its address."""
    return FoundDevice(address, False, f"{why}; {OTHERS.get(address, '')}".rstrip("; "))
