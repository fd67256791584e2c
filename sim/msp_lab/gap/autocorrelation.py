"""How much an error repeats in the readings that follow, before and after: the autocorrelation of residuals.

The residual of a reading is its place in the model's distribution, given the readings before it, as a normal deviate:
where the model is right these are independent, its own correlated noise included.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from msp_lab.gap.measures import HeldOutReadings
from msp_lab.gap.runs import reading_before
from msp_range.arrays import Array
from msp_sim.model.model import Model

LAGS = 20
"""Readings back to which it is drawn: correlated noise and held values have decayed by then in all recordings tried."""
MIN_PAIRS = 30
"""A lag with fewer pairs of readings is left out: its band would be wider than 0.35."""
FARTHEST = 4.0
"""Residuals are cut there [standard deviations], so that a few impossible readings do not make the picture."""


@dataclass(frozen=True)
class Autocorrelation:
    """Autocorrelation of residuals, by lag."""

    apart: Array
    """Median time between the two readings of a pair [s], or their distance in readings, (k,)."""
    in_seconds: bool
    """Whether ``apart`` is in seconds."""
    value: Array
    """Correlation, (k,)."""
    band: Array
    """What 95 % of independent residuals stay within, (k,)."""


def residual_autocorrelation(model: Model, readings: HeldOutReadings, rng: np.random.Generator) -> Autocorrelation:
    """Correlation of each residual with that of the same sensor and run some readings before."""
    n = len(readings)
    residual = np.clip(ndtri(places(model, readings, rng)), -FARTHEST, FARTHEST)
    residual -= residual.mean()
    variance = max(float(np.mean(residual**2)), 1e-12)
    before, _ = reading_before(readings.contexts, n)
    time_s = readings.contexts.get("time_s")
    apart, value, pairs = [], [], []
    back = np.arange(n)
    for lag in range(1, LAGS + 1):
        back = np.where(back >= 0, before[back], -1)
        rows = np.flatnonzero(back >= 0)
        if rows.size < MIN_PAIRS:
            break
        apart.append(float(lag) if time_s is None else float(np.nanmedian(time_s[rows] - time_s[back[rows]])))
        value.append(float(np.mean(residual[rows] * residual[back[rows]])) / variance)
        pairs.append(rows.size)
    return Autocorrelation(np.array(apart), time_s is not None, np.array(value), 1.96 / np.sqrt(np.array(pairs)))


def places(model: Model, readings: HeldOutReadings, rng: np.random.Generator) -> Array:
    """Share of the model's readings that are smaller than each reading (randomised in its step), 0 to 1, (n,)."""
    found = np.empty(len(readings))
    for part, rows in model.chunks(readings.contexts):
        reading = readings.reading_cm[part]
        given, _ = rows.given(reading)
        found[part] = np.exp(given.log_below(reading)) + rng.random(reading.size) * np.exp(given.log_prob(reading))
    return np.clip(found, 0.0, 1.0)
