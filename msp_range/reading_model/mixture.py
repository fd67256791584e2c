"""The base reading model: what a range finder reports, given the true range.

The mixture of Thrun (report 5.2.1, eq 9-12) in steps of the sensor's resolution, with its limits and codes.
`ReadingModel.sample` draws readings for true ranges, and `ReadingModel.log_prob` gives the log-probabilities of
readings: one distribution, drawn from by the simulator and scored by filters and fits. The report's equations are
normalised over the real line; here, by its erratum 6, every density is normalised on what the sensor can report, the
exponential ends at the expected range, and a reading's probability is that of its step.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from msp_range.arrays import Array
from msp_range.correction.calibration import IDENTITY, Calibration
from msp_range.reading_model.rows import MixtureRows, shares_of
from msp_range.reading_model.sensor_model import (
    SATURATED_CM,
    WEIGHTS_RANGE_CM,
    MixtureParameters,
    SensorModel,
    load_sensor_model,
)

TRUE_RANGE = "true_range_cm"
"""The one context column that the base model needs."""
MOST_LOG_ODDS = 600.0
"""Growth with range stops at these log odds: beyond about 700 their exponential is no float any more."""


@dataclass(frozen=True)
class ReadingModel:
    """Distribution of a reading k [cm] over m, m + d ... M, given the true range z* [cm].

    With m and M the sensor's shortest and longest reading, d its resolution (mostly 1 cm) and [a, b] the reading's
    interval, k - d/2 to k + d/2::

        q(k) = w_hit hit(k) + w_short short(k) + w_missed [k = M] + w_random random(k)

        hit(k)         Phi((b - z*) / sigma) - Phi((a - z*) / sigma)                              (eq 9)
                       a = -inf for k = m: nearer than the minimum reads the minimum
                       b = +inf for k = M: beyond the maximum reads as no echo
        short(k)       (exp(-lambda (a' - m)) - exp(-lambda (b' - m))) / (1 - exp(-lambda (e - m)))   (eq 10)
                       e = min(z*, M), and [a', b'] the part of [a, b] inside [m, e]; [k = m] where e <= m
        [k = M]        an echo missed (eq 11)
        random(k)      d / (M - m + d)                                                            (eq 12)

    z* is the true range as the calibration takes it to a reading, `Calibration.forward`. A surface that gives no
    echo is one at infinity: its hits read M, and a short reading may be anywhere before M. M is the no-echo code,
    and of all readings of M, whatever their cause, a fraction s arrives as 255::

        p(M) = (1 - s) q(M),    p(255) = q(255) + s q(M),    p(k) = q(k) otherwise

    Two of the parameters may depend on the range r = z* within 0 ... M (M where there is no echo)::

        sigma(r)^2 = sigma^2 + (g r)^2
        w_missed(r) / (1 - w_missed(r)) = w_missed / (1 - w_missed) exp(h (r - 3 m)),  the others in proportion

    Parameters
    ----------
    parameters
        Weights w, sigma, lambda, s, and the growths g and h. Weights are divided by their sum.
    minimum_cm, maximum_cm
        m and M.
    calibration
        Mean reading over true range.
    resolution_cm
        d, of which m and M are multiples.

    Examples
    --------
    >>> weights = {"hit": 0.9, "short": 0.03, "missed": 0.05, "random": 0.02}
    >>> parameters = {"weights": weights, "sigma_cm": 1.5, "short_rate_per_m": 0.5, "saturated_fraction": 0.2}
    >>> model = ReadingModel(MixtureParameters.model_validate(parameters), minimum_cm=20, maximum_cm=765)
    >>> contexts = {"true_range_cm": np.array([300.0, 300.0])}
    >>> print(np.exp(model.log_prob(np.array([300, 765]), contexts)).round(4))
    [0.2351 0.04  ]
    """

    parameters: MixtureParameters
    minimum_cm: float
    maximum_cm: float
    calibration: Calibration = IDENTITY
    resolution_cm: float = 1.0

    @classmethod
    def of(cls, sensor: SensorModel | Path | str) -> "ReadingModel":
        """The base model of a sensor model file, or of its path, or of the name of one that comes with the package."""
        if not isinstance(sensor, SensorModel):
            sensor = load_sensor_model(sensor)
        limits = sensor.minimum_cm, sensor.maximum_cm
        return cls(sensor.reading_model, *limits, sensor.calibration_curve, sensor.resolution_cm)

    def sample(self, contexts: Mapping[str, Any], rng: np.random.Generator) -> Array:
        """Draw one reading for each context.

        Parameters
        ----------
        contexts
            Arrays of length n by column name; `true_range_cm` is needed, NaN where there is no echo.
        rng
            Random generator; one normal and one uniform a reading, and one more uniform a reading of no echo.

        Returns
        -------
        ndarray, shape (n,)
            Readings [cm], multiples of the resolution.

        Raises
        ------
        ValueError
            `true_range_cm` is missing or is not one column.
        """
        rows = self.rows(_true_range_cm(contexts))
        reading_cm = rows.draw(rng.standard_normal(len(rows)), rng.random(len(rows)))
        if rows.saturated_fraction > 0.0:
            no_echo = np.flatnonzero(reading_cm == self.maximum_cm)
            reading_cm[no_echo[rng.random(no_echo.size) < rows.saturated_fraction]] = SATURATED_CM
        return reading_cm

    def log_prob(self, reading_cm: ArrayLike, contexts: Mapping[str, Any]) -> Array:
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
            log p; -inf for what the sensor cannot report: fractions of its resolution, values outside its limits, NaN.

        Raises
        ------
        ValueError
            `true_range_cm` is missing, or the lengths differ.
        """
        true_cm = _true_range_cm(contexts)
        reading = np.asarray(reading_cm, dtype=np.float64)
        if reading.shape != true_cm.shape:
            raise ValueError(
                f"found readings of shape {reading.shape} and {TRUE_RANGE} of shape {true_cm.shape}, expected the same"
            )
        return self.rows(true_cm).log_prob(reading)

    def rows(self, true_range_cm: Array) -> MixtureRows:
        """The distribution of the reading of each true range [cm]."""
        centre_cm = self.calibration.forward(true_range_cm)
        return MixtureRows(
            centre_cm,
            self.sigma_cm(centre_cm),
            self.log_weights(centre_cm),
            self.parameters.short_rate_per_m,
            self.parameters.saturated_fraction,
            self.minimum_cm,
            self.maximum_cm,
            self.resolution_cm,
        )

    def sigma_cm(self, true_range_cm: Any) -> Any:
        """Standard deviation of a hit before it is rounded [cm], for one range or an array of them [cm]."""
        parameters = self.parameters
        if parameters.sigma_growth_cm_per_m == 0.0:
            return parameters.sigma_cm
        return np.hypot(parameters.sigma_cm, parameters.sigma_growth_cm_per_m / 100.0 * self._within(true_range_cm))

    def shares(self, true_range_cm: Any) -> list[Any]:
        """Shares of hit, short, missed and random, for one range or an array of them [cm]."""
        return shares_of(self.log_weights(true_range_cm))

    def log_weights(self, true_range_cm: Any) -> tuple[Any, Any, Any, Any]:
        """log of the shares of hit, short, missed and random, but for a common summand: numbers or arrays."""
        hit, short, missed, random = self._log_shares
        if self.parameters.missed_growth_per_m != 0.0:
            beyond_m = (self._within(true_range_cm) - min(WEIGHTS_RANGE_CM, self.maximum_cm)) / 100.0
            grown = np.clip(self.parameters.missed_growth_per_m * beyond_m, -MOST_LOG_ODDS, MOST_LOG_ODDS)
            missed = missed + grown
        return hit, short, missed, random

    @cached_property
    def _log_shares(self) -> tuple[float, float, float, float]:
        weights = self.parameters.weights
        hit, short, missed, random = map(_log, (weights.hit, weights.short, weights.missed, weights.random))
        return hit, short, missed, random

    def _within(self, true_range_cm: Any) -> Any:
        """The range on which the parameters may depend: what gives no echo is as far as the sensor can reach."""
        return np.maximum(np.fmin(true_range_cm, self.maximum_cm), 0.0)


def _true_range_cm(contexts: Mapping[str, Any]) -> Array:
    if TRUE_RANGE not in contexts:
        raise ValueError(f"found the context columns {sorted(contexts)}, expected {TRUE_RANGE!r} among them")
    true_cm = np.asarray(contexts[TRUE_RANGE], dtype=np.float64)
    if true_cm.ndim != 1:
        raise ValueError(f"found {TRUE_RANGE} of shape {true_cm.shape}, expected one dimension")
    return true_cm


def _log(probability: float) -> float:
    return math.log(probability) if probability > 0.0 else -math.inf
