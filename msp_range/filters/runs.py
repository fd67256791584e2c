"""Runs: what a range may have done lately, as a weighted set of hypotheses, for many streams at once.

Readings enter, one a stream and step; the posterior median of the range and the variance about it leave. The bridge
has one stream (`msp_range.filters.changepoint`), a study has one a seed.

A hypothesis is a run since its last change, with a Gaussian of range x and rate v; a run that stands has v = 0 and no
variance of it. Between two readings, T apart, a run either goes on, or

    kinks   x goes on; v changes by N(0, (BEND_M_S2 T)^2), is drawn anew from N(0, TURN_M_S^2), or becomes 0
    jumps   x is drawn anew, uniform over all that the sensor can report; v becomes 0 or stays as it was

Both happen at rates that each hypothesis learns from its own kinks and jumps, as Gamma(a + count, b + time). A reading
y is of the surface, N(y; x, R), with the weight of hits, or it is not (`Likelihood.elsewhere`). In a run the two are
brought together by their moments (the probabilistic data association filter, Bar-Shalom and Tse 1975): beta is the
probability of a hit, K the Kalman gain, r = y - x and S = P + R, and

    x' = x + beta K r        P' = P - beta K S K^T + beta (1 - beta) K r^2 K^T

A jump whose first reading was not of the surface is the state 'nowhere': no hypothesis knows x. Only the HYPOTHESES
most probable runs are kept, so that a step costs the same for ever.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from msp_range.filters.normal import normal_cdf, normal_quantile
from msp_range.reading_model.kernel import Hit, Short
from msp_range.reading_model.sensor_model import MixtureParameters

HYPOTHESES = 24
"""Runs that are kept; twice as many change no figure of the study by more than 1 %."""
CHANGES, CHANGES_IN_S = 0.1, 1.0
"""a and b: what is believed of each kind of change before any reading, as many in so many seconds [1, s]."""
RATES_MEMORY_S = 60.0
"""Changes and time longer ago than this no longer count for the rates [s]."""
STANDS = 0.3
"""Share of the kinks of a moving run after which it stands."""
TURN_M_S = 1.0
"""Standard deviation of the rate after a turn [m/s]: what a vehicle climbs at."""
BENDS = 0.5
"""Share of bends in the other kinks; the rest are turns."""
BEND_M_S2 = 1.0
"""Standard deviation of the acceleration between the two readings of a bend [m/s^2]: what a vehicle speeds up with."""
SURPRISE = 0.01
"""A jump or a turn to a reading is at most so many times as probable as that there is none, where the reading model has
readings that are not of the surface. So it takes a second reading to believe a step."""
KNOWN = 1e-3
"""The first range is put out when 'nowhere' is less probable than this."""
SURE = 0.5
"""A reading that is less probably of the surface moves the runs, but nothing is put out."""
TOLERANCE_M = 1e-5
"""Of the posterior median [m]."""
MOST_ITERATIONS = 60

_Array = NDArray[np.float64]


@dataclass(frozen=True)
class Likelihood:
    """What the filter needs of a reading model (`msp_range.reading_model.kernel`), in metres, for one reading with a
    range: no-echo codes do not come here, and the shares are those of the other three kinds.

    Attributes
    ----------
    hit, short, random
        Shares of readings of the surface, of something nearer, and of nothing.
    short_rate_per_m
        Rate at which short readings get rarer with range [1/m].
    minimum_m, maximum_m
        The sensor's limits [m].
    variance_m2
        Of a hit [m^2], rounding included.
    bias_m2
        Variance of what rounding adds to the mean of many readings at one place [m^2]; no averaging takes it away.
    """

    hit: float
    short: float
    random: float
    short_rate_per_m: float
    minimum_m: float
    maximum_m: float
    variance_m2: float
    bias_m2: float

    @classmethod
    def of(cls, model: MixtureParameters, minimum_cm: int, maximum_cm: int, resolution_cm: int) -> "Likelihood":
        """That of a sensor model file's section ``reading_model``."""
        weights = model.weights
        heard = weights.hit + weights.short + weights.random
        if not weights.hit > 0.0:
            raise ValueError("filter changepoint: the reading model's weight of hits is 0, expected more")
        step_m = resolution_cm / 100.0
        return cls(
            hit=weights.hit / heard,
            short=weights.short / heard,
            random=weights.random / heard,
            short_rate_per_m=model.short_rate_per_m,
            minimum_m=minimum_cm / 100.0,
            maximum_m=maximum_cm / 100.0,
            variance_m2=(model.sigma_cm / 100.0) ** 2 + step_m**2 / 12.0,
            bias_m2=rounding_bias_m2(model.sigma_cm / 100.0, step_m),
        )

    @property
    def length_m(self) -> float:
        """Of the interval that the sensor can report [m]."""
        return self.maximum_m - self.minimum_m

    def short_density(self, reading_m: _Array, range_m: _Array) -> _Array:
        """Share times density of a short reading before a surface at ``range_m`` [1/m]."""
        reach_m = np.maximum(range_m - self.minimum_m, 1e-3)
        density: _Array = self.short * Short.density(reading_m - self.minimum_m, reach_m, self.short_rate_per_m)
        return density

    def elsewhere(self, reading_m: _Array, range_m: _Array) -> _Array:
        """Density of a reading that is not of the surface at ``range_m`` [1/m]."""
        density = self.random / self.length_m
        if self.short == 0.0:
            return np.full_like(range_m, density)
        result: _Array = density + (reading_m < range_m) * self.short_density(reading_m, range_m)
        return result

    def anywhere(self, reading_m: _Array) -> _Array:
        """The same where nothing is known of the range: uniform over what the sensor can report [1/m].

        The integral over the range of the truncated exponential has no closed form; its norm is taken at the middle
        of the ranges beyond the reading.
        """
        density = np.full_like(reading_m, self.random / self.length_m)
        if self.short > 0.0:
            beyond = np.clip((self.maximum_m - reading_m) / self.length_m, 0.0, 1.0)
            density += beyond * self.short_density(reading_m, (reading_m + self.maximum_m) / 2)
        return density


def rounding_bias_m2(std_m: float, step_m: float) -> float:
    """Variance, over where in a step the range lies, of the mean of many rounded readings less the range [m^2].

    The mean of round(x + noise) - x is a Fourier series in x with amplitudes exp(-2 pi^2 k^2 sigma^2) / (pi k), in
    steps: 1/12 in all without noise, and nothing from half a step of noise on.

    Examples
    --------
    >>> print(f"{rounding_bias_m2(0.0, 1.0):.4f} {rounding_bias_m2(0.5, 1.0):.6f}")
    0.0833 0.000003
    """
    sigma = std_m / step_m
    series = sum(math.exp(-4 * math.pi**2 * k * k * sigma * sigma) / (2 * math.pi**2 * k * k) for k in range(1, 2000))
    return series * step_m * step_m


class Posterior(NamedTuple):
    """After a step, one a stream.

    Attributes
    ----------
    range_m
        Median of the range [m].
    variance_m2
        About it [m^2].
    sure
        Whether a level is known and the reading was probably of the surface: then the range is worth putting out.
    """

    range_m: _Array
    variance_m2: _Array
    sure: NDArray[np.bool_]


class Runs:
    """Hypotheses of ``streams`` streams that know nothing of each other.

    Attributes
    ----------
    state
        Shape (8, streams, HYPOTHESES): probability, x [m], v [m/s], their variances P_xx, P_xv, P_vv, and the kinks and
        jumps so far.
    nowhere
        Probability that no hypothesis knows the range, shape (streams,).
    time_s
        Time that counts for the rates, shape (streams,).
    """

    def __init__(self, likelihood: Likelihood, streams: int) -> None:
        self.likelihood = likelihood
        self.state = np.zeros((8, streams, HYPOTHESES))
        self.state[3] = likelihood.variance_m2
        self.nowhere = np.ones(streams)
        self.time_s = np.zeros(streams)
        self.known = np.zeros(streams, dtype=bool)
        self._rows = np.arange(streams)[:, None]

    def take(self, streams: NDArray[np.intp]) -> "Runs":
        """A copy of some streams."""
        some = Runs(self.likelihood, streams.size)
        some.state, some.nowhere = self.state[:, streams], self.nowhere[streams]
        some.time_s, some.known = self.time_s[streams], self.known[streams]
        return some

    def put(self, streams: NDArray[np.intp], some: "Runs") -> None:
        """Write back what `take` gave."""
        self.state[:, streams], self.nowhere[streams] = some.state, some.nowhere
        self.time_s[streams], self.known[streams] = some.time_s, some.known

    def update(self, elapsed_s: _Array, reading_m: _Array, variance_m2: _Array) -> Posterior:
        """Take one reading in every stream; all arguments have shape (streams,).

        Parameters
        ----------
        elapsed_s
            Time since the reading before [s].
        reading_m, variance_m2
            The reading [m] and its variance where it is of the surface [m^2].
        """
        likelihood = self.likelihood
        reading, noise = reading_m[:, None], variance_m2[:, None]
        moved = self._predict(elapsed_s[:, None])
        before, x, v, p_xx, p_xv, p_vv, _, _ = moved.runs
        spread = p_xx + noise
        off = reading - x
        hit = likelihood.hit * Hit.density(off * off, spread)
        elsewhere = likelihood.elsewhere(reading, x)
        wild = (before * elsewhere).sum(axis=1, keepdims=True)
        hits, soft = before * hit, 2 * HYPOTHESES
        straight, turn = hits[:, :soft].sum(axis=1, keepdims=True), hits[:, soft:].sum(axis=1, keepdims=True)
        most = np.where(wild > 0.0, SURPRISE * (wild + straight), np.inf)
        hit[:, soft:] *= np.minimum(1.0, most / np.maximum(turn, 1e-300))
        either = hit + elsewhere
        # Of a reading that nothing explains all products are 0, and the jump below takes it.
        beta = hit / np.maximum(either, 1e-300)
        gain_x, gain_v = p_xx / spread, p_xv / spread
        step = beta * off
        shrink = beta * ((1.0 - beta) * off * off - spread)

        jump = moved.jump * (likelihood.hit / likelihood.length_m)
        fair = jump
        jump = np.where(wild > 0.0, np.minimum(jump, most), jump)
        nowhere = self.nowhere[:, None]
        found = jump + nowhere * (likelihood.hit / likelihood.length_m)
        lost = (jump * (likelihood.length_m / likelihood.hit) + nowhere) * likelihood.anywhere(reading)

        size = before.shape[1]
        after = np.empty((8, before.shape[0], size + 2))
        after[0, :, :size] = before * either
        after[1, :, :size] = x + gain_x * step
        after[2, :, :size] = v + gain_v * step
        after[3, :, :size] = p_xx + gain_x * gain_x * shrink
        after[4, :, :size] = p_xv + gain_x * gain_v * shrink
        after[5, :, :size] = p_vv + gain_v * gain_v * shrink
        after[6:, :, :size] = moved.runs[6:]
        after[0, :, size:] = 0.5 * found
        after[1, :, size:] = reading
        after[2, :, size] = after[5, :, size] = 0.0
        after[2, :, size + 1 :], after[5, :, size + 1 :] = moved.rate_m_s, moved.rate_m2_s2
        after[3, :, size:] = noise
        after[4, :, size:] = 0.0
        # The first range of all was no jump.
        after[6, :, size:], after[7, :, size:] = moved.kinks, moved.jumps + jump / np.maximum(found, 1e-300)

        best = np.argpartition(after[0], size + 2 - HYPOTHESES, axis=1)[:, size + 2 - HYPOTHESES :]
        self.state = after[:, self._rows, best]
        total = self.state[0].sum(axis=1, keepdims=True) + lost
        self.state[0] /= total
        self.nowhere = (lost / total)[:, 0]
        # The share that a jump to this reading would have without the bound: the estimate waits, its variance does not.
        doubt = (fair - jump) / (total + fair - jump)
        surface = (before * hit).sum(axis=1, keepdims=True) + found
        return self._posterior(reading_m, doubt[:, 0], (surface > SURE * (surface + wild + lost))[:, 0])

    def innovation(self, elapsed_s: _Array, reading_m: _Array, variance_m2: _Array) -> _Array:
        """The next reading's normalised innovation, before it is taken; shapes as for `update`.

        The normal deviate of the reading's cumulative probability under all that the runs predict. Only for a reading
        model without readings of something else.
        """
        state, time_s = self.state, self.time_s
        moved = self._predict(elapsed_s[:, None])
        self.state, self.time_s = state, time_s
        probability, x, _, p_xx, _, _, _, _ = moved.runs
        likelihood = self.likelihood
        below = normal_cdf((reading_m[:, None] - x) / np.sqrt(p_xx + variance_m2[:, None]))
        share = np.clip((reading_m - likelihood.minimum_m) / likelihood.length_m, 0.0, 1.0)
        cumulative = (probability * below).sum(axis=1) + (moved.jump[:, 0] + self.nowhere) * share
        deviate: _Array = normal_quantile(np.clip(cumulative, 1e-12, 1.0 - 1e-12))
        return deviate

    def _predict(self, elapsed_s: _Array) -> "_Moved":
        """The runs at the next reading, without it: those that go on, that kink and move, and that kink and stand."""
        probability, x, v, p_xx, p_xv, p_vv, kinks, jumps = self.state
        fade = np.exp(-elapsed_s / RATES_MEMORY_S)
        kinks, jumps = kinks * fade, jumps * fade
        self.time_s = self.time_s * fade[:, 0] + elapsed_s[:, 0]
        time_s = self.time_s[:, None]
        kink = -np.expm1(-elapsed_s * (CHANGES + kinks) / (CHANGES_IN_S + time_s))
        jump = probability * -np.expm1(-elapsed_s * (CHANGES + jumps) / (CHANGES_IN_S + time_s))
        # What is left after a jump shares itself out among the rest.
        probability = probability - jump
        stand = probability * kink * STANDS * (p_vv > 0.0)
        turn = probability * kink - stand

        bend = BENDS * turn
        # Straight on, bent, turned, standing: before and after the change they are at the same place.
        runs = np.zeros((8, x.shape[0], 4, HYPOTHESES))
        for index, share in enumerate((probability - turn - stand, bend, turn - bend, stand)):
            runs[0, :, index] = share
        runs[1:4] = np.stack((x, np.zeros_like(x), p_xx))[:, :, None]
        runs[1, :, :2] += (v * elapsed_s)[:, None]
        runs[2, :, :2] = v[:, None]
        runs[4, :, :2] = p_xv[:, None]
        runs[5, :, 0] = p_vv
        runs[5, :, 1] = p_vv + (BEND_M_S2 * elapsed_s) ** 2
        runs[5, :, 2] = TURN_M_S * TURN_M_S
        longer_s = elapsed_s[:, None]
        runs[3] += (2.0 * runs[4] + runs[5] * longer_s) * longer_s
        runs[4] += runs[5] * longer_s
        runs[6] = kinks[:, None]
        runs[6, :, 1:] += 1.0
        runs[7] = jumps[:, None]

        jumped = jump.sum(axis=1, keepdims=True)
        share = jump / np.maximum(jumped, 1e-300)
        rate = (share * v).sum(axis=1, keepdims=True)
        return _Moved(
            runs.reshape(8, x.shape[0], 4 * HYPOTHESES),
            jump=jumped,
            rate_m_s=rate,
            rate_m2_s2=(share * (self.state[5] + (v - rate) ** 2)).sum(axis=1, keepdims=True),
            kinks=(share * kinks).sum(axis=1, keepdims=True),
            jumps=(share * jumps).sum(axis=1, keepdims=True),
        )

    def _posterior(self, reading_m: _Array, doubt: _Array, heard: NDArray[np.bool_]) -> Posterior:
        likelihood = self.likelihood
        probability, x, _, p_xx, _, _, _, _ = self.state
        median = _median(probability, x, np.sqrt(p_xx), self.nowhere, likelihood.minimum_m, likelihood.length_m)
        off = x - median[:, None]
        middle = (likelihood.minimum_m + likelihood.maximum_m) / 2 - median
        variance = (
            (probability * (p_xx + off * off)).sum(axis=1)
            + self.nowhere * (likelihood.length_m**2 / 12.0 + middle * middle)
            + doubt * (reading_m - median) ** 2
            + likelihood.bias_m2
        )
        self.known = self.known | (self.nowhere < KNOWN)
        return Posterior(median, variance, self.known & heard)


class _Moved(NamedTuple):
    """Runs before a reading, shape (8, streams, 4 HYPOTHESES), and what a jump would start with, shape (streams, 1)."""

    runs: _Array
    jump: _Array
    rate_m_s: _Array
    rate_m2_s2: _Array
    kinks: _Array
    jumps: _Array


def _median(probability: _Array, x: _Array, std: _Array, nowhere: _Array, minimum_m: float, length_m: float) -> _Array:
    """Median of a mixture of normals, shape (streams, hypotheses), and a uniform; Newton's method inside a bracket."""
    low, high = (x - 9.0 * std).min(axis=1), (x + 9.0 * std).max(axis=1)
    low, high = np.minimum(low, minimum_m), np.maximum(high, minimum_m + length_m)
    heaviest = np.argmax(probability, axis=1)
    median: _Array = x[np.arange(x.shape[0]), heaviest]
    peak = probability / (std * math.sqrt(2 * math.pi))
    going = np.ones(x.shape[0], dtype=bool)
    for _ in range(MOST_ITERATIONS):
        z = (median[:, None] - x) / std
        over = (probability * normal_cdf(z)).sum(axis=1) - 0.5
        over += nowhere * np.clip((median - minimum_m) / length_m, 0.0, 1.0)
        slope = (peak * np.exp(-0.5 * z * z)).sum(axis=1) + nowhere / length_m
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
