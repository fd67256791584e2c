"""Intervals and tests that the analyses share, against plain sampling and published values."""

import numpy as np
import pytest

from msp_lab.estimates import IntervalEstimate, common_spread, detectable, fit_points, holm, mean_and_spread, share
from tests.support.known import contains, width
from tests.support.slow import slow


@pytest.mark.parametrize(("sigma_cm", "n"), [(0.15, 50), (0.35, 100), (0.5, 2000), (2.0, 100)])
def test_mean_and_spread_hold_the_truth_although_readings_are_whole(sigma_cm: float, n: int) -> None:
    rng = np.random.default_rng(1)
    held_mean = held_spread = 0
    trials = 200
    for _ in range(trials):
        mean_cm = rng.uniform(100.0, 101.0)
        found = mean_and_spread(np.rint(mean_cm + sigma_cm * rng.standard_normal(n)), step=1.0)
        held_mean += contains(found.mean, mean_cm)
        held_spread += contains(found.spread, sigma_cm)
    # 95 % of 200, less four standard deviations; rounding makes some of them wider.
    assert held_mean >= 178
    assert held_spread >= 178


def test_readings_that_are_all_equal_do_not_fix_the_mean() -> None:
    found = mean_and_spread(np.full(100, 250.0), step=1.0)
    assert found.mean.value == pytest.approx(250.0, abs=0.01)
    assert width(found.mean) > 0.8
    assert found.spread.value == 0.0


def test_a_half_is_between_two_readings() -> None:
    found = mean_and_spread(np.repeat([250.0, 251.0], [50, 50]), step=1.0)
    assert found.mean.value == pytest.approx(250.5, abs=0.02)


def test_share_is_wilsons() -> None:
    # Brown, Cai and DasGupta 2001, their formula (4), for 0 of 20: upper end z^2 / (n + z^2).
    found = share(0, 20)
    assert (found.low, found.high) == pytest.approx((0.0, 3.8415 / 23.8415), rel=1e-4)


@pytest.mark.parametrize("strays", [[], [50.0], [49.0, 51.0, 60.0]])
def test_a_mean_between_two_steps_is_not_moved_by_strays(strays: list[float]) -> None:
    rng = np.random.default_rng(5)
    true_ones_cm = (54.3, 54.5, 54.7, 54.9)
    groups = [np.concatenate([np.rint(rng.normal(each, 0.19, 400)), strays]) for each in true_ones_cm]
    usual = common_spread(groups, 1.0)
    assert usual == pytest.approx(0.19, abs=0.02)
    for true_cm, values in zip(true_ones_cm, groups, strict=True):
        found = mean_and_spread(values, step=1.0, usual_spread=usual)
        assert found.mean.value == pytest.approx(true_cm, abs=0.06)
        assert contains(found.mean, true_cm)
        assert found.spread.value < 0.26


@pytest.mark.parametrize("n", [5, *slow(20)])
def test_the_spread_of_short_set_ups_is_not_lost(n: int) -> None:
    """Ten readings of two steps are likeliest with their mean on the boundary and no spread at all."""
    rng = np.random.default_rng(7)
    held, spreads, trials = [], [], 40
    for _ in range(trials):
        true_ones_cm = rng.uniform(50.0, 51.0, 12)
        groups = [np.rint(rng.normal(each, 0.35, n)) for each in true_ones_cm]
        usual = common_spread(groups, 1.0)
        assert usual is not None
        spreads.append(usual)
        for true_cm, values in zip(true_ones_cm, groups, strict=True):
            held.append(contains(mean_and_spread(values, step=1.0, usual_spread=usual).mean, true_cm))
    assert 0.25 < np.median(spreads) < 0.4
    assert np.mean(held) >= 0.92


def test_two_groups_of_readings_are_no_strays() -> None:
    found = mean_and_spread(np.repeat([50.0, 58.0], [80, 100]), step=1.0)
    assert found.mean.value == pytest.approx((80 * 50 + 100 * 58) / 180)


def test_holm_is_the_published_one() -> None:
    # Holm's steps by hand: 4 * 0.005, then 3 * 0.01, 2 * 0.03, and never less than the one before.
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])


def test_the_smallest_detectable_effect_is_detected_in_four_of_five_cases() -> None:
    rng = np.random.default_rng(2)
    n, level = 12, 0.01
    effect = detectable(1.0 / np.sqrt(n), n - 1, level)
    values = effect + rng.standard_normal((4000, n))
    t = values.mean(axis=1) / (values.std(axis=1, ddof=1) / np.sqrt(n))
    # Student's t at 0.5 % with 11 degrees of freedom, from its table.
    assert (np.abs(t) > 3.106).mean() == pytest.approx(0.8, abs=0.03)


@pytest.mark.slow
def test_a_line_through_points_holds_offset_and_scale_in_95_of_100_cases() -> None:
    rng = np.random.default_rng(3)
    x = np.arange(40.0, 261.0, 20.0)
    design = np.column_stack([np.ones_like(x), x])
    held = np.zeros(2)
    trials = 400
    for _ in range(trials):
        known = rng.uniform(0.02, 0.2, x.size)
        y = 1.5 + 1.01 * x + known * rng.standard_normal(x.size) + 0.3 * rng.standard_normal(x.size)
        fit = fit_points(design, y, known**2)
        for i, truth in enumerate((1.5, 1.01)):
            estimate = fit.estimate(i, "")
            held[i] += contains(estimate, truth)
    assert (held / trials >= 0.92).all()
    assert (held / trials <= 0.98).all()


def test_points_that_agree_get_no_variance_between_them() -> None:
    x = np.arange(40.0, 261.0, 20.0)
    fit = fit_points(np.column_stack([np.ones_like(x), x]), 2.0 + x, np.full(x.size, 0.01))
    assert fit.between == 0.0
    assert fit.coefficients == pytest.approx([2.0, 1.0])


def test_an_estimate_is_changed_with_its_interval_and_holds_what_is_within() -> None:
    estimate = IntervalEstimate(2.0, 1.0, None, "cm", 5)
    assert estimate.mapped(lambda end: end - 1.5) == IntervalEstimate(0.5, -0.5, None, "cm", 5)
    assert [estimate.holds(value) for value in (0.9, 1.0, 1e9)] == [False, True, True]
