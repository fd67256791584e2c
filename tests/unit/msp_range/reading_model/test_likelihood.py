"""The likelihood of the fit: the reading model's on its grid, a distribution on every grid, and its derivatives."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from msp_range.reading_model import densities as mix
from msp_range.reading_model.densities import probabilities
from msp_range.reading_model.grid import NO_ECHO, NOWHERE, SECOND_NO_ECHO, ReadingGrid
from msp_range.reading_model.likelihood import Likelihood
from msp_range.reading_model.mixture import ReadingModel
from msp_range.reading_model.sensor_model import MixtureParameters

MB1242 = ReadingGrid(20, 765, second_no_echo_cm=255)
GRIDS = {
    "mb1242": MB1242,
    "lidar": ReadingGrid(5, 500, 5),
    "codes_at_both_ends": ReadingGrid(2, 400, 0.5, second_no_echo_cm=1),
    "second_code_on_grid": ReadingGrid(2, 400, 0.5, second_no_echo_cm=50),
    "second_code_above": ReadingGrid(20, 120, second_no_echo_cm=900),
}
RANGES_CM = np.array([-3.0, 5.0, 19.7, 20.3, 57.2, 255.3, 399.9, 411.0, 764.7, 790.0, math.inf])
WEIGHTS = {"hit": 0.8, "short": 0.1, "missed": 0.06, "random": 0.04}


def theta(growing: bool = False) -> NDArray[np.float64]:
    values = np.zeros(len(mix.NAMES))
    values[[mix.U, mix.R, mix.M]] = 0.1 / 0.94, 0.04 / 0.94, 0.06
    values[[mix.T, mix.L, mix.S]] = math.log(1.7), 0.005, 0.25
    if growing:
        values[[mix.V, mix.G]] = 0.004**2, 0.003
    return values


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


@pytest.mark.parametrize("growing", [False, True])
def test_on_whole_centimetres_it_is_the_reading_models(growing: bool) -> None:
    rng = np.random.default_rng(4)
    true_cm = np.append(rng.uniform(-5.0, 790.0, 2000), np.tile(RANGES_CM, 30))
    reading_cm = model(growing).sample({"true_range_cm": true_cm}, rng)
    log_p = model(growing).log_prob(reading_cm, {"true_range_cm": true_cm})
    itself = probabilities(MB1242, theta(growing), reading_cm, true_cm)[1]
    assert np.log(itself) == pytest.approx(log_p, rel=1e-10)
    likelihood = Likelihood(MB1242, MB1242.cell(reading_cm), true_cm, np.ones(true_cm.size))
    assert likelihood.derivatives(theta(growing), frozenset())[0] == pytest.approx(log_p.sum(), rel=1e-12)


@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS.keys())
@pytest.mark.parametrize("more", [False, True])
def test_probabilities_sum_to_one_and_pile_up_on_every_grid(grid: ReadingGrid, more: bool) -> None:
    readings = {grid.minimum_cm + i * grid.resolution_cm for i in range(grid.cells)}
    codes = np.array(sorted(readings | {grid.second_no_echo_cm or grid.maximum_cm}))
    for range_cm in RANGES_CM:
        below, itself = probabilities(grid, theta(more), codes, np.full(codes.size, range_cm))
        up_to = np.cumsum(itself)
        assert up_to[-1] == pytest.approx(1.0, abs=1e-9)
        assert below == pytest.approx(np.append(0.0, up_to[:-1]), abs=1e-9)


def test_the_derivatives_are_those_of_the_value() -> None:
    rng = np.random.default_rng(5)
    true_cm = np.append(rng.uniform(0.0, 790.0, 3000), np.full(20, math.inf))
    reading_cm = model(True).sample({"true_range_cm": true_cm}, rng)
    likelihood = Likelihood(MB1242, MB1242.cell(reading_cm), true_cm, rng.integers(1, 4, true_cm.size).astype(float))
    for growing, free in ((True, {mix.V, mix.G}), (True, {mix.V}), (False, set())):
        numbers = frozenset(free)
        at = theta(growing)
        _, gradient, hessian = likelihood.derivatives(at, numbers)
        asked = np.array([mix.U, mix.R, mix.M, mix.T, mix.L, mix.S, *sorted(free)])
        for i in asked:
            step = 1e-6 * max(abs(at[i]), 1e-5 if i == mix.V else 1e-3)
            above, under = at.copy(), at.copy()
            above[i] += step
            under[i] -= step
            plus, minus = likelihood.derivatives(above, numbers), likelihood.derivatives(under, numbers)
            error = 1e-4 * math.sqrt(abs(hessian[i, i]))
            assert (plus[0] - minus[0]) / (2 * step) == pytest.approx(gradient[i], rel=1e-5, abs=error)
            scale = np.sqrt(np.abs(hessian[i, i] * np.diag(hessian)))[asked]
            by_difference = ((plus[1] - minus[1]) / (2 * step))[asked]
            assert by_difference / scale == pytest.approx(hessian[i, asked] / scale, abs=1e-6)


def test_a_reading_that_cannot_be_makes_the_likelihood_nothing() -> None:
    no_random = theta()
    no_random[mix.R] = 0.0
    likelihood = Likelihood(MB1242, np.array([700]), np.array([100.0]), np.ones(1))
    assert likelihood.derivatives(no_random, frozenset())[0] == -math.inf


def test_cells_of_readings_and_codes() -> None:
    assert MB1242.cell([20, 254, 255, 764, 765, 19, 300.5, math.nan]).tolist() == [
        0,
        234,
        SECOND_NO_ECHO,
        744,
        NO_ECHO,
        NOWHERE,
        NOWHERE,
        NOWHERE,
    ]
    fine = ReadingGrid(2, 400, 0.1, second_no_echo_cm=1)
    # Metres that were turned into centimetres are not exact.
    assert fine.cell([2.3 + 1e-6, 1.0, 400.0, 2.34]).tolist() == [3, SECOND_NO_ECHO, NO_ECHO, NOWHERE]
    assert fine.nearest([2.34, 1.0, 399.98, 401.0]) == pytest.approx([2.3, 1.0, 400.0, 401.0], rel=1e-12)


def test_a_second_code_between_two_steps_is_refused() -> None:
    with pytest.raises(ValueError, match=r"on the grid, found 30\.5 cm"):
        ReadingGrid(20, 765, 1, 30.5)
