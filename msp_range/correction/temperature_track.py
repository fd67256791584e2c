"""The value of one temperature source over time: which values are credible, and how accurate they are now.

It is updated with the reported values in the order of their times, and gives an `Air`. A value that air and thermometer
can have reached since the previous one is good. Any other is a jump: the new level is unconfirmed, and the last good
value is held with a standard deviation that covers both, until `msp_range.correction.air_temperature` decides. A source
that jumps again and again flaps: its last good value is held in the same way, and no other source is compared with it.
"""

import math
from collections import deque

from msp_range.acoustics.air import HELD, Air
from msp_range.correction.range_comparison import RangeComparison, RangeHistory
from msp_range.correction.settling import Settling
from msp_range.correction.temperature import COLDEST_C, HOTTEST_C, FileSource, MavlinkSource

AGE_C_PER_S = 0.02
"""Growth of a value's standard deviation with its age [deg C/s]: 1.2 per minute. A climb at 3 m/s in the standard
atmosphere and the passage of a cold front both change the air by 0.02 per second. With less, a dead thermometer is
trusted longer; with 0.02 its value is as uncertain as the fixed temperature after 10 minutes."""
JUMP_C = 3.0
"""A change by up to this much beyond what the source's rate allows is not a jump [deg C]: it changes a distance by 0.5
%, and happens to thermometers in gusts and shadows. With less those count as jumps, with more faults pass."""
FIRST_VALUES = 3
"""A first level of fewer values is replaced by the next one [values], once: some autopilots send a zero before their
first measurement. With more, a thermometer that fails in its first seconds is believed."""
FLAPS, FLAP_MEMORY_S = 2, 60.0
"""A source flaps, as with a loose contact, if it jumps this many times and comes back within this time [s]; a single
damaged value is one jump. With more jumps or a shorter time its wrong levels are followed for longer; with a longer
time it is doubted for longer after it has healed."""
STEADY_C = 2.0
"""Largest variation of a steady level [deg C]."""
COVERS = 0.55
"""Standard deviation that covers two levels, as a share of their difference: 1 / 1.96 and some more, so that each is
within the other's 95 % interval."""
BELIEVED_AFTER_S = 300.0
"""Time after which the new level of a jump is used if it was steady and nothing contradicts it [s]: five time constants
of a slow thermometer in still air (60 s), so a vehicle carried into cold air is right after that at the latest. Longer
keeps the old temperature with a large variance for longer, shorter believes a faulty thermometer sooner."""


class Level:
    """A level that follows values which it can reach.

    Attributes
    ----------
    since_s
        Time of the first value [s].
    time_s, value_c
        Time and value of the newest one [s, deg C].
    settling
        How far the air may be ahead of it.
    """

    def __init__(self, time_s: float, value_c: float, is_switched_on: bool = False) -> None:
        self.since_s = self.time_s = time_s
        self.value_c = value_c
        self.settling = Settling(time_s, value_c, is_switched_on)
        self._slack_c = JUMP_C

    def reaches(self, time_s: float, value_c: float, allowed_c: float) -> bool:
        """Follow to ``value_c`` if the change is within ``allowed_c`` plus the rest of `JUMP_C`; return whether it
        is."""
        change_c, allowed_c = value_c - self.value_c, allowed_c + self._slack_c
        is_near = abs(change_c) <= allowed_c
        if is_near:
            self.time_s, self.value_c = time_s, value_c
            self.settling.update(time_s, value_c)
            allowed_c -= abs(change_c)
        self._slack_c = min(allowed_c, JUMP_C)
        return is_near


class Jump(Level):
    """A level that a source has reached faster than air changes.

    Attributes
    ----------
    since_s
        Time at which the source left its last good level [s].
    steady_since_s
        Time since which the values have stayed within `STEADY_C` [s].
    refused
        True once another source or the ranges have contradicted it.
    ranges
        Comparison of the ranges since then with those before.
    """

    def __init__(self, since_s: float, time_s: float, level_c: float, ranges: RangeComparison) -> None:
        super().__init__(time_s, level_c)
        self.since_s, self.steady_since_s = since_s, time_s
        self.refused = False
        self.ranges = ranges
        self._anchor_c = level_c

    def reaches(self, time_s: float, value_c: float, allowed_c: float) -> bool:
        """Follow to the next value if it is near enough; a level that moves away is no longer refused."""
        if not super().reaches(time_s, value_c, allowed_c):
            return False
        if abs(value_c - self._anchor_c) > STEADY_C:
            self._anchor_c, self.steady_since_s = value_c, time_s
            self.refused = False
        return True


class TemperatureTrack:
    """The values of one source.

    Parameters
    ----------
    source
        The source in the airframe file.
    history
        The raw downward ranges.

    Attributes
    ----------
    source
        The source.
    jump
        The unconfirmed level, or None.
    """

    def __init__(self, source: FileSource | MavlinkSource, history: RangeHistory) -> None:
        self.source = source
        self.jump: Jump | None = None
        self._history = history
        self._std_c = source.error_std_c
        self._good: Level | None = None
        self._reported_s = float("-inf")
        self._values = 0  # of the good level; up to `FIRST_VALUES` without a jump between them, nor while it flaps
        self._departures: deque[tuple[float, float]] = deque(maxlen=FLAPS)  # times [s], and the other level [deg C]

    def update(self, time_s: float, reported_c: float) -> None:
        """Update with a value of the source."""
        source = self.source
        air_c = reported_c - source.bias_c
        if not COLDEST_C <= air_c <= HOTTEST_C:
            return
        silent_s = time_s - self._reported_s
        self._reported_s = time_s
        # After a silence the air may have changed by the standard deviation of the held value.
        allowed_c = source.max_rate_c_per_s * min(silent_s, source.max_age_s) + 2 * AGE_C_PER_S * silent_s
        if self._good is None:
            self._start(time_s, air_c)
        elif self._good.reaches(time_s, air_c, allowed_c):
            self._values += self.flapping_c(time_s) is None
            self.jump = None
        elif self._values < FIRST_VALUES and not self._departures:
            self._departures.append((time_s, self._good.value_c))
            self._start(time_s, air_c)
        elif self.jump is None or not self.jump.reaches(time_s, air_c, allowed_c):
            since_s = self.jump.since_s if self.jump else time_s
            if self.jump is None:
                self._departures.append((time_s, air_c))
                self._values = 0 if self._values < FIRST_VALUES else self._values
            self.jump = Jump(since_s, time_s, air_c, RangeComparison(self._history, self._good.time_s, time_s))

    def _start(self, time_s: float, air_c: float) -> None:
        self._good, self.jump = Level(time_s, air_c, self.jump is None), None
        self._values = 1

    def confirm(self, doubt_c: float = 0.0) -> None:
        """Accept the jump; ``doubt_c`` remains as a standard deviation [deg C]."""
        assert self.jump is not None
        self._std_c = math.hypot(self.source.error_std_c, doubt_c)
        self._departures.clear()
        self._start(self._reported_s, self.jump.value_c)

    @property
    def doubt_c(self) -> float:
        """Standard deviation that covers the last good level and that of a jump [deg C].

        After a refused jump the source is wrong at one of the two levels. It is the new one if the source had been good
        for as long as it takes for a level to be accepted; otherwise it may have been wrong from its start.
        """
        jump, good = self.jump, self._good
        if jump is None or good is None or (jump.refused and jump.since_s - good.since_s >= BELIEVED_AFTER_S):
            return 0.0
        return COVERS * abs(jump.value_c - good.value_c)

    def flapping_c(self, now_s: float) -> tuple[float, float] | None:
        """Lowest and highest level of a source that flaps [deg C]; None: it does not."""
        left = self._departures
        if self._good is None or len(left) < FLAPS or left[0][0] < now_s - FLAP_MEMORY_S:
            return None
        left_c = [level_c for _, level_c in left]
        return min(*left_c, self._good.value_c), max(*left_c, self._good.value_c)

    @property
    def settling(self) -> Settling | None:
        """How far the air may be ahead of the newest level; None before the first."""
        level = self._good if self.jump is None or self.jump.refused else self.jump
        return None if level is None else level.settling

    @property
    def settles(self) -> bool:
        """Whether the source settles."""
        return self.settling is not None and self.settling.lag_c != 0.0

    def good(self, now_s: float) -> Air | None:
        """The last good value; its standard deviation covers the source's error and the value's age. None before the
        first.

        Its source is `HELD` if it is older than the source's limit, or the source has jumped or flaps.
        """
        good, silent_s = self._good, now_s - self._reported_s
        if good is None:
            return None
        is_new = self.jump is None and silent_s <= self.source.max_age_s and self.flapping_c(now_s) is None
        std_c = math.hypot(self._std_c, AGE_C_PER_S * max(now_s - good.time_s, 0.0))
        return Air(good.value_c, std_c, self.source.name if is_new else HELD)

    def air(self, now_s: float, good: Air) -> Air:
        """The result of `good` with its lag corrected, and its full uncertainty: of the lag, a jump and flapping.

        Of a source that has flapped from its start, neither level is better than the other: the middle is used.
        """
        doubt_c, flapping_c = self.doubt_c, self.flapping_c(now_s)
        if flapping_c is not None:
            lowest_c, highest_c = flapping_c
            doubt_c = COVERS * (highest_c - lowest_c)
            if self._values < FIRST_VALUES:
                good = good._replace(temperature_c=(lowest_c + highest_c) / 2)
        settling = self.settling
        if settling is None:
            return good
        std_c = math.hypot(good.std_c, doubt_c, settling.std_c)
        return good._replace(temperature_c=good.temperature_c + settling.ahead_c, std_c=std_c)

    def reported(self, now_s: float) -> Air | None:
        """The present value, confirmed or not; None if the source is silent or flaps."""
        if self._good is None or now_s - self._reported_s > self.source.max_age_s or self.flapping_c(now_s):
            return None
        level = self.jump or self._good
        return Air(level.value_c, self._std_c, self.source.name)
