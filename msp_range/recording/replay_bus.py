"""A bus whose sensors answer with readings that were measured before.

The bridge's own driver pings and reads as in a flight, and gets the recorded answers of each address in their
order. The recorded time of the next ping is `ReplayBus.next_ping`; whoever drives the polling sleeps until then, so
that on a virtual clock the readings have their recorded times.
"""

import errno
from collections.abc import Callable, Iterator, Mapping, Sequence

from msp_range.bus.base import Address, BusError
from msp_range.clock import Clock
from msp_range.sensors.base import Playback, RecordedPing


class ReplayBus:
    """A Bus (see `msp_range.bus.base.Bus`) with recorded sensors on it.

    Each range command starts the next recorded ping of its address, however late it comes, so none is left out. Not
    acknowledged are a read where the sensor did not answer, a range command after the last recorded ping, and anything
    at an address that is not in the record.

    Parameters
    ----------
    pings
        By address, in the order of their times.
    clock
        The bridge's clock.
    playbacks
        Function that makes the recorded sensor at each address: a driver's ``playback``.

    Attributes
    ----------
    behind_s
        How late the latest ping was after its recorded time [s]: much, where the record has more readings a second
        than the bridge polls.
    """

    def __init__(
        self,
        pings: Mapping[Address, Sequence[RecordedPing]],
        clock: Clock,
        playbacks: Mapping[Address, Callable[[], Playback]],
    ) -> None:
        self._clock = clock
        self._sensors = {address: _Sensor(of_sensor, playbacks[address]()) for address, of_sensor in pings.items()}
        self.behind_s = 0.0

    def next_ping(self, address: Address) -> RecordedPing | None:
        """The sensor's next ping; None where the record has no more of it."""
        return self._sensors[address].next if address in self._sensors else None

    def write(self, address: Address, data: bytes) -> None:
        """Start the next recorded ranging where ``data`` is the range command; anything else does nothing."""
        now_s = self._clock.now()
        sensor = self._sensors.get(address)
        starts = None if sensor is None else sensor.playback.starts(data, now_s < sensor.busy_until_s)
        if sensor is None or starts is None or (starts and sensor.next is None):
            raise BusError(errno.EREMOTEIO, "write", address)
        if starts and sensor.next is not None:
            ping = sensor.next
            self.behind_s = max(self.behind_s, now_s - ping.ping_s)
            sensor.ping(now_s, ping)
            if ping.word is None and ping.ready_s <= 0:
                raise BusError(errno.EREMOTEIO, "write", address)

    def read(self, address: Address, count: int) -> bytes:
        """Return the answer to the last ping."""
        sensor = self._sensors.get(address)
        answer = None
        if sensor is not None and sensor.raw is not None:
            answer = sensor.playback.answer(count, sensor.raw, self._clock.now() < sensor.busy_until_s)
        if answer is None:
            raise BusError(errno.EREMOTEIO, "read", address)
        return answer

    def busy_s(self, address: Address) -> float:
        """0: the bridge asks every few milliseconds, and so reads each answer as early as it was read in the flight."""
        return 0.0

    def reopen(self) -> None:
        """Nothing to do: a record does not lock up."""

    def close(self) -> None:
        """Nothing to do."""


class _Sensor:
    """The recorded pings of one address, and the state that they leave it in."""

    def __init__(self, pings: Sequence[RecordedPing], playback: Playback) -> None:
        self._pings: Iterator[RecordedPing] = iter(pings)
        self.next = next(self._pings, None)
        self.playback = playback
        self.raw: float | None = playback.first_raw
        self.busy_until_s = float("-inf")

    def ping(self, now_s: float, ping: RecordedPing) -> None:
        self.next = next(self._pings, None)
        self.raw = ping.word
        self.busy_until_s = now_s if ping.word is None else now_s + ping.ready_s
