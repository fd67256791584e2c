"""The base reading model: what a range finder reports, given the true range.

The mixture of Thrun (report 5.2.1, eq 9-12) in whole centimetres, with the sensor's limits and codes. True ranges
enter, readings leave (`ReadingModel.sample`), or readings enter too and their log-probabilities leave
(`ReadingModel.log_prob`): one distribution, drawn from by the simulator and scored by filters and fits. The report's
equations are normalised over the real line; here, by its erratum 6, every density is normalised on what the sensor
can report, the exponential ends at the expected range, and a reading's probability is that of its 1 cm interval.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import expit, log_ndtr, logit

from msp_range.correction.calibration import IDENTITY, Calibration
from msp_range.reading_model.sensor_model import (
    SATURATED_CM,
    WEIGHTS_RANGE_CM,
    MixtureParameters,
    SensorModel,
)

TRUE_RANGE = "true_range_cm"
"""The one context column that the base model needs."""

_Array = NDArray[np.float64]


@dataclass(frozen=True)
class ReadingModel:
    """Distribution of a reading k [cm] over the whole centimetres m ... M, given the true range z* [cm].

    With m and M the sensor's shortest and longest reading and [a, b] the reading's interval, k - 1/2 to k + 1/2::

        q(k) = w_hit hit(k) + w_unexpected unexpected(k) + w_max [k = M] + w_random random(k)

        hit(k)         Phi((b - z*) / sigma) - Phi((a - z*) / sigma)                              (eq 9)
                       a = -inf for k = m: nearer than the minimum reads the minimum
                       b = +inf for k = M: beyond the maximum reads as no echo
        unexpected(k)  (exp(-lambda (a' - m)) - exp(-lambda (b' - m))) / (1 - exp(-lambda (e - m)))   (eq 10)
                       e = min(z*, M), and [a', b'] the part of [a, b] inside [m, e]; [k = m] where e <= m
        [k = M]        an echo missed (eq 11)
        random(k)      1 / (M - m + 1)                                                            (eq 12)

    z* is the true range as the calibration takes it to a reading, `Calibration.forward`. A surface that the beam cannot
    hear is one at infinity: its hits read M, and something unexpected may be anywhere before M. M is the no-echo code,
    and of all readings of M, whatever their cause, a fraction s arrives as 255::

        p(M) = (1 - s) q(M),    p(255) = q(255) + s q(M),    p(k) = q(k) otherwise

    Two of the parameters may depend on the range r = z* within 0 ... M (M where nothing is heard)::

        sigma(r)^2 = sigma^2 + (g r)^2
        w_max(r) / (1 - w_max(r)) = w_max / (1 - w_max) exp(h (r - 3 m)),  the other weights in their proportions

    Parameters
    ----------
    parameters
        Weights w, sigma, lambda, s, and the growths g and h. Weights are divided by their sum.
    minimum_cm, maximum_cm
        m and M.
    calibration
        Mean reading over true range.

    Examples
    --------
    >>> weights = {"hit": 0.9, "unexpected": 0.03, "max": 0.05, "random": 0.02}
    >>> parameters = {"weights": weights, "sigma_cm": 1.5, "unexpected_rate_per_m": 0.5, "saturated_fraction": 0.2}
    >>> model = ReadingModel(MixtureParameters.model_validate(parameters), minimum_cm=20, maximum_cm=765)
    >>> contexts = {"true_range_cm": np.array([300.0, 300.0])}
    >>> print(np.exp(model.log_prob(np.array([300, 765]), contexts)).round(4))
    [0.2351 0.04  ]
    """

    parameters: MixtureParameters
    minimum_cm: int
    maximum_cm: int
    calibration: Calibration = IDENTITY

    @classmethod
    def of(cls, sensor: SensorModel) -> "ReadingModel":
        """The base model of a sensor model file."""
        return cls(sensor.reading_model, sensor.minimum_cm, sensor.maximum_cm, sensor.calibration_curve)

    def sample(self, contexts: Mapping[str, Any], rng: np.random.Generator) -> _Array:
        """Draw one reading for each context.

        Parameters
        ----------
        contexts
            Arrays of length n by column name; `true_range_cm` is needed, NaN where the beam hears nothing.
        rng
            Source of chance; one normal and one uniform a reading, and one more uniform a reading of no echo.

        Returns
        -------
        ndarray, shape (n,)
            Readings [cm], whole numbers.

        Raises
        ------
        ValueError
            `true_range_cm` is missing or is not one column.
        """
        true_cm = self.calibration.forward(_true_range_cm(contexts))
        reading_cm = rng.standard_normal(true_cm.size)
        reading_cm *= self.sigma_cm(true_cm)
        reading_cm += true_cm
        np.rint(reading_cm, out=reading_cm)
        # fmin and not minimum: it takes NaN, a surface that is not heard, to the maximum.
        np.fmin(reading_cm, self.maximum_cm, out=reading_cm)
        np.maximum(reading_cm, self.minimum_cm, out=reading_cm)
        kind = rng.random(true_cm.size)
        outliers = np.flatnonzero(kind >= self._thresholds(true_cm)[0])
        reading_cm[outliers] = self._outliers_cm(kind[outliers], true_cm[outliers])
        if self.parameters.saturated_fraction > 0.0:
            no_echo = np.flatnonzero(reading_cm == self.maximum_cm)
            saturated = rng.random(no_echo.size) < self.parameters.saturated_fraction
            reading_cm[no_echo[saturated]] = SATURATED_CM
        return reading_cm

    def sample_one(self, true_range_cm: float | None, rng: np.random.Generator) -> int:
        """Draw one reading [cm] from the distribution of `sample`, without arrays.

        Parameters
        ----------
        true_range_cm
            True range [cm]; None or NaN where the beam hears nothing.
        rng
            Source of chance.
        """
        expected_cm = math.inf
        if true_range_cm is not None and true_range_cm == true_range_cm:
            expected_cm = self.calibration.forward(true_range_cm)
        minimum_cm, maximum_cm, parameters = self.minimum_cm, self.maximum_cm, self.parameters
        below_hit, below_unexpected, below_max = self._thresholds(expected_cm)
        kind = rng.random()
        if kind < below_hit:
            heard_cm = expected_cm + self.sigma_cm(expected_cm) * rng.standard_normal()
        elif kind < below_unexpected:
            share = (kind - below_hit) / (below_unexpected - below_hit)
            rate_per_cm = parameters.unexpected_rate_per_m / 100.0
            length_cm = max(min(expected_cm, maximum_cm) - minimum_cm, 0.0)
            heard_cm = minimum_cm - math.log1p(share * math.expm1(-rate_per_cm * length_cm)) / rate_per_cm
        elif kind < below_max:
            heard_cm = maximum_cm
        else:
            share = (kind - below_max) / (1.0 - below_max)
            heard_cm = minimum_cm + int(share * (maximum_cm - minimum_cm + 1))
        if heard_cm <= minimum_cm:
            return minimum_cm
        reading_cm = maximum_cm if heard_cm >= maximum_cm else round(heard_cm)
        if reading_cm == maximum_cm and rng.random() < parameters.saturated_fraction:
            return SATURATED_CM
        return reading_cm

    def log_prob(self, reading_cm: ArrayLike, contexts: Mapping[str, Any]) -> _Array:
        """Natural logarithm of each reading's probability given its context.

        Parameters
        ----------
        reading_cm
            Readings [cm], shape (n,).
        contexts
            As for `sample`.

        Returns
        -------
        ndarray, shape (n,)
            log p; -inf for what the sensor cannot report: fractions of a centimetre, values outside its limits, NaN.

        Raises
        ------
        ValueError
            `true_range_cm` is missing, or the lengths differ.
        """
        true_cm = self.calibration.forward(_true_range_cm(contexts))
        reading = np.asarray(reading_cm, dtype=np.float64)
        if reading.shape != true_cm.shape:
            raise ValueError(
                f"found readings of shape {reading.shape} and {TRUE_RANGE} of shape {true_cm.shape}, expected the same"
            )
        reportable = (reading >= self.minimum_cm) & (reading <= self.maximum_cm) & (np.rint(reading) == reading)
        log_p = self._log_unsaturated(np.where(reportable, reading, self.minimum_cm), true_cm)
        fraction = self.parameters.saturated_fraction
        if fraction > 0.0:
            log_p[reading == self.maximum_cm] += _log(1.0 - fraction)
            saturated = np.flatnonzero(reading == SATURATED_CM)
            no_echo = self._log_unsaturated(np.full(saturated.size, float(self.maximum_cm)), true_cm[saturated])
            log_p[saturated] = np.logaddexp(log_p[saturated], no_echo + math.log(fraction))
        log_p[~reportable] = -np.inf
        return log_p

    def sigma_cm(self, true_range_cm: Any) -> Any:
        """Standard deviation of a hit before it is rounded [cm], for one range or an array of them [cm]."""
        parameters = self.parameters
        if parameters.sigma_growth_cm_per_m == 0.0:
            return parameters.sigma_cm
        return np.hypot(parameters.sigma_cm, parameters.sigma_growth_cm_per_m / 100.0 * self._within(true_range_cm))

    def max_weight(self, true_range_cm: Any) -> Any:
        """Share of `max`, for one range or an array of them [cm]; the other shares keep their proportions."""
        parameters, share = self.parameters, self._shares[2]
        if parameters.max_growth_per_m == 0.0 or share in (0.0, 1.0):
            return share
        beyond_m = (self._within(true_range_cm) - WEIGHTS_RANGE_CM) / 100.0
        return expit(logit(share) + parameters.max_growth_per_m * beyond_m)

    def log_weights(self, true_range_cm: Any) -> tuple[Any, Any, Any, Any]:
        """log of the shares of hit, unexpected, max and random, but for a common summand: numbers or arrays."""
        hit, unexpected, max_, random = self._shares
        here = self.max_weight(true_range_cm)
        # The odds of `max` against the others.
        log_max = logit(here) + _log(1.0 - max_) if isinstance(here, np.ndarray) else _log(max_)
        return _log(hit), _log(unexpected), log_max, _log(random)

    def _within(self, true_range_cm: Any) -> Any:
        """The range on which the parameters may depend: what is not heard is as far as the sensor can reach."""
        return np.maximum(np.fmin(true_range_cm, self.maximum_cm), 0.0)

    @cached_property
    def _shares(self) -> tuple[float, float, float, float]:
        """Weights of hit, unexpected, max and random, divided by their sum."""
        weights = self.parameters.weights
        total = weights.hit + weights.unexpected + weights.max + weights.random
        return weights.hit / total, weights.unexpected / total, weights.max / total, weights.random / total

    @cached_property
    def _same_thresholds(self) -> tuple[float, float, float]:
        """Cumulative weights: a uniform number below the first is a hit, then unexpected, then max, then random."""
        hit, unexpected, max_, random = self._shares
        # The last share takes what rounding leaves, so it must be none where it has no weight.
        return hit, hit + unexpected, hit + unexpected + max_ if random > 0.0 else 1.0

    def _thresholds(self, true_cm: Any) -> tuple[Any, Any, Any]:
        """The cumulative weights for one range or an array of them [cm]."""
        hit, unexpected, max_, random = self._shares
        if self.parameters.max_growth_per_m == 0.0 or max_ in (0.0, 1.0):
            return self._same_thresholds
        here = self.max_weight(true_cm)
        left = (1.0 - here) / (1.0 - max_)
        below_unexpected = (hit + unexpected) * left
        return hit * left, below_unexpected, below_unexpected + here if random > 0.0 else 1.0

    def _outliers_cm(self, kind: _Array, true_cm: _Array) -> _Array:
        """Readings of the three rarer kinds, each placed by what is left of the uniform number that chose its kind."""
        below_hit, below_unexpected, below_max = (
            np.broadcast_to(threshold, kind.shape) for threshold in self._thresholds(true_cm)
        )
        reading_cm = np.full(kind.size, float(self.maximum_cm))
        unexpected = np.flatnonzero(kind < below_unexpected)
        if unexpected.size:
            start = below_hit[unexpected]
            share = (kind[unexpected] - start) / (below_unexpected[unexpected] - start)
            rate_per_cm = self.parameters.unexpected_rate_per_m / 100.0
            length_cm = np.maximum(np.fmin(true_cm[unexpected], self.maximum_cm) - self.minimum_cm, 0.0)
            nearer_cm = self.minimum_cm - np.log1p(share * np.expm1(-rate_per_cm * length_cm)) / rate_per_cm
            reading_cm[unexpected] = np.rint(nearer_cm)
        random = np.flatnonzero(kind >= below_max)
        if random.size:
            start = below_max[random]
            share = (kind[random] - start) / (1.0 - start)
            reading_cm[random] = self.minimum_cm + np.floor(share * (self.maximum_cm - self.minimum_cm + 1))
        # A share next to 1 can round up to it.
        np.minimum(reading_cm, self.maximum_cm, out=reading_cm)
        return reading_cm

    def _log_unsaturated(self, reading_cm: _Array, true_cm: _Array) -> _Array:
        """log q, for readings that the sensor can report."""
        minimum_cm, maximum_cm = self.minimum_cm, self.maximum_cm
        hit, unexpected, max_, random = self._shares
        here = self.max_weight(true_cm)
        # What the growth of `max` takes from the three others.
        with np.errstate(divide="ignore"):
            log_left = np.log1p(-here) - np.log1p(-max_) if np.ndim(here) else 0.0
        log_hit_cm = log_hit(reading_cm, true_cm, self.sigma_cm(true_cm), minimum_cm, maximum_cm)
        log_q: _Array = _log(hit) + log_left + log_hit_cm
        if unexpected > 0.0:
            log_unexpected_cm = log_unexpected(
                reading_cm, true_cm, self.parameters.unexpected_rate_per_m, minimum_cm, maximum_cm
            )
            log_q = np.logaddexp(log_q, _log(unexpected) + log_left + log_unexpected_cm)
        log_random = _log(random / (maximum_cm - minimum_cm + 1)) + log_left
        with np.errstate(divide="ignore"):
            log_max = np.log(here)
        log_elsewhere = np.where(reading_cm == maximum_cm, np.logaddexp(log_random, log_max), log_random)
        log_either: _Array = np.logaddexp(log_q, log_elsewhere)
        return log_either


def log_hit(
    reading_cm: _Array,
    true_cm: _Array,
    sigma_cm: float | _Array,
    minimum_cm: int,
    maximum_cm: int,
    last_cm: _Array | None = None,
) -> _Array:
    """log of the probability that a normal variable lies in the reading's interval (`ReadingModel`, eq 9).

    Exact in the tails: it is finite where the probability itself is too small for a float.

    Parameters
    ----------
    reading_cm
        Readings that the sensor can report [cm].
    true_cm
        True range [cm]; NaN or infinite where nothing can be heard.
    sigma_cm
        Standard deviation [cm].
    minimum_cm, maximum_cm
        The sensor's limits.
    last_cm
        For the probability of any reading from ``reading_cm`` to this one [cm], not smaller.
    """
    last_cm = reading_cm if last_cm is None else last_cm
    lower = np.where(reading_cm == minimum_cm, -np.inf, reading_cm - 0.5)
    upper = np.where(last_cm == maximum_cm, np.inf, last_cm + 0.5)
    unheard = ~(true_cm < np.inf)
    centre = np.where(unheard, maximum_cm, true_cm)
    a, b = (lower - centre) / sigma_cm, (upper - centre) / sigma_cm
    # Phi(b) - Phi(a) = Phi(-a) - Phi(-b): on the left side of the bell both terms are small, and nothing cancels.
    right = a > 0.0
    log_phi_a, log_phi_b = log_ndtr(np.where(right, -b, a)), log_ndtr(np.where(right, -a, b))
    with np.errstate(divide="ignore"):
        log_p: _Array = log_phi_b + np.log(-np.expm1(log_phi_a - log_phi_b))
    log_p[unheard] = np.where(last_cm[unheard] == maximum_cm, 0.0, -np.inf)
    return log_p


def log_unexpected(
    reading_cm: _Array,
    true_cm: _Array,
    rate_per_m: float | _Array,
    minimum_cm: int,
    maximum_cm: int,
    last_cm: _Array | None = None,
) -> _Array:
    """log of the probability that the truncated exponential lies in the reading's interval (`ReadingModel`, eq 10).

    Parameters
    ----------
    reading_cm
        Readings that the sensor can report [cm].
    true_cm
        True range [cm], where the exponential ends; NaN or beyond the maximum: it ends at the maximum.
    rate_per_m
        lambda [1/m].
    minimum_cm, maximum_cm
        The sensor's limits.
    last_cm
        For the probability of any reading from ``reading_cm`` to this one [cm], not smaller.
    """
    last_cm = reading_cm if last_cm is None else last_cm
    rate_per_cm = rate_per_m / 100.0
    end = np.fmin(true_cm, maximum_cm)
    lower = np.maximum(reading_cm - 0.5, minimum_cm)
    width = np.maximum(np.minimum(last_cm + 0.5, end) - lower, 0.0)
    length = np.maximum(end - minimum_cm, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        log_p = (
            rate_per_cm * (minimum_cm - lower)
            + np.log(-np.expm1(-rate_per_cm * width))
            - np.log(-np.expm1(-rate_per_cm * length))
        )
    return np.where(length > 0.0, log_p, np.where(reading_cm == minimum_cm, 0.0, -np.inf))


def _true_range_cm(contexts: Mapping[str, Any]) -> _Array:
    if TRUE_RANGE not in contexts:
        raise ValueError(f"found the context columns {sorted(contexts)}, expected {TRUE_RANGE!r} among them")
    true_cm = np.asarray(contexts[TRUE_RANGE], dtype=np.float64)
    if true_cm.ndim != 1:
        raise ValueError(f"found {TRUE_RANGE} of shape {true_cm.shape}, expected one dimension")
    return true_cm


def _log(probability: float) -> float:
    return math.log(probability) if probability > 0.0 else -math.inf
