"""Compare raw ranges before and after a jump of a thermometer: did the air change, or only the thermometer?

A range finder times its echo: when the air goes from T1 to T2 all raw ranges change together by sqrt(T1 / T2), in
kelvin, with the air and not after it. Raw downward ranges before and after the jump are compared: True if they changed
accordingly, False if they did not change, and None if that is undecided, as while the vehicle climbs.
"""

import math
from collections import deque
from itertools import islice, takewhile
from statistics import median

from msp_range.acoustics.air import ZERO_CELSIUS_K

HISTORY_S = 20.0
"""Time for which ranges are kept [s]. For a source that is read less often than every 15 s there are no ranges from
before a jump, and its jumps stay undecided."""
GUARD_S = 2.0
"""Ranges within this time before the last good value are left out [s], because the air changes before a thermometer
does."""
FEWEST_BEFORE, MOST_BEFORE = 24, 64
"""Number of readings for the level before a jump: at least a second of four sensors in turn, at most 6 s. With fewer,
noise (2 cm each) would look like a climb."""
READINGS = 16
"""Number of readings in a comparison with the level before; their median has a standard error of 0.6 cm."""
STAYS_S = 5.0
"""Time for which the comparison must give the same result before it decides [s]."""
READINGS_OF_A_DIP, DIP = 5, 0.5
"""If the median of this many successive readings has moved by this share of the expected change, the ranges have not
stayed constant: an autopilot that holds its height by these distances brings them back within two seconds. With fewer
readings or a smaller share noise leaves more jumps undecided; with more, a change of the air that an autopilot has
corrected is refused."""
OVERLAP_S = 1.0
"""Time for which readings are compared again [s], because a median needs several of them."""
SMALLEST_M = 0.05
"""Changes of the air that change the ranges by less than this stay undecided [m]: 7 deg C at 4 m, 28 at 1 m. Medians of
whole centimetres are accurate to 1 cm. With less, noise decides."""
TOLERANCE = 1 / 3
"""Tolerance as a share of the expected change, for 'changed accordingly' and for 'not changed'."""

Readings = list[tuple[str, float]]
"""Sensor and logarithm of the raw range."""


class RangeHistory:
    """The raw downward ranges of the last seconds."""

    def __init__(self) -> None:
        self._readings: deque[tuple[float, str, float]] = deque()

    def record(self, time_s: float, sensor: str, range_m: float) -> None:
        """Keep a range as the sensor reported it; in the order of their times."""
        self._readings.append((time_s, sensor, range_m))
        while self._readings[0][0] < time_s - HISTORY_S:
            self._readings.popleft()

    def between(self, from_s: float, to_s: float, most: int) -> Readings:
        """The ranges after ``from_s`` and up to ``to_s``, the newest ``most`` of them, in the order of their times."""
        since = takewhile(lambda each: each[0] > from_s, reversed(self._readings))
        newest = islice((each for each in since if each[0] <= to_s), most)
        return [(sensor, math.log(range_m)) for _, sensor, range_m in newest][::-1]


class RangeComparison:
    """Comparison of the ranges since a jump with those before it.

    Parameters
    ----------
    history
        Kept up to date by its owner.
    good_s, jump_s
        Times of the last good value and of the first one at the new level [s].
    """

    def __init__(self, history: RangeHistory, good_s: float, jump_s: float) -> None:
        self._history = history
        self._jump_s = jump_s
        self._compared_s = good_s - GUARD_S
        self._dip = 0.0
        before = history.between(float("-inf"), good_s - GUARD_S, MOST_BEFORE)
        self._before = {name: median([each for sensor, each in before if sensor == name]) for name in dict(before)}
        self._range_m = math.exp(median([log_range for _, log_range in before])) if before else 0.0
        half = len(before) // 2
        self._climbed = float("inf")
        if len(before) >= FEWEST_BEFORE:
            self._climbed = abs(self._change(before[half:]) - self._change(before[:half]))
        self._first_s = float("inf")
        self._least, self._most = float("inf"), float("-inf")

    def update(self, now_s: float) -> None:
        """Compare the newest ranges."""
        if self._climbed == float("inf"):
            return
        new = self._known(self._compared_s, now_s, MOST_BEFORE)
        if len(new) >= READINGS_OF_A_DIP:
            self._compared_s = now_s - OVERLAP_S
            windows = [new[i : i + READINGS_OF_A_DIP] for i in range(len(new) - READINGS_OF_A_DIP + 1)]
            self._dip = max(self._dip, *[abs(self._change(window)) for window in windows])
        known = self._known(self._jump_s, now_s, READINGS)
        if len(known) < READINGS:
            return
        self._first_s = min(self._first_s, now_s)
        change = self._change(known)
        self._least, self._most = min(self._least, change), max(self._most, change)

    def changed(self, now_s: float, from_c: float, to_c: float) -> bool | None:
        """Whether the ranges have changed as they do when the air goes from ``from_c`` to ``to_c``.

        Returns
        -------
        bool or None
            True: changed accordingly all the time since the jump; False: not changed; None: undecided.
        """
        expected = 0.5 * math.log((from_c + ZERO_CELSIUS_K) / (to_c + ZERO_CELSIUS_K))
        tolerance = TOLERANCE * abs(expected)
        if now_s - self._first_s < STAYS_S or abs(expected) * self._range_m < SMALLEST_M or self._climbed > tolerance:
            return None
        if expected - tolerance <= self._least and self._most <= expected + tolerance:
            return True
        if -tolerance <= self._least and self._most <= tolerance and self._dip <= DIP * abs(expected):
            return False
        return None

    def _known(self, from_s: float, to_s: float, most: int) -> Readings:
        return [each for each in self._history.between(from_s, to_s, most) if each[0] in self._before]

    def _change(self, readings: Readings) -> float:
        return median([log_range - self._before[sensor] for sensor, log_range in readings])
