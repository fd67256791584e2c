"""The result of a fit of the base mixture: parameters with errors and intervals, and probabilities of readings.

The maximum of a likelihood enters; named parameters leave with standard errors from the observed information (for the
weights by the delta method) and with intervals that respect the bounds of the parameters.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.special import expit, logit, xlog1py, xlogy
from scipy.stats import norm

from msp_range.arrays import Array
from msp_range.reading_model import densities as mix
from msp_range.reading_model.grid import ReadingGrid
from msp_range.reading_model.likelihood import Likelihood
from msp_range.reading_model.newton import Bounds, Optimum, profile_limit
from msp_range.reading_model.sensor_model import MixtureParameters

Z = float(norm.ppf(0.975))
"""Normal quantile of the intervals: 95 %, two-sided."""
DROP = Z * Z / 2.0
"""Drop of the log-likelihood at the ends of a 95 % interval by its profile: half of chi-square's quantile."""
NEAR_BOUND = 4.0
"""Within this many standard errors of a bound the interval is computed from the profile likelihood."""
UNKNOWN_FRACTION = 0.5
"""Standard error above which a fraction counts as not identified."""
UNKNOWN_FALL = 3.0
"""A lambda counts as not identified if its standard error is this many times both itself and 1 / (mean range)."""

_NUMBERS = {
    "short": mix.U,
    "random": mix.R,
    "missed": mix.M,
    "sigma_cm": mix.T,
    "short_rate_per_m": mix.L,
    "saturated_fraction": mix.S,
    "sigma_growth_cm_per_m": mix.V,
    "missed_growth_per_m": mix.G,
}
MIN_WEIGHT = 1e-4
"""Floor of a weight in a sensor model file, and of the share of missed echoes at 3 m that depends on range. A kind of
reading with a share of 0 could never be compared with any reading, and an outlier in flight would have no probability.
20,000 readings without one of a kind are compatible with this share; a smaller floor lets a fit whose missed echoes are
all near move the share at 3 m to 1e-30, and the growth with it."""
MAX_GROWTH_PER_M = 10.0
"""Largest growth of the log odds of missed echoes with range [1/m]: from `MIN_WEIGHT` to certainty within 1.5 m. With a
larger one the share at one range says nothing of another, and its derivatives overflow."""
#                             U    R    M    T            L     S    V    G
BOUNDS = Bounds(
    lower=np.array([0.0, 0.0, 0.0, math.log(0.01), 1e-5, 0.0, 0.0, -MAX_GROWTH_PER_M / 100.0]),
    upper=np.array([1.0, 1.0, 1.0, math.log(100.0), 10.0, 1.0, 1.0, MAX_GROWTH_PER_M / 100.0]),
    stride=np.array([0.3, 0.3, 0.3, 1.0, 0.02, 0.5, 0.01, 0.01]),
    relative=np.arange(len(mix.NAMES)) == mix.L,
)


def bounds_of(moving: Sequence[int]) -> Bounds:
    """Return the bounds of a fit in which these parameters move: with growth, missed echoes are possible anywhere."""
    if mix.G not in moving:
        return BOUNDS
    lower, upper = np.array(BOUNDS.lower), np.array(BOUNDS.upper)
    lower[mix.M], upper[mix.M] = MIN_WEIGHT, 1.0 - MIN_WEIGHT
    return replace(BOUNDS, lower=lower, upper=upper)


_SHARES = frozenset({"hit", "short", "missed", "random", "saturated_fraction"})


def with_floors(parameters: MixtureParameters, saturates: bool) -> tuple[MixtureParameters, tuple[str, ...]]:
    """Return the parameters with no share below `MIN_WEIGHT`, and the names of those that were raised.

    The saturated fraction is one of them where the sensor ``saturates``: may read 255 for no echo.

    Examples
    --------
    >>> weights = {"hit": 1.0, "short": 0.0, "missed": 0.0, "random": 0.0}
    >>> given = {"weights": weights, "sigma_cm": 1.0, "short_rate_per_m": 0.5, "saturated_fraction": 0.0}
    >>> found, raised = with_floors(MixtureParameters.model_validate(given), saturates=False)
    >>> print(f"{found.weights.hit:.4f} {found.weights.random:g} {', '.join(raised)}")
    0.9997 0.0001 short, missed, random
    """
    shares = parameters.weights.model_dump()
    raised = tuple(name for name, share in shares.items() if share < MIN_WEIGHT)
    seldom = ("saturated_fraction",) if saturates and parameters.saturated_fraction < MIN_WEIGHT else ()
    if seldom:
        parameters = parameters.model_copy(update={"saturated_fraction": MIN_WEIGHT})
    if not raised:
        return parameters, seldom
    floored = {name: max(share, MIN_WEIGHT) for name, share in shares.items()}
    # The largest share pays for it.
    largest = max(shares, key=lambda name: shares[name])
    floored[largest] -= sum(floored.values()) - 1.0
    weights = parameters.weights.model_copy(update=floored)
    return parameters.model_copy(update={"weights": weights}), (*raised, *seldom)


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
    rows: int
    """Sum of log probabilities; number of readings, and of distinct rows among them."""
    _likelihood: Likelihood = field(repr=False, compare=False)
    _optimum: Optimum = field(repr=False, compare=False)
    _moving: tuple[int, ...] = field(repr=False, compare=False)

    def below(
        self, reading_cm: ArrayLike, expected_cm: ArrayLike, reference_std_cm: ArrayLike = 0.0
    ) -> tuple[Array, Array]:
        """Probability of a smaller reading, and of the reading itself, each (n,)."""
        reading, expected = columns(reading_cm, expected_cm)
        reference_cm2 = np.broadcast_to(np.asarray(reference_std_cm, dtype=np.float64) ** 2, reading.shape)
        return mix.probabilities(self.grid, self._optimum.theta, reading, expected, reference_cm2)

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
        if _NUMBERS[name] not in self._moving:
            return value, value
        low, high = _ends(name)
        if name in self.not_identified:
            return low, high
        room = value - low if name not in _SHARES else min(value - low, high - value)
        if math.isnan(error) or room < NEAR_BOUND * error:
            return self._profile(name)
        if name in _SHARES:
            width = Z * error / (value * (1.0 - value))
            return float(expit(logit(value) - width)), float(expit(logit(value) + width))
        if low > -math.inf:
            return value * math.exp(-Z * error / value), value * math.exp(Z * error / value)
        return value - Z * error, value + Z * error

    def _profile(self, name: str) -> tuple[float, float]:
        number = _NUMBERS[name]
        free = mix.optional(self._moving)
        derivatives = partial(self._likelihood.derivatives, free=free)
        curvature = -float(self._optimum.hessian[number, number])
        guess = math.sqrt(2.0 * DROP / curvature) if curvature > 0.0 else 1e-3
        gradient = abs(float(self._optimum.gradient[number]))
        if number not in self._optimum.inside and gradient > 0.0:
            guess = min(guess, DROP / gradient)
        guess = min(guess, float(BOUNDS.stride[number]))
        bounds = bounds_of(self._moving)
        limits = []
        for sign in (-1.0, 1.0):
            limit = profile_limit(derivatives, self._optimum, self._moving, number, bounds, sign * guess, DROP)
            theta = np.array(self._optimum.theta)
            theta[number] = limit
            limits.append(_named(theta)[name])
        return limits[0], limits[1]


def columns(reading_cm: ArrayLike, expected_cm: ArrayLike) -> tuple[Array, Array]:
    """Readings and ranges as arrays of the same length."""
    reading, expected = np.asarray(reading_cm, dtype=np.float64), np.asarray(expected_cm, dtype=np.float64)
    if reading.ndim != 1 or reading.shape != expected.shape:
        raise FitError(
            f"found readings of shape {reading.shape} and expected ranges of shape {expected.shape}, "
            "expected two columns of the same length"
        )
    return reading, expected


def result_of(rows: Likelihood, best: Optimum, moving: Sequence[int]) -> FitResult:
    """Convert a maximum to named parameters with errors."""
    theta = np.array(best.theta)
    information = -best.hessian
    inside = list(best.inside)
    unknown = _unknown(information, inside, moving, max(theta[mix.L], 1.0 / rows.mean_length_cm))
    inside = [number for number in inside if number not in unknown]
    if mix.S in unknown:
        theta[mix.S] = 0.0
    covariance = np.zeros_like(information)
    try:
        covariance[np.ix_(inside, inside)] = np.linalg.inv(information[np.ix_(inside, inside)])
    except np.linalg.LinAlgError:
        covariance[np.ix_(inside, inside)] = math.nan
    named = {name: value for name, value in _named(theta).items() if name == "hit" or _NUMBERS[name] in moving}
    if mix.S not in moving:
        named["saturated_fraction"] = 0.0
    jacobian = _jacobian(theta, tuple(named))
    variances = np.diag(jacobian @ covariance @ jacobian.T)
    errors = {
        name: math.sqrt(variance) if variance > 0.0 else math.nan
        for name, variance in zip(named, variances, strict=True)
    }
    names_of = {number: name for name, number in _NUMBERS.items()}
    held = tuple(names_of[number] for number in moving if number not in best.inside and number not in unknown)
    everything = _named(theta)
    weights = {name: everything.pop(name) for name in ("hit", "short", "missed", "random")}
    parameters = MixtureParameters.model_validate({"weights": weights, **everything})
    return FitResult(
        grid=rows.grid,
        parameters=parameters,
        estimates=named,
        standard_errors=errors,
        at_bound=held,
        not_identified=tuple(names_of[number] for number in moving if number in unknown),
        log_likelihood=best.value,
        readings=round(rows.readings),
        rows=rows.rows,
        _likelihood=rows,
        _optimum=best,
        _moving=tuple(moving),
    )


def _named(theta: Array) -> dict[str, float]:
    """Parameters of the sensor model file from those of the likelihood."""
    left = 1.0 - theta[mix.M]
    short, random = left * theta[mix.U], left * theta[mix.R]
    named = {
        "hit": left - short - random,
        "short": short,
        "missed": theta[mix.M],
        "random": random,
        "sigma_cm": min(max(math.exp(theta[mix.T]), 0.01), 100.0),
        "short_rate_per_m": 100.0 * theta[mix.L],
        "saturated_fraction": theta[mix.S],
        "sigma_growth_cm_per_m": 100.0 * math.sqrt(theta[mix.V]),
        "missed_growth_per_m": 100.0 * theta[mix.G],
    }
    return {name: float(value) for name, value in named.items()}


def _jacobian(theta: Array, names: Sequence[str]) -> Array:
    """Derivatives of named parameters by those of the likelihood."""
    left = 1.0 - theta[mix.M]
    rows = {name: np.zeros(len(mix.NAMES)) for name in _named(theta)}
    rows["hit"][[mix.U, mix.R, mix.M]] = -left, -left, theta[mix.U] + theta[mix.R] - 1.0
    rows["short"][[mix.U, mix.M]] = left, -theta[mix.U]
    rows["random"][[mix.R, mix.M]] = left, -theta[mix.R]
    rows["missed"][mix.M] = rows["saturated_fraction"][mix.S] = 1.0
    rows["sigma_cm"][mix.T] = math.exp(theta[mix.T])
    rows["short_rate_per_m"][mix.L] = rows["missed_growth_per_m"][mix.G] = 100.0
    if theta[mix.V] > 0.0:
        rows["sigma_growth_cm_per_m"][mix.V] = 50.0 / math.sqrt(theta[mix.V])
    # A weight whose share is fixed at zero stays zero.
    for name, number in (("short", mix.U), ("random", mix.R)):
        if theta[number] == 0.0:
            rows[name][:] = 0.0
    return np.array([rows[name] for name in names])


def _unknown(information: Array, inside: Sequence[int], moving: Sequence[int], rate: float) -> frozenset[int]:
    """Numbers of parameters that the readings do not determine; `rate` is a typical lambda [1/cm]."""
    unknown = set()
    if mix.U in moving and mix.U not in inside:
        unknown.add(mix.L)
    for number, scale in ((mix.S, UNKNOWN_FRACTION), (mix.L, UNKNOWN_FALL * rate)):
        if number in moving and number not in unknown and information[number, number] * scale**2 < 1.0:
            unknown.add(number)
    return frozenset(unknown)


def _ends(name: str) -> tuple[float, float]:
    """Bounds of a named parameter."""
    theta = np.zeros(len(mix.NAMES))
    ends = []
    for bounds in (BOUNDS.lower, BOUNDS.upper):
        theta[_NUMBERS[name]] = bounds[_NUMBERS[name]]
        ends.append(_named(theta)[name])
    if name == "missed_growth_per_m":
        return -math.inf, math.inf
    return ends[0], ends[1]


def _share_interval(share: float, error: float, readings: int) -> tuple[float, float]:
    """Interval of the share of hits: that of a binomial likelihood with the same information."""
    missing = 1.0 - share
    trials = readings if math.isnan(error) or missing <= 0.0 else share * missing / error**2

    def excess(other: float) -> float:
        gain = xlogy(share, share) + xlogy(missing, missing) - xlogy(share, other) - xlog1py(missing, -other)
        return float(trials * gain - DROP)

    lowest, highest = 1e-12, 1.0 - 1e-12
    low = float(brentq(excess, lowest, share)) if share > lowest and excess(lowest) > 0.0 else 0.0
    high = float(brentq(excess, share, highest)) if share < highest and excess(highest) > 0.0 else 1.0
    return low, high
