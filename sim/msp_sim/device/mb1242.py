"""One MB1242 (I2CXL-MaxSonar-EZ4) seen from the bus.

Commands, busy time and address change follow the datasheet; where it is silent the choice is a parameter or is said to
be a guess. Only the standard library is used.
"""

from msp_sim.device.device import DeviceTiming, NotAcknowledged, RangeFinder

DEFAULT_ADDRESS = 0x70
"""7-bit address from the factory; 0xE0 in the 8-bit form of the datasheet."""
RANGE_COMMAND = b"\x51"
ADDRESS_COMMAND = b"\xaa\xa5"
ILLEGAL_ADDRESSES_8BIT = frozenset({0, 80, 164, 170})
"""New addresses, in 8-bit form, that the sensor ignores."""
MINIMUM_CM, NO_ECHO_CM = 20, 765
SATURATED_CM = 255
"""No echo sometimes arrives as this distance [cm]. With the error of a faulty ranging on top, the same error of two
sensors would give them a common distance where neither has an echo."""
PART_INFO = b"\x01\x2c"
"""What is read before the first ranging. The real bytes are not documented: these look like 300 cm."""
TIMING = DeviceTiming(ready_s=0.020, s_per_cm=58e-6, no_echo_s=0.067, address_change_s=0.125)
"""58 us/cm is the way there and back at 22.5 deg C; the part's full cycle is about 67 ms, and the address change is
from the datasheet. ``ready_s`` is an assumption."""


class EmulatedMB1242(RangeFinder):
    """One sensor on the bus; parameters, attributes and errors are those of `RangeFinder`.

    Examples
    --------
    >>> time_s = 0.0
    >>> sonar = EmulatedMB1242(0x70, lambda: time_s, lambda ping_time_s: 258)
    >>> sonar.write(RANGE_COMMAND)
    >>> sonar.read(2)
    Traceback (most recent call last):
        ...
    msp_sim.device.device.NotAcknowledged
    >>> time_s = 0.1
    >>> sonar.read(2).hex()
    '0102'
    """

    minimum_cm = MINIMUM_CM
    no_echo_cm = NO_ECHO_CM
    no_echo_codes = frozenset({SATURATED_CM})
    default_timing = TIMING

    def power_cycle(self) -> None:
        """Lose the last ranging and whatever was going on; the address stays."""
        super().power_cycle()
        self._answer = PART_INFO

    def write(self, data: bytes) -> None:
        """Take ``data`` from the master.

        One range command pings, an address command changes the address, anything else is acknowledged and ignored.

        Raises
        ------
        NotAcknowledged
            It ranges, changes its address, or a fault keeps it silent.
        """
        now_s = self._acknowledge()
        if data == RANGE_COMMAND:
            self._ping(now_s)
        elif len(data) == 3 and data.startswith(ADDRESS_COMMAND):
            self._change_address(data[2], now_s)

    def read(self, count: int) -> bytes:
        """Return ``count`` bytes: the last ranging, most significant byte first, or part info before the first one.

        Bytes beyond the second are those of a released line, 0xFF: a guess. Raises NotAcknowledged as `write` does.
        """
        answer = self._read_answer(self._acknowledge())
        return answer if count == 2 else answer.ljust(count, b"\xff")[:count]

    def _acknowledge(self) -> float:
        """Return the time [s] of a transfer that the sensor takes part in."""
        now_s = self._with_power()
        if now_s < self._busy_until_s:
            raise NotAcknowledged
        return now_s

    def _change_address(self, new_8bit: int, now_s: float) -> None:
        new_8bit &= ~1
        if new_8bit not in ILLEGAL_ADDRESSES_8BIT:
            self.address = new_8bit >> 1
            self._busy_until_s = now_s + self._timing.address_change_s
