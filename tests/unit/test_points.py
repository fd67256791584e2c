"""Readings sorted into points: what is one set-up, what is a code, what is of the surface."""

import numpy as np
import pytest

from msp_lab.characterise.points import conditions, sort_into_points
from tests.support.plain_bench import point, table
from tests.support.shipped import SENSOR


def test_a_point_is_what_was_set_up_once() -> None:
    rng = np.random.default_rng(1)
    data = table(
        point(rng, 100, air_temperature_c=20.0),
        point(rng, 200, air_temperature_c=20.0),
        point(rng, 200, sensor="two"),
        point(rng, 200, run="next day"),
        point(rng, 200, condition="material", target="asphalt"),
        point(rng, 200, condition="material", target="concrete"),
        point(rng, 200, condition="vibration", vibration_hz=60),
        point(rng, 200, condition="external_interference", external_level_db=90, external_distance_cm=100),
        point(rng, 200, condition="external_interference", external_level_db=90, external_distance_cm=300),
    )
    found = [each.found for each in sort_into_points(data, SENSOR)]
    assert len(found) == 9
    assert [each.level for each in found[4:]] == [
        "asphalt",
        "concrete",
        "60 Hz",
        "70 to 90 dB at the sensor",
        "70 to 90 dB at the sensor",
    ]
    assert all(each.readings == 100 for each in found)


def test_temperatures_that_drift_are_one_level() -> None:
    rng = np.random.default_rng(2)
    parts = [point(rng, 100, condition="temperature", n=50) for _ in range(3)]
    for part, warm_c in zip(parts, (8.3, 21.1, 46.1), strict=True):
        part["air_temperature_c"] = warm_c + rng.uniform(-0.5, 0.5, 50)
    levels = {each.level for each in sort_into_points(table(*parts), SENSOR)}
    assert levels == {"8 C", "21 C", "46 C"}


def test_every_reading_is_counted_once() -> None:
    rng = np.random.default_rng(3)
    part = point(rng, 400, n=2000, missed=0.05, saturated=0.02, stray=0.05, error_cm=2.0)
    part["reading_cm"][:7] = np.nan
    found = sort_into_points(table(part), SENSOR)[0].found
    assert found.no_answer == 7
    assert found.no_echo == (part["reading_cm"] == 765).sum()
    assert found.saturated == (part["reading_cm"] == 255).sum()
    assert found.hits + found.short + found.long + found.no_echo + found.saturated + found.no_answer == 2000
    # Strays are even over 20 to 764, 400 is about half-way.
    assert found.short == pytest.approx(2000 * 0.05 * 380 / 745, abs=25)
    assert found.error is not None
    assert found.error.low is not None
    assert found.error.high is not None
    assert found.error.low < 2.0 < found.error.high


def test_255_is_a_range_where_the_others_are_near_it() -> None:
    rng = np.random.default_rng(4)
    near = sort_into_points(table(point(rng, 254, sigma_cm=1.0)), SENSOR)[0].found
    assert (near.saturated, near.hits) == (0, 100)
    far = sort_into_points(table(point(rng, 300, saturated=0.3)), SENSOR)[0].found
    assert far.saturated > 10


def test_two_clusters_are_not_averaged() -> None:
    rng = np.random.default_rng(5)
    part = point(rng, 120, n=100)
    part["reading_cm"][:45] = rng.integers(45, 80, 45)
    found = sort_into_points(table(part), SENSOR)[0].found
    assert (found.hits, found.short) == (55, 45)
    assert found.error is not None
    assert abs(found.error.value) < 0.3


def test_readings_that_are_all_far_off_are_not_of_the_surface() -> None:
    rng = np.random.default_rng(6)
    found = sort_into_points(table(point(rng, 120, error_cm=-60.0)), SENSOR)[0].found
    assert (found.hits, found.short, found.error) == (0, 100, None)


@pytest.mark.parametrize(("true_cm", "error_cm"), [(100, -17.2), (260, -17.2), (100, 22.0), (300, 40.0), (300, -40.0)])
def test_a_surface_that_is_read_far_off_is_still_the_surface(true_cm: float, error_cm: float) -> None:
    """A neighbour's ping that is 1 ms early makes 17 cm, and 46 deg C make 4 % of the range."""
    rng = np.random.default_rng(10)
    found = sort_into_points(table(point(rng, true_cm, error_cm=error_cm)), SENSOR)[0].found
    assert found.hits == 100
    assert found.error is not None
    assert found.error.value == pytest.approx(error_cm, abs=0.3)


def test_hits_that_scatter_more_are_all_hits() -> None:
    rng = np.random.default_rng(11)
    found = sort_into_points(table(point(rng, 400, n=4000, sigma_cm=4.0)), SENSOR)[0].found
    # 4.5 standard deviations leave out one in 150,000, and the fixed 8 cm would one in 20.
    assert found.hits >= 3998
    assert found.spread is not None
    assert found.spread.value == pytest.approx(4.0, abs=0.15)


def test_the_error_in_other_air_is_taken_back_by_eq_7() -> None:
    rng = np.random.default_rng(7)
    # 5 deg C: sound takes longer by sqrt(295.65 / 278.15), and a sensor made for 22.5 deg C reads that much more.
    reads_cm = 300.0 * np.sqrt(295.65 / 278.15)
    part = point(rng, 300, error_cm=reads_cm - 300.0, n=400, air_temperature_c=5.0)
    found = sort_into_points(table(part), SENSOR)[0].found
    assert found.error is not None
    assert found.compensated_error is not None
    assert found.error.value == pytest.approx(9.29, abs=0.15)
    assert found.compensated_error.value == pytest.approx(0.0, abs=0.15)


def test_without_a_temperature_of_a_hit_nothing_is_compensated() -> None:
    part = point(np.random.default_rng(7), 300, n=50)
    part["reading_cm"][0] = 765.0
    part["air_temperature_c"] = np.where(np.arange(50) == 0, 5.0, np.nan)
    assert sort_into_points(table(part), SENSOR)[0].found.compensated_error is None


def test_rounding_is_no_spread_where_the_range_changes() -> None:
    rng = np.random.default_rng(7)
    true_cm = np.linspace(60.0, 79.9, 2000)
    part = point(rng, 70, n=2000)
    part |= {"true_range_cm": true_cm, "reading_cm": np.rint(true_cm + 0.1 * rng.standard_normal(2000))}
    (found,) = [each.found for each in sort_into_points(table(part), SENSOR)]
    assert found.spread is not None
    assert found.spread.value == pytest.approx(0.1, abs=0.05)


def test_equal_ranges_are_equal_however_many_readings_they_have() -> None:
    rng = np.random.default_rng(7)
    first, second = sort_into_points(table(point(rng, 502.3, n=40), point(rng, 502.3, n=7, run="2")), SENSOR)
    assert first.range_cm == second.range_cm == 502.3


def test_without_a_condition_what_is_varied_gives_it() -> None:
    rng = np.random.default_rng(8)
    parts = [
        point(rng, 100, incidence_deg=0.0, n=5),
        point(rng, 100, incidence_deg=9.0, n=5),
        point(rng, 100, vibration_hz=60.0, n=5),
        point(rng, 100, vibration_hz=0.0, n=5),
    ]
    for part in parts:
        del part["condition"]
    assert conditions(table(*parts))[::5].tolist() == ["field_of_view", "field_of_view", "vibration", "baseline"]


def test_a_range_that_changes_all_the_time_is_cut_into_pieces() -> None:
    rng = np.random.default_rng(9)
    true_cm = np.linspace(50.0, 250.0, 3000)
    part = point(rng, 100, n=3000)
    part["true_range_cm"] = true_cm
    part["reading_cm"] = np.rint(true_cm + 1.0 + 0.5 * rng.standard_normal(3000))
    found = [each.found for each in sort_into_points(table(part), SENSOR)]
    assert len(found) == 11
    assert np.mean([each.error.value for each in found if each.error]) == pytest.approx(1.0, abs=0.1)
