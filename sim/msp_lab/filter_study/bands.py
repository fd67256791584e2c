"""Monte-Carlo bands: the range of a filter's statistics over many seeds.

For a variant of a filter and a number of seeds, each scenario and statistic has a middle and a spread to either side,
from which the distance of a table's row follows.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from msp_lab.filter_study.nine import Variant, apply
from msp_lab.filter_study.scenarios import NAMES, NOISE_CM2, ScenarioRuns, report_readings, truth
from msp_lab.filter_study.statistics import error_statistics
from msp_lab.filter_study.table import Row
from msp_range.arrays import Array

WIDTH = 4.0
"""Half the width of a band in spreads: one in 16,000 normal values is outside, and a table has 135 values. A narrower
band looks for explanations of random variation."""
TAIL, TAIL_SPREADS = 1.0, 2.326
"""The spread to one side is the distance of this percentile from the middle, over what it is for a normal variable."""
FLOOR = 0.02
"""Smallest spread, as a share of the median RMS or of the value itself: medians of whole numbers hardly vary."""
SMALLEST_CM = 0.01
"""Smallest median RMS for that [cm]."""
SEEDS = 1000
"""Runs per scenario for the bands; their percentiles are then known to about 5 % of a spread."""
SEARCH_SEED = 20_240
"""Random seed of the bands; the same runs serve every variant."""


@dataclass(frozen=True)
class Band:
    """Bands of one variant in one scenario, arrays in the order of the statistics.

    RMS and variance are positive and skewed: their spreads are those of their logarithms.
    """

    middle: Array
    """Median over the seeds."""
    below: Array
    above: Array
    """Spread below and above the middle."""

    def distance(self, row: Row) -> Array:
        """Distance of each value of a row from the middle in spreads, less what its rounding explains."""
        rounding = 0.5 * 10.0 ** -np.array(row.decimals, dtype=float)
        values = np.array(row.values)
        off = _scaled(values) - _scaled(self.middle)
        explained = np.where(_POSITIVE, rounding / np.maximum(values, SMALLEST_CM), rounding)
        off = np.sign(off) * np.maximum(np.abs(off) - explained, 0.0)
        distance: Array = np.where(off < 0, off / self.below, off / self.above)
        return distance

    @property
    def log_spread(self) -> float:
        """Sum of the logarithms of the spreads, which penalises bands that are wide enough for everything."""
        return float(0.5 * np.log(self.below * self.above).sum())

    @property
    def low(self) -> Array:
        """Lower end of the band of each statistic."""
        return _unscaled(_scaled(self.middle) - WIDTH * self.below)

    @property
    def high(self) -> Array:
        """Upper end of the band of each statistic."""
        return _unscaled(_scaled(self.middle) + WIDTH * self.above)


_POSITIVE = np.array([True, False, False, False, True])


def _scaled(values: Array) -> Array:
    """Logarithms of RMS and variance, and the other three as they are."""
    positive = _POSITIVE if values.ndim == 1 else _POSITIVE[:, None]
    return np.where(positive, np.log(np.maximum(values, SMALLEST_CM**2)), values)


def _unscaled(values: Array) -> Array:
    return np.where(_POSITIVE, np.exp(np.where(_POSITIVE, values, 0.0)), values)


def find_bands(variant: Variant) -> Mapping[str, Band]:
    """Return the bands of one variant in all scenarios from `SEEDS` runs of each, the same for every variant."""
    return {name: band_in(variant, name, SEEDS) for name in NAMES}


@lru_cache(maxsize=8192)
def band_in(variant: Variant, name: str, seeds: int) -> Band:
    """Return the band in one scenario, from so many runs."""
    runs = _runs(name, seeds, variant.noise_factor)
    error_cm = apply(variant, runs.reading_cm) - runs.true_cm
    values = error_statistics(-error_cm if variant.reversed else error_cm)
    low, middle, high = np.percentile(_scaled(values), (TAIL, 50.0, 100.0 - TAIL), axis=1)
    middle_cm = _unscaled(middle)
    floor = np.where(_POSITIVE, FLOOR, FLOOR * max(float(middle_cm[0]), SMALLEST_CM))
    return Band(
        middle_cm, np.maximum((middle - low) / TAIL_SPREADS, floor), np.maximum((high - middle) / TAIL_SPREADS, floor)
    )


@lru_cache(maxsize=64)
def _runs(name: str, seeds: int, noise_factor: float) -> ScenarioRuns:
    """The same runs for every variant; the noise has the same random numbers for all of its variances."""
    rng = np.random.default_rng([SEARCH_SEED, NAMES.index(name)])
    return report_readings(_truth(name, seeds), rng, NOISE_CM2 * noise_factor)


@lru_cache
def _truth(name: str, seeds: int) -> ScenarioRuns:
    return truth(name, seeds, np.random.default_rng([SEARCH_SEED, NAMES.index(name), 1]))
