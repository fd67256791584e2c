"""MaxBotix MaxSonars that send lines on a serial port by themselves, with faults.

Lines and families as in `msp_range.sensors.maxsonar`, which names the sources. When in its cycle a sensor pings is from
its timing; that a line takes up the cycle's end is an assumption. Only the standard library is used.
"""

from collections import deque

from msp_sim.device.device import FAULT_KINDS, SERIAL_FAULT_KINDS, DeviceTiming, NotAcknowledged, RangeFinder

BYTE_S = 10 / 9600
"""Time of a byte on the wire [s]: start bit, eight data bits and stop bit at 9600 baud."""
NOISE = bytes([0x00, 0xFF, 0x5B, 0x9E])
"""Bytes of the kind "noise": none that a sensor sends."""


class Unplugged(NotAcknowledged):
    """The port is not there."""


class EmulatedMaxSonar(RangeFinder):
    """One sensor on its port; parameters and errors are those of `RangeFinder`, with the port as the address.

    Examples
    --------
    >>> time_s = 0.0
    >>> sonar = EmulatedMaxSonarCm("serial:/dev/ttyUSB0:9600", lambda: time_s, lambda ping_s: 258)
    >>> time_s = 0.099
    >>> sonar.read(64)
    b'R258\\r'
    """

    digits: int
    fault_kinds = (
        frozenset(FAULT_KINDS)
        - {"clock_fault", "or_ed", "saturated", "lost_high_byte", "impossible", "missed_read", "locked_up"}
    ) | SERIAL_FAULT_KINDS.keys()

    def power_cycle(self) -> None:
        """Begin a cycle."""
        super().power_cycle()
        self._on_wire: deque[tuple[float, int]] = deque()
        self._line_s = self._now() + self._timing.no_echo_s

    @property
    def busy_until_s(self) -> float:
        """It can always be read."""
        return float("-inf")

    def write(self, data: bytes) -> None:
        """Drop what has arrived; raises Unplugged."""
        now_s = self._advance()
        while self._on_wire and self._on_wire[0][0] <= now_s:
            self._on_wire.popleft()

    def read(self, count: int) -> bytes:
        """Bytes that have arrived; raises NotAcknowledged where there are none, Unplugged without the port."""
        now_s = self._advance()
        arrived = bytearray()
        while self._on_wire and self._on_wire[0][0] <= now_s and len(arrived) < count:
            arrived.append(self._on_wire.popleft()[1])
        if not arrived:
            raise NotAcknowledged
        return bytes(arrived)

    def _advance(self) -> float:
        """Put the lines that have begun by now on the wire; returns the time [s]."""
        now_s = self._now()
        if self.faults and self._strikes("unplugged", now_s):
            self._on_wire.clear()
            raise Unplugged
        try:
            self._with_power()
            sends = True
        except NotAcknowledged:
            sends = False
        while now_s >= self._line_s - (self.digits + 2) * BYTE_S:
            if sends:
                self._ping(self._line_s - self._timing.ready_s - self._timing.s_per_cm * self.no_echo_cm)
                line = self._line(int.from_bytes(self._answer, "big"), now_s)
                start_s = self._line_s - len(line) * BYTE_S
                self._on_wire += [(start_s + (i + 1) * BYTE_S, byte) for i, byte in enumerate(line)]
            self._line_s += self._timing.no_echo_s
        return now_s

    def _line(self, word: int, now_s: float) -> bytes:
        number = min(word, 10**self.digits - 1)
        line = f"R{number:0{self.digits}d}\r".encode()
        if not self.faults:
            return line
        if self._strikes("garbled_digit", now_s):
            # One bit of the first digit.
            line = line[:1] + bytes([line[1] ^ 0x01]) + line[2:]
        if self._strikes("half_line", now_s):
            line = line[: len(line) // 2]
        if self._strikes("noise", now_s):
            line = line[:2] + NOISE + line[2:]
        if self._strikes("wrong_baud", now_s):
            line = bytes(0xF8 | byte >> 5 for byte in line)
        return line


class EmulatedMaxSonarCm(EmulatedMaxSonar):
    """An XL-MaxSonar for 7.65 m."""

    digits, per_cm, minimum_cm, no_echo_cm = 3, 1, 20, 765
    default_timing = DeviceTiming(ready_s=0.034, s_per_cm=58e-6, no_echo_s=0.099)


class EmulatedMaxSonarMm(EmulatedMaxSonar):
    """An HRLV- or HRXL-MaxSonar for 5 m."""

    digits, per_cm, minimum_cm, no_echo_cm = 4, 10, 30, 500
    default_timing = DeviceTiming(ready_s=0.102, s_per_cm=58e-6, no_echo_s=0.133)


class EmulatedMaxSonarMm10m(EmulatedMaxSonar):
    """An HRXL-MaxSonar for 10 m."""

    digits, per_cm, minimum_cm, no_echo_cm = 4, 10, 50, 1000
    default_timing = DeviceTiming(ready_s=0.106, s_per_cm=58e-6, no_echo_s=0.166)
