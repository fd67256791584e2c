"""A driver: an invented sonar that answers in millimetres, two bytes, 0xFFFF without an echo."""

from msp_range.bus import Bus, BusError
from msp_range.clock import Clock
from msp_range.reading import Decoded, Status
from msp_range.sensors.base import Driver, FoundDevice, RecordedPing, stranger

RANGE_COMMAND = b"\x01"
ADDRESS_COMMAND = 0x02
NO_ECHO = 0xFFFF
RANGING_S = 0.05


def decode(word: int) -> Decoded:
    """What an answer says."""
    if word == NO_ECHO:
        return Decoded(Status.NO_ECHO, None, word)
    return Decoded(Status.OK, word / 1000, word) if 30 <= word <= 6000 else Decoded(Status.IMPOSSIBLE, None, word)


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
        return decode(int.from_bytes(self._bus.read(self.address, 2), "big"))

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
        return FoundDevice(address, not decoded.status.is_fault, f"answers {decoded.raw} mm")

    @classmethod
    def move(cls, bus: Bus, clock: Clock, old: int, new: int) -> None:
        """Give it another address, at once."""
        bus.write(old, bytes([ADDRESS_COMMAND, new]))

    @classmethod
    def recorded_ping(cls, echo_s: float, raw: int | None) -> RecordedPing:
        """Sound takes 5.8 us per millimetre there and back; the echo came half of that after the ping."""
        flight_s = 5.8e-6 * (raw if raw is not None and raw != NO_ECHO else 0)
        return RecordedPing(echo_s - flight_s / 2, raw, RANGING_S)

    @classmethod
    def playback(cls) -> "_Playback":
        """It does not acknowledge while it ranges."""
        return _Playback()


class _Playback:
    """Two bytes of the recorded answer."""

    first_raw = NO_ECHO

    def starts(self, data: bytes, ranging: bool) -> bool | None:
        return None if ranging else data == RANGE_COMMAND

    def answer(self, count: int, raw: int, ranging: bool) -> bytes | None:
        return None if ranging else raw.to_bytes(2, "big").ljust(count, b"\xff")[:count]
