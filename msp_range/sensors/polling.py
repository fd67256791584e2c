"""The order and the time in which range finders ping and are asked for their answers.

Groups of sensors ping in turn; the members of a group ping together, which is right only where they cannot hear each
other. A sensor that ranges does not acknowledge, so it is asked again every `POLL_INTERVAL_S` from the moment at which
it could first be done, and never later than its deadline. A sensor that did not answer is pinged again in its next turn
like every other.
"""

import errno
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from msp_range.bus import Bus, BusError
from msp_range.clock import Clock
from msp_range.reading import Reading, Status
from msp_range.sensors.base import RangeSensor

POLL_INTERVAL_S = 0.002
"""Between two tries to read a sensor that still ranges; half of it is the mean delay that polling adds."""
LATE_S = 0.1
"""An answer that is asked for this long after the deadline is too old to be told [s]."""
REOPEN_INTERVAL_S = 1.0
"""Between two attempts to open a bus again that has locked up or gone."""


@dataclass(frozen=True, slots=True)
class Timing:
    """When a sensor can be asked, all after its ping [s].

    Attributes
    ----------
    first_answer_s
        The soonest that an answer can be there.
    deadline_s
        The last try to read.
    echo_s_per_m
        Time of flight that the sensor counts for one metre of range, there and back [s/m].
    """

    first_answer_s: float
    deadline_s: float
    echo_s_per_m: float = 5.8e-3


@dataclass(frozen=True, slots=True)
class PolledSensor:
    """A sensor with its name in the airframe, its timing, and how its readings scatter.

    The standard deviation of a reading of range z is sqrt(std_m^2 + (std_growth z)^2) [m]; None: unknown.
    """

    name: str
    device: RangeSensor
    timing: Timing
    std_m: float | None = None
    std_growth: float = 0.0

    def std_at(self, range_m: float | None) -> float | None:
        """Standard deviation of a reading of this range [m]; None where there is no range."""
        if range_m is None or self.std_m is None:
            return None
        return math.hypot(self.std_m, self.std_growth * range_m) if self.std_growth else self.std_m


@dataclass(frozen=True, slots=True)
class Spacing:
    """How far apart pings are.

    Attributes
    ----------
    ping_interval_s
        From one group's ping to the next one's [s]: the time in which the echoes of a ping die away.
    near_below_m, near_interval_s
        While every sensor's last answer was a range below ``near_below_m``, pings follow at ``near_interval_s``;
        None: never.
    """

    ping_interval_s: float = 0.100
    near_below_m: float | None = None
    near_interval_s: float | None = None


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


class Schedule(Protocol):
    """Who pings next, and when."""

    def turn(self, last_ping_s: float) -> tuple[float, Sequence[PolledSensor]]:
        """The next turn: when, at the earliest [s], and the sensors that ping together.

        ``last_ping_s`` is the time of the turn before. Asked once for each turn, when the one before has ended. Time
        infinity: there is no next turn.
        """
        ...

    def hear(self, reading: Reading) -> None:
        """Take note of a reading."""
        ...


class RoundRobin:
    """Groups in turn, for ever, as far apart as `Spacing` says."""

    def __init__(self, groups: Sequence[Sequence[PolledSensor]], spacing: Spacing, start_s: float) -> None:
        if not groups or not all(groups):
            raise ValueError(f"every polling group needs at least one sensor; found {groups!r}")
        self._groups = itertools.cycle(groups)
        self._spacing = spacing
        self._start_s: float | None = start_s
        self._near = {sensor.name: False for group in groups for sensor in group}

    def turn(self, last_ping_s: float) -> tuple[float, Sequence[PolledSensor]]:
        """The next group; sooner while all sensors are near the ground, where the airframe allows it."""
        group = next(self._groups)
        if self._start_s is not None:
            start_s, self._start_s = self._start_s, None
            return start_s, group
        near_interval_s = self._spacing.near_interval_s
        if near_interval_s is not None and all(self._near.values()):
            return last_ping_s + near_interval_s, group
        return last_ping_s + self._spacing.ping_interval_s, group

    def hear(self, reading: Reading) -> None:
        """Note whether the sensor is near the ground."""
        below_m = self._spacing.near_below_m or 0.0
        self._near[reading.sensor] = reading.range_m is not None and reading.range_m < below_m


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
