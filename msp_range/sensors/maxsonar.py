"""MaxBotix MaxSonar on a serial port: the XL family in centimetres, the HRLV and HRXL families in millimetres.

Sources: MaxBotix' data sheets of the series XL-MaxSonar-EZ/AE, HRLV-MaxSonar-EZ and HRXL-MaxSonar-WR (PD11500), and its
article 'Using the MaxSonar TX Output'. ArduPilot's AP_RangeFinder_MaxsonarSerialLV reads lines of this form, too, as
inches: it keeps their digits and drops all else. Not tried on a real sensor.

9600 baud, 8N1. The sensor measures by itself while its pin 4 is open or high, and sends an ASCII 'R', the range in a
fixed number of digits and a carriage return, without a checksum. One number says that there was no target. A digit that
is changed on the way is a range like any other; every other damage is no such line.
"""

import errno
import re
from typing import ClassVar

from msp_range.bus import Address, Bus, BusError
from msp_range.reading import Decoded, Status
from msp_range.sensors.base import SerialDriver

GARBLED = 0xFFFF
"""In the recorded answer: what arrived was no line of such a sensor."""
MOST_BYTES = 64
"""Bytes that one read takes: more than a sensor sends between two of them."""


class MaxSonar(SerialDriver):
    """One MaxSonar on a serial port; a family says how its lines are written."""

    digits: ClassVar[int]
    """Digits of the range."""
    minimum_cm: ClassVar[int]
    """Shortest report [cm]: nearer objects give it too."""
    no_echo_cm: ClassVar[int]
    """What no target is recorded as [cm]."""

    def __init__(self, bus: Bus, address: Address) -> None:
        super().__init__(bus, address)
        self._arrived = b""

    def ping(self) -> None:
        """Drop what has arrived."""
        self._arrived = b""
        super().ping()

    def answer(self) -> Decoded:
        """The newest line that arrived since the ping; raises BusError (EAGAIN) while there is none."""
        self._arrived += self._bus.read(self.address, MOST_BYTES)
        *lines, rest = self._arrived.split(b"\r")
        # The end of a line that was on its way at the ping.
        if lines and re.fullmatch(rb"\d*", lines[0]):
            del lines[0]
        if not lines and len(rest) <= 2 * self.digits:
            self._arrived = rest
            raise BusError(errno.EAGAIN, "read", self.address)
        self._arrived = b""
        return self.decode(self.word(lines[-1] if lines else rest))

    @classmethod
    def word(cls, line: bytes) -> float:
        """A line without its carriage return as the one number that is recorded and decoded [cm].

        Examples
        --------
        >>> MaxSonarMm.word(b"R1234"), MaxSonarMm.word(b"R5000"), MaxSonarCm.word(b"R1234") == GARBLED
        (123.4, 500, True)
        """
        if not re.fullmatch(rb"R\d{%d}" % cls.digits, line):
            return GARBLED
        if line + b"\r" == cls.line(cls.no_echo_cm):
            return cls.no_echo_cm
        whole, rest = divmod(int(line[1:]), cls.per_cm)
        return whole + rest / cls.per_cm if rest else whole

    @classmethod
    def decode(cls, word: float) -> Decoded:
        """What a recorded word means.

        Examples
        --------
        >>> MaxSonarCm.decode(258).range_m, MaxSonarCm.decode(765).status.value, MaxSonarCm.decode(19).status.value
        (2.58, 'no_echo', 'impossible')
        """
        if word == cls.no_echo_cm:
            return Decoded(Status.NO_ECHO, None, word)
        if not cls.minimum_cm <= word < cls.no_echo_cm:
            return Decoded(Status.IMPOSSIBLE, None, word)
        return Decoded(Status.AT_MINIMUM if word == cls.minimum_cm else Status.OK, word / 100, word)

    @classmethod
    def line(cls, word: float) -> bytes:
        """The line of a recorded word; that of `GARBLED` is none."""
        number = min(round(word * cls.per_cm), 10**cls.digits - 1)
        return b"?\r" if word == GARBLED else f"R{number:0{cls.digits}d}\r".encode()

    @classmethod
    def playback(cls) -> "_Playback":
        """It sends the line when the measurement has ended."""
        return _Playback(cls)


class _Playback:
    """The line of each recorded word, once."""

    first_raw = GARBLED

    def __init__(self, family: type[MaxSonar]) -> None:
        self._family = family

    def starts(self, data: bytes, ranging: bool) -> bool | None:
        return not ranging

    def answer(self, count: int, raw: float, ranging: bool) -> bytes | None:
        return None if ranging else self._family.line(raw)


class MaxSonarCm(MaxSonar):
    """XL-MaxSonar-EZ, -AE and -WR for 7.65 m (MB1200-MB1240, MB7060): 'R258', and 'R765' without a target."""

    part = "an XL-MaxSonar"
    digits, per_cm, minimum_cm, no_echo_cm = 3, 1, 20, 765


class MaxSonarMm(MaxSonar):
    """HRLV-MaxSonar-EZ and HRXL-MaxSonar-WR for 5 m (MB1043, MB7360): 'R2580', and 'R5000' without a target."""

    part = "an HR-MaxSonar for 5 m"
    digits, per_cm, minimum_cm, no_echo_cm = 4, 10, 30, 500


class MaxSonarMm10m(MaxSonar):
    """HRXL-MaxSonar-WR for 10 m (MB7363, MB7366): 'R2580', and 'R9999' without a target."""

    part = "an HR-MaxSonar for 10 m"
    digits, per_cm, minimum_cm, no_echo_cm = 4, 10, 50, 1000
