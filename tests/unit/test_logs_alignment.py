"""Whether the lag of readings behind a reference is found again, and how well a reference is known."""

from collections.abc import Callable

import numpy as np
import pytest

from msp_lab.logs.alignment import Alignment, Interval, _lowest, align, reference_std_cm
from msp_lab.logs.log import Series
from msp_range.arrays import Array


def climbs(at_s: Array) -> Array:
    """Height of a vehicle that climbs and descends by 1 to 2 m/s [cm]."""
    return 300.0 + 150.0 * np.sin(at_s / 1.3) + 60.0 * np.sin(at_s / 0.61)


def fitted(time_s: Array, reading_cm: Array, expected_cm: Callable[[Array], Array], seed: int = 1) -> Alignment:
    """How readings fit a reference with which they overlap."""
    found = align(time_s, reading_cm, expected_cm, np.random.default_rng(seed))
    assert found is not None
    return found


def lag_of(found: Alignment) -> Interval:
    assert found.lag_s is not None
    return found.lag_s


def aligned(seed: int, lag_s: float = 0.21, seconds: float = 60.0) -> Alignment:
    rng = np.random.default_rng(seed)
    time_s = np.arange(0.0, seconds, 0.1)
    reading_cm = np.round(1.03 * climbs(time_s - lag_s) + 12.0 + rng.normal(0.0, 3.0, time_s.size))
    reading_cm[rng.random(time_s.size) < 0.1] = 765.0
    reading_cm[rng.random(time_s.size) < 0.05] = np.nan
    reference = Series("", np.arange(0.0, seconds, 0.05), climbs(np.arange(0.0, seconds, 0.05)))
    return fitted(time_s, reading_cm, reference.at, seed)


@pytest.mark.parametrize("lag_s", [-0.4, 0.0, 0.21, 1.1])
def test_a_lag_is_found_next_to_a_scale_an_offset_and_outliers(lag_s: float) -> None:
    found = aligned(1, lag_s)
    value_s, low_s, high_s = lag_of(found)
    assert abs(value_s - lag_s) < 0.01
    assert low_s < value_s < high_s
    assert high_s - low_s < 0.03
    # 3 % of 300 cm and 12 cm.
    assert abs(found.offset_cm - 21.0) < 2.0


def test_a_damaged_value_of_the_reference_is_a_hole() -> None:
    time_s = np.arange(0.0, 60.0, 0.1)
    heights = climbs(time_s)
    heights[300] = 7e174
    assert abs(lag_of(fitted(time_s, climbs(time_s - 0.21), Series("", time_s, heights).at)).value - 0.21) < 0.01


def test_of_many_readings_a_lag_is_found_though_every_second_one_is_bad() -> None:
    time_s = np.linspace(0.0, 600.0, 20_000)
    reading_cm = climbs(time_s - 0.21)
    reading_cm[::2] = 30.0 + np.random.default_rng(2).normal(0.0, 3.0, reading_cm[::2].size)
    assert abs(lag_of(fitted(time_s, reading_cm, climbs)).value - 0.21) < 0.05


@pytest.mark.slow
def test_the_interval_holds_the_lag_as_often_as_it_says() -> None:
    found = [aligned(seed, seconds=40.0) for seed in range(200)]
    held = sum(low_s <= 0.21 <= high_s for _, low_s, high_s in map(lag_of, found))
    # Of 200 intervals of 95 %, 182 to 197 with a probability of 99 %.
    assert 182 <= held <= 198


def test_a_hover_has_no_lag() -> None:
    rng = np.random.default_rng(1)
    time_s = np.arange(0.0, 60.0, 0.1)
    found = fitted(time_s, 300.0 + rng.normal(0.0, 2.0, time_s.size), lambda at: 300.0 + 0.0 * at)
    assert found.lag_s is None
    assert found.no_lag == "the reference does not change"
    assert 1.5 < found.scatter_cm < 2.5


def test_a_noisy_reference_and_one_with_holes_leave_no_lag_and_say_why() -> None:
    rng = np.random.default_rng(1)
    time_s = np.arange(0.0, 40.0, 0.1)
    noisy = Series("", time_s, climbs(time_s) + rng.normal(0.0, 900.0, time_s.size))
    found = fitted(time_s, climbs(time_s - 0.2), noisy.at)
    low_s, high_s = (
        float(each) for each in found.no_lag.removeprefix("its 95 % interval is ").split(" s")[0].split(" to ")
    )
    assert high_s - low_s > 0.75
    # 2 s of every 4 s are known: no reading has 1.5 s before and after it.
    holes = Series("", time_s[time_s % 4.0 < 2.0], climbs(time_s[time_s % 4.0 < 2.0]))
    found = fitted(time_s, climbs(time_s - 0.2), holes.at)
    assert found.no_lag == "only 0 readings have the reference throughout from 1.5 s before to 1.5 s after them"


def test_a_lag_beyond_those_that_are_tried_is_none() -> None:
    time_s = np.arange(0.0, 60.0, 0.1)
    found = fitted(time_s, climbs(time_s - 1.7), climbs)
    assert found.no_lag == "the best one is 1.50 s, the last that is tried"


def test_hardly_any_readings_are_not_aligned() -> None:
    time_s = np.arange(0.0, 3.0, 0.1)
    assert align(time_s, climbs(time_s), climbs, np.random.default_rng(1)) is None


def test_between_the_lags_that_are_tried_a_parabola_has_its_lowest_point() -> None:
    lags_s = np.arange(-0.1, 0.105, 0.01)
    assert _lowest(lags_s, (lags_s - 0.034) ** 2) == pytest.approx(0.034)


def test_three_instruments_show_the_error_of_each() -> None:
    rng = np.random.default_rng(1)
    true_cm = climbs(np.arange(0.0, 200.0, 0.1))
    reading_cm, reference_cm, other_cm = (
        true_cm + offset + rng.normal(0.0, std, true_cm.size) for offset, std in ((5.0, 6.0), (0.0, 2.0), (-40.0, 4.0))
    )
    for first, second, std_cm in ((reference_cm, other_cm, 2.0), (other_cm, reference_cm, 4.0)):
        found = reference_std_cm(reading_cm, first, second, rng)
        assert found is not None
        assert found[1] <= std_cm <= found[2]
        assert found[2] - found[1] < 1.5


def test_an_interval_of_a_bootstrap_has_the_standard_deviation_of_what_was_drawn() -> None:
    drawn = np.random.default_rng(1).normal(3.0, 0.2, 4000)
    interval = Interval.of(3.0, drawn.tolist())
    assert (interval.low, interval.high) == pytest.approx((2.6, 3.4), abs=0.05)
    assert interval.std == pytest.approx(0.2, rel=0.05)
