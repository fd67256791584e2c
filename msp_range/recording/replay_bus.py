"""A bus whose sensors answer with readings that were measured before.

Recorded pings by 7-bit address enter; the bridge's own driver pings and reads as ever, and gets the recorded answers in
their order. When to ping is in the record too: `ReplayBus.next_ping_s` says it, and whoever drives the polling sleeps
until then, so that on a virtual clock the readings get their own times back.
"""

import errno
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from msp_range.bus.base import BusError
from msp_range.clock import Clock
from msp_range.sensors.mb1242 import ANSWER_BYTES, COMMAND_RANGE

PART_INFO = b"\x01\x2c"
"""What a sensor answers before its first ping; the real bytes are not documented, these look like 300 cm."""


class RecordedPing(NamedTuple):
    """One ping and what came of it.

    Attributes
    ----------
    ping_s
        Time of the ping [s].
    word
        The sensor's 16-bit answer; None where there was none.
    ready_s
        From the ping until the sensor acknowledges again [s]. Zero and no answer: the ping was not acknowledged.
    """

    ping_s: float
    word: int | None
    ready_s: float

    @property
    def acknowledged(self) -> bool:
        """Whether the sensor took the range command."""
        return self.word is not None or self.ready_s > 0


class ReplayBus:
    """A Bus (see `msp_range.bus.base.Bus`) with recorded MB1242 on it.

    Each range command takes the next recorded ping of its address, however late it comes, so nothing is left out. The
    sensor does not acknowledge while it ranges, never where it did not answer, and not at all after its last reading;
    an address that is not in the record does not acknowledge either.

    Parameters
    ----------
    pings
        By 7-bit address, in the order of their times.
    clock
        The bridge's clock.

    Attributes
    ----------
    behind_s
        How late the latest ping was after its recorded time [s]: much, where the record has more readings a second
        than the bridge polls.
    """

    def __init__(self, pings: Mapping[int, Sequence[RecordedPing]], clock: Clock) -> None:
        self._clock = clock
        self._sensors = {address: _Sensor(each) for address, each in pings.items()}
        self.behind_s = 0.0

    def next_ping_s(self, address: int) -> float | None:
        """When the sensor was pinged next [s]; None where the record has no more of it."""
        sensor = self._sensors.get(address)
        return None if sensor is None or sensor.next is None else sensor.next.ping_s

    def write(self, address: int, data: bytes) -> None:
        """Start the next recorded ranging where ``data`` is the range command; anything else does nothing."""
        now_s = self._clock.now()
        sensor = self._sensors.get(address)
        if sensor is None or sensor.next is None or now_s < sensor.busy_until_s:
            raise BusError(errno.EREMOTEIO, "write", address)
        if data == COMMAND_RANGE:
            ping = sensor.next
            self.behind_s = max(self.behind_s, now_s - ping.ping_s)
            sensor.ping(now_s, ping)
            if not ping.acknowledged:
                raise BusError(errno.EREMOTEIO, "write", address)

    def read(self, address: int, count: int) -> bytes:
        """Return the answer to the last ping."""
        sensor = self._sensors.get(address)
        if sensor is None or sensor.answer is None or self._clock.now() < sensor.busy_until_s:
            raise BusError(errno.EREMOTEIO, "read", address)
        return sensor.answer[:count]

    def reopen(self) -> None:
        """Nothing to do: a record does not lock up."""

    def close(self) -> None:
        """Nothing to do."""


class _Sensor:
    """The recorded pings of one address, and the state that they leave it in."""

    def __init__(self, pings: Sequence[RecordedPing]) -> None:
        self._pings: Iterator[RecordedPing] = iter(pings)
        self.next = next(self._pings, None)
        self.answer: bytes | None = PART_INFO
        self.busy_until_s = float("-inf")

    def ping(self, now_s: float, ping: RecordedPing) -> None:
        self.next = next(self._pings, None)
        self.answer = None if ping.word is None else ping.word.to_bytes(ANSWER_BYTES, "big")
        self.busy_until_s = now_s if ping.word is None else now_s + ping.ready_s
