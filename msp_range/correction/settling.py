"""How far the air is ahead of a thermometer that settles, as in a housing that has come from a hall into the cold.

Values of one source enter in order of time, `Settling.lag_c` leaves. A thermometer with the time constant tau follows
its air by dx/dt = (air - x) / tau, so the air is ahead of a reading x by tau dx/dt. Tau is not known: the largest
counts once the reading has moved by more than it does in sun and shade, until it hardly moves any more.
"""

from collections import deque

SLOWEST_S = 120.0
"""Time constant of the slowest thermometer [s], one in a closed housing; in moving air it is 5 s (an SHT4x on a board)
to 20 s (a DS18B20 in its can). It is the lag per rate. Larger states a larger variance while any thermometer settles,
smaller does not cover such a housing."""
ORDINARY_C = 2.5
"""A change by up to this much is no settling [deg C]: 2 between sun and shade, and a step of 0.5 of a coarse
thermometer. With less, shadows count; with more, settling is recognised later: the slowest thermometer in air that is
35 C colder after 10 s, in air that is 10 C colder after 36 s, and below 3 C, where the lag is within the thermometer's
own 95 %, never."""
ORDINARY_NOISES = 6.0
"""The same in standard deviations of the thermometer's noise, in addition. The difference of two values has 1.4, and
that of the extremes of `MEMORY_S` five; with less, noise of 0.5 C counts as settling."""
LARGEST_C = 40.0
"""Largest difference between two airs [deg C]: a hall at 20 and a winter's day of -20. The reading still has what is
left of it before it. Larger states a larger variance for quick thermometers."""
MEMORY_S = 90.0
"""Time within which a change counts [s]. Longer takes a long descent (0.02 C/s at 3 m/s) for settling, shorter forgets
the slowest thermometer."""
RATE_S = 15.0
"""Time over which the rate is measured [s]. Shorter measures the noise, longer keeps a large variance for longer after
a quick thermometer has settled."""
SETTLED_C = 2.0
"""A thermometer has settled when the lag is below this [deg C], about one standard deviation of a good thermometer.
With less, noise prolongs settling."""
SPACING_S = 0.9
"""Shortest time between two values that are kept [s]: an autopilot may send 50 per second, and one per second is
enough. Longer recognises settling later."""
FIRST_NOISE_C, NOISE_VALUES = 0.5, 30
"""Noise assumed at the start [deg C], and the number of values over which it is averaged. With less than 0.5, noisy
thermometers seem to settle when they are switched on; with fewer values, at any time."""
PER_NOISE = 1.95
"""Mean size of the second difference of white noise, per standard deviation: sqrt(6) sqrt(2 / pi)."""


class Settling:
    """The recent values of a source.

    Attributes
    ----------
    lag_c
        How much warmer the air is at most than the newest value, negative if colder [deg C]; 0: it does not settle.
    """

    def __init__(self, time_s: float, value_c: float) -> None:
        self.lag_c = 0.0
        self._values = deque([(time_s, value_c)])
        self._start: tuple[float, float] | None = None  # Time [s] and value [deg C] before it began to settle.
        self._noise_c, self._noises = FIRST_NOISE_C, 1

    def update(self, time_s: float, value_c: float) -> None:
        """Update with the next value."""
        values = self._values
        if time_s - values[-1][0] < SPACING_S:
            return
        if len(values) > 1:
            self._noises = min(self._noises + 1, NOISE_VALUES)
            second_c = abs(value_c - 2 * values[-1][1] + values[-2][1])
            self._noise_c += (second_c / PER_NOISE - self._noise_c) / self._noises
        while len(values) > 1 and values[0][0] < time_s - MEMORY_S:
            values.popleft()
        ordinary_c = ORDINARY_C + ORDINARY_NOISES * self._noise_c
        if self._start is None:
            self._start = next((past for past in reversed(values) if abs(value_c - past[1]) > ordinary_c), None)
        if self._start is not None:
            # Of the last seconds only: the change may be over by now.
            since_s = max(self._start[0], time_s - RATE_S)
            past_s, past_c = next((past for past in reversed(values) if past[0] <= since_s), values[0])
            left_c = max(LARGEST_C - abs(value_c - self._start[1]), 0.0)
            lag_c = SLOWEST_S * (value_c - past_c) / (time_s - past_s)
            self.lag_c = min(max(lag_c, -left_c), left_c)
        if self._start is not None and abs(self.lag_c) < SETTLED_C:
            self._start, self.lag_c = None, 0.0
            values.clear()
        values.append((time_s, value_c))
