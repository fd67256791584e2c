"""How far the air is ahead of a thermometer that settles, as in a housing that has come from a hall into the cold.

The lag is estimated from one source's values in the order of their times. A thermometer with the time constant tau
follows its air by dx/dt = (air - x) / tau, so the air is ahead of a reading x by tau dx/dt. Tau is not known. Once the
reading has moved by more than it does in sun and shade, and until it hardly moves any more, the largest tau says how
far the air may be ahead, and how the reading bends says how far it probably is: x = air - lag e^(-t / tau), with t = 0
now, is fitted for several tau, which count by how well they fit.
"""

import math
import operator
from collections import deque
from itertools import pairwise
from statistics import correlation, median

SLOWEST_S = 120.0
"""Time constant of the slowest thermometer [s], one in a closed housing; in moving air it is 5 s (an SHT4x on a board)
to 20 s (a DS18B20 in its can). It is the lag per rate. Larger states a larger variance while any thermometer settles,
smaller does not cover such a housing."""
ORDINARY_C = 2.5
"""A change by up to this much is no settling [deg C]: 2 between sun and shade, and a step of 0.5 of a coarse
thermometer. With less, shadows count; with more, settling is recognised later: the slowest thermometer in air that is
35 C colder after 10 s, in air that is 10 C colder after 36 s, and below 3 C, where the lag is within the thermometer's
own 95 %, never."""
SWITCHED_ON_S, SWITCHED_ON_C = 10.0, 1.0
"""In the first seconds [s] a change by this much already counts as settling [deg C], apart from its largest step, which
a take-off out of warm air makes: a vehicle is switched on where it has just been carried to. Longer reports shadows,
shorter lets a vehicle that takes off at once fly with a distance that is 6 % off."""
STRAIGHT_NATS = 9.0
"""A thermometer settles if a straight line is likelier than a constant by this much, with a noise that is not known
[nats]: the noise of the few first values says little. Five values show it at ten standard errors of the slope, ten
values at six; a step gives less than eight. Less reports noise, more reports later."""
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
TAUS_S = (5.0, 10.0, 20.0, 40.0, 60.0, 90.0, SLOWEST_S)
"""Time constants that are tried [s]: each as likely as the next before the fit. Fewer make the correction jump from one
to the next, more cost processor time once a second."""
FITTED_VALUES = 4
"""With fewer values nothing is corrected: two show only a rate. With more the correction starts later."""
LAG_STD_C = 15.0
"""Standard deviation of a lag before the fit [deg C]: 40 is the largest. Larger follows the fit of a few values."""
LEVEL_VALUES, LEVEL_NOISES = 9, 2.5
"""The level before settling is the median of the first number of values; settling begins at the value that is farther
from it than the second number of standard deviations of the noise. With an earlier beginning a quick thermometer looks
slow."""
LEAST_NOISE_C = 0.1
"""Least scatter about the fitted curve [deg C]: steps of a thermometer, and air that is not the same everywhere.
Smaller decides for one time constant after fewer values."""
LAG_SHARE = 1 / math.sqrt(12)
"""Least standard deviation of the lag, as a share of its largest value: that of a uniform distribution from 0 to it. A
housing has more than one time constant; smaller trusts the fitted form."""
FASTEST_C_PER_S = 2.0
"""The lag is corrected for no faster than this [deg C/s]: 2 cm/s at 6 m, slower than a vehicle that lands. Faster moves
the distance like a climb, slower leaves it wrong for longer."""
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

    Parameters
    ----------
    time_s, value_c
        Of the first one.
    is_switched_on
        Whether the source begins here, and has not jumped to this value.

    Attributes
    ----------
    lag_c
        How much warmer the air is at most than the newest value, negative if colder [deg C]; 0: it does not settle.
    ahead_c, std_c
        How much warmer it probably is, at no more than `FASTEST_C_PER_S`, and the standard deviation of that [deg C].
    """

    def __init__(self, time_s: float, value_c: float, is_switched_on: bool = True) -> None:
        self.lag_c = self.ahead_c = self.std_c = 0.0
        self._values = deque([(time_s, value_c)])
        self._start: tuple[float, float] | None = None  # Time [s] and value [deg C] before it began to settle.
        self._begun_s = time_s
        self._until_s = time_s + SWITCHED_ON_S if is_switched_on else time_s  # So long little is settling.
        self._noise_c, self._noises = FIRST_NOISE_C, 1

    def update(self, time_s: float, value_c: float) -> None:
        """Update with the next value."""
        values = self._values
        elapsed_s = time_s - values[-1][0]
        if elapsed_s < SPACING_S:
            return
        if len(values) > 1:
            self._noises = min(self._noises + 1, NOISE_VALUES)
            second_c = abs(value_c - 2 * values[-1][1] + values[-2][1])
            self._noise_c += (second_c / PER_NOISE - self._noise_c) / self._noises
        while len(values) > 1 and values[0][0] < time_s - MEMORY_S:
            values.popleft()
        if self._start is None:
            least_c = ORDINARY_C + ORDINARY_NOISES * self._noise_c
            self._start = next((past for past in reversed(values) if abs(value_c - past[1]) > least_c), None)
            if self._start is None and time_s < self._until_s:
                all_c = [*[past_c for _, past_c in values], value_c]
                largest_c = max([after_c - before_c for before_c, after_c in pairwise(all_c)], key=abs)
                if abs(value_c - all_c[0] - largest_c) > SWITCHED_ON_C and _straight_nats(all_c) > STRAIGHT_NATS:
                    self._start = values[0]
            if self._start is not None:
                # The last value that is that of before it began to settle.
                before_s = self._start[0]
                level_c = median([past_c for past_s, past_c in values if past_s <= before_s][-LEVEL_VALUES:])
                near_c = LEVEL_NOISES * max(self._noise_c, LEAST_NOISE_C)
                level_s = [past_s for past_s, past_c in values if abs(past_c - level_c) <= near_c]
                self._begun_s = max(level_s, default=before_s)
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
        probable_c, self.std_c = (0.0, 0.0) if self._start is None else self._fitted(self._begun_s, time_s)
        most_c = FASTEST_C_PER_S * elapsed_s
        self.ahead_c += min(max(probable_c - self.ahead_c, -most_c), most_c)
        self.std_c = math.hypot(max(self.std_c, LAG_SHARE * abs(self.lag_c)), probable_c - self.ahead_c)

    def _fitted(self, since_s: float, now_s: float) -> tuple[float, float]:
        """Mean and standard deviation of the lag by the values since a time [deg C].

        For each tau, with e = e^((now - t) / tau) and the prior of the lag L ~ N(0, LAG_STD_C^2):
        L = -S_xe / (S_ee + s^2 / LAG_STD_C^2), S sums of squares about the means and s the noise.
        """
        values = [(now_s - past_s, past_c) for past_s, past_c in self._values if past_s >= since_s]
        if len(values) < FITTED_VALUES:
            return 0.0, abs(self.lag_c) / math.sqrt(3)
        noise_c2 = max(self._noise_c, LEAST_NOISE_C) ** 2
        lags_c, variances, logs = [], [], []
        mean_c = sum(past_c for _, past_c in values) / len(values)
        for tau_s in TAUS_S:
            grown = [math.exp(age_s / tau_s) for age_s, _ in values]
            mean = sum(grown) / len(grown)
            square = sum((growth - mean) ** 2 for growth in grown) + noise_c2 / LAG_STD_C**2
            product = sum(
                (growth - mean) * (past_c - mean_c) for growth, (_, past_c) in zip(grown, values, strict=True)
            )
            lags_c.append(-product / square)
            variances.append(noise_c2 / square)
            logs.append(0.5 * product * product / square / noise_c2 - 0.5 * math.log(square))
        weights = [math.exp(log - max(logs)) for log in logs]
        total = sum(weights)
        lag_c = sum(map(operator.mul, weights, lags_c)) / total
        squares = [own + (each - lag_c) ** 2 for own, each in zip(variances, lags_c, strict=True)]
        spread = sum(map(operator.mul, weights, squares)) / total
        low_c, high_c = sorted((0.0, self.lag_c))
        return min(max(lag_c, low_c), high_c), min(math.sqrt(spread), abs(self.lag_c))


def _straight_nats(values: list[float]) -> float:
    """Log likelihood ratio of a straight line over a constant, noise unknown: -n/2 log(1 - r^2), r the correlation."""
    try:
        return -0.5 * len(values) * math.log1p(-(correlation(range(len(values)), values) ** 2))
    except ValueError:  # Only of a line without any noise: that the values differ is known.
        return math.inf
