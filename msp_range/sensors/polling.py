"""Range finders are pinged in the order of a schedule and asked for their answers.

A sensor that ranges does not acknowledge, so it is asked again every `POLL_INTERVAL_S` from the moment at which
it could first be done, and never later than its deadline.
"""

import errno
from typing import NamedTuple

from msp_range.bus import Bus, BusError
from msp_range.clock import Clock
from msp_range.reading import Reading, Status
from msp_range.sensors.schedule import PolledSensor, Schedule

POLL_INTERVAL_S = 0.002
"""Between two tries to read a sensor that still ranges; half of it is the mean delay that polling adds."""
LATE_S = 0.1
"""An answer that is asked for this long after the deadline is too old to be told [s]."""
REOPEN_INTERVAL_S = 1.0
"""Between two attempts to open a bus again that has locked up or gone."""


class Ranging(NamedTuple):
    """One ping and what came of it.

    Attributes
    ----------
    reading
        The result.
    ping_s, answered_s
        Times of the ping and of the last try to read, on the bridge's clock [s].
    error
        The last transfer's error where there was no answer.
    """

    reading: Reading
    ping_s: float
    answered_s: float
    error: BusError | None = None


class _Pending:
    """A sensor that has been pinged and not yet answered."""

    __slots__ = ("next_try_s", "ping_s", "sensor")

    def __init__(self, sensor: PolledSensor, ping_s: float) -> None:
        self.sensor = sensor
        self.ping_s = ping_s
        self.next_try_s = ping_s + sensor.timing.first_answer_s


class Poller:
    """Pings sensors in the order of a schedule, and asks them for their answers.

    Parameters
    ----------
    bus
        Only to open it again after a lock-up; transfers go through the sensors.
    clock
        Time of pings and answers.
    schedule
        Who pings next, and when.
    """

    def __init__(self, bus: Bus, clock: Clock, schedule: Schedule) -> None:
        self._bus = bus
        self._clock = clock
        self._schedule = schedule
        self._pending: list[_Pending] = []
        self._group_ping_s = clock.now()
        self._next_ping_s, self._next_group = schedule.turn(self._group_ping_s)
        self._reopened_s = float("-inf")

    @property
    def next_event_s(self) -> float:
        """When `step` has something to do [s]."""
        if self._pending:
            return min([each.next_try_s for each in self._pending])
        return self._next_ping_s

    def step(self) -> list[Ranging]:
        """Ping, or ask, whatever is due; returns the rangings that ended."""
        if self._pending:
            return self._ask()
        if self._clock.now() >= self._next_ping_s:
            return self._ping()
        return []

    def _ping(self) -> list[Ranging]:
        failed = []
        for sensor in self._next_group:
            try:
                sensor.device.ping()
            except BusError as error:
                now_s = self._clock.now()
                failed.append(self._no_answer(sensor, now_s, now_s, error))
            else:
                self._pending.append(_Pending(sensor, self._clock.now()))
        # After the writes, which a stretched clock can delay: the next ping counts from here.
        self._group_ping_s = self._clock.now()
        if not self._pending:
            self._plan()
        return failed

    def _ask(self) -> list[Ranging]:
        ended = []
        for pending in list(self._pending):
            now_s = self._clock.now()
            if now_s < pending.next_try_s:
                continue
            ranging = self._try(pending, now_s)
            if ranging is not None:
                self._pending.remove(pending)
                ended.append(ranging)
        if not self._pending:
            self._plan()
        return ended

    def _try(self, pending: _Pending, now_s: float) -> Ranging | None:
        sensor = pending.sensor
        timing = sensor.timing
        if now_s > pending.ping_s + timing.deadline_s + LATE_S:
            # The program or the bus stood still: what the sensor would say is true of then and not of now.
            late = BusError(errno.ETIME, "read", sensor.device.address)
            return self._no_answer(sensor, pending.ping_s, now_s, late)
        try:
            decoded = sensor.device.answer(now_s - pending.ping_s)
        except BusError as error:
            # Sums and not differences of times: in virtual time a try at the deadline must be seen to be there.
            deadline_s = pending.ping_s + timing.deadline_s
            if now_s >= deadline_s or error.bus_at_fault:
                return self._no_answer(sensor, pending.ping_s, self._clock.now(), error)
            pending.next_try_s = min(now_s + POLL_INTERVAL_S, deadline_s)
            return None
        range_m = decoded.range_m
        echo_s = pending.ping_s if range_m is None else pending.ping_s + 0.5 * range_m * timing.echo_s_per_m
        std_m = sensor.std_at(range_m)
        reading = Reading(echo_s, sensor.name, decoded.status, range_m, std_m, decoded.raw, decoded.suspect)
        self._schedule.hear(reading)
        return Ranging(reading, pending.ping_s, self._clock.now())

    def _no_answer(self, sensor: PolledSensor, ping_s: float, now_s: float, error: BusError) -> Ranging:
        # An adapter that was unplugged and one whose device does not acknowledge can give the same ENODEV.
        doubtful = error.bus_at_fault or error.errno == errno.ENODEV
        if doubtful and now_s - self._reopened_s >= REOPEN_INTERVAL_S:
            self._reopened_s = now_s
            try:
                self._bus.reopen()
            except BusError as reopen_error:
                error = reopen_error
        reading = Reading(ping_s, sensor.name, Status.NO_ANSWER)
        self._schedule.hear(reading)
        return Ranging(reading, ping_s, now_s, error)

    def _plan(self) -> None:
        self._next_ping_s, self._next_group = self._schedule.turn(self._group_ping_s)
