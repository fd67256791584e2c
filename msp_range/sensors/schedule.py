"""The order in which range finders ping, and the time between pings.

Groups of sensors ping in turn; the members of a group ping together, which is allowed only if they cannot receive each
other's echoes. The turns of sensors that do not answer are given to those that do.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from pydantic import Field

from msp_range.reading import Reading
from msp_range.sensors.base import RangeSensor
from msp_range.yaml_file import Section

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


class AnswerTiming(NamedTuple):
    """Times at which a sensor can be read, relative to its ping [s]."""

    first_answer_s: float
    """Earliest possible answer."""
    deadline_s: float
    """Last attempt to read."""
    echo_s_per_m: float = 5.8e-3
    """Two-way time of flight that the sensor assumes per metre of range [s/m]."""
    sent_s: float | None = None
    """Time from a measurement's ping to its answer, of a sensor that measures by itself; None: it is pinged."""


class PolledSensor(NamedTuple):
    """A sensor with its name in the airframe, its timing, and the spread of its readings.

    The standard deviation of a reading of range z is sqrt(std_m^2 + (std_growth z)^2) [m]; None: unknown.
    """

    name: str
    device: RangeSensor
    timing: AnswerTiming
    std_m: float | None = None
    std_growth: float = 0.0


class Near(Section):
    """Faster pings near the ground, where echoes die away sooner."""

    below_m: float = Field(gt=0, le=10)
    """while all sensors read less than this [m]"""
    ping_interval_s: float = Field(ge=0.03, le=1)
    """time between pings there [s]"""


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


@dataclass(slots=True, eq=False)
class _Turns:
    """A sensor, and what decides its turns."""

    sensor: PolledSensor
    is_near: bool = False
    faults: int = 0
    pinged_s: float = -math.inf
    again_since_s: float = -math.inf
    again: int = 0
    """Number of extra turns since ``again_since_s``."""


class RoundRobin:
    """Endless turns of all groups, in fixed intervals; turns of dead sensors are given to the others.

    A sensor is dead after ``dead_after`` successive faults, until it gives an answer that is not a fault. A cycle has a
    turn for each group with a working sensor, and at most one for a dead group that is due for a retry; a dead sensor
    of a working group is retried in the group's turn. A retry that is not acknowledged takes no time from the next
    turn. If all sensors are dead, all of them keep their turns.

    Parameters
    ----------
    groups
        Groups of sensors that ping together, in the order of their turns.
    interval_s
        Time from one group's ping to the next one's [s], in which the echoes die away.
    start_s
        Time of the first turn [s].
    near
        Faster pings while every working sensor's last answer is near; None: never.
    dead_after
        Number of successive faults; infinity: every sensor keeps its turns.
    """

    def __init__(
        self,
        groups: Sequence[Sequence[PolledSensor]],
        interval_s: float,
        start_s: float,
        near: Near | None = None,
        dead_after: float = DEAD_AFTER,
    ) -> None:
        if not groups or not all(groups):
            raise ValueError(f"every polling group needs at least one sensor; found {groups!r}")
        self._groups = [[_Turns(sensor) for sensor in group] for group in groups]
        self._of = {member.sensor.name: member for group in self._groups for member in group}
        self._interval_s = interval_s
        self._near = near
        self._dead_after = dead_after
        self._round: deque[Sequence[_Turns]] = deque()
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
        for member in group:
            member.pinged_s = at_s
        self._is_retry = self._are_dead(group) and bool(self._living_groups())
        return at_s, [member.sensor for member in group]

    def on_reading(self, reading: Reading) -> None:
        """Record whether the sensor works, and whether it is near the ground."""
        turns = self._of[reading.sensor]
        if self._near is not None:
            turns.is_near = reading.range_m is not None and reading.range_m < self._near.below_m
        if reading.status.is_fault:
            turns.faults += 1
            return
        if self._is_dead(turns):
            # The cause of its recovery (a plug, the supply, the bus) may have affected others too: retry them now.
            for other in self._of.values():
                other.pinged_s = -math.inf
        turns.faults = 0

    def again(self, sensor: str) -> None:
        """Give the sensor the turn after the next one, alone, if other sensors have turns."""
        turns = self._of[sensor]
        if turns.pinged_s - turns.again_since_s > AGAIN_EVERY_S:
            turns.again_since_s, turns.again = turns.pinged_s, 0
        if turns.again < AGAIN and len(self._living_groups()) > 1:
            turns.again += 1
            self._round.appendleft([turns])

    def _is_dead(self, turns: _Turns) -> bool:
        return turns.faults >= self._dead_after

    def _are_dead(self, group: Sequence[_Turns]) -> bool:
        return all(map(self._is_dead, group))

    def _living_groups(self) -> list[list[_Turns]]:
        return [group for group in self._groups if not self._are_dead(group)]

    def _next_round(self, at_s: float) -> Sequence[Sequence[_Turns]]:
        living = self._living_groups()
        if not living or not any(map(self._is_dead, self._of.values())):
            return self._groups
        due = [group for group in self._groups if self._are_dead(group) and at_s - group[0].pinged_s >= RETRY_S]
        # One retry per cycle: if retries are acknowledged, more of them would delay the working sensors.
        retried = sorted(due, key=lambda group: group[0].pinged_s)[:1]
        return retried + [
            [member for member in group if not self._is_dead(member) or at_s - member.pinged_s >= RETRY_S]
            for group in living
        ]

    def _spacing_s(self) -> float:
        """Time from the previous turn to the next one [s]."""
        if self._near is None:
            return self._interval_s
        working = [turns for turns in self._of.values() if not self._is_dead(turns)]
        is_near = working and all(turns.is_near for turns in working)
        return self._near.ping_interval_s if is_near else self._interval_s
