"""Garmin LIDAR-Lite v3: a laser range finder for 40 m, asked through registers.

Sources: the maker's 'LIDAR-Lite v3 Operation Manual and Technical Specifications' (its procedures and register bits as
quoted in public code: the measuring procedure in garmin/LIDARLite_Arduino_Library src/LIDARLite.cpp, which also has the
address change, as has garmin/LIDARLite_RaspberryPi_Library src/lidarlite_v3.cpp; the status bits in dotnet/iot
LidarLiteV3 and chisl.io's LIDAR-Lite-v3.hpp); Garmin's support note 'LIDAR-Lite v3 Sensor I2C Guidelines' (a register
and its value in one write); Linux' drivers/iio/proximity/pulsedlight-lidar-lite-v2.c (a stop condition between the
register's number and the read of it, so two plain transfers; status bit 3: out of range); PX4's ll40ls/LidarLiteI2C.cpp
(bit 15 of a distance is invalid, 0 is a known bad state, less than 5 cm is impossible). Not tried on a real sensor.

Write 0x04 to register 0x00 to measure with receiver bias correction, read register 0x01 until bit 0 is low, read two
bytes from 0x0F with 0x80 for auto-increment: centimetres, most significant byte first. It acknowledges all the time.
"""

import errno

from msp_range.bus import Address, Bus, BusError
from msp_range.clock import Clock
from msp_range.reading import Decoded, Status
from msp_range.sensors.base import (
    POLL_INTERVAL_S,
    AddressError,
    Driver,
    FoundDevice,
    acknowledges,
    stranger,
)

COMMAND_MEASURE = b"\x00\x04"
"""Register 0x00: measure, with receiver bias correction."""
STATUS = 0x01
DISTANCE = 0x8F
"""Registers 0x0F and 0x10, by auto-increment."""
SERIAL = 0x96
"""Registers 0x16 and 0x17, by auto-increment."""
UNLOCK_HIGH, UNLOCK_LOW, SECOND_ADDRESS, ADDRESS_MODE = 0x18, 0x19, 0x1A, 0x1E
DISABLE_DEFAULT = 0x08

BUSY, NO_PEAK, HEALTHY, PROCESS_ERROR = 0x01, 0x08, 0x20, 0x40
"""Bits of the status: busy; no peak in the correlation record, the measurement is invalid; reference and receiver bias
are operational; a system error during the measurement."""

MINIMUM_CM = 5
"""Nearer is impossible, as in PX4's driver."""
NO_ECHO_CM = 4000
"""The maker's range, on a target that reflects 70 %. From here on there is nothing within range."""
FAULT_BIT = 0x8000
"""In the recorded answer: the status register reported an error; PX4 takes an answer with this bit as invalid."""

LONGEST_S = 0.1
"""A measurement is over by then [s]: twice the 20 ms of the default 50 a second, and what PX4 allows it."""
SETTLE_S = 0.001
"""After a write to a register [s], as in the maker's library."""


def recorded_word(status: int, answer: bytes) -> int:
    """Status and distance registers as the one 16-bit number that is recorded and decoded.

    Parameters
    ----------
    status
        Register 0x01.
    answer
        Registers 0x0F and 0x10.

    Returns
    -------
    int
        The distance [cm]; `NO_ECHO_CM` where there was no signal; with `FAULT_BIT` where the sensor reports an error.

    Examples
    --------
    >>> recorded_word(0x20, b"\\x01\\x02"), recorded_word(0x28, b"\\x00\\x01"), hex(recorded_word(0x60, b"\\x01\\x02"))
    (258, 4000, '0x8102')
    """
    word = int.from_bytes(answer, "big")
    if status & PROCESS_ERROR or not status & HEALTHY:
        return word | FAULT_BIT
    return NO_ECHO_CM if status & NO_PEAK else word


def decode(word: int) -> Decoded:
    """What a recorded word means.

    Examples
    --------
    >>> decode(258).range_m, decode(4000).status.value, decode(0).status.value, decode(0x8102).status.value
    (2.58, 'no_echo', 'impossible', 'impossible')
    """
    if word & FAULT_BIT or word < MINIMUM_CM:
        return Decoded(Status.IMPOSSIBLE, None, word)
    if word >= NO_ECHO_CM:
        return Decoded(Status.NO_ECHO, None, word)
    return Decoded(Status.OK, word / 100, word)


class _Playback:
    """Registers with the status and the distance of a recorded word; it acknowledges all the time."""

    first_raw = 0

    def __init__(self) -> None:
        self._register = 0

    def starts(self, data: bytes, ranging: bool) -> bool | None:
        self._register = data[0] if data else self._register
        return data == COMMAND_MEASURE and not ranging

    def answer(self, count: int, raw: int, ranging: bool) -> bytes | None:
        if self._register == STATUS:
            flags = BUSY if ranging else 0
            flags |= PROCESS_ERROR if raw & FAULT_BIT else HEALTHY
            return bytes([flags]).ljust(count, b"\x00")[:count]
        return raw.to_bytes(2, "big")[:count] if self._register == DISTANCE else bytes(count)


class LidarLiteV3(Driver):
    """One LIDAR-Lite v3 on a bus."""

    part = "a LIDAR-Lite v3"
    default_address = 0x62
    keeps_address = False
    playback = _Playback
    busy_s = 0.0

    def ping(self) -> None:
        """Start a measurement."""
        self._bus.write(self.address, COMMAND_MEASURE)

    def answer(self) -> Decoded:
        """Read the result of the last measurement; raises BusError (EBUSY) while the sensor is busy."""
        status = _registers(self._bus, self.address, STATUS, 1)[0]
        if status & BUSY:
            raise BusError(errno.EBUSY, "read", self.address)
        return decode(recorded_word(status, _registers(self._bus, self.address, DISTANCE, 2)))

    @classmethod
    def ignores_address(cls, address: int) -> bool:
        """Only even ones are available (the manual)."""
        return address % 2 == 1

    @classmethod
    def identify(cls, bus: Bus, clock: Clock, address: int) -> FoundDevice:
        """Such a sensor is busy right after the command to measure, and then answers what can be a range.

        Other devices take that command as a value for a register of theirs: ask only where such a sensor should be.
        """
        sensor = cls(bus, address)
        try:
            sensor.ping()
            pinged_s = clock.now()
            if not _registers(bus, address, STATUS, 1)[0] & BUSY:
                return stranger(address, "not a LIDAR-Lite v3: it is not busy after the command to measure")
            while True:
                clock.sleep_until(clock.now() + POLL_INTERVAL_S)
                try:
                    decoded = sensor.answer()
                    break
                except BusError as error:
                    if error.errno != errno.EBUSY:
                        raise
                if clock.now() > pinged_s + LONGEST_S:
                    return stranger(address, "not a LIDAR-Lite v3, or out of order: it stays busy")
        except BusError as error:
            return stranger(address, f"no answer to the command to measure (errno {error.errno})")
        if decoded.status.is_fault:
            return FoundDevice(
                address, False, f"measures, but answers 0x{decoded.raw or 0:04x} ({decoded.status.value})"
            )
        found = "no signal" if decoded.range_m is None else f"{decoded.raw} cm"
        return FoundDevice(address, True, f"LIDAR-Lite v3: {found}")

    @classmethod
    def move(cls, bus: Bus, clock: Clock, old: int, new: int) -> None:
        """Unlock with the serial number, give the new address, and disable the default one; lost with the power.

        Of two sensors at one address neither is unlocked: both answer at once, so what is read is no serial number.
        """
        if new == cls.default_address:
            raise AddressError(f"switch its power off and on: {cls.part} then answers at 0x{new:02x} again")
        high, low = _registers(bus, old, SERIAL, 2)
        for register, value in ((UNLOCK_HIGH, high), (UNLOCK_LOW, low), (SECOND_ADDRESS, new)):
            bus.write(old, bytes([register, value]))
            clock.sleep_until(clock.now() + SETTLE_S)
        # At the new address, as in the maker's library: the default one stays where the new one does not work.
        if acknowledges(bus, new):
            bus.write(new, bytes([ADDRESS_MODE, DISABLE_DEFAULT]))
            clock.sleep_until(clock.now() + SETTLE_S)


def _registers(bus: Bus, address: Address, register: int, count: int) -> bytes:
    """Read registers: their number in a transfer of its own, then their values."""
    bus.write(address, bytes([register]))
    return bus.read(address, count)
