"""A driver: an invented sonar that answers in millimetres, two bytes, 0xFFFF without an echo."""

from msp_range.bus import Bus, BusError
from msp_range.clock import Clock
from msp_range.reading import Decoded, Status
from msp_range.sensors.base import Driver, FoundDevice, stranger

RANGE_COMMAND = b"\x01"
ADDRESS_COMMAND = 0x02
NO_ECHO_MM, MAXIMUM_CM = 0xFFFF, 600
RANGING_S = 0.05


def decode(range_cm: int) -> Decoded:
    """What an answer says, in the centimetres that recordings and the laboratory have; the maximum is no echo."""
    if range_cm == MAXIMUM_CM:
        return Decoded(Status.NO_ECHO, None, range_cm)
    status = Status.OK if 3 <= range_cm < MAXIMUM_CM else Status.IMPOSSIBLE
    return Decoded(status, range_cm / 100 if status is Status.OK else None, range_cm)


class Acme(Driver):
    """One sonar on a bus; it does not acknowledge while it ranges."""

    part = "an Acme sonar"
    default_address = 0x30
    keeps_address = True
    busy_s = RANGING_S

    def ping(self) -> None:
        """Start a ranging."""
        self._bus.write(self.address, RANGE_COMMAND)

    def answer(self) -> Decoded:
        """Read the result; raises BusError while the sensor ranges."""
        range_mm = int.from_bytes(self._bus.read(self.address, 2), "big")
        return decode(MAXIMUM_CM if range_mm == NO_ECHO_MM else round(range_mm / 10))

    @classmethod
    def identify(cls, bus: Bus, clock: Clock, address: int) -> FoundDevice:
        """Let it range once."""
        sensor = cls(bus, address)
        try:
            sensor.ping()
            clock.sleep_until(clock.now() + 2 * RANGING_S)
            decoded = sensor.answer()
        except BusError as error:
            return stranger(address, f"no answer to the range command (errno {error.errno})")
        return FoundDevice(address, not decoded.status.is_fault, f"answers {decoded.raw} cm")

    @classmethod
    def move(cls, bus: Bus, clock: Clock, old: int, new: int) -> None:
        """Give it another address, at once."""
        bus.write(old, bytes([ADDRESS_COMMAND, new]))

    @classmethod
    def playback(cls) -> "_Playback":
        """It does not acknowledge while it ranges."""
        return _Playback()


class _Playback:
    """Two bytes of the recorded answer, in millimetres again."""

    first_raw = MAXIMUM_CM

    def starts(self, data: bytes, ranging: bool) -> bool | None:
        return None if ranging else data == RANGE_COMMAND

    def answer(self, count: int, raw: int, ranging: bool) -> bytes | None:
        range_mm = NO_ECHO_MM if raw == MAXIMUM_CM else 10 * raw
        return None if ranging else range_mm.to_bytes(2, "big").ljust(count, b"\xff")[:count]
