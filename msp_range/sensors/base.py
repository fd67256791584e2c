"""What the polling needs to know of a range finder."""

from typing import NamedTuple, Protocol

from msp_range.reading import Status


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
