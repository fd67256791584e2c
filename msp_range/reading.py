"""A reading: the value that is passed from the sensor to the message.

A driver creates it, and every stage returns a new one. An unusable measurement is a reading with a status and
without a range; broken equipment at the start of a program raises instead. Zero metres never means 'unknown'.
"""

from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple


class Status(Enum):
    """Status of a sensor's answer.

    Only ``OK`` and ``AT_MINIMUM`` carry a range. ``AT_MINIMUM`` is the sensor's shortest report: the surface is
    there or nearer. ``NO_ECHO``: the sensor works but received no echo. The others are faults; ``STUCK``,
    ``FIXED`` (it sees something that moves with the vehicle) and ``GARBLED`` (bytes lost or mixed up on the bus) are
    detected by comparison with the known ground or the vehicle's motion, not from the answer itself.
    """

    OK = "ok"
    AT_MINIMUM = "at_minimum"
    NO_ECHO = "no_echo"
    CLOCK_FAULT = "clock_fault"
    IMPOSSIBLE = "impossible"
    PART_INFO = "part_info"
    NO_ANSWER = "no_answer"
    STUCK = "stuck"
    FIXED = "fixed"
    GARBLED = "garbled"

    has_range: bool
    """True if a reading of this status has a range."""
    is_fault: bool
    """True for faults of the sensor or its wiring."""

    # Set once for each member, because they are used several times per reading.
    def __init__(self, word: str) -> None:
        self.has_range = word in ("ok", "at_minimum")
        self.is_fault = word not in ("ok", "at_minimum", "no_echo")


class Decoded(NamedTuple):
    """A decoded answer."""

    status: Status
    """Status of the reading."""
    range_m: float | None
    """Distance [m] as the sensor reports it, uncorrected; None unless ``status.has_range``."""
    raw: float | None
    """The answer as a number [cm]; None if there was none."""
    suspect: bool = False
    """The value is a valid range, but also a known fault code."""
    earliest_s: float = 0.0
    """Shortest time from a ping to this answer [s]; one that comes sooner is not the answer to that ping."""

    def arrived_after(self, since_ping_s: float) -> "Decoded":
        """The answer, if it can have come within this time after its ping [s]; otherwise an impossible one.

        The time is the longest possible, from before the ping's write until after the answer was read: on a busy
        computer a transfer returns long after it was on the bus, and a program stands still between two of them.
        """
        return self if since_ping_s >= self.earliest_s else Decoded(Status.IMPOSSIBLE, None, self.raw)


@dataclass(frozen=True, slots=True)
class Reading:
    """One measurement of one sensor."""

    time_s: float
    """Time of the echo on the bridge's clock [s]: ping plus half the time of flight; time of the ping if there was no
    echo."""
    sensor: str
    """Name of the sensor in the airframe file."""
    status: Status
    """Status of the answer."""
    range_m: float | None = None
    """Distance along the beam [m]; None unless ``status.has_range``."""
    std_m: float | None = None
    """Standard deviation of ``range_m`` [m]; None if unknown."""
    raw: float | None = None
    """The sensor's own answer [cm], in its steps; None without an answer."""
    suspect: bool = False
    """True if the answer is a valid range and also a known fault code of this kind of sensor."""

    @property
    def variance_m2(self) -> float:
        """Variance of the error of ``range_m`` [m^2]; infinite if unknown."""
        return float("inf") if self.std_m is None else self.std_m * self.std_m

    def __post_init__(self) -> None:
        if (self.range_m is not None) != self.status.has_range:
            raise ValueError(
                f"status {self.status.value!r} with range {self.range_m!r}: expected a range for ok and at_minimum only"
            )
