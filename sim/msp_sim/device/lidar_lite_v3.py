"""One Garmin LIDAR-Lite v3 seen from the bus, with faults.

Registers, busy flag and address change follow the maker's manual (see `msp_range.sensors.lidar_lite_v3` for it); what a
sensor without a signal has in its distance registers is a guess. Only the standard library is used. Every time is
seconds on the ``now`` clock that the device is given.
"""

from msp_sim.device.device import FAULT_KINDS, DeviceTiming, RangeFinder

DEFAULT_ADDRESS = 0x62
COMMAND, STATUS, DISTANCE, SERIAL = 0x00, 0x01, 0x0F, 0x16
UNLOCK_HIGH, UNLOCK_LOW, SECOND_ADDRESS, ADDRESS_MODE = 0x18, 0x19, 0x1A, 0x1E
AUTO_INCREMENT = 0x80
RESET, MEASURE, MEASURE_UNCORRECTED = 0x00, 0x04, 0x03
DISABLE_DEFAULT = 0x08
BUSY, NO_PEAK, HEALTHY = 0x01, 0x08, 0x20
NO_SIGNAL_CM = 1
"""What the distance registers hold where there was no signal: seen by users of the part, not in its manual."""
MINIMUM_CM, NO_ECHO_CM = 5, 4000
TIMING = DeviceTiming(ready_s=0.020, s_per_cm=0.0, no_echo_s=0.020)
"""The maker's default of 50 measurements a second, and light is there at once."""


class EmulatedLidarLiteV3(RangeFinder):
    """One sensor on the bus; parameters, attributes and errors are those of `RangeFinder`.

    ``serial`` is its serial number, which an address change needs; ``also_at`` its second address, if it has one.

    Examples
    --------
    >>> time_s = 0.0
    >>> lidar = EmulatedLidarLiteV3(0x62, lambda: time_s, lambda ping_time_s: 258)
    >>> lidar.write(bytes([COMMAND, MEASURE]))
    >>> lidar.write(bytes([STATUS]))
    >>> lidar.read(1).hex()
    '21'
    >>> time_s = 0.1
    >>> lidar.write(bytes([AUTO_INCREMENT | DISTANCE]))
    >>> lidar.read(2).hex()
    '0102'
    """

    minimum_cm = MINIMUM_CM
    no_echo_cm = NO_ECHO_CM
    default_timing = TIMING
    # It does not stretch the clock, so that is not read too early; and eight bits are nobody's type for 40 m.
    fault_kinds = frozenset(FAULT_KINDS) - {"clock_fault", "saturated"}
    serial = 0x3080
    _powered = False

    def power_cycle(self) -> None:
        """Forget everything, a changed address too."""
        super().power_cycle()
        self._answer = b"\x00\x00"
        self._register = 0
        self._unlock = [0, 0]
        # What it is made with may be an address that it was given before.
        if self._powered:
            self.address = DEFAULT_ADDRESS
        self._powered = True
        self.also_at = None

    def write(self, data: bytes) -> None:
        """Take the number of a register, and its value if there is one; raises NotAcknowledged where it is silent."""
        now_s = self._with_power()
        if not data:
            return
        self._register = data[0]
        if len(data) == 2:
            self._set(data[0], data[1], now_s)

    def read(self, count: int) -> bytes:
        """Return ``count`` registers from the one that was named last; raises NotAcknowledged as `write` does.

        Registers that are not emulated read 0, as undefined ones of parts made since August 2018 do.
        """
        now_s = self._with_power()
        if self._register & ~AUTO_INCREMENT == DISTANCE:
            registers = self._read_answer(now_s)
            if registers == NO_ECHO_CM.to_bytes(2, "big"):
                registers = NO_SIGNAL_CM.to_bytes(2, "big")
        elif self._register & ~AUTO_INCREMENT == SERIAL:
            registers = self.serial.to_bytes(2, "big")
        elif self._register == STATUS:
            registers = bytes([self._status(now_s)])
        else:
            registers = b""
        if not self._register & AUTO_INCREMENT:
            registers = registers[:1] * count
        return registers.ljust(count, b"\x00")[:count]

    def _status(self, now_s: float) -> int:
        no_peak = NO_PEAK if self._answer == NO_ECHO_CM.to_bytes(2, "big") else 0
        return HEALTHY | no_peak | (BUSY if now_s < self._busy_until_s else 0)

    def _set(self, register: int, value: int, now_s: float) -> None:
        if register == COMMAND and value in (MEASURE, MEASURE_UNCORRECTED) and now_s >= self._busy_until_s:
            self._ping(now_s)
        elif register == COMMAND and value == RESET:
            self.power_cycle()
        elif register in (UNLOCK_HIGH, UNLOCK_LOW):
            self._unlock[register - UNLOCK_HIGH] = value
        elif register == SECOND_ADDRESS and bytes(self._unlock) == self.serial.to_bytes(2, "big") and not value & 1:
            # Where the default address is disabled, the new one takes the place of the one before.
            if self.address == DEFAULT_ADDRESS:
                self.also_at = value
            else:
                self.address = value
        elif register == ADDRESS_MODE and value == DISABLE_DEFAULT and self.also_at is not None:
            self.address, self.also_at = self.also_at, None
