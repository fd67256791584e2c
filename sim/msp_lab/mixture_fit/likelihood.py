"""The log-likelihood of readings under the base mixture, by the numbers that its fit moves, and their maximum.

The distribution of one reading, and its slopes, are those of `msp_range.reading_model.rows`; here they are summed over
all readings, equal pairs of reading and expected range once with their count.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, TypeAlias

import numpy as np

from msp_lab.mixture_fit.grid import ReadingGrid
from msp_lab.mixture_fit.maximise import held_numbers, maximise
from msp_lab.mixture_fit.parameters import MIN_WEIGHT, NAMES, Numbers, bounds_of
from msp_range.arrays import Array
from msp_range.reading_model.rows import FREE, Base, ByRow, MixtureRows, shares_of
from msp_range.reading_model.sensor_model import WEIGHTS_RANGE_CM

CHUNK = 1 << 13
"""Rows processed at a time, so that the arrays fit into the processor's cache. Affects speed only."""
SAMPLE_ROWS = 20_000
"""Number of rows that are fitted before all are, where there are twice as many."""
ENOUGH_NATS = 1e-3
CLIMB_ROUNDS = 50
"""A climb ends with a step that gains less than this [nat], or after this many steps: a last step is at most 4 % of a
standard error long. After it the curvature takes the place of the outer product of the scores, and errors are squared
from step to step."""
CURVATURE_ROWS = 100_000
"""Rows from which errors are computed, about; of twice as many and more the others are taken to be alike. The curvature
takes eight times as long as a step. Fewer: errors of rare kinds of reading are known badly."""


Maximum: TypeAlias = tuple[Array, float, tuple[Array, Array]]


class Optimum(NamedTuple):
    """A maximum within bounds."""

    numbers: Numbers
    value: float
    """Log-likelihood there."""
    information: Array
    """Curvature there, (k, k); its diagonal is 0 for numbers that do not move."""
    inside: tuple[str, ...]
    """Names of the numbers that moved, with information, and are not held by a bound."""
    left_nats: float
    """What one more step promises."""


@dataclass(frozen=True)
class Likelihood(ByRow):
    """Log-likelihood of readings."""

    grid: ReadingGrid
    reading_cm: Array
    expected_cm: Array
    """Expected range of each reading [cm], at most `NO_ECHO_CENTRE`: no echo."""
    count: Array
    """How many readings each row stands for."""
    reference_cm2: Array
    """Variance of the error of each expected range [cm^2]."""

    def __len__(self) -> int:
        return self.reading_cm.size

    @cached_property
    def readings(self) -> float:
        """How many readings there are."""
        return float(self.count.sum())

    def sample(self, most: int) -> "Likelihood":
        """The likelihood of every n-th row, about ``most`` rows."""
        return self.take(slice(None, None, max(len(self) // most, 1)))

    @cached_property
    def _chunks(self) -> list["Likelihood"]:
        return [self.take(slice(start, start + CHUNK)) for start in range(0, len(self), CHUNK)]

    @cached_property
    def _within_m(self) -> Array:
        """Range on which spread and missed echoes may depend [m]."""
        return np.clip(self.expected_cm, 0.0, self.grid.maximum_cm) / 100.0

    @property
    def _beyond_m(self) -> Array:
        """That range beyond the one to which the share of missed echoes refers [m]."""
        return self._within_m - min(WEIGHTS_RANGE_CM, self.grid.maximum_cm) / 100.0

    def rows(self, numbers: Numbers) -> MixtureRows:
        """The distribution of each reading."""
        limits = self.grid.minimum_cm, self.grid.maximum_cm, self.grid.resolution_cm
        rows = MixtureRows(self.expected_cm, 1.0, (0.0, 0.0, 0.0, 0.0), numbers.rate, numbers.saturated, *limits)
        rows = rows.changed(Base(0.0, *numbers[:4]))
        hit, short, missed, random = rows.log_weights
        if numbers.missed_growth != 0.0:
            missed = missed + numbers.missed_growth * self._beyond_m
        variance = rows.sigma_cm**2 + self.reference_cm2 + numbers.sigma_growth_2 * self._within_m**2
        return replace(rows, sigma_cm=np.sqrt(variance), log_weights=(hit, short, missed, random))

    def hits(self, numbers: Numbers) -> float:
        """How many of the readings are expected to be hits, each by its share at its own range."""
        return float(self.count @ np.broadcast_to(shares_of(self.rows(numbers).log_weights)[0], len(self)))

    def slopes(self, at: Array) -> tuple[float, tuple[Array, Array]]:
        """Value, gradient (k,) and outer product of the scores (k, k), at numbers (k,)."""
        value, gradient, outer = 0.0, np.zeros(at.size), np.zeros((at.size, at.size))
        numbers = Numbers(*at)
        for part in self._chunks:
            rows = part.rows(numbers)
            # The first row is by an offset, which is no number of this fit.
            found = np.empty((1 + at.size, len(part)))
            log_p = rows.scores_into(found[: len(FREE)], part.reading_cm)
            scores = found[1:]
            by = Numbers(*scores)
            by_variance = by.log_sigma / rows.sigma_cm**2
            np.multiply(by_variance, 0.5 * part._within_m**2, out=by.sigma_growth_2)
            np.multiply(by_variance, np.exp(2.0 * numbers.log_sigma), out=by.log_sigma)
            np.multiply(by.log_odds_missed, part._beyond_m, out=by.missed_growth)
            np.divide(by.rate, numbers.rate, out=by.rate)
            counted = scores * part.count
            value += float(part.count @ log_p)
            gradient += counted.sum(axis=1)
            outer += counted @ scores.T
        return value, (gradient, outer)

    def curvature(self, at: Array, bounds: tuple[Array, Array]) -> Array:
        """Minus the second derivatives at numbers (k,), (k, k); a diagonal of 0 for those whose bounds are equal."""
        some, found = self.sample(CURVATURE_ROWS), np.zeros((at.size, at.size))
        _, (gradient, outer) = some.slopes(at)
        for k in np.flatnonzero(bounds[0] < bounds[1]):
            there = at.copy()
            # Far above rounding, and far below what changes the curvature.
            there[k] += min(1e-4 / np.sqrt(max(outer[k, k], 1e-300)), 1e-4)
            found[k] = (gradient - some.slopes(there)[1][0]) / (there[k] - at[k])
        return 0.5 * (found + found.T) * self.readings / some.readings

    def maximum(self, start: Numbers, bounds: tuple[Array, Array], enough_nats: float = ENOUGH_NATS) -> Maximum:
        """The nearest maximum, about: numbers (k,), their log-likelihood, its gradient and the outer product."""
        start_at = np.clip(np.array(start), *bounds)
        return maximise(self.slopes, lambda _, here: here, start_at, bounds, enough_nats, CLIMB_ROUNDS)

    def optimum(self, start: Numbers, moving: Sequence[str]) -> Optimum:
        """The maximum by these numbers: of a sample of the rows first, and from there of all."""
        bounds = bounds_of(start, moving)
        if len(self) > 2 * SAMPLE_ROWS:
            start = Numbers(*self.sample(SAMPLE_ROWS).maximum(start, bounds)[0])
            # What the sample lacks may be among the others.
            seen = {name: max(getattr(start, name), float(np.log(MIN_WEIGHT))) for name in NAMES[1:4]}
            saturated = min(max(start.saturated, MIN_WEIGHT), 1.0 - MIN_WEIGHT)
            start = start._replace(**seen, saturated=saturated)
        near, known, here = self.maximum(start, bounds)
        curvature = self.curvature(near, bounds)
        at, value, (gradient, _) = maximise(
            self.slopes, lambda _, there: (there[0], curvature), near, bounds, ENOUGH_NATS, known=(known, here)
        )
        if value - known > ENOUGH_NATS:
            curvature = self.curvature(at, bounds)
        held = held_numbers(at, gradient, curvature, *bounds)
        inside = tuple(name for name, is_held in zip(NAMES, held, strict=True) if not is_held)
        step = np.linalg.lstsq(curvature[np.ix_(~held, ~held)], gradient[~held], rcond=None)[0]
        return Optimum(Numbers(*at.tolist()), value, curvature, inside, 0.5 * abs(float(gradient[~held] @ step)))
