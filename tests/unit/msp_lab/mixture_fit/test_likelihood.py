"""The likelihood of the fit: the reading model's on its grid, with the slopes of its value."""

import math

import numpy as np
import pytest

from msp_lab.mixture_fit.grid import ReadingGrid
from msp_lab.mixture_fit.likelihood import Likelihood
from msp_lab.mixture_fit.parameters import NAMES, Numbers, bounds_of
from msp_range.reading_model.kernel import NO_ECHO_CENTRE
from msp_range.reading_model.mixture import ReadingModel
from msp_range.reading_model.sensor_model import MixtureParameters

MB1242 = ReadingGrid(20, 765, saturates=True)
GRIDS = {"mb1242": MB1242, "lidar": ReadingGrid(5, 500, 5), "fine": ReadingGrid(2, 400, 0.5, saturates=True)}
RANGES_CM = np.array([-3.0, 5.0, 19.7, 20.3, 57.2, 255.3, 399.9, 411.0, 764.7, 790.0, NO_ECHO_CENTRE])
WEIGHTS = {"hit": 0.8, "short": 0.1, "missed": 0.06, "random": 0.04}


def numbers(growing: bool) -> Numbers:
    odds = np.log([0.1 / 0.8, 0.06 / 0.8, 0.04 / 0.8]).tolist()
    growth = (0.4**2, 0.3) if growing else (0.0, 0.0)
    return Numbers(math.log(1.7), odds[0], odds[1], odds[2], 0.5, 0.25, *growth)


def model(growing: bool) -> ReadingModel:
    parameters = {
        "weights": WEIGHTS,
        "sigma_cm": 1.7,
        "short_rate_per_m": 0.5,
        "saturated_fraction": 0.25,
        "sigma_growth_cm_per_m": 0.4 if growing else 0.0,
        "missed_growth_per_m": 0.3 if growing else 0.0,
    }
    return ReadingModel(MixtureParameters.model_validate(parameters), 20, 765)


def likelihood(growing: bool, std_cm: float = 0.0) -> tuple[Likelihood, float]:
    """Of drawn readings, and what the reading model says of them."""
    rng = np.random.default_rng(4)
    true_cm = np.append(rng.uniform(-5.0, 790.0, 2000), np.tile(RANGES_CM, 30))
    reading_cm = model(growing).sample({"true_range_cm": true_cm}, rng)
    count = rng.integers(1, 4, true_cm.size).astype(float)
    log_p = model(growing).log_prob(reading_cm, {"true_range_cm": true_cm})
    return Likelihood(MB1242, reading_cm, true_cm, count, np.full(true_cm.size, std_cm**2)), float(count @ log_p)


@pytest.mark.parametrize("growing", [False, True])
def test_on_whole_centimetres_it_is_the_reading_models(growing: bool) -> None:
    found, expected = likelihood(growing)
    assert found.slopes(np.array(numbers(growing)))[0] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS.keys())
@pytest.mark.parametrize("growing", [False, True])
def test_probabilities_sum_to_one_and_pile_up_on_every_grid(grid: ReadingGrid, growing: bool) -> None:
    codes = grid.nearest(np.arange(grid.minimum_cm, grid.maximum_cm + grid.resolution_cm / 2, grid.resolution_cm))
    for range_cm in RANGES_CM:
        some, none = np.full(codes.size, range_cm), np.zeros(codes.size)
        rows = Likelihood(grid, codes, some, none + 1.0, none).rows(
            numbers(growing)._replace(saturated=0.25 * grid.saturates)
        )
        up_to = np.cumsum(np.exp(rows.log_prob(codes)))
        assert up_to[-1] == pytest.approx(1.0, abs=1e-9)
        assert np.exp(rows.log_below(codes)) == pytest.approx(np.append(0.0, up_to[:-1]), abs=1e-9)


@pytest.mark.parametrize(("growing", "std_cm"), [(False, 0.0), (True, 0.0), (True, 1.0)])
def test_the_slopes_and_the_curvature_are_those_of_the_value(growing: bool, std_cm: float) -> None:
    found, _ = likelihood(growing, std_cm=std_cm)
    at = np.array(numbers(growing))
    moving = NAMES if growing else NAMES[:6]
    _, (gradient, outer) = found.slopes(at)
    curvature = found.curvature(at, bounds_of(numbers(growing), moving))
    for i in range(len(moving)):
        step = np.zeros(at.size)
        step[i] = 1e-2 / math.sqrt(outer[i, i])
        (less, (before, _)), (more, (after, _)) = (found.slopes(at + sign * step) for sign in (-1.0, 1.0))
        assert (more - less) / (2.0 * step[i]) == pytest.approx(gradient[i], abs=1e-3 * math.sqrt(outer[i, i]))
        by_difference = (before - after)[: len(moving)] / (2.0 * step[i])
        scale = np.sqrt(outer[i, i] * np.diag(outer))[: len(moving)]
        assert by_difference / scale == pytest.approx(curvature[i, : len(moving)] / scale, abs=2e-3)
    # At the truth both are the information.
    scale = np.sqrt(np.diag(outer))[: len(moving)]
    of_moving = slice(None, len(moving))
    assert (curvature - outer)[of_moving, of_moving] / np.outer(scale, scale) == pytest.approx(0.0, abs=0.5)


def test_readings_on_the_grid() -> None:
    assert ReadingGrid(20, 200, 2, saturates=True).codes_cm == (200, 255)
    with pytest.raises(ValueError, match="on the grid, found 255"):
        ReadingGrid(20, 400, 2, saturates=True)
    fine = ReadingGrid(2, 400, 0.1)
    # Metres that were turned into centimetres are not exact.
    assert fine.nearest(np.array([2.3 + 1e-6, 2.34, 1.0, 399.98, 401.0])).tolist() == [2.3, 2.3, 1.0, 400.0, 401.0]
