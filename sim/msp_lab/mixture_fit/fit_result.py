"""The result of a fit of the base mixture: parameters with errors and intervals, and probabilities of readings.

Standard errors are from the observed information at the maximum of the likelihood, for the weights by the delta method,
and intervals respect the bounds of the parameters.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.special import expit, logit, xlog1py, xlogy

from msp_lab.mixture_fit.grid import ReadingGrid
from msp_lab.mixture_fit.likelihood import Likelihood, Optimum
from msp_lab.mixture_fit.parameters import KINDS, NAMES, PARAMETERS, Numbers, bounds_of, named, slopes_of
from msp_range.arrays import Array
from msp_range.reading_model.kernel import NO_ECHO_CENTRE
from msp_range.reading_model.sensor_model import MixtureParameters
from msp_sim.intervals import LIKELIHOOD_DROP, Z

NEAR_BOUND = 4.0
"""Within this many standard errors of a bound the interval is computed from the profile likelihood."""
UNKNOWN_FRACTION = 0.5
"""Standard error above which a fraction counts as not identified."""
UNKNOWN_FALL = 3.0
"""A lambda counts as not identified if its standard error is this many times both itself and 1 / (mean range)."""


class FitError(ValueError):
    """Readings that cannot be fitted; the message says what was found, what was expected and what to do."""


@dataclass(frozen=True)
class FitResult:
    """A fitted mixture."""

    grid: ReadingGrid
    """What the sensor can report."""
    parameters: MixtureParameters
    """Parameters as in a sensor model file."""
    estimates: dict[str, float]
    standard_errors: dict[str, float]
    """Estimates and their standard errors, by name; the error is NaN for parameters at a bound or not identified."""
    at_bound: tuple[str, ...]
    """Names of parameters at a bound, such as a weight of 0."""
    not_identified: tuple[str, ...]
    """Names of parameters that the readings do not determine, such as lambda without short readings."""
    log_likelihood: float
    readings: int
    """Sum of log probabilities, and number of readings."""
    _likelihood: Likelihood = field(repr=False, compare=False)
    _optimum: Optimum = field(repr=False, compare=False)
    _moving: tuple[str, ...] = field(repr=False, compare=False)

    def below(
        self, reading_cm: ArrayLike, expected_cm: ArrayLike, reference_std_cm: ArrayLike = 0.0
    ) -> tuple[Array, Array]:
        """Probability of a smaller reading, and of the reading itself, each (n,); 0 for what is not on the grid."""
        reading, expected = columns(reading_cm, expected_cm)
        reference_cm2 = np.broadcast_to(np.asarray(reference_std_cm, dtype=np.float64) ** 2, reading.shape)
        rows = Likelihood(self.grid, reading, expected, np.ones(reading.size), reference_cm2).rows(
            self._optimum.numbers
        )
        return np.exp(rows.log_below(reading)), np.exp(rows.log_prob(reading))

    def interval(self, name: str) -> tuple[float, float]:
        """95 % confidence interval of a parameter.

        From the standard error, on the scale of log odds (weights and fraction) or of the logarithm (sigma, lambda);
        within four standard errors of a bound from the profile of the likelihood, which refits the others at every
        step. The full range if the parameter is not identified; the value twice if it was not fitted, such as the
        fraction of a sensor without a second code.
        """
        if name not in self.estimates:
            raise ValueError(f"found {name!r}, expected one of {', '.join(self.estimates)}")
        value, error = self.estimates[name], self.standard_errors[name]
        if name == "hit":
            return _share_interval(value, error, self.readings)
        parameter = PARAMETERS[name]
        if parameter.number not in self._moving:
            return value, value
        if name in self.not_identified:
            return parameter.least, parameter.most
        room = min(value - parameter.least, parameter.most - value) if parameter.is_share else value - parameter.least
        if math.isnan(error) or room < NEAR_BOUND * error:
            return self._profile(name, -1.0), self._profile(name, 1.0)
        if parameter.is_share:
            width = Z * error / (value * (1.0 - value))
            return float(expit(logit(value) - width)), float(expit(logit(value) + width))
        if math.isfinite(parameter.least):
            return value * math.exp(-Z * error / value), value * math.exp(Z * error / value)
        return value - Z * error, value + Z * error

    def _profile(self, name: str, sign: float) -> float:
        """Value at which the profile log-likelihood has dropped by `LIKELIHOOD_DROP`; the parameter's bound if it never
        does."""
        _, _, number, *ends = PARAMETERS[name][:5]
        k = NAMES.index(number)
        best = self._optimum
        bound = bounds_of(best.numbers, self._moving)[sign > 0.0][k]
        others = [other for other in self._moving if other != number]
        centre = best.numbers[k]
        known = {centre: -LIKELIHOOD_DROP}
        last = best.numbers

        def excess(place: float) -> float:
            nonlocal last
            if place not in known:
                start = last._replace(**{number: place})
                at, value, _ = self._likelihood.maximum(start, bounds_of(start, others))
                last, known[place] = Numbers(*at.tolist()), best.value - value - LIKELIHOOD_DROP
            return known[place]

        step = sign / math.sqrt(max(best.information[k, k], 4.0))
        near, far = centre, centre
        while excess(far) <= 0.0:
            if far == bound:
                return ends[sign > 0.0]
            near, far = far, min(far + step, bound) if sign > 0.0 else max(far + step, bound)
            step *= 2.0
        limit = float(brentq(excess, near, far, xtol=1e-3 * abs(far - centre)))
        return float(named(best.numbers._replace(**{number: limit}))[name])


def columns(reading_cm: ArrayLike, expected_cm: ArrayLike) -> tuple[Array, Array]:
    """Readings and ranges as arrays; no echo is a range beyond that of any sensor."""
    expected = np.asarray(expected_cm, dtype=np.float64)
    return np.asarray(reading_cm, dtype=np.float64), np.minimum(expected, NO_ECHO_CENTRE)


def result_of(rows: Likelihood, best: Optimum, moving: Sequence[str], mean_length_m: float) -> FitResult:
    """Convert a maximum to named parameters with errors; ``mean_length_m`` is the mean distance of readings from the
    minimum."""
    numbers, spread = best.numbers, Numbers(*np.diag(best.information))
    unknown = set()
    if spread.saturated * UNKNOWN_FRACTION**2 < 1.0:
        unknown.add("saturated_fraction")
        numbers = numbers._replace(saturated=0.0)
    longest = UNKNOWN_FALL * max(numbers.rate, 1.0 / mean_length_m)
    if "log_odds_short" not in best.inside or spread.rate * longest**2 < 1.0:
        unknown.add("short_rate_per_m")
    found = named(numbers)
    moved = {
        parameter.name: NAMES.index(parameter.number) for parameter in PARAMETERS.values() if parameter.number in moving
    }
    estimates = {name: value for name, value in found.items() if name in (*moved, "hit", "saturated_fraction")}
    ends = np.transpose(bounds_of(best.numbers, moving))
    held = {name for name, k in moved.items() if NAMES[k] not in best.inside}
    unknown |= {name for name in held if best.numbers[moved[name]] not in ends[moved[name]]}
    unknown &= moved.keys()
    known = [k for name, k in moved.items() if name not in unknown | held]
    covariance = np.zeros_like(best.information)
    covariance[np.ix_(known, known)] = _inverse(best.information[np.ix_(known, known)])
    slopes = slopes_of(numbers)
    variances = dict(zip(found, np.einsum("pi,ij,pj->p", slopes, covariance, slopes).tolist(), strict=True))
    errors = {name: math.sqrt(variances[name]) if variances[name] > 0.0 else math.nan for name in estimates}
    weights = {name: found.pop(name) for name in KINDS}
    return FitResult(
        grid=rows.grid,
        parameters=MixtureParameters.model_validate({"weights": weights, **found}),
        estimates=estimates,
        standard_errors=errors,
        at_bound=tuple(name for name in moved if name in held - unknown),
        not_identified=tuple(name for name in moved if name in unknown),
        log_likelihood=best.value,
        readings=round(rows.readings),
        _likelihood=rows,
        _optimum=best,
        _moving=tuple(moving),
    )


def _inverse(information: Array) -> Array:
    """The covariance by an information; NaN where that is none, as of numbers that the readings do not tell apart."""
    try:
        np.linalg.cholesky(information)
    except np.linalg.LinAlgError:
        return np.full_like(information, np.nan)
    return np.asarray(np.linalg.inv(information), dtype=np.float64)


def _share_interval(share: float, error: float, readings: int) -> tuple[float, float]:
    """Interval of the share of hits: that of a binomial likelihood with the same information."""
    missing = 1.0 - share
    trials = readings if math.isnan(error) or missing <= 0.0 else share * missing / error**2

    def excess(other: float) -> float:
        gain = xlogy(share, share) + xlogy(missing, missing) - xlogy(share, other) - xlog1py(missing, -other)
        return float(trials * gain - LIKELIHOOD_DROP)

    lowest, highest = 1e-12, 1.0 - 1e-12
    low = float(brentq(excess, lowest, share)) if share > lowest and excess(lowest) > 0.0 else 0.0
    high = float(brentq(excess, share, highest)) if share < highest and excess(highest) > 0.0 else 1.0
    return low, high
