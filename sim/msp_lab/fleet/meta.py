"""Random-effects meta-analysis: the mean over a fleet, the spread between its vehicles, and who does not belong.

Estimates with their standard errors enter. The model is ``b_u ~ N(mean, tau^2 + s_u^2)``: s_u is what one vehicle's
readings leave open, tau is by how much vehicles really differ. tau^2 is the value at which the weighted sum of squares
is as large as it is expected to be (Paule & Mandel 1982; DerSimonian & Kacker 2007, Contemp. Clin. Trials 28:105).

Mean and spread are those of the ordinary vehicles, for a few odd ones would otherwise widen the spread until they look
ordinary themselves. These are found from medians, which half of the vehicles cannot move, and the rest is done without
the others (a one-step reweighted estimate: Rousseeuw & Leroy 1987, Robust Regression and Outlier Detection).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.optimize import bisect
from scipy.stats import chi2, norm
from scipy.stats import t as student

from msp_range.arrays import Array, Flags

MEDIAN_SQUARE = float(chi2.median(1))
"""Median of the square of a normal number: half of the vehicles are nearer to the mean than its root."""
ORDINARY_DEVIATIONS = 3.5
"""A vehicle is ordinary within so many deviations of the others. In 2,000 drawn fleets of 20 without odd vehicles,
p-values of 0.001 then came 0.4 to 2 times as often as they should, and at 3 up to 3 times. Lower: the spread is
underestimated; higher: odd vehicles hide behind the spread that they make."""
SPREAD_CONFIDENCE = 0.7
"""A vehicle is compared with the others at the upper limit of their spread at this confidence (by the sum of squares;
Viechtbauer 2007, Stat. Med. 26:37): where vehicles differ by as much as their errors, the spread is often estimated as
0, and one with many readings looks odd. Higher: weak odd ones are missed; 10 standard errors count as 9 at this one. Of
20 drawn vehicles one that is 7 spreads off has a p-value below 0.00025 in 77 to 91 % of the fleets, and 0 to 5 of
10,000 ordinary ones have (0.8: 75 to 89 %, 0 to 2; 0.5: 77 to 95 %, 0 to 15)."""
MIN_ORDINARY = 3
"""Mean and spread are from at least so many vehicles: of two nobody could say which is the odd one."""
TURNS = 10
"""Times at most that vehicles are sorted into ordinary and odd ones; it takes two or three."""
ROUNDS = 100
"""Steps of an iteration at most; it takes about five."""


@dataclass(frozen=True)
class Pooled:
    """A fleet's estimate of one number."""

    mean: float
    error: float
    """Mean of the ordinary vehicles, and its standard error."""
    tau: float
    """Standard deviation between them."""
    i2: float
    """Share of the scatter of their estimates that is not the estimates' own error (Higgins & Thompson 2002)."""
    ordinary: Flags
    """(units,): which vehicles it is from."""

    @property
    def log_p(self) -> float:
        """Logarithm of the p-value of a mean of 0, by Student's t of one less than the ordinary vehicles."""
        size = abs(self.mean) / self.error
        # What the vehicles' own errors say is known; only a spread between them has to be estimated from so few.
        tail = student.logsf(size, int(self.ordinary.sum()) - 1) if self.tau > 0.0 else norm.logsf(size)
        return float(np.log(2.0) + tail)


def paule_mandel(values: Array, errors: Array) -> tuple[float, float, float]:
    """Mean, its standard error, and tau.

    Parameters
    ----------
    values, errors
        Estimates and their standard errors, two or more.

    Examples
    --------
    Two estimates of error 1 that are 4 apart scatter with a variance of 8, of which 1 is their own:

    >>> mean, error, tau = paule_mandel(np.array([0.0, 4.0]), np.array([1.0, 1.0]))
    >>> print(f"{mean:.3f} {error:.3f} {tau**2:.3f}")
    2.000 2.000 7.000
    """
    everyone = np.ones((1, values.size), dtype=bool)
    # What the weighted sum of squares is expected to be.
    mean, error, tau = _random_effects(values, errors, everyone, values.size - 1)
    return float(mean[0]), float(error[0]), float(tau[0])


def _random_effects(values: Array, errors: Array, inside: Flags, square: float) -> tuple[Array, Array, Array]:
    """`paule_mandel` of several sets of the estimates, of equal size: inside is (sets, estimates)."""
    tau2 = np.zeros(inside.shape[0])
    for _ in range(ROUNDS):
        weight = inside / (errors**2 + tau2[:, None])
        total = weight.sum(axis=1)
        mean = weight @ values / total
        squares = (values - mean[:, None]) ** 2
        excess = (weight * squares).sum(axis=1) - square
        is_open = excess > 1e-9 * values.size
        if not is_open.any():
            break
        # Newton's step; the sum of squares falls with tau^2 and is convex, so that it never goes too far.
        tau2 += np.where(is_open, excess / (weight**2 * squares).sum(axis=1), 0.0)
    return mean, total**-0.5, np.sqrt(tau2)


def pooled(values: Array, errors: Array) -> Pooled:
    """Mean and spread of the ordinary vehicles.

    Parameters
    ----------
    values, errors
        (units,), all known; three or more.
    """
    middle, spread = _median_fit(values, errors)
    ordinary = np.abs(values - middle) <= ORDINARY_DEVIATIONS * np.sqrt(errors**2 + spread**2)
    for _ in range(TURNS):
        deviation, _ = _deviations(values, errors, ordinary)
        now = np.abs(deviation) <= ORDINARY_DEVIATIONS
        if now.sum() < MIN_ORDINARY or (now == ordinary).all():
            break
        ordinary = now
    mean, error, tau = paule_mandel(values[ordinary], errors[ordinary])
    weight = 1.0 / errors[ordinary] ** 2
    centre = weight @ values[ordinary] / weight.sum()
    q = float(weight @ (values[ordinary] - centre) ** 2)
    i2 = max(0.0, 1.0 - (int(ordinary.sum()) - 1) / q) if q > 0.0 else 0.0
    return Pooled(mean, error, tau, i2, ordinary)


def left_out(values: Array, errors: Array, fleet: Pooled, always_differ: bool = False) -> tuple[Array, Array]:
    """Each vehicle against the ordinary ones other than itself.

    Parameters
    ----------
    values, errors, fleet
        As for `pooled`, and what it gave.
    always_differ
        Vehicles differ in this number by nature, even where a spread of 0 fits these ones best.

    Returns
    -------
    tuple
        Deviation in standard deviations of a prediction, and the logarithm of its two-sided p-value, both (units,).
        The prediction's variance is the vehicle's own, that between vehicles at its upper limit, and that of the mean.
        The last two are known from few vehicles only, for which Student's t stands (Higgins, Thompson & Spiegelhalter
        2009), with as many degrees of freedom as their share of the variance makes (Satterthwaite 1946, Biometrics
        Bull. 2:110).
    """
    deviation, predicted = _deviations(values, errors, fleet.ordinary)
    freedom = np.maximum(fleet.ordinary.sum() - fleet.ordinary - 2.0, 1.0)
    if not always_differ:
        # Only the part that is not the vehicle's own error, which is known, is estimated from the others.
        freedom = freedom * (1.0 + errors**2 / predicted) ** 2
    return deviation, np.minimum(np.log(2.0) + student.logsf(np.abs(deviation), freedom), 0.0)


def _deviations(values: Array, errors: Array, ordinary: Flags) -> tuple[Array, Array]:
    """Each vehicle against the ordinary ones other than itself.

    Returns
    -------
    tuple
        The deviation in standard deviations of a prediction, and the prediction's variance without the vehicle's own.
    """
    inside = np.tile(ordinary, (values.size, 1))
    np.fill_diagonal(inside, False)
    mean, error, tau = (np.empty(values.size) for _ in range(3))
    for some in (ordinary, ~ordinary):
        if some.any():
            square = _upper_square(int(inside[some][0].sum()) - 1)
            mean[some], error[some], tau[some] = _random_effects(values, errors, inside[some], square)
    predicted: Array = tau**2 + error**2
    deviation: Array = (values - mean) / np.sqrt(errors**2 + predicted)
    return deviation, predicted


@lru_cache
def _upper_square(freedom: int) -> float:
    """Sum of squares at which tau is at its upper limit at `SPREAD_CONFIDENCE`."""
    return float(chi2.isf(SPREAD_CONFIDENCE, freedom))


def shrunk(values: Array, errors: Array, fleet: Pooled) -> tuple[Array, Array]:
    """Each vehicle's estimate drawn towards the fleet's mean, and its standard error (empirical Bayes).

    An ordinary vehicle is worth ``(b / s^2 + mean / tau^2) / (1 / s^2 + 1 / tau^2)``. The uncertainty of the mean is
    counted (Morris 1983, J. Am. Stat. Assoc. 78:47). A vehicle that is not ordinary keeps its own estimate.
    """
    own = fleet.tau**2 / (fleet.tau**2 + errors**2)
    own = np.where(fleet.ordinary, own, 1.0)
    error = np.sqrt(own * errors**2 + (1.0 - own) ** 2 * fleet.error**2)
    return own * values + (1.0 - own) * fleet.mean, error


def _median_fit(values: Array, errors: Array) -> tuple[float, float]:
    """Weighted median, and the spread at which the median square is that of normal numbers."""

    def ratio(tau2: float) -> tuple[float, float]:
        variance = errors**2 + tau2
        middle = _weighted_median(values, 1.0 / variance)
        return middle, float(np.median((values - middle) ** 2 / variance)) / MEDIAN_SQUARE

    tau2 = where_one(lambda tau2: ratio(tau2)[1], float(np.ptp(values)) ** 2 / MEDIAN_SQUARE)
    return ratio(tau2)[0], float(np.sqrt(tau2))


def where_one(ratio: Callable[[float], float], high: float) -> float:
    """Where a ratio that falls with a variance is 1, between 0 and `high`; the end of the two that is nearest to it."""
    if ratio(0.0) <= 1.0:
        return 0.0
    return (
        float(bisect(lambda variance: ratio(variance) - 1.0, 0.0, high, xtol=1e-9 * high))
        if ratio(high) < 1.0
        else high
    )


def _weighted_median(values: Array, weights: Array) -> float:
    order = np.argsort(values)
    below = np.cumsum(weights[order]) - 0.5 * weights[order]
    return float(np.interp(0.5 * weights.sum(), below, values[order]))
