"""MaxBotix MB1242 (I2CXL-MaxSonar-EZ4) and its series, which shares the protocol: other models need only a model file.

Source: the maker's data sheet of the I2CXL-MaxSonar-EZ series. The sensor measures on the one-byte command 0x51, does
not acknowledge while it measures, and answers a plain two-byte read (no register) with whole centimetres, most
significant byte first, 20 to 765. It has no status byte, so a fault can be recognised only by the value and by
the time of the answer. A write of 0xAA 0xA5 and an address in 8-bit form changes its address, which it keeps
without power.
"""

from msp_range.bus import Address, Bus, BusError
from msp_range.clock import Clock
from msp_range.reading import Decoded, Status
from msp_range.sensors.base import POLL_INTERVAL_S, Driver, FoundDevice, acknowledges, stranger

COMMAND_RANGE = b"\x51"
ANSWER_BYTES = 2
MINIMUM_CM = 20
"""Shortest report [cm]: nearer objects give it too."""
NO_ECHO_CM = 765
"""Answer if no echo arrived within the cycle [cm]."""
DOUBTFUL_CM = frozenset({253, 255})
"""765 whose high byte is lost (0xFD), whose two bytes are OR-ed (0x02 | 0xFD), or that is saturated to eight bits; also
legal distances."""
CLOCK_FAULT_BIT = 0x8000
"""Bit that is set if the master sampled the first bit while the sensor still stretched the clock."""
ECHO_S_PER_CM = 58e-6
"""Two-way time of flight per centimetre of range [s]."""
EARLIEST_ANSWER_S = 0.010
"""No measurement ends before this time plus its time of flight [s]; half of what the data sheet's timing suggests.
Larger would reject valid answers, smaller would accept information that is not a range."""

UNLOCK = b"\xaa\xa5"
ILLEGAL_8BIT = frozenset({0, 80, 164, 170})
"""Addresses in 8-bit form that the sensor ignores."""
CHANGE_S = 0.125
"""Time that the sensor needs to store a new address [s]."""
RANGING_S = 0.080
"""By this time after the ping a measurement has ended [s]."""
RANGES_STILL_S = 0.008
"""At this time after the ping no measurement has ended [s]."""
TRIES = 5
"""How often a device is asked while it should be ranging, where a busy computer asks too late. Each takes 0.1 s."""

PART_INFO = 0x012C
"""Answer before the first ping; the real bytes are not documented, these look like 300 cm."""


def decode(answer: bytes, *, pinged: bool = True) -> Decoded:
    """Decode a two-byte answer.

    Parameters
    ----------
    answer
        The two bytes read.
    pinged
        False if the sensor has not been pinged since it was powered: the bytes are then information about the part that
        only looks like a distance.

    Raises
    ------
    ValueError
        Not two bytes.

    Examples
    --------
    >>> decode(bytes([0x01, 0xF7])).range_m
    5.03
    >>> decode(bytes([0x02, 0xFD])).status.value, decode(bytes([0x81, 0xF7])).status.value
    ('no_echo', 'clock_fault')
    """
    if len(answer) != ANSWER_BYTES:
        raise ValueError(f"an MB1242 answers {ANSWER_BYTES} bytes; found {len(answer)}: {answer.hex(' ')}")
    word = answer[0] << 8 | answer[1]
    if not pinged:
        return Decoded(Status.PART_INFO, None, word)
    if word & CLOCK_FAULT_BIT:
        return Decoded(Status.CLOCK_FAULT, None, word)
    if not MINIMUM_CM <= word <= NO_ECHO_CM:
        return Decoded(Status.IMPOSSIBLE, None, word)
    earliest_s = EARLIEST_ANSWER_S + word * ECHO_S_PER_CM
    if word == NO_ECHO_CM:
        return Decoded(Status.NO_ECHO, None, word, False, earliest_s)
    status = Status.AT_MINIMUM if word == MINIMUM_CM else Status.OK
    return Decoded(status, word / 100, word, word in DOUBTFUL_CM, earliest_s)


def encode(reading_cm: int) -> bytes:
    """Encode a reading in whole centimetres as two bytes: the inverse of `decode`."""
    return reading_cm.to_bytes(ANSWER_BYTES, "big")


class _Playback:
    """It answers a plain read with two bytes, and acknowledges nothing while it measures."""

    first_raw = PART_INFO

    def starts(self, data: bytes, ranging: bool) -> bool | None:
        return None if ranging else data == COMMAND_RANGE

    def answer(self, count: int, raw: int, ranging: bool) -> bytes | None:
        return None if ranging else raw.to_bytes(ANSWER_BYTES, "big")[:count]


class MB1242(Driver):
    """One MB1242 on a bus."""

    part = "an MB1242"
    default_address = 0x70
    keeps_address = True
    playback = _Playback
    busy_s = RANGING_S
    stretches_clock = True

    def __init__(self, bus: Bus, address: Address) -> None:
        super().__init__(bus, address)
        self._pinged = False

    def ping(self) -> None:
        """Start a measurement."""
        self._bus.write(self.address, COMMAND_RANGE)
        self._pinged = True

    def answer(self) -> Decoded:
        """Read the result of the last ping.

        An answer that arrives sooner than its own echo could is not the answer to this ping: the sensor lost its power
        and sends part information, or repeats the previous answer.
        """
        return decode(self._bus.read(self.address, ANSWER_BYTES), pinged=self._pinged)

    @classmethod
    def ignores_address(cls, address: int) -> bool:
        """Some addresses equal commands or parts of them."""
        return address << 1 in ILLEGAL_8BIT

    @classmethod
    def identify(cls, bus: Bus, clock: Clock, address: int) -> FoundDevice:
        """Such a sensor does not acknowledge for some time after the range command, and then answers with a possible
        range.

        Other devices may interpret that one-byte command differently.
        """
        try:
            for _ in range(TRIES):
                start_s = clock.now()
                bus.write(address, COMMAND_RANGE)
                pinged_s = clock.now()
                clock.sleep_until(pinged_s + RANGES_STILL_S)
                busy = not acknowledges(bus, address)
                asked_s = clock.now() - start_s
                first = _first_answer(bus, clock, address, pinged_s + RANGING_S)
                clock.sleep_until(pinged_s + RANGING_S)
                answer = bus.read(address, ANSWER_BYTES)
                if busy or asked_s < _soonest_s(answer):
                    break
        except BusError as error:
            return stranger(address, f"no answer to the range command (errno {error.errno})")
        if not busy and asked_s >= _soonest_s(answer):
            return FoundDevice(address, False, "not recognised: the computer is too busy to ask while it is ranging")
        if not busy:
            return stranger(address, "not an MB1242: it answers while it should be ranging")
        if first not in (None, answer):
            return FoundDevice(
                address, False, "its answer changes without a new ranging: are two sensors at this address?"
            )
        decoded = decode(answer)
        if decoded.status.is_fault:
            return FoundDevice(address, False, f"ranges, but answers 0x{decoded.raw or 0:04x} ({decoded.status.value})")
        return FoundDevice(
            address, True, f"MB1242: {decoded.raw} cm" + (" (no echo)" if decoded.range_m is None else "")
        )

    @classmethod
    def move(cls, bus: Bus, clock: Clock, old: int, new: int) -> None:
        """Write the command, and wait until the address is stored."""
        bus.write(old, UNLOCK + bytes([new << 1]))
        clock.sleep_until(clock.now() + CHANGE_S)

    @classmethod
    def garbled_from(cls, raw: int) -> tuple[int, ...]:
        """Answers that a bus fault would change into ``raw``: the high byte lost, or OR-ed into the low one.

        Examples
        --------
        >>> MB1242.garbled_from(247), MB1242.garbled_from(300)
        ((503, 759, 502, 757), ())
        """
        if raw > 0xFF:
            return ()
        lost = [high << 8 | raw for high in (1, 2)]
        mixed = [high << 8 | raw & ~high for high in (1, 2) if raw & high]
        return tuple([answer for answer in dict.fromkeys([*lost, *mixed]) if answer < NO_ECHO_CM])


def _soonest_s(answer: bytes) -> float:
    """Time after a ping before which no such sensor gives an answer [s]; infinite for what is none of its answers."""
    reading_cm = int.from_bytes(answer, "big") % CLOCK_FAULT_BIT
    if not MINIMUM_CM <= reading_cm <= NO_ECHO_CM:
        return float("inf")
    return EARLIEST_ANSWER_S + ECHO_S_PER_CM * reading_cm


def _first_answer(bus: Bus, clock: Clock, address: int, until_s: float) -> bytes | None:
    """The answer of the first sensor that acknowledges: of two sensors the one with the shorter range."""
    while clock.now() < until_s:
        try:
            return bus.read(address, ANSWER_BYTES)
        except BusError:
            clock.sleep_until(clock.now() + POLL_INTERVAL_S)
    return None
