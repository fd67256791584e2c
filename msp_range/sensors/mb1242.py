"""MaxBotix MB1242 (I2CXL-MaxSonar-EZ4): constants, decoding and transfers.

Source: the maker's data sheet of the I2CXL-MaxSonar-EZ series. The sensor ranges on the one-byte command 0x51, does
not acknowledge while it ranges, and answers a plain two-byte read (no register) with whole centimetres, most
significant byte first, 20 to 765. It has no status byte, so everything that can be known of a fault is in the value
and in the time at which it came.
"""

from msp_range.bus import Bus
from msp_range.reading import Status
from msp_range.sensors.base import Decoded

COMMAND_RANGE = b"\x51"
ANSWER_BYTES = 2
MINIMUM_CM = 20
"""Objects nearer than this read this."""
NO_ECHO_CM = 765
"""Nothing heard within the cycle reads this."""
DOUBTFUL_CM = frozenset({253, 255})
"""765 whose high byte is lost (0xFD), whose two bytes are OR-ed (0x02 | 0xFD), or that is saturated to eight bits; also
legal distances."""
CLOCK_FAULT_BIT = 0x8000
"""Set where the master sampled the first bit while the sensor still stretched the clock."""
ECHO_S_PER_CM = 58e-6
"""Time of flight of one centimetre of range, there and back."""
EARLIEST_ANSWER_S = 0.010
"""No ranging is over sooner than this plus its time of flight; half of what the maker's timing suggests."""


def decode(answer: bytes, *, pinged: bool = True) -> Decoded:
    """What a two-byte answer means.

    Parameters
    ----------
    answer
        The two bytes as read.
    pinged
        False where the sensor has not been told to range since it was powered: the bytes are then part information
        that only looks like a distance.

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
    if word == NO_ECHO_CM:
        return Decoded(Status.NO_ECHO, None, word)
    if word == MINIMUM_CM:
        return Decoded(Status.AT_MINIMUM, word / 100, word)
    if MINIMUM_CM < word < NO_ECHO_CM:
        return Decoded(Status.OK, word / 100, word, suspect=word in DOUBTFUL_CM)
    return Decoded(Status.IMPOSSIBLE, None, word)


def encode(reading_cm: int) -> bytes:
    """The two bytes of a reading in whole centimetres: `decode` backwards."""
    return reading_cm.to_bytes(ANSWER_BYTES, "big")


def garbled_from(word: int) -> tuple[int, ...]:
    """Answers of which a fault of the bus would make ``word``: the high byte lost, or OR-ed into the low one.

    Examples
    --------
    >>> garbled_from(247), garbled_from(300)
    ((503, 759, 502, 757), ())
    """
    if word > 0xFF:
        return ()
    lost = [high << 8 | word for high in (1, 2)]
    mixed = [high << 8 | word & ~high for high in (1, 2) if word & high]
    return tuple([answer for answer in dict.fromkeys([*lost, *mixed]) if answer < NO_ECHO_CM])


class MB1242:
    """One MB1242 on a bus; a `RangeSensor`."""

    def __init__(self, bus: Bus, address: int) -> None:
        self._bus = bus
        self.address = address
        self._pinged = False

    def ping(self) -> None:
        """Start a ranging."""
        self._bus.write(self.address, COMMAND_RANGE)
        self._pinged = True

    def answer(self, since_ping_s: float) -> Decoded:
        """Read the result of the last ping.

        An answer that comes before its own echo could have is not an answer to this ping (the sensor lost its power
        and shows part information, or repeats the ranging before): it is impossible.
        """
        decoded = decode(self._bus.read(self.address, ANSWER_BYTES), pinged=self._pinged)
        if decoded.raw is not None and not decoded.status.is_fault:
            earliest_s = EARLIEST_ANSWER_S + decoded.raw * ECHO_S_PER_CM
            if since_ping_s < earliest_s:
                return Decoded(Status.IMPOSSIBLE, None, decoded.raw)
        return decoded
