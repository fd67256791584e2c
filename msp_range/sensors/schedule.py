"""The order in which range finders ping, and how far apart.

Groups of sensors ping in turn; the members of a group ping together, which is right only where they cannot hear each
other.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from msp_range.reading import Reading
from msp_range.sensors.base import RangeSensor


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
