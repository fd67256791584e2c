"""Run histories: what a range may have done lately, as a weighted set of hypotheses, for many streams at once.

It filters many streams at once, a reading of each per step, and gives the posterior median of the range and the
variance about it. The bridge has one stream (`msp_range.filters.changepoint`), a study has one per seed.

A hypothesis is the history since its last change, with a Gaussian of range x and rate v; a stationary one has v = 0
without variance. Between two readings, T apart, a history either continues, or has a

    slope change   x continues; v changes by N(0, (BEND_M_S2 T)^2), is drawn again from N(0, TURN_M_S^2), or becomes 0
    level change   x is drawn again, uniform over all that the sensor can report; v becomes 0 or is kept

Both happen at rates that each hypothesis estimates from its own changes, as Gamma(a + count, b + time). A reading y
comes from the surface, N(y; x, R), with the weight of hits, or it is an outlier (`RangeLikelihood.outlier_density`).
Within a history both cases are merged by their moments (the probabilistic data association filter, Bar-Shalom and Tse
1975): beta is the probability of a hit, K the Kalman gain, r = y - x and S = P + R, and

    x' = x + beta K r        P' = P - beta K S K^T + beta (1 - beta) K r^2 K^T

After a level change whose first reading is an outlier the state is 'unlocated': no hypothesis knows x. Only the
HYPOTHESES limit probable histories are kept, so the cost of a step is constant.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from msp_range.arrays import Array, Flags, Indices
from msp_range.reading_model.kernel import Hit, Short
from msp_range.reading_model.sensor_model import MixtureParameters

HYPOTHESES = 24
"""Number of histories that are kept; twice as many change no figure of the filter study by more than 1 %."""
PRIOR_CHANGES, PRIOR_TIME_S = 0.1, 1.0
"""Prior a and b of the rate of each kind of change: that many changes in that time [1, s]. A higher rate follows
changes sooner and smooths less, until a history has estimated its own."""
RATES_MEMORY_S = 60.0
"""Time constant with which past changes and time are forgotten for the rates [s]. Longer adapts more slowly."""
STOP_SHARE = 0.3
"""Probability that a slope change of a moving history is a stop."""
TURN_M_S = 1.0
"""Standard deviation of the rate after a turn [m/s]: a typical climb rate."""
BEND_SHARE = 0.5
"""Share of bends in the other slope changes; the rest are turns."""
BEND_M_S2 = 1.0
"""Standard deviation of the acceleration between the two readings of a bend [m/s^2]: a vehicle's typical
acceleration."""
MAX_SINGLE_READING_ODDS = 0.01
"""Largest odds of a level change or turn that only one reading supports, if the reading model has outliers. So a second
reading has to confirm a step. Larger follows steps at once and believes outliers."""
LOCATED_SHARE = 1e-3
"""Probability of 'unlocated' below which the first range is given out."""
CONVERGED_SHARE = 0.5
"""Smallest probability that a reading comes from the surface for which a range is given out; the histories are updated
in any case."""
TOLERANCE_M = 1e-5
"""Precision of the posterior median [m]."""
MAX_ITERATIONS = 60
"""Largest number of Newton steps for the median; bisection alone would need about 30."""


@dataclass(frozen=True)
class RangeLikelihood:
    """The part of a reading model (`msp_range.reading_model.kernel`) that the filter uses, in metres, for readings with
    a range: codes for no echo are rejected before, and the shares are relative to the other three kinds.
    """

    hit: float
    short: float
    random: float
    """Shares of hits, short and random readings."""
    short_rate_per_m: float
    """Rate with which the density of short readings decreases with range [1/m]."""
    minimum_m: float
    maximum_m: float
    """The sensor's limits [m]."""
    variance_m2: float
    """Variance of a hit [m^2], rounding included."""
    bias_m2: float
    """Variance of the rounding error of the mean of many readings at one range [m^2], which averaging does not
    reduce."""

    @classmethod
    def of(
        cls, model: MixtureParameters, minimum_cm: float, maximum_cm: float, resolution_cm: float
    ) -> "RangeLikelihood":
        """Make it from a sensor model file's section ``reading_model``."""
        weights = model.weights
        with_range = weights.hit + weights.short + weights.random
        if not weights.hit > 0.0:
            raise ValueError("filter changepoint: the reading model's weight of hits is 0, expected more")
        step_m = resolution_cm / 100.0
        return cls(
            hit=weights.hit / with_range,
            short=weights.short / with_range,
            random=weights.random / with_range,
            short_rate_per_m=model.short_rate_per_m,
            minimum_m=minimum_cm / 100.0,
            maximum_m=maximum_cm / 100.0,
            variance_m2=(model.sigma_cm / 100.0) ** 2 + step_m**2 / 12.0,
            bias_m2=rounding_bias_m2(model.sigma_cm / 100.0, step_m),
        )

    @property
    def length_m(self) -> float:
        """Length of the interval that the sensor can report [m]."""
        return self.maximum_m - self.minimum_m

    def short_density(self, reading_m: Array, range_m: Array) -> Array:
        """Share times density of a short reading in front of a surface at ``range_m`` [1/m]."""
        reach_m = np.maximum(range_m - self.minimum_m, 1e-3)
        density: Array = self.short * Short.density(reading_m - self.minimum_m, reach_m, self.short_rate_per_m)
        return density

    def outlier_density(self, reading_m: Array, range_m: Array) -> Array:
        """Density of an outlier, given a surface at ``range_m`` [1/m]."""
        shorter = (reading_m < range_m) * self.short_density(reading_m, range_m)
        return np.asarray(self.random / self.length_m + shorter)

    def unlocated_outlier_density(self, reading_m: Array) -> Array:
        """Density of an outlier for an unknown range, uniform over what the sensor can report [1/m].

        The integral over the range of the truncated exponential has no closed form; its norm is taken at the middle
        of the ranges beyond the reading.
        """
        beyond = np.clip((self.maximum_m - reading_m) / self.length_m, 0.0, 1.0)
        shorter = beyond * self.short_density(reading_m, (reading_m + self.maximum_m) / 2)
        return np.asarray(self.random / self.length_m + shorter)


def rounding_bias_m2(std_m: float, step_m: float) -> float:
    """Variance of the rounding error of the mean of many readings, over the position of the range in a step [m^2].

    The mean of round(x + noise) - x is a Fourier series in x with amplitudes exp(-2 pi^2 k^2 sigma^2) / (pi k), in
    steps: a variance of 1/12 without noise, and practically zero from half a step of noise on.

    Examples
    --------
    >>> print(f"{rounding_bias_m2(0.0, 1.0):.4f} {rounding_bias_m2(0.5, 1.0):.6f}")
    0.0833 0.000003
    """
    sigma = std_m / step_m
    series = sum(math.exp(-4 * math.pi**2 * k * k * sigma * sigma) / (2 * math.pi**2 * k * k) for k in range(1, 2000))
    return series * step_m * step_m


class Posterior(NamedTuple):
    """The estimate after a step, one per stream."""

    range_m: Array
    """Median of the range [m]."""
    variance_m2: Array
    """Variance about the median [m^2]."""
    converged: Flags
    """Whether a level is known and the reading probably came from the surface, so that the range can be given out."""


class RunHistories:
    """Hypotheses of ``streams`` independent streams.

    Attributes
    ----------
    state
        Shape (8, streams, HYPOTHESES): probability, x [m], v [m/s], their variances P_xx, P_xv, P_vv, and the numbers
        of slope and level changes.
    unlocated
        Probability that no hypothesis knows the range, shape (streams,).
    time_s
        Time on which the rates are based, shape (streams,).
    """

    def __init__(self, likelihood: RangeLikelihood, streams: int) -> None:
        self.likelihood = likelihood
        self.state = np.zeros((8, streams, HYPOTHESES))
        self.state[3] = likelihood.variance_m2
        self.unlocated = np.ones(streams)
        self.time_s = np.zeros(streams)
        self.known = np.zeros(streams, dtype=bool)
        self._rows = np.arange(streams)[:, None]

    def take(self, streams: Indices) -> "RunHistories":
        """A copy of some streams."""
        some = RunHistories(self.likelihood, streams.size)
        some.state, some.unlocated = self.state[:, streams], self.unlocated[streams]
        some.time_s, some.known = self.time_s[streams], self.known[streams]
        return some

    def put(self, streams: Indices, some: "RunHistories") -> None:
        """Write back the streams that `take` returned."""
        self.state[:, streams], self.unlocated[streams] = some.state, some.unlocated
        self.time_s[streams], self.known[streams] = some.time_s, some.known

    def update(self, elapsed_s: Array, reading_m: Array, variance_m2: Array) -> Posterior:
        """Update with one reading in every stream; all arguments have shape (streams,).

        Parameters
        ----------
        elapsed_s
            Time since the previous reading [s].
        reading_m, variance_m2
            The reading [m] and its variance if it is a hit [m^2].
        """
        likelihood = self.likelihood
        reading, noise = reading_m[:, None], variance_m2[:, None]
        runs, unbounded, started = self.predict(elapsed_s[:, None])
        before, x, p_xx = runs[0], runs[1], runs[3]
        spread, deviation = p_xx + noise, reading - x
        hit = likelihood.hit * Hit.density(deviation * deviation, spread)
        outlier_density = likelihood.outlier_density(reading, x)
        outlier = (before * outlier_density).sum(axis=1, keepdims=True)
        hits, soft = before * hit, 2 * HYPOTHESES
        straight, turn = hits[:, :soft].sum(axis=1, keepdims=True), hits[:, soft:].sum(axis=1, keepdims=True)
        limit = np.where(outlier > 0.0, MAX_SINGLE_READING_ODDS * (outlier + straight), np.inf)
        hit[:, soft:] *= np.minimum(1.0, limit / np.maximum(turn, 1e-300))
        either = hit + outlier_density
        # For a reading that no history explains all products are 0, and the level change below explains it.
        moments = _moments(runs, either, hit / np.maximum(either, 1e-300), deviation, spread)

        unbounded = unbounded * (likelihood.hit / likelihood.length_m)
        level_change = np.where(outlier > 0.0, np.minimum(unbounded, limit), unbounded)
        unlocated = self.unlocated[:, None]
        found = level_change + unlocated * (likelihood.hit / likelihood.length_m)
        lost = (
            level_change * (likelihood.length_m / likelihood.hit) + unlocated
        ) * likelihood.unlocated_outlier_density(reading)
        started[0], started[1], started[3] = 0.5 * found, reading, noise
        # The very first range is not a level change.
        started[7] += level_change / np.maximum(found, 1e-300)

        after = np.concatenate((moments, started), axis=2)
        most = after.shape[2] - HYPOTHESES
        self.state = after[:, self._rows, np.argpartition(after[0], most, axis=1)[:, most:]]
        total = self.state[0].sum(axis=1, keepdims=True) + lost
        self.state[0] /= total
        self.unlocated = (lost / total)[:, 0]
        # Probability of the level change without the limit: the estimate waits for a second reading, its variance does
        # not.
        doubt = (unbounded - level_change) / (total + unbounded - level_change)
        surface = (before * hit).sum(axis=1, keepdims=True) + found
        return self._posterior(reading_m, doubt[:, 0], (surface > CONVERGED_SHARE * (surface + outlier + lost))[:, 0])

    def predict(self, elapsed_s: Array) -> tuple[Array, Array, Array]:
        """Predict the histories at the next reading.

        Returns
        -------
        runs
            Those that continue, bend, turn and stop, shape (8, streams, 4 HYPOTHESES).
        level_change
            Probability of a level change, shape (streams, 1).
        started
            What is known of the two that begin with it, stationary and with the rate kept, shape (8, streams, 2).
        """
        probability, x, v, p_xx, p_xv, p_vv = self.state[:6]
        fade = np.exp(-elapsed_s / RATES_MEMORY_S)
        # Row by row in memory, as the sums below add them.
        counts = self.state[6:].copy() * fade
        self.time_s = self.time_s * fade[:, 0] + elapsed_s[:, 0]
        time_s = PRIOR_TIME_S + self.time_s[:, None]
        slope_share, level_share = -np.expm1(-elapsed_s * (PRIOR_CHANGES + counts) / time_s)
        level_change = probability * level_share
        # The probability without a level change is divided among the other cases.
        probability = probability - level_change
        slope_change = probability * slope_share
        stop = slope_change * STOP_SHARE * (p_vv > 0.0)
        turn = slope_change - stop
        bend = BEND_SHARE * turn
        # The range is the same just before and after the change.
        runs = np.zeros((8, x.shape[0], 4, HYPOTHESES))
        runs[0] = np.stack((probability - turn - stop, bend, turn - bend, stop), axis=1)
        runs[1], runs[3] = x[:, None], p_xx[:, None]
        runs[1, :, :2] += (v * elapsed_s)[:, None]
        runs[2, :, :2] = v[:, None]
        runs[4, :, :2] = p_xv[:, None]
        runs[5, :, 0] = p_vv
        runs[5, :, 1] = p_vv + (BEND_M_S2 * elapsed_s) ** 2
        runs[5, :, 2] = TURN_M_S * TURN_M_S
        longer_s = elapsed_s[:, None]
        runs[3] += (2.0 * runs[4] + runs[5] * longer_s) * longer_s
        runs[4] += runs[5] * longer_s
        runs[6:] = counts[:, :, None]
        runs[6, :, 1:] += 1.0

        any_level_change = level_change.sum(axis=1, keepdims=True)
        share = level_change / np.maximum(any_level_change, 1e-300)
        rate = (share * v).sum(axis=1, keepdims=True)
        started = np.zeros((8, x.shape[0], 2))
        started[2, :, 1:] = rate
        started[5, :, 1:] = (share * (p_vv + (v - rate) ** 2)).sum(axis=1, keepdims=True)
        started[6:] = (share * counts).sum(axis=2, keepdims=True)
        return runs.reshape(8, x.shape[0], 4 * HYPOTHESES), any_level_change, started

    def _posterior(self, reading_m: Array, doubt: Array, is_hit: Flags) -> Posterior:
        likelihood = self.likelihood
        probability, x, p_xx = self.state[0], self.state[1], self.state[3]
        median = _median(probability, x, np.sqrt(p_xx), self.unlocated, likelihood.minimum_m, likelihood.length_m)
        deviation = x - median[:, None]
        middle = (likelihood.minimum_m + likelihood.maximum_m) / 2 - median
        variance = (
            (probability * (p_xx + deviation * deviation)).sum(axis=1)
            + self.unlocated * (likelihood.length_m**2 / 12.0 + middle * middle)
            + doubt * (reading_m - median) ** 2
            + likelihood.bias_m2
        )
        self.known = self.known | (self.unlocated < LOCATED_SHARE)
        return Posterior(median, variance, self.known & is_hit)


def _moments(runs: Array, weight: Array, beta: Array, deviation: Array, spread: Array) -> Array:
    """Histories after a reading that is a hit with the probability beta; the equations are the module's."""
    before, x, v, p_xx, p_xv, p_vv, *changes = runs
    gain_x, gain_v = p_xx / spread, p_xv / spread
    step = beta * deviation
    shrink = beta * ((1.0 - beta) * deviation * deviation - spread)
    return np.stack(
        (
            before * weight,
            x + gain_x * step,
            v + gain_v * step,
            p_xx + gain_x * gain_x * shrink,
            p_xv + gain_x * gain_v * shrink,
            p_vv + gain_v * gain_v * shrink,
            *changes,
        )
    )


def _median(probability: Array, x: Array, std: Array, unlocated: Array, minimum_m: float, length_m: float) -> Array:
    """Median of a mixture of normals, shape (streams, hypotheses), and a uniform; Newton's method inside a bracket."""
    low, high = (x - 9.0 * std).min(axis=1), (x + 9.0 * std).max(axis=1)
    low, high = np.minimum(low, minimum_m), np.maximum(high, minimum_m + length_m)
    heaviest = np.argmax(probability, axis=1)
    median: Array = x[np.arange(x.shape[0]), heaviest]
    peak = probability / (std * math.sqrt(2 * math.pi))
    going = np.ones(x.shape[0], dtype=bool)
    for _ in range(MAX_ITERATIONS):
        z = (median[:, None] - x) / std
        over = (probability * normal_cdf(z)).sum(axis=1) - 0.5
        over += unlocated * np.clip((median - minimum_m) / length_m, 0.0, 1.0)
        slope = (peak * np.exp(-0.5 * z * z)).sum(axis=1) + unlocated / length_m
        high = np.where(over >= 0.0, median, high)
        low = np.where(over <= 0.0, median, low)
        better = median - over / np.maximum(slope, 1e-12)
        better = np.where((better > low) & (better < high), better, 0.5 * (low + high))
        moved = np.where(going, better - median, 0.0)
        median = median + moved
        going = np.abs(moved) > TOLERANCE_M
        if not going.any():
            break
    return median


def normal_cdf(z: Array) -> Array:
    """The normal distribution's Phi(z) = erfc(-z / sqrt 2) / 2, exact to rounding in both tails.

    By the standard library, element by element: importing scipy.special takes 0.15 s, a third of the bridge's start,
    and the filter in flight needs only 24 values at a time.

    Parameters
    ----------
    z : ndarray, any shape
        Standard normal deviate.

    Returns
    -------
    ndarray, same shape
        Probability of less than ``z``.

    Examples
    --------
    >>> print(normal_cdf(np.array([-1.959964, 0.0])).round(6))
    [0.025 0.5  ]
    """
    doubled = map(math.erfc, (z * -math.sqrt(0.5)).ravel().tolist())
    return 0.5 * np.fromiter(doubled, np.float64, z.size).reshape(z.shape)
