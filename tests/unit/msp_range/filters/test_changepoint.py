"""The changepoint filter: steps, slopes, outliers and missing readings, and a variance that is honest."""

import math
from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from msp_range.filters.base import Estimate
from msp_range.filters.changepoint import Changepoint
from msp_range.filters.runs import RangeLikelihood, RunHistories, rounding_bias_m2

STD_M = 0.02
GAUSSIAN = RangeLikelihood(1.0, 0.0, 0.0, 0.5, 0.2, 7.65, STD_M**2, 0.0)
WILD = RangeLikelihood(0.95, 0.03, 0.02, 0.5, 0.2, 7.65, STD_M**2, 0.0)


def run(
    likelihood: RangeLikelihood, ranges_m: Sequence[float] | NDArray[np.float64], interval_s: float = 0.1
) -> np.ndarray:
    """Ranges and variances, two columns; NaN where nothing is put out, or where a reading is missing (NaN)."""
    one = Changepoint(likelihood)
    out = []
    for index, range_m in enumerate(ranges_m):
        estimate = None if math.isnan(range_m) else one.update(index * interval_s, Estimate(range_m, STD_M**2))
        out.append(estimate or (math.nan, math.nan))
    return np.array(out)


def noisy(true_m: np.ndarray, seed: int = 1) -> np.ndarray:
    return true_m + np.random.default_rng(seed).normal(0.0, STD_M, np.shape(true_m))


@pytest.mark.slow
def test_a_level_is_averaged() -> None:
    """After 100 readings the error is about a tenth of one reading's, and the stated variance says so."""
    errors, variances = [], []
    for seed in range(40):
        out = run(GAUSSIAN, noisy(np.full(100, 3.0), seed))
        errors.append(out[-1, 0] - 3.0)
        variances.append(out[-1, 1])
    assert np.std(errors) < 0.2 * STD_M
    assert np.mean(np.square(errors) / variances) == pytest.approx(0.85, abs=0.45)


@pytest.mark.parametrize("interval_s", [0.1, 0.4])
def test_a_slope_is_followed_without_lag(interval_s: float) -> None:
    true_m = 1.0 + 0.7 * interval_s * np.arange(25)
    out = np.array([run(WILD, noisy(true_m, seed), interval_s)[:, 0] for seed in range(20)])
    late = out[:, 12:] - true_m[12:]
    assert abs(np.nanmean(late)) < 0.3 * STD_M
    assert np.nanstd(late) < 0.75 * STD_M


@pytest.mark.parametrize("step_m", [0.5, -0.5, 1.25, -2.0])
def test_gaussian_readings_are_followed_at_once_and_others_wait_for_a_second(step_m: float) -> None:
    true_m = np.concatenate([np.full(40, 3.0), np.full(10, 3.0 + step_m)])
    readings = noisy(true_m)
    at_once, waits = run(GAUSSIAN, readings)[:, 0], run(WILD, readings)[:, 0]
    assert abs(at_once[40] - true_m[40]) < 3 * STD_M
    assert np.isnan(waits[40])
    assert abs(waits[41] - true_m[41]) < 3 * STD_M


@pytest.mark.parametrize("outlier_m", [4.0, 2.0, 0.3, 7.4])
def test_one_outlier_moves_nothing(outlier_m: float) -> None:
    readings = noisy(np.full(45, 3.0))
    readings[40] = outlier_m
    out = run(WILD, readings)
    assert np.isnan(out[40, 0])
    assert abs(out[41, 0] - out[39, 0]) < 0.02
    assert not np.isnan(out[41:, 0]).any()


@pytest.mark.parametrize("outlier_m", [5.0, 3.2])
def test_one_outlier_moves_nothing_where_there_are_many_steps(outlier_m: float) -> None:
    """Steps are learned to be frequent, and still take a second reading."""
    true_m = np.repeat(np.tile([3.0, 3.7], 12), 8)
    readings = noisy(true_m)
    readings[-3] = outlier_m
    out = run(WILD, readings)
    assert np.isnan(out[-3, 0])
    assert abs(out[-2, 0] - 3.7) < 3 * STD_M


def test_two_outliers_that_disagree_move_nothing() -> None:
    readings = noisy(np.full(45, 3.0))
    readings[40:42] = 4.7, 1.1
    out = run(WILD, readings)[:, 0]
    assert np.isnan(out[40:42]).all()
    assert abs(out[42] - 3.0) < 3 * STD_M


def test_the_first_reading_waits_for_a_second_where_there_are_outliers() -> None:
    assert run(GAUSSIAN, [3.0])[0, 0] == pytest.approx(3.0, abs=1e-4)
    out = run(WILD, [0.5, 3.0, 3.01, 3.0])[:, 0]
    assert np.isnan(out[:2]).all()
    assert out[2:] == pytest.approx(3.0, abs=0.02)


def test_missing_readings_are_bridged_by_their_time_stamps() -> None:
    """On a slope the estimate after a gap is where the slope has gone."""
    true_m = 1.0 + 0.05 * np.arange(40)
    readings = noisy(true_m)
    readings[30:36] = np.nan
    out = run(WILD, readings)[:, 0]
    assert abs(out[36] - true_m[36]) < 4 * STD_M


def test_the_variance_grows_over_a_gap() -> None:
    readings = noisy(np.full(60, 3.0))
    gap = readings.copy()
    gap[40:52] = np.nan
    assert run(WILD, gap)[52, 1] > 1.5 * run(WILD, readings)[52, 1]


def test_many_streams_are_as_many_single_ones() -> None:
    rng = np.random.default_rng(7)
    true_m = np.where(np.arange(60) < 30, 3.0, 3.8)
    readings = noisy(np.tile(true_m, (5, 1)))
    readings[rng.random(readings.shape) < 0.05] = 0.7
    readings[rng.random(readings.shape) < 0.05] = np.nan
    together = RunHistories(WILD, 5)
    last = np.full(5, -1)
    out = np.full(readings.shape, np.nan)
    variances = out.copy()
    for sample in range(readings.shape[1]):
        heard = np.flatnonzero(~np.isnan(readings[:, sample]))
        some = together.take(heard)
        elapsed_s = np.where(last[heard] < 0, 0.0, 0.1 * sample - 0.1 * last[heard])
        posterior = some.update(elapsed_s, readings[heard, sample], np.full(heard.size, STD_M**2))
        together.put(heard, some)
        last[heard] = sample
        out[heard, sample] = np.where(posterior.converged, posterior.range_m, np.nan)
        variances[heard, sample] = np.where(posterior.converged, posterior.variance_m2, np.nan)
    for stream in range(5):
        alone = run(WILD, readings[stream])
        np.testing.assert_allclose(out[stream], alone[:, 0], rtol=0, atol=2e-5)
        np.testing.assert_allclose(variances[stream], alone[:, 1], rtol=1e-3)


def test_probabilities_stay_probabilities() -> None:
    runs = RunHistories(WILD, 3)
    rng = np.random.default_rng(3)
    for _ in range(300):
        runs.update(rng.uniform(0.0, 2.0, 3), rng.uniform(0.2, 7.65, 3), np.full(3, STD_M**2))
        total = runs.state[0].sum(axis=1) + runs.unlocated
        np.testing.assert_allclose(total, 1.0, rtol=1e-9)
        assert (runs.state[3] > 0).all()
        assert (runs.state[5] >= 0).all()
        assert np.isfinite(runs.state).all()


def test_readings_at_one_time_are_taken() -> None:
    one = Changepoint(GAUSSIAN)
    for range_m in (3.0, 3.02, 2.98):
        assert one.update(5.0, Estimate(range_m, STD_M**2)) is not None
    assert one.update(4.0, Estimate(3.0, STD_M**2)) is not None


def test_a_reading_without_a_variance_has_the_model_s() -> None:
    with_it, without = Changepoint(GAUSSIAN), Changepoint(GAUSSIAN)
    assert with_it.update(0.0, Estimate(3.0, STD_M**2)) == without.update(0.0, Estimate(3.0, math.inf))


def test_reset_forgets() -> None:
    one = Changepoint(GAUSSIAN)
    for index in range(20):
        one.update(0.1 * index, Estimate(3.0, STD_M**2))
    one.reset()
    fresh = Changepoint(GAUSSIAN)
    assert one.update(50.0, Estimate(1.0, STD_M**2)) == fresh.update(50.0, Estimate(1.0, STD_M**2))


def test_rounding_leaves_an_error_that_no_averaging_takes_away() -> None:
    """Against many roundings of readings at every place within a step."""
    rng = np.random.default_rng(2)
    for std_m in (0.0, 0.001, 0.002, 0.003):
        place_m = np.linspace(0.0, 0.01, 200, endpoint=False)
        readings = np.round((place_m[:, None] + rng.normal(0.0, std_m, (200, 4000))) / 0.01) * 0.01
        bias_m = readings.mean(axis=1) - place_m
        assert rounding_bias_m2(std_m, 0.01) == pytest.approx(bias_m.var(), rel=0.02, abs=1e-8)
