"""The order in which range finders ping, and the time between pings.

Groups of sensors ping in turn; the members of a group ping together, which is allowed only if they cannot receive each
other's echoes. The turns of sensors that do not answer are given to those that do.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from msp_range.reading import Reading
from msp_range.sensors.base import RangeSensor

DEAD_AFTER = 3
"""Number of successive faults after which a sensor's turns are given to the others; the pilot then gets a text
(`msp_range.health`). With fewer, sensors that sometimes fail lose their turns; with more, the turns of a dead sensor
are given away later, by one cycle each. Four sensors that each fail in 40 % of their readings give 517 fused distances
per minute with 2, 542 with 3, 550 with 4; with 20 % faults 592, 593 and 594."""
AGAIN, AGAIN_EVERY_S = 2, 2.0
"""Number of extra turns for a sensor whose reading does not fit, and the time within which it gets no more [s]: objects
are detected in half the time, and a noisy sensor takes one turn in ten from the others."""
RETRY_S = 2.0
"""Time after which a dead sensor is tried again [s], and so the delay until a recovered one is used. A dead sensor that
acknowledges its ping takes a turn from the others each time, one in twenty at 100 ms."""


@dataclass(frozen=True, slots=True)
class AnswerTiming:
    """Times at which a sensor can be read, relative to its ping [s]."""

    first_answer_s: float
    """Earliest possible answer."""
    deadline_s: float
    """Last attempt to read."""
    echo_s_per_m: float = 5.8e-3
    """Two-way time of flight that the sensor assumes per metre of range [s/m]."""


@dataclass(frozen=True, slots=True)
class PolledSensor:
    """A sensor with its name in the airframe, its timing, and the spread of its readings.

    The standard deviation of a reading of range z is sqrt(std_m^2 + (std_growth z)^2) [m]; None: unknown.
    """

    name: str
    device: RangeSensor
    timing: AnswerTiming
    std_m: float | None = None
    std_growth: float = 0.0


@dataclass(frozen=True, slots=True)
class Spacing:
    """The time between pings."""

    ping_interval_s: float = 0.100
    """Time from one group's ping to the next one's [s], in which the echoes die away."""
    near_below_m: float | None = None
    near_interval_s: float | None = None
    """While every sensor's last answer is a range below ``near_below_m``, pings follow after ``near_interval_s``; None:
    never."""


class Schedule(Protocol):
    """Decides which sensors ping next, and when."""

    def turn(self, last_ping_s: float, acknowledged: bool) -> tuple[float, Sequence[PolledSensor]]:
        """The next turn: its earliest time [s], and the sensors that ping together.

        Called once for each turn, when the previous one has ended. An infinite time means that there is no next turn.

        Parameters
        ----------
        last_ping_s
            Time of the last ping of the previous turn [s].
        acknowledged
            Whether any sensor acknowledged a ping of the previous turn; if not, there was no sound.
        """

    def on_reading(self, reading: Reading) -> None:
        """Record a reading."""

    def again(self, sensor: str) -> None:
        """Give a sensor whose reading did not fit an extra turn soon, if there are other sensors."""


class RoundRobin:
    """Endless turns of all groups, with the times of `Spacing`; turns of dead sensors are given to the others.

    A sensor is dead after ``dead_after`` successive faults, until it gives an answer that is not a fault. A cycle has a
    turn for each group with a working sensor, and at most one for a dead group that is due for a retry; a dead sensor
    of a working group is retried in the group's turn. A retry that is not acknowledged takes no time from the next
    turn. If all sensors are dead, all of them keep their turns.

    Parameters
    ----------
    groups
        Groups of sensors that ping together, in the order of their turns.
    spacing
        Time between turns.
    start_s
        Time of the first turn [s].
    dead_after
        Number of successive faults; infinity: every sensor keeps its turns.
    """

    def __init__(
        self,
        groups: Sequence[Sequence[PolledSensor]],
        spacing: Spacing,
        start_s: float,
        dead_after: float = DEAD_AFTER,
    ) -> None:
        if not groups or not all(groups):
            raise ValueError(f"every polling group needs at least one sensor; found {groups!r}")
        self._groups = groups
        self._spacing = spacing
        self._dead_after = dead_after
        sensors = [sensor for group in groups for sensor in group]
        self._near = {sensor.name: False for sensor in sensors}
        self._faults = {sensor.name: 0 for sensor in sensors}
        self._pinged_s = {sensor.name: float("-inf") for sensor in sensors}
        self._round: deque[Sequence[PolledSensor]] = deque()
        self._of = {sensor.name: sensor for sensor in sensors}
        self._again: dict[str, tuple[float, int]] = {}
        self._start_s: float | None = start_s
        self._counts_from_s = start_s
        self._is_retry = False

    def turn(self, last_ping_s: float, acknowledged: bool) -> tuple[float, Sequence[PolledSensor]]:
        """The next group; sooner while all working sensors are near the ground, if the airframe allows it."""
        if self._start_s is not None:
            at_s, self._start_s = self._start_s, None
        else:
            if acknowledged or not self._is_retry:
                self._counts_from_s = last_ping_s
            at_s = self._counts_from_s + self._spacing_s()
        if not self._round:
            self._round.extend(self._next_round(at_s))
        group = self._round.popleft()
        self._pinged_s.update({sensor.name: at_s for sensor in group})
        self._is_retry = self._is_dead_group(group) and bool(self._living_groups())
        return at_s, group

    def on_reading(self, reading: Reading) -> None:
        """Record whether the sensor works, and whether it is near the ground."""
        name = reading.sensor
        below_m = self._spacing.near_below_m or 0.0
        self._near[name] = reading.range_m is not None and reading.range_m < below_m
        if reading.status.is_fault:
            self._faults[name] += 1
            return
        if self._is_dead(name):
            # The cause of its recovery (a plug, the supply, the bus) may have affected others too: retry them now.
            self._pinged_s = dict.fromkeys(self._pinged_s, float("-inf"))
        self._faults[name] = 0

    def again(self, sensor: str) -> None:
        """Give the sensor the turn after the next one, alone, if other sensors have turns."""
        since_s, count = self._again.get(sensor, (float("-inf"), 0))
        now_s = self._pinged_s[sensor]
        if now_s - since_s > AGAIN_EVERY_S:
            since_s, count = now_s, 0
        if count < AGAIN and len(self._living_groups()) > 1:
            self._again[sensor] = since_s, count + 1
            self._round.appendleft([self._of[sensor]])

    def _is_dead(self, name: str) -> bool:
        return self._faults[name] >= self._dead_after

    def _is_dead_group(self, group: Sequence[PolledSensor]) -> bool:
        return all(self._is_dead(sensor.name) for sensor in group)

    def _living_groups(self) -> list[Sequence[PolledSensor]]:
        return [group for group in self._groups if not self._is_dead_group(group)]

    def _next_round(self, at_s: float) -> Sequence[Sequence[PolledSensor]]:
        are_dead = [self._is_dead(name) for name in self._faults]
        if all(are_dead) or not any(are_dead):
            return self._groups
        living = self._living_groups()
        due = [group for group in self._groups if self._is_dead_group(group) and self._is_due(group[0], at_s)]
        # One retry per cycle: if retries are acknowledged, more of them would delay the working sensors.
        retried = sorted(due, key=lambda group: self._pinged_s[group[0].name])[:1]
        return retried + [
            [each for each in group if not self._is_dead(each.name) or self._is_due(each, at_s)] for group in living
        ]

    def _is_due(self, sensor: PolledSensor, at_s: float) -> bool:
        return at_s - self._pinged_s[sensor.name] >= RETRY_S

    def _spacing_s(self) -> float:
        """Time from the previous turn to the next one [s]."""
        spacing = self._spacing
        if spacing.near_interval_s is None:
            return spacing.ping_interval_s
        living = [name for name in self._near if not self._is_dead(name)]
        is_near = living and all(self._near[name] for name in living)
        return spacing.near_interval_s if is_near else spacing.ping_interval_s
