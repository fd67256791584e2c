"""Speed of sound and temperature compensation against published values."""

import math

import numpy as np
import pytest

from msp_range.acoustics.air import (
    Air,
    air_error_m,
    air_variance_m2,
    compensate_range,
    speed_of_sound,
)


@pytest.mark.parametrize(
    ("temperature_c", "published_m_s"),
    [(-20.0, 318.9), (0.0, 331.3), (10.0, 337.3), (20.0, 343.2), (30.0, 349.0)],
)
def test_speed_of_sound_is_that_of_dry_air_tables(temperature_c: float, published_m_s: float) -> None:
    # Half a unit of the table's last digit, and 1e-4 for gamma and M as different tables take them.
    assert speed_of_sound(temperature_c) == pytest.approx(published_m_s, abs=0.05 + 1e-4 * published_m_s)


@pytest.mark.parametrize(("air_c", "error_percent"), [(0.0, 4.0), (15.0, 1.3), (40.0, -2.8)])
def test_compensation_takes_out_the_error_of_a_sensor_calibrated_at_22_5(air_c: float, error_percent: float) -> None:
    reading_m = 3.0
    true_m = compensate_range(reading_m, air_c, 22.5)
    assert 100.0 * (reading_m / true_m - 1.0) == pytest.approx(error_percent, abs=0.05)


def test_compensation_of_table_5_1_at_335_cm() -> None:
    # Mean errors 2.821 and 0.067 cm before and after, which is air of 15.2 C (to 0.05 C) under a calibration at 20 C.
    tolerance_m = 3.35 * 0.5 * 0.05 / 288.0 + 0.5e-5
    assert compensate_range(3.37821, 15.2, 20.0) == pytest.approx(3.35067, abs=tolerance_m)


def test_hot_air_of_the_report_is_4_4_percent_and_not_30() -> None:
    hot_c, room_c = (115.0 - 32.0) / 1.8, (68.0 - 32.0) / 1.8
    assert compensate_range(1.0, hot_c, room_c) == pytest.approx(1.0436, abs=5e-5)


@pytest.mark.parametrize("air_c", [-20.0, 3.0, 22.5, 50.0])
def test_compensation_undoes_a_sensor_that_times_the_echo_with_its_own_speed(air_c: float) -> None:
    true_m = 4.2
    reading_m = true_m / speed_of_sound(air_c) * speed_of_sound(22.5)
    assert compensate_range(reading_m, air_c, 22.5) == pytest.approx(true_m, rel=1e-12)


def test_there_and_back_takes_the_makers_58_us_a_centimetre_at_22_5() -> None:
    assert 1e6 * 0.02 / speed_of_sound(22.5) == pytest.approx(58.0, abs=0.05)


def test_arrays_agree_with_numbers_and_broadcast() -> None:
    air_c = np.array([-20.0, 0.0, 22.5, 50.0])
    range_m = np.array([0.2, 1.0, 3.0, 7.65])
    assert speed_of_sound(air_c) == pytest.approx([speed_of_sound(t) for t in air_c.tolist()], rel=1e-15)
    each = zip(range_m.tolist(), air_c.tolist(), strict=True)
    assert compensate_range(range_m, air_c, 22.5) == pytest.approx(
        [compensate_range(r, t, 22.5) for r, t in each], rel=1e-15
    )
    assert compensate_range(range_m, np.array(5.0), 22.5).shape == (4,)
    assert compensate_range(np.array(1.0), air_c, 22.5).shape == (4,)
    assert compensate_range(range_m[:, None], air_c, 22.5).shape == (4, 4)


def test_an_unknown_temperature_stays_unknown() -> None:
    assert math.isnan(compensate_range(3.0, math.nan, 22.5))
    assert np.isnan(compensate_range(np.array(3.0), np.array([math.nan, 20.0]), 22.5)).tolist() == [True, False]


def test_absolute_zero_and_below_are_refused() -> None:
    with pytest.raises(ValueError, match=r"found a temperature of -273\.15 deg C, expected one above absolute zero"):
        speed_of_sound(-273.15)
    with pytest.raises(ValueError, match=r"-300\.0"):
        speed_of_sound(np.array([20.0, -300.0]))
    with pytest.raises(ValueError, match=r"absolute zero"):
        compensate_range(3.0, 20.0, -273.15)


@pytest.mark.parametrize("air_c", [-20.0, 20.0, 45.0])
@pytest.mark.parametrize("std_c", [0.5, 2.0])
def test_the_variance_of_a_range_is_what_wrong_temperatures_do_to_it(air_c: float, std_c: float) -> None:
    """Against eq 7 itself, with temperatures drawn about the true one: to the sampling error of 100,000."""
    believed_c = air_c + std_c * np.random.default_rng(1).standard_normal(100_000)
    errors_m = compensate_range(np.full(100_000, 5.0), believed_c, air_c) - 5.0
    assert air_variance_m2(5.0, Air(air_c, std_c, "fixed")) == pytest.approx(errors_m.var(), rel=0.02)
    bound_m = air_error_m(5.0, Air(air_c, std_c, "fixed"))
    assert np.mean(np.abs(errors_m) <= bound_m) == pytest.approx(0.95, abs=0.005)


def test_five_metres_in_air_of_20_give_or_take_12_degrees() -> None:
    """(R / 2T)^2 var(T) by hand: 5 m / 586.3 K x 12 K is 10.23 cm."""
    assert 1e4 * air_variance_m2(5.0, Air(20.0, 12.0, "fixed")) == pytest.approx(10.234**2, rel=1e-3)
    assert air_variance_m2(10.0, Air(20.0, 12.0, "fixed")) == 4 * air_variance_m2(5.0, Air(20.0, 12.0, "fixed"))
    assert air_variance_m2(5.0, Air(20.0, 0.0, "fixed")) == 0.0
