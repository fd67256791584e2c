"""The result of a fit of the base mixture: parameters with errors and intervals, and probabilities of readings.

The maximum of a likelihood enters; named parameters leave with standard errors from the observed information (for the
weights by the delta method) and with intervals that respect the bounds of the parameters.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.special import expit, logit, xlog1py, xlogy
from scipy.stats import norm

from msp_lab.mixture_fit.grid import ReadingGrid
from msp_lab.mixture_fit.likelihood import (
    LEAST_LOG_ODDS,
    MIN_WEIGHT,
    NAMES,
    Likelihood,
    Numbers,
    Optimum,
    bounds_of,
)
from msp_range.arrays import Array
from msp_range.reading_model.kernel import NO_ECHO_CENTRE
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

KINDS = ("hit", "short", "missed", "random")
NUMBERS = {
    "short": ("log_odds_short", 0.0, 1.0),
    "missed": ("log_odds_missed", 0.0, 1.0),
    "random": ("log_odds_random", 0.0, 1.0),
    "sigma_cm": ("log_sigma", 0.01, 100.0),
    "short_rate_per_m": ("rate", 1e-3, 1e3),
    "saturated_fraction": ("saturated", 0.0, 1.0),
    "sigma_growth_cm_per_m": ("sigma_growth_2", 0.0, 100.0),
    "missed_growth_per_m": ("missed_growth", -math.inf, math.inf),
}
"""Parameters of the sensor model file: the number of the fit that moves each, its lowest and its highest value."""


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
    _moving: tuple[str, ...] = field(repr=False, compare=False)

    def below(
        self, reading_cm: ArrayLike, expected_cm: ArrayLike, reference_std_cm: ArrayLike = 0.0
    ) -> tuple[Array, Array]:
        """Probability of a smaller reading, and of the reading itself, each (n,)."""
        reading, expected = columns(reading_cm, expected_cm)
        reading = np.where(self.grid.can_report(reading), self.grid.nearest(reading), reading)
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
        number, low, high = NUMBERS[name]
        if number not in self._moving:
            return value, value
        if name in self.not_identified:
            return low, high
        room = min(value - low, high - value) if name in _SHARES else value - low
        if math.isnan(error) or room < NEAR_BOUND * error:
            return self._profile(name, -1.0), self._profile(name, 1.0)
        if name in _SHARES:
            width = Z * error / (value * (1.0 - value))
            return float(expit(logit(value) - width)), float(expit(logit(value) + width))
        if low > -math.inf:
            return value * math.exp(-Z * error / value), value * math.exp(Z * error / value)
        return value - Z * error, value + Z * error

    def _profile(self, name: str, sign: float) -> float:
        """Where the log-likelihood has dropped by `DROP`, the other numbers refitted; the bound if it does not."""
        number, *ends = NUMBERS[name]
        k = NAMES.index(number)
        best = self._optimum
        bound = bounds_of(best.numbers, self._moving)[sign > 0.0][k]
        others = [each for each in self._moving if each != number]
        centre = best.numbers[k]
        known = {centre: -DROP}
        last = best.numbers

        def excess(place: float) -> float:
            nonlocal last
            if place not in known:
                start = last._replace(**{number: place})
                at, value, _ = self._likelihood.maximum(start, bounds_of(start, others))
                last, known[place] = Numbers(*at.tolist()), best.value - value - DROP
            return known[place]

        step = sign / math.sqrt(max(best.information[k, k], 4.0))
        near, far = centre, centre
        while excess(far) <= 0.0:
            if far == bound:
                return ends[sign > 0.0]
            near, far = far, min(far + step, bound) if sign > 0.0 else max(far + step, bound)
            step *= 2.0
        limit = float(brentq(excess, near, far, xtol=1e-3 * abs(far - centre)))
        return _named(best.numbers._replace(**{number: limit}))[name]


def columns(reading_cm: ArrayLike, expected_cm: ArrayLike) -> tuple[Array, Array]:
    """Readings and ranges as arrays of the same length."""
    reading, expected = np.asarray(reading_cm, dtype=np.float64), np.asarray(expected_cm, dtype=np.float64)
    if reading.ndim != 1 or reading.shape != expected.shape:
        raise FitError(
            f"found readings of shape {reading.shape} and expected ranges of shape {expected.shape}, "
            "expected two columns of the same length"
        )
    return reading, np.minimum(expected, NO_ECHO_CENTRE)


def result_of(rows: Likelihood, best: Optimum, moving: Sequence[str], mean_length_m: float) -> FitResult:
    """Convert a maximum to named parameters with errors; readings are so far from the minimum, on average."""
    numbers = best.numbers
    spread = dict(zip(NAMES, np.diag(best.information), strict=True))
    unknown = set()
    if spread["saturated"] * UNKNOWN_FRACTION**2 < 1.0:
        unknown.add("saturated_fraction")
        numbers = numbers._replace(saturated=0.0)
    longest = UNKNOWN_FALL * max(numbers.rate, 1.0 / mean_length_m)
    if "log_odds_short" not in best.inside or spread["rate"] * longest**2 < 1.0:
        unknown.add("short_rate_per_m")
    named = _named(numbers)
    moved = {name: number for name, (number, *_) in NUMBERS.items() if number in moving}
    estimates = {name: value for name, value in named.items() if name in (*moved, "hit", "saturated_fraction")}
    ends = dict(zip(NAMES, zip(*bounds_of(best.numbers, moving), strict=True), strict=True))
    held = {name for name, number in moved.items() if number not in best.inside}
    unknown |= {name for name in held if getattr(best.numbers, moved[name]) not in ends[moved[name]]}
    unknown &= moved.keys()
    known = [NAMES.index(moved[name]) for name in moved if name not in unknown and moved[name] in best.inside]
    covariance = np.zeros_like(best.information)
    covariance[np.ix_(known, known)] = _inverse(best.information[np.ix_(known, known)])
    jacobian = _jacobian(numbers, named)
    variances = {name: float(jacobian[name] @ covariance @ jacobian[name]) for name in estimates}
    errors = {name: math.sqrt(variance) if variance > 0.0 else math.nan for name, variance in variances.items()}
    weights = {name: named[name] for name in KINDS}
    others = {name: value for name, value in named.items() if name not in KINDS}
    return FitResult(
        grid=rows.grid,
        parameters=MixtureParameters.model_validate({"weights": weights, **others}),
        estimates=estimates,
        standard_errors=errors,
        at_bound=tuple(name for name in moved if name in held - unknown),
        not_identified=tuple(name for name in moved if name in unknown),
        log_likelihood=best.value,
        readings=round(rows.readings),
        rows=len(rows),
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


def _named(numbers: Numbers) -> dict[str, float]:
    """Parameters of the sensor model file from the numbers of the fit; a kind that never came has a share of 0."""
    log_odds = np.array([0.0, numbers.log_odds_short, numbers.log_odds_missed, numbers.log_odds_random])
    odds = np.where(log_odds > LEAST_LOG_ODDS, np.exp(log_odds), 0.0)
    return dict(zip(KINDS, (odds / odds.sum()).tolist(), strict=True)) | {
        "sigma_cm": min(max(math.exp(numbers.log_sigma), 0.01), 100.0),
        "short_rate_per_m": numbers.rate,
        "saturated_fraction": numbers.saturated,
        "sigma_growth_cm_per_m": math.sqrt(numbers.sigma_growth_2),
        "missed_growth_per_m": numbers.missed_growth,
    }


def _jacobian(numbers: Numbers, named: dict[str, float]) -> dict[str, Array]:
    """Derivatives of each named parameter by the numbers of the fit."""
    rows = {name: np.zeros(len(NAMES)) for name in named}
    for name in KINDS:
        for other in KINDS[1:]:
            rows[name][NAMES.index(NUMBERS[other][0])] = named[name] * ((name == other) - named[other])
    growth = named["sigma_growth_cm_per_m"]
    slopes = {
        "sigma_cm": named["sigma_cm"],
        "short_rate_per_m": 1.0,
        "saturated_fraction": 1.0,
        "sigma_growth_cm_per_m": 0.5 / growth if growth > 0.0 else 0.0,
        "missed_growth_per_m": 1.0,
    }
    for name, slope in slopes.items():
        rows[name][NAMES.index(NUMBERS[name][0])] = slope
    return rows


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
