"""Ping range finders in the order of a schedule, and read their answers.

A sensor that is measuring has no answer yet, so it is read again every `POLL_INTERVAL_S` from the moment at which
it could first be done, and never later than its deadline. Attempts that would fail are left out: by what an emulated
bus knows, and on a real one by when the sensor answered last.
"""

import errno
import math
from collections import deque
from operator import attrgetter
from typing import NamedTuple

from msp_range.bus import Bus, BusError
from msp_range.clock import Clock
from msp_range.numbers import limited
from msp_range.reading import Decoded, Reading, Status
from msp_range.sensors.base import POLL_INTERVAL_S
from msp_range.sensors.schedule import PolledSensor, Schedule

LATE_S = 0.1
"""An answer that is read this long after the deadline is too old to be used [s]."""
LONGEST_WAIT_S = 0.019
"""A sensor that is expected to measure for longer than this is asked in between [s]: an answer that comes sooner than
expected is read at most this late. Longer delays the first sight of an object that appears, shorter keeps bus and
processor busier: each attempt in vain wakes the bridge."""
SOONER_S = 0.0005
"""After a first attempt that was answered the next one comes this much sooner [s], until one is in vain: only that
shows how soon there is an answer. Smaller follows a sensor that becomes quicker more slowly, larger makes more attempts
in vain."""
STALE_S = 0.02
"""Where a sensor that measures by itself is asked later than planned by more than this, what has arrived meanwhile is
dropped, since nobody knows when it came [s]: at 2 m/s the height would be off by 4 cm. Larger makes readings older than
they seem, smaller loses a reading to each hiccup of a busy computer."""
REOPEN_INTERVAL_S = 1.0
"""Time between two attempts to reopen a bus that is locked up or missing [s]."""


class Ranging(NamedTuple):
    """A ping and its result."""

    reading: Reading
    """The result."""
    ping_s: float
    answered_s: float
    """Times of the ping and of the last attempt to read, on the bridge's clock [s]."""
    error: BusError | None = None
    """The last transfer's error if there was no answer."""


class _Pending:
    """A sensor that was pinged, between ``from_s`` and ``ping_s``, and has not answered yet.

    It is busy for ``busy_s`` [s], and probably until ``expected_s``.
    """

    def __init__(self, sensor: PolledSensor, from_s: float, ping_s: float, busy_s: float, expected_s: float) -> None:
        self.sensor = sensor
        self.from_s, self.ping_s, self.expected_s = from_s, ping_s, expected_s
        self.deadline_s = ping_s + sensor.timing.deadline_s
        self.tried_s = -math.inf
        next_try_s = ping_s + sensor.timing.first_answer_s
        until_s = ping_s + busy_s
        while next_try_s < until_s:
            next_try_s += POLL_INTERVAL_S
        self._try_from(next_try_s, next_try_s)

    def tried(self, now_s: float) -> None:
        """Plan the next attempt after one in vain."""
        self.tried_s = now_s
        self._try_from(now_s + POLL_INTERVAL_S, now_s)

    def _try_from(self, soonest_s: float, none_until_s: float) -> None:
        self.next_try_s = limited(min(self.expected_s, none_until_s + LONGEST_WAIT_S), soonest_s, self.deadline_s)


class _Duration(NamedTuple):
    """How long a sensor measures, by its last answer [s]."""

    earliest_s: float
    """Shortest time in which that answer can come, see `Decoded.earliest_s`: it grows with the range."""
    extra_s: float
    """What the sensor takes on top of that, at any range."""

    @property
    def total_s(self) -> float:
        """Time from the ping to the answer, where the range is that of the last one [s]."""
        return self.earliest_s + self.extra_s


def _duration(pending: _Pending, earliest_s: float, now_s: float, before: _Duration | None) -> _Duration:
    """How long a sensor measures, where it answered now; ``before``: the same by its previous answer."""
    extra_s = now_s - pending.ping_s - earliest_s
    if before is not None:
        extra_s = min(extra_s, before.extra_s)
    # It was done some time between the last attempt in vain and the next, which would be a poll later.
    in_vain_s = pending.tried_s + 0.5 * POLL_INTERVAL_S - pending.ping_s - earliest_s
    return _Duration(earliest_s, max(extra_s - SOONER_S, in_vain_s))


class Poller:
    """Pings sensors in the order of a schedule, and reads their answers.

    Each step makes at most one transfer: on a locked-up bus it takes a second until the kernel gives up, and between
    two steps the bridge does everything else that is due.

    Parameters
    ----------
    bus
        Used to reopen it after a lock-up, and asked how long a pinged sensor is busy; transfers go through the sensors.
    clock
        Time of pings and answers.
    schedule
        Decides which sensor pings next, and when.

    Attributes
    ----------
    next_event_s
        Time at which `step` has something to do [s]; in the past if the next transfer should follow at once.
    """

    def __init__(self, bus: Bus, clock: Clock, schedule: Schedule) -> None:
        self._bus = bus
        self._clock = clock
        self._schedule = schedule
        self._unpinged: deque[PolledSensor] = deque()
        self._pending: list[_Pending] = []
        self._next: _Pending
        self._to_reopen: Ranging | None = None
        self._durations: dict[str, _Duration] = {}
        self._last_ping_s = clock.now()
        self._acknowledged = False
        self._reopened_s = float("-inf")
        self._plan()
        self.next_event_s = self._turn_s

    def step(self) -> list[Ranging]:
        """Make the transfer that is due, if any (a ping, a read or reopening the bus); returns the measurement that it
        ended."""
        now_s = self._clock.now()
        if now_s < self.next_event_s:
            return []
        ranging: Ranging | None
        if self._to_reopen is not None:
            ranging = self._reopen(self._to_reopen)
        elif self._unpinged:
            ranging = self._ping(self._unpinged.popleft())
        else:
            ranging = self._ask(self._next, now_s)
        if ranging is not None:
            self._schedule.on_reading(ranging.reading)
        if self._to_reopen is not None:
            self.next_event_s = self._to_reopen.answered_s
        elif self._pending and not self._unpinged:
            self._next = min(self._pending, key=attrgetter("next_try_s"))
            self.next_event_s = self._next.next_try_s
        else:
            if not self._unpinged:
                self._plan()
            self.next_event_s = self._turn_s
        return [] if ranging is None else [ranging]

    def _plan(self) -> None:
        self._turn_s, sensors = self._schedule.turn(self._last_ping_s, self._acknowledged)
        self._unpinged.extend(sensors)
        self._acknowledged = False

    def _ping(self, sensor: PolledSensor) -> Ranging | None:
        from_s = self._clock.now()
        try:
            sensor.device.ping()
        except BusError as error:
            self._last_ping_s = self._clock.now()
            return self._no_answer(sensor, self._last_ping_s, self._last_ping_s, error)
        # Taken after the write, which a stretched clock can delay: the next turn counts from the last ping of this one.
        self._last_ping_s = self._clock.now()
        busy_s, expected_s = self._bus.busy_s(sensor.device.address), -math.inf
        if busy_s is None:
            busy_s = 0.0
            if sensor.name in self._durations:
                expected_s = self._last_ping_s + self._durations[sensor.name].total_s
        self._pending.append(_Pending(sensor, from_s, self._last_ping_s, busy_s, expected_s))
        self._acknowledged = True
        return None

    def _ask(self, pending: _Pending, now_s: float) -> Ranging | None:
        sensor = pending.sensor
        if now_s > pending.deadline_s + LATE_S:
            # The program or the bus was blocked: the sensor's answer would be old.
            self._pending.remove(pending)
            late = BusError(errno.ETIME, "read", sensor.device.address)
            return self._no_answer(sensor, pending.ping_s, now_s, late)
        sent_s = sensor.timing.sent_s
        try:
            if sent_s is not None and now_s - pending.next_try_s > STALE_S:
                sensor.device.ping()
            decoded = sensor.device.answer()
        except BusError as error:
            # Compare sums, not differences: in virtual time an attempt exactly at the deadline has to count.
            if now_s < pending.deadline_s and not error.bus_at_fault:
                pending.tried(now_s)
                return None
            self._pending.remove(pending)
            return self._no_answer(sensor, pending.ping_s, self._clock.now(), error)
        self._pending.remove(pending)
        if not decoded.status.is_fault:
            before = self._durations.get(sensor.name)
            self._durations[sensor.name] = _duration(pending, decoded.earliest_s, now_s, before)
        answered_s = self._clock.now()
        decoded = decoded.arrived_after(answered_s - pending.from_s)
        ping_s = pending.ping_s if sent_s is None else answered_s - sent_s
        return Ranging(reading_of(sensor, ping_s, decoded), pending.ping_s, answered_s)

    def _no_answer(self, sensor: PolledSensor, ping_s: float, now_s: float, error: BusError) -> Ranging | None:
        """The failed measurement; None if the bus has to be reopened first, in a separate step."""
        # Without its traceback, whose frames hold it in turn: only a garbage collection would release them.
        kept = error.with_traceback(None)
        ranging = Ranging(Reading(ping_s, sensor.name, Status.NO_ANSWER), ping_s, now_s, kept)
        if not error.calls_for_reopening or now_s - self._reopened_s < REOPEN_INTERVAL_S:
            return ranging
        self._reopened_s = now_s
        self._to_reopen = ranging
        return None

    def _reopen(self, failed: Ranging) -> Ranging:
        self._to_reopen = None
        try:
            self._bus.reopen()
        except BusError as error:
            return failed._replace(error=error.with_traceback(None))
        return failed


def reading_of(sensor: PolledSensor, ping_s: float, decoded: Decoded) -> Reading:
    """The reading of an answer to a ping: its time is that of the echo, after half the time of flight."""
    range_m, std_m = decoded.range_m, sensor.std_m
    if range_m is None:
        return Reading(ping_s, sensor.name, decoded.status, raw=decoded.raw, suspect=decoded.suspect)
    if std_m is not None and sensor.std_growth:
        std_m = math.hypot(std_m, sensor.std_growth * range_m)
    echo_s = ping_s + 0.5 * range_m * sensor.timing.echo_s_per_m
    return Reading(echo_s, sensor.name, decoded.status, range_m, std_m, decoded.raw, decoded.suspect)
