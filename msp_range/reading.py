"""The one value that travels from the sensor to the message.

A driver makes it, every stage returns a new one. A measurement that cannot be used is a reading with a status and
no range; broken equipment at the start of a program raises instead. Zero metres never means 'unknown'.
"""

from dataclasses import dataclass
from enum import Enum


class Status(Enum):
    """What a sensor's answer means.

    Only ``OK`` and ``AT_MINIMUM`` carry a range. ``AT_MINIMUM`` is the sensor's shortest report: the surface is
    there or nearer. ``NO_ECHO`` is a healthy sensor that heard nothing. The rest are faults; ``STUCK``
    and ``GARBLED`` (bytes lost or mixed up on the bus) are found by comparison with the ground that is known and not in
    the answer.
    """

    OK = "ok"
    AT_MINIMUM = "at_minimum"
    NO_ECHO = "no_echo"
    CLOCK_FAULT = "clock_fault"
    IMPOSSIBLE = "impossible"
    PART_INFO = "part_info"
    NO_ANSWER = "no_answer"
    STUCK = "stuck"
    GARBLED = "garbled"

    has_range: bool
    """True where a reading of this status carries a range."""
    is_fault: bool
    """True where the sensor or its wiring, and not the scene, is to blame."""

    # Set once for each member: they are asked several times a reading.
    def __init__(self, word: str) -> None:
        self.has_range = word in ("ok", "at_minimum")
        self.is_fault = word not in ("ok", "at_minimum", "no_echo")


@dataclass(frozen=True, slots=True)
class Reading:
    """One ranging of one sensor.

    Attributes
    ----------
    time_s
        Time of the echo on the bridge's clock [s]: ping plus half the time of flight; time of the ping where there
        was no echo.
    sensor
        Name of the sensor in the airframe file.
    status
        What the answer means.
    range_m
        Distance along the beam [m]; None unless ``status.has_range``.
    std_m
        Standard deviation of ``range_m`` [m]; None where unknown.
    raw
        The sensor's 16-bit answer as it came; None where there was no answer.
    suspect
        True where the answer is a legal range that is also a known fault code of this kind of sensor.
    """

    time_s: float
    sensor: str
    status: Status
    range_m: float | None = None
    std_m: float | None = None
    raw: int | None = None
    suspect: bool = False

    def __post_init__(self) -> None:
        if (self.range_m is not None) != self.status.has_range:
            raise ValueError(
                f"status {self.status.value!r} with range {self.range_m!r}: ok and at_minimum have a range, others none"
            )
