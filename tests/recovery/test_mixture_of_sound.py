"""The mixture fitted to readings made from sound: what 20,000 readings say agrees with what a million say.

No mixture made these readings, so the truth is the mixture nearest to them, fitted to a million.
"""

from functools import cache

import numpy as np
import pytest

from evaluation.blind.campaign import over_ranges
from msp_lab.mixture_fit.fit import fit_readings
from msp_lab.mixture_fit.fit_result import FitResult
from msp_lab.mixture_fit.grid import ReadingGrid

pytestmark = pytest.mark.slow
GRID = ReadingGrid(minimum_cm=20, maximum_cm=765, resolution_cm=1, saturates=True)
SEEDS = range(100, 108)
OFFSET_CM, SCALE = -0.62, 1.0044
"""Mean reading of a hit over the true range: the room's air is warmer than that of the sensor's calibration, and the
echo is detected at its front. A straight line through the hits."""


def _fit(seed: int, count: int) -> FitResult:
    columns = over_ranges(seed, count)
    return fit_readings(columns["reading_cm"], OFFSET_CM + SCALE * np.asarray(columns["true_range_cm"], float), GRID)


@cache
def _truth() -> FitResult:
    return _fit(1, 1_000_000)


def test_20000_readings_agree_with_a_million() -> None:
    """Eight campaigns of eight parameters each: at least nine tenths of the 95 % intervals hold the truth."""
    truth = _truth()
    inside = []
    for seed in SEEDS:
        found = _fit(seed, 20_000)
        assert found.estimates.keys() == truth.estimates.keys()
        for name in found.estimates:
            low, high = found.interval(name)
            inside.append(low <= truth.estimates[name] <= high)
    assert np.mean(inside) >= 0.9


def test_every_kind_of_reading_is_found() -> None:
    """What the room does: 2 % misfires, 1 % lock-ups, 30 % of missed echoes cut to a byte, passers-by."""
    estimates = _truth().estimates
    assert estimates["missed"] == pytest.approx(0.02, abs=0.002)
    assert estimates["random"] == pytest.approx(0.01, abs=0.002)
    assert estimates["saturated_fraction"] == pytest.approx(0.3, abs=0.01)
    # Of one passer-by in 50 m of beam, cut at 0.4 to 3 m.
    assert 0.02 < estimates["short"] < 0.05
    assert estimates["hit"] > 0.9
