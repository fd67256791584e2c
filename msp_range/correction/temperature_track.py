"""The value of one temperature source over time: which of its values are the air's, and how well they hold now.

Reported values enter, in the order of their times; an `Air` leaves. A value that the air and a thermometer can have
reached since the one before is good. Any other is a jump: the new level stays unconfirmed, and the last good value is
held with a deviation that covers both, until somebody decides (`msp_range.correction.air_temperature`).
"""

import math

from msp_range.acoustics.air import HELD, Air
from msp_range.correction.range_comparison import RangeComparison, RangeHistory
from msp_range.correction.temperature import COLDEST_C, HOTTEST_C, FileSource, MavlinkSource

AGE_C_PER_S = 0.02
"""How much the deviation of a value grows with its age [deg C/s]: 1.2 a minute. A climb at 3 m/s passes through 0.02 a
second of the standard atmosphere, the passage of a cold front is as fast. Smaller: a dead thermometer is trusted for
longer; with 0.02 its value is as good as the fixed temperature after 10 minutes."""
LAG_S, RATE_MEMORY_S = 20.0, 5.0
"""While a thermometer's value changes, the air is ahead of it by the rate times its time constant [s]: 5 (an SHT4x on
a board) to 20 (a DS18B20 in its can) in moving air. So much is added to the deviation; the rate is a mean over the
second number [s]. Larger: a larger variance while the air changes."""
SHORTEST_S = 0.1
"""Values that are closer together in time show no rate [s]: they came in one packet."""
JUMP_C = 3.0
"""A change by this beyond what the source's rate allows is no jump, however fast [deg C]: it moves a distance by 0.5 %.
Thermometers in gusts and in the sun's shadow do so. Smaller: those count as jumps; larger: faults pass."""
FIRST_VALUES = 3
"""A level of fewer values is given up for the next one [values]: some autopilots send a zero before their first
measurement. More: a thermometer that fails in its first seconds is believed."""
STEADY_C = 2.0
"""A level that stays within this is steady [deg C]."""
COVERS = 0.55
"""Standard deviation that covers two levels, as a share of their difference: each is within 95 % of the other."""
BELIEVED_AFTER_S = 300.0
"""A jump's new level that was steady for this long and that nothing contradicts is believed [s]. It is five time
constants of a slow thermometer in still air (60 s): a vehicle carried into the cold is right after that at the latest.
Longer: it flies longer with the old temperature and a large variance; shorter: a faulty thermometer is believed
sooner."""


class Level:
    """A value that follows those that it can reach.

    Attributes
    ----------
    since_s
        Time of the first value [s].
    time_s, value_c
        The newest [s, deg C].
    rate_c_per_s
        How fast it changes [deg C/s].
    """

    def __init__(self, time_s: float, value_c: float) -> None:
        self.since_s = self.time_s = time_s
        self.value_c = value_c
        self.rate_c_per_s = 0.0
        self._slack_c = JUMP_C

    def reaches(self, time_s: float, value_c: float, allowed_c: float) -> bool:
        """Follow to ``value_c`` where that is ``allowed_c`` and what is left of `JUMP_C` away; whether it is."""
        change_c, allowed_c = value_c - self.value_c, allowed_c + self._slack_c
        is_near = abs(change_c) <= allowed_c
        if is_near:
            elapsed_s = max(time_s - self.time_s, SHORTEST_S)
            share = 1 - math.exp(-elapsed_s / RATE_MEMORY_S)
            self.rate_c_per_s += share * (change_c / elapsed_s - self.rate_c_per_s)
            self.time_s, self.value_c = time_s, value_c
            allowed_c -= abs(change_c)
        self._slack_c = min(allowed_c, JUMP_C)
        return is_near


class Jump:
    """A level that a source has reached faster than the air changes.

    Attributes
    ----------
    level
        Where it is.
    since_s
        When the source left its last good level [s].
    steady_since_s
        Since when the values have stayed within `STEADY_C` [s].
    refused
        True once another source or the ranges have shown that it is not the air's.
    ranges
        The ranges since then against those before.
    """

    def __init__(self, since_s: float, time_s: float, level_c: float, ranges: RangeComparison) -> None:
        self.level = Level(time_s, level_c)
        self.since_s, self.steady_since_s = since_s, time_s
        self.refused = False
        self.ranges = ranges
        self._anchor_c = level_c

    def reaches(self, time_s: float, level_c: float, allowed_c: float) -> bool:
        """Follow to the next value where it is near enough; a level that moves away is no longer refused."""
        if not self.level.reaches(time_s, level_c, allowed_c):
            return False
        if abs(level_c - self._anchor_c) > STEADY_C:
            self._anchor_c, self.steady_since_s = level_c, time_s
            self.refused = False
        return True


class TemperatureTrack:
    """One source.

    Parameters
    ----------
    source
        As in the airframe file.
    history
        The raw downward ranges.

    Attributes
    ----------
    name
        The source's.
    jump
        The level that is not confirmed; None: there is none.
    """

    def __init__(self, source: FileSource | MavlinkSource, history: RangeHistory) -> None:
        self.name = source.name
        self.jump: Jump | None = None
        self._source = source
        self._history = history
        self._std_c = source.error_std_c
        self._good: Level | None = None
        self._reported_s = float("-inf")
        self._values = 0  # of the good level

    def update(self, time_s: float, reported_c: float) -> None:
        """Take a value as the source reported it."""
        source = self._source
        air_c = reported_c - source.bias_c
        if not COLDEST_C <= air_c <= HOTTEST_C:
            return
        silent_s = time_s - self._reported_s
        self._reported_s = time_s
        # After a silence the air may be as far away as the deviation of the held value.
        allowed_c = source.max_rate_c_per_s * min(silent_s, source.max_age_s) + 2 * AGE_C_PER_S * silent_s
        if self._good is None:
            self._start(time_s, air_c)
        elif self._good.reaches(time_s, air_c, allowed_c):
            self._values += 1
            self.jump = None
        elif self._values < FIRST_VALUES:
            self._start(time_s, air_c)
        elif self.jump is None or not self.jump.reaches(time_s, air_c, allowed_c):
            since_s = time_s if self.jump is None else self.jump.since_s
            self.jump = Jump(since_s, time_s, air_c, RangeComparison(self._history, self._good.time_s, time_s))

    def _start(self, time_s: float, air_c: float) -> None:
        self._good, self.jump = Level(time_s, air_c), None
        self._values = 1

    def confirm(self, doubt_c: float = 0.0) -> None:
        """The jump was the air's; ``doubt_c`` stays as a standard deviation [deg C]."""
        assert self.jump is not None
        self._std_c = math.hypot(self._source.error_std_c, doubt_c)
        self._start(self._reported_s, self.jump.level.value_c)

    @property
    def doubt_c(self) -> float:
        """Standard deviation that covers the last good level and that of a jump [deg C].

        A jump that is refused shows that the source is wrong at one of the two. That is the new one where the source
        had been good for as long as a level takes to be believed; before that it may have been wrong from its start.
        """
        jump, good = self.jump, self._good
        if jump is None or good is None or (jump.refused and jump.since_s - good.since_s >= BELIEVED_AFTER_S):
            return 0.0
        return COVERS * abs(jump.level.value_c - good.value_c)

    def is_new(self, now_s: float) -> bool:
        """True where the source has a good value that is not older than its limit."""
        return self.jump is None and self._good is not None and now_s - self._good.time_s <= self._source.max_age_s

    def good(self, now_s: float) -> Air | None:
        """The last good value, and its deviation with its age alone; None before there was one."""
        if self._good is None:
            return None
        std_c = math.hypot(self._std_c, AGE_C_PER_S * max(now_s - self._good.time_s, 0.0))
        return Air(self._good.value_c, std_c, self.name if self.is_new(now_s) else HELD)

    def air(self, good: Air) -> Air:
        """What `good` has returned, with all that makes it uncertain: what it lags behind, and a jump that is open."""
        level = self._good if self.jump is None or self.jump.refused else self.jump.level
        lag_c = 0.0 if level is None else LAG_S * level.rate_c_per_s
        return good._replace(std_c=math.hypot(good.std_c, self.doubt_c, lag_c))

    def reported(self, now_s: float) -> Air | None:
        """What the source reports now, confirmed or not; None where it is silent."""
        if self._good is None or now_s - self._reported_s > self._source.max_age_s:
            return None
        level = self._good if self.jump is None else self.jump.level
        return Air(level.value_c, self._std_c, self.name)
