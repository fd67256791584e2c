"""Numbers with their intervals, and tests: shares, points, means and spreads of whole centimetres, Holm, power.

Each function makes an `IntervalEstimate` or a p-value of counts or readings. Intervals are 95 % ones. A sensor that
reports whole centimetres with little noise hides its mean between two of them, so the mean's and the spread's intervals
are those of the likelihood of the rounded readings, and not of their average.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq
from scipy.special import chdtri, gammaincinv, logsumexp, ndtr, stdtrit

from msp_range.arrays import Array
from msp_sim.intervals import CONFIDENCE, LIKELIHOOD_DROP, Z, wilson

DITHERED = 0.6
"""Rounded readings that scatter by more than this many of their steps lose nothing by it: before rounding that is
sqrt(0.36 - 1 / 12) = 0.53, and the average's bias is under exp(-2 pi^2 0.277) / pi = 0.0014 steps."""
STRAY = 1e-4
"""Chance that a reading that is not of the surface is in any one step of those near it: of the 1 % that a sensor in
order has, spread over a hundred steps. At 0 one such reading widens the spread of readings that are nearly all alike,
and their mean moves by a tenth of a step with it; larger, tails count as strays."""
NEAR_STEPS, MOST_NEAR = 3.0, 0.9
"""Only readings within this number of steps of the median decide whether they scatter by more than `DITHERED`, if they
are at least this share of all: the others are then strays, not a second group."""
GROUPS = 3
"""Set-ups with readings of two steps or more that a spread of all is taken from."""
USUAL_WITHIN = 0.3
"""Standard deviation of the logarithm of a set-up's spread about that of all. Larger: the mean of readings of two steps
is less certain; smaller: a set-up that scatters more has a mean that is too certain."""
_SPREADS = (0.02, 2.0)
"""Spreads that are tried for rounded values [steps]."""
BATCH = 15
"""Readings in a batch, at least: those a batch apart are taken to be independent."""


@dataclass(frozen=True)
class IntervalEstimate:
    """A number with its 95 % interval."""

    value: float
    low: float | None = None
    high: float | None = None
    """Ends of the interval; None where the data give none on that side."""
    unit: str = ""
    """Unit of all three; "" for a share or a ratio."""
    n: int = 0
    """Number of independent things it rests on, which `of` names."""
    of: str = "readings"
    """What was counted: "readings" or "points" (a point is one set-up: a range, an angle, a target)."""

    @classmethod
    def about(cls, value: float, half: float, n: int, of: str = "readings", unit: str = "cm") -> "IntervalEstimate":
        """A number with an interval that reaches as far to both sides."""
        return cls(value, value - half, value + half, unit, n, of)

    @property
    def ends(self) -> tuple[float, float]:
        """Ends of the interval; infinite where the data give none."""
        return -math.inf if self.low is None else self.low, math.inf if self.high is None else self.high

    @property
    def standard_error(self) -> float:
        """Standard error, where the interval is roughly symmetric; infinite without one."""
        low, high = self.ends
        return (high - low) / (2 * Z)

    def holds(self, value: float) -> bool:
        """Whether a value is within the interval; an end that is not known is no limit."""
        low, high = self.ends
        return low <= value <= high

    def mapped(self, change: Callable[[float], float]) -> "IntervalEstimate":
        """The estimate and both ends of its interval changed by a rising function."""
        low, high = (None if end is None else change(end) for end in (self.low, self.high))
        return replace(self, value=change(self.value), low=low, high=high)

    def __str__(self) -> str:
        """The numbers with two digits of what the interval reaches, ``?`` for an end that is not known, and the unit.

        Examples
        --------
        >>> print(IntervalEstimate(-1.387, -1.57, unit="cm"), "and", IntervalEstimate(503.0, 503.0, 503.0, "cm"))
        -1.39 (-1.57 to ?) cm and 503 cm
        """
        reach = max((abs(end - self.value) for end in self.ends if math.isfinite(end)), default=0.0)
        unit = f" {self.unit}" if self.unit else ""
        if reach == 0.0:
            return f"{self.value:.6g}{unit}"
        # With a wide interval the value itself needs more digits than the interval.
        size = min(reach, abs(self.value)) if 0.0 < abs(self.value) < 0.1 * reach else reach
        digits = min(max(1 - math.floor(math.log10(size)), 0), 6)
        low, high = ("?" if end is None else f"{end:.{digits}f}" for end in (self.low, self.high))
        return f"{self.value:.{digits}f} ({low} to {high}){unit}"

    def root(self, known: float = 0.0) -> "IntervalEstimate":
        """The standard deviation of this variance, without a part that is known."""
        return self.mapped(lambda end: math.sqrt(max(end - known, 0.0)))


def student(standard_error: float, freedom: float) -> float:
    """Half of Student's 95 % interval of an estimate with this standard error; of the normal one where it is known."""
    return float(stdtrit(freedom, 0.5 + CONFIDENCE / 2)) * standard_error


def share(count: int, of: int) -> IntervalEstimate:
    """A share with Wilson's interval.

    Examples
    --------
    >>> found = share(3, 100)
    >>> print(f"{found.value:.3f} {found.low:.3f} {found.high:.3f}")
    0.030 0.010 0.085
    """
    return IntervalEstimate(count / of, *wilson(count, of), "", of)


class PointsFit(NamedTuple):
    """Coefficients of a linear model of points, and the variance between them that their own do not explain."""

    coefficients: Array
    covariance: Array
    between: float
    freedom: int

    def estimate(self, i: int, unit: str, extra_std: float = 0.0) -> IntervalEstimate:
        """A coefficient with Student's interval, widened by the standard deviation of an error common to all."""
        value, n = float(self.coefficients[i]), self.freedom + self.coefficients.size
        if self.freedom < 1:
            return IntervalEstimate(value, unit=unit, n=n, of="points")
        half = math.hypot(student(math.sqrt(self.covariance[i, i]), self.freedom), Z * extra_std)
        return IntervalEstimate.about(value, half, n, "points", unit)


def fit_points(design: Array, y: Array, variance: Array | float) -> PointsFit:
    """Weighted least squares with a variance between points, which is added until the residuals are as expected.

    `design` is (points, coefficients), of full rank; `y` and `variance` are each point's value and what is known of its
    variance. Paule and Mandel 1982 (J. Res. NBS 87, 377): the variance between is the one at which the weighted sum of
    squared residuals equals its degrees of freedom, and 0 where it is below already.
    """
    freedom = y.size - design.shape[1]
    between = _variance_between(design, y, variance, freedom) if freedom > 0 else 0.0
    coefficients, covariance, _ = _least_squares(design, y, variance + between)
    return PointsFit(coefficients, covariance, between, freedom)


def fit_line(x: Array, y: Array, variance: Array | float = 0.0) -> PointsFit:
    """`fit_points` of a straight line: offset and scale."""
    return fit_points(np.column_stack([np.ones_like(x), x]), y, variance)


def mean_of_points(
    values: Array, variance: Array | float = 0.0, extra_std: float = 0.0, unit: str = "cm"
) -> IntervalEstimate:
    """Mean of one value a point, as by `fit_points` and `PointsFit.estimate`; no interval for one value alone."""
    return fit_points(np.ones((values.size, 1)), values, variance).estimate(0, unit, extra_std)


def _least_squares(design: Array, y: Array, variance: Array | float) -> tuple[Array, Array, float]:
    """Coefficients of weighted least squares, their covariance, and the weighted sum of squared residuals."""
    weight = np.full(y.size, 1.0 / (variance + 1e-12))
    covariance = np.linalg.inv(design.T * weight @ design)
    coefficients: Array = covariance @ (design.T * weight @ y)
    return coefficients, covariance, float(weight @ (y - design @ coefficients) ** 2)


def _variance_between(design: Array, y: Array, variance: Array | float, wanted: float) -> float:
    """The variance with which the weighted sum of squared residuals is as wanted; 0 where it is below already."""

    def excess(between: float) -> float:
        return _least_squares(design, y, variance + between)[2] - wanted

    # Without variances of their own the sum is that of equal weights over the variance between.
    high = 1.0 + _least_squares(design, y, 1.0)[2] / wanted
    return float(brentq(excess, 0.0, high)) if excess(0.0) > 0.0 else 0.0


def between_points(residual: Array, variance: Array, known: float = 0.0, fitted: int = 1) -> IntervalEstimate:
    """Standard deviation between points beyond the scatter of readings and a known variance [cm].

    `residual` and `variance` are each point's distance from what is expected, and the variance that its readings give
    it; `known` is the variance between points that has another cause, and `fitted` counts the numbers that were fitted
    to the same points. The interval is that of the Q profile (Viechtbauer 2007, Statistics in Medicine 26, 37): the
    variances at which the weighted sum of squared residuals is at the 2.5 and 97.5 % points of chi squared.

    Examples
    --------
    >>> between_points(np.array([0.31, -0.28, 0.02, -0.4, 0.35]), np.full(5, 0.01)).low > 0.05
    True
    """
    freedom = residual.size - fitted
    wanted = (freedom, *chdtri(freedom, [0.025, 0.975]).tolist())
    mean = np.ones((residual.size, 1))
    value, low, high = (math.sqrt(_variance_between(mean, residual, variance + known, total)) for total in wanted)
    return IntervalEstimate(value, low, high, "cm", residual.size, "points")


def dependence_factor(series: Sequence[Array]) -> float:
    """By how much readings that depend on the ones before widen the variance of their mean; 1 where they do not.

    `series` are each point's readings in order. Batch means: the variance of the means of consecutive batches, times
    their length, over that of single readings, pooled over the points.
    """
    means, singles, freedom = 0.0, 0.0, 0
    for values in series:
        batches = min(10, values.size // BATCH)
        if batches < 2:
            continue
        length = values.size // batches
        cut = values[: batches * length].reshape(batches, length)
        means += length * float(cut.mean(axis=1).var(ddof=1)) * (batches - 1)
        singles += float(cut.var(ddof=1)) * (batches - 1)
        freedom += batches - 1
    # The ratio is above 1 in half of all cases without dependence: only a significant one counts.
    if singles == 0.0 or means / singles < float(chdtri(freedom, 0.01)) / freedom:
        return 1.0
    return means / singles


class MeanAndSpread(NamedTuple):
    """Mean and standard deviation before rounding, each with its interval."""

    mean: IntervalEstimate
    spread: IntervalEstimate


def mean_and_spread(values: Array, step: float, usual_spread: float | None = None) -> MeanAndSpread:
    """Mean and standard deviation that a normal variable had before at least two values were rounded to a step [cm].

    A step of 0: they are continuous. `usual_spread` is that of other such values, from `common_spread`: where these are
    all of two steps, a mean near the boundary with a small spread is as likely as one far from it with a large spread.

    Where the values scatter little, the estimates are by the likelihood of the rounded values, strays among them, and
    their intervals end where the profile log likelihood is 1.92 below its top. Otherwise they are by average and
    variance, less step^2 / 12.

    Examples
    --------
    Ten equal readings do not say that there is no noise, nor where in their centimetre the mean is:

    >>> found = mean_and_spread(np.full(10, 100.0), step=1.0)
    >>> print(f"{found.mean.low:.1f} to {found.mean.high:.1f}, spread up to {found.spread.high:.1f}")
    99.5 to 100.5, spread up to 0.4
    """
    if _is_of_few_steps(values, step):
        return _of_rounded(values, step, None if usual_spread is None else usual_spread / step)
    n, average = values.size, float(values.mean())
    variance = float(values.var(ddof=1))
    mean = IntervalEstimate.about(average, student(math.sqrt(variance / n), n - 1), n)
    low, high = (n - 1) * variance / (2.0 * gammaincinv((n - 1) / 2, [0.5 + CONFIDENCE / 2, 0.5 - CONFIDENCE / 2]))
    return MeanAndSpread(mean, IntervalEstimate(variance, low, high, "cm", n).root(step**2 / 12))


def half_of_mean(values: Array, step: float) -> float:
    """Half of the interval of the mean of values whose rounding to a step is an error of each."""
    return Z * math.sqrt((float(values.var(ddof=1)) + step**2 / 12.0) / values.size)


def common_spread(groups: Sequence[Array], step: float) -> float | None:
    """Standard deviation before rounding that groups of values about different means have in common.

    None where fewer than `GROUPS` of them show anything of it: values of two steps or more that scatter little.
    """
    few = [group for group in groups if _is_of_few_steps(group, step)]
    shown = [values for values in few if np.unique(values).size > 1]
    if len(shown) < GROUPS:
        return None
    spreads = np.geomspace(*_SPREADS, 41)
    total = np.zeros(spreads.size)
    for values in few:
        means = float(np.median(values)) / step + np.linspace(-1.0, 1.0, 81)
        # Over all means alike: with the likeliest one of each group its boundary takes the place of the spread.
        total += logsumexp(_log_likelihood(values / step, means, spreads), axis=0)
    return step * float(spreads[total.argmax()])


def _is_of_few_steps(values: Array, step: float) -> bool:
    """Whether rounded values scatter so little that their average is not their mean before rounding."""
    if step <= 0.0:
        return False
    near = values[np.abs(values - np.median(values)) <= NEAR_STEPS * step]
    return bool(near.size >= MOST_NEAR * values.size and near.std() < DITHERED * step)


def _of_rounded(values: Array, step: float, usual: float | None) -> MeanAndSpread:
    middle = float(np.median(values)) / step
    mean_ends, spread_ends = (middle - 1.0, middle + 1.0), _SPREADS
    # Three looks, each at what the one before found likely.
    for _ in range(3):
        means, spreads = np.linspace(*mean_ends, 41), np.geomspace(*spread_ends, 41)
        log_likelihood = _log_likelihood(values / step, means, spreads)
        if usual is not None:
            log_likelihood -= 0.5 * (np.log(spreads / usual) / USUAL_WITHIN) ** 2
        by_mean, by_spread = log_likelihood.max(axis=1), log_likelihood.max(axis=0)
        mean_ends, spread_ends = _where_likely(means, by_mean), _where_likely(spreads, by_spread)
    # Where the likelihood is flat, its middle.
    mean = float(means[by_mean > by_mean.max() - 1e-6].mean())
    spread, (least, largest) = float(spreads[by_spread.argmax()]), spread_ends
    if np.ptp(np.rint(values / step)) == 0.0:
        # All in one step: any smaller spread is as likely.
        spread = least = 0.0
    found = (
        IntervalEstimate(mean, *mean_ends, "cm", values.size),
        IntervalEstimate(spread, least, largest, "cm", values.size),
    )
    return MeanAndSpread(*(estimate.mapped(lambda steps: step * steps) for estimate in found))


def _log_likelihood(values: Array, means: Array, spreads: Array) -> Array:
    """Log likelihood of values that were rounded to whole numbers, shape (means, spreads); each may be a stray."""
    steps, counts = np.unique(np.rint(values), return_counts=True)
    spread = spreads[:, None]
    low = (steps - 0.5 - means[:, None, None]) / spread
    likelihood: Array = np.log(ndtr(low + 1.0 / spread) - ndtr(low) + STRAY) @ counts
    return likelihood


def _where_likely(grid: Array, profile: Array) -> tuple[float, float]:
    likely = np.flatnonzero(profile > profile.max() - LIKELIHOOD_DROP)
    return float(grid[max(likely[0] - 1, 0)]), float(grid[min(likely[-1] + 1, grid.size - 1)])


def holm(p_values: Sequence[float]) -> list[float]:
    """p-values corrected for their number, Holm 1979: none of all that are true is refused in 95 % of cases.

    Examples
    --------
    >>> print([round(p, 3) for p in holm([0.01, 0.04, 0.03])])
    [0.03, 0.06, 0.06]
    """
    p, order = np.array(p_values), np.argsort(p_values, kind="stable")
    adjusted = np.empty(p.size)
    adjusted[order] = np.maximum.accumulate(np.minimum(p[order] * np.arange(p.size, 0, -1), 1.0))
    return adjusted.tolist()


def detectable(standard_error: float, freedom: float, level: float) -> float:
    """Smallest effect that a two-sided t-test at `level` finds with a probability of 0.8.

    Examples
    --------
    >>> print(f"{detectable(standard_error=0.1, freedom=11, level=0.05):.2f}")
    0.31
    """
    return standard_error * float(stdtrit(freedom, 1 - level / 2) + stdtrit(freedom, 0.8))
