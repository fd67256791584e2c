"""Meta-analysis over a fleet, against published examples and numbers worked by hand."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm
from scipy.stats import t as student

from msp_lab.fleet.findings import FleetFindings
from msp_lab.fleet.statistics import (
    Group,
    Number,
    Pooled,
    between_sessions,
    groups_of,
    left_out,
    numbers_of,
    over_sessions,
    pooled,
    shrunk,
)
from msp_lab.fleet.terms import FleetTerm
from msp_lab.fleet.unit import Sessions, UnitNumbers
from msp_lab.fleet.vehicles import units_of
from msp_lab.fleet.words import one_session_line, plain_of, sentence_of
from msp_range.errors import UserError

LEVEL = float(np.log(0.00025))
"""Of an odd one of 20 vehicles at a rate of false findings of 0.05."""
BCG = np.array(
    [
        [4, 119, 11, 128],
        [6, 300, 29, 274],
        [3, 228, 11, 209],
        [62, 13536, 248, 12619],
        [33, 5036, 47, 5761],
        [180, 1361, 372, 1079],
        [8, 2537, 10, 619],
        [505, 87886, 499, 87892],
        [29, 7470, 45, 7232],
        [17, 1699, 65, 1600],
        [186, 50448, 141, 27197],
        [5, 2493, 3, 2338],
        [27, 16886, 29, 17825],
    ],
    dtype=float,
)
"""Cases and others with and without BCG vaccine in 13 trials (Colditz et al. 1994, JAMA 271:698)."""


@pytest.mark.parametrize(("vehicles", "says"), [(4, True), (5, True), (6, False), (20, False)])
def test_a_small_fleet_reports_that_its_scatter_hides_much(vehicles: int, says: bool) -> None:
    findings = FleetFindings("", "", "", vehicles, vehicles, 12, 3600, (), 0, (), 0.05, 40, (), 1, "", "")
    assert ("even one that is far off" in sentence_of(findings)) == says


@pytest.mark.parametrize(("sensors", "says"), [(32, True), (4, False), (8, False)])
def test_sensors_of_one_session_each_may_be_one_sensor_without_a_name(sensors: int, says: bool) -> None:
    findings = FleetFindings("", "", "", 4, sensors, 32, 3600, (), 0, (), 0.05, 40, (), 1, "", "")
    assert ("give the tables a column 'sensor'" in one_session_line(findings)) == says


@pytest.mark.parametrize(
    ("number", "change", "says"),
    [
        ("scatter", 0.2624, "readings scatter 1.3 times as much"),
        ("scatter", -0.3365, "readings scatter 1.4 times less"),
        ("missed", -0.3365, "missed echoes come 1.4 times less often"),
    ],
)
def test_sizes_are_larger_and_events_come_more_often(number: str, change: float, says: str) -> None:
    assert plain_of(FleetTerm(number, "value"), change, with_size=True) == says


def bcg() -> tuple[np.ndarray, np.ndarray]:
    """Logarithms of the relative risk, and their standard errors."""
    cases, others, cases_without, others_without = BCG.T
    with_, without = cases + others, cases_without + others_without
    variance = 1 / cases - 1 / with_ + 1 / cases_without - 1 / without
    return np.log(cases / with_ / (cases_without / without)), np.sqrt(variance)


def test_bcg_trials_give_the_published_mean_and_spread() -> None:
    # By Paule and Mandel, Viechtbauer's metafor (2010, J. Stat. Softw. 36:3) has -0.7150 (0.1809) and tau^2 0.3181; I^2
    # by its definition from Q = 152.23.
    values, errors = bcg()
    fleet = pooled(values, errors, LEVEL)
    assert not fleet.odd.any()
    assert fleet.mean == pytest.approx(-0.7150, abs=0.0001)
    assert fleet.error == pytest.approx(0.1809, abs=0.0001)
    assert fleet.tau**2 == pytest.approx(0.3181, abs=0.0001)
    assert fleet.i2 == pytest.approx(0.9212, abs=0.0005)
    assert np.exp(fleet.log_p) == pytest.approx(2.0 * student.sf(0.7150 / 0.1809, 12), rel=0.01)


def test_estimates_without_errors_are_compared_by_students_t() -> None:
    values = np.array([0.3, -1.4, 2.2, 0.9, -0.6, 7.0, 1.6])
    log_p = left_out(values, np.full(7, 1e-6), np.arange(7), 5)
    others = np.delete(values, 5)
    t = (values[5] - others.mean()) / np.sqrt(np.var(others, ddof=1) * (1.0 + 1.0 / others.size))
    assert log_p == pytest.approx(np.log(2.0) + student.logsf(t, others.size - 1), abs=1e-6)


def test_equal_estimates_have_their_mean_and_next_to_no_spread() -> None:
    fleet = pooled(np.full(20, 2.0), np.ones(20), LEVEL)
    assert fleet.mean == pytest.approx(2.0)
    assert fleet.error == pytest.approx(20.0**-0.5)
    assert fleet.tau == 0.0


def test_three_odd_vehicles_of_twenty_do_not_hide_each_other() -> None:
    rng = np.random.default_rng(5)
    values, errors = rng.standard_normal(20), np.ones(20)
    values[:3] += 10.0
    fleet = pooled(values, errors, LEVEL)
    assert list(np.flatnonzero(fleet.odd)) == [0, 1, 2]
    assert fleet.deviation_log_p[:3].max() < np.log(1e-6)
    assert fleet.deviation_log_p[3:].min() > np.log(1e-3)
    # All of them together are no odd ones, but what the fleet shares.
    everyone = pooled(values[3:] + 10.0, errors[3:], LEVEL)
    assert not everyone.odd.any()
    assert everyone.mean == pytest.approx(10.0, abs=0.6)
    assert everyone.log_p < -30.0


def test_odd_vehicles_that_are_known_better_than_the_others_do_not_hide_each_other() -> None:
    """Log odds of short readings at full throttle: who has few of them knows little of it."""
    values = [2.06, 2.28, 2.33, 0.37, -0.41, 0.44, 0.33, -0.24, -0.06, 0.17, 0.47, 0.85, 0.23, -0.82, 0.84, 0.11]
    errors = [0.25, 0.25, 0.24, 0.51, 0.67, 0.36, 0.49, 0.68, 0.50, 0.61, 0.51, 0.45, 0.50, 0.71, 0.42, 0.38]
    fleet = pooled(np.array(values), np.array(errors), LEVEL)
    assert list(np.flatnonzero(fleet.odd)) == [0, 1, 2]
    assert fleet.deviation_log_p[:3].max() < np.log(5e-5)


def test_one_that_is_far_off_by_its_own_error_is_not_odd_next_to_one_that_is() -> None:
    """Log odds of random readings: the first has 28 of them, the second hardly any."""
    values = [1.23, -3.03, -1.15, 0.05, 0.19, -0.84, 0.03, 0.21, 0.35, 0.07, 0.39, -0.66, -0.1, 0.41, -0.37, 0.14]
    errors = [0.24, 1.0, 0.69, 0.39, 0.26, 0.46, 0.4, 0.3, 0.44, 0.34, 0.42, 0.55, 0.29, 0.27, 0.37, 0.29]
    values, errors = [*values, 0.23, -0.46, -0.29, 0.3], [*errors, 0.26, 0.65, 0.37, 0.29]
    fleet = pooled(np.array(values), np.array(errors), LEVEL)
    assert list(np.flatnonzero(fleet.odd)) == [0]
    assert fleet.deviation_log_p[1] < np.log(0.02)


def test_each_vehicle_is_compared_with_what_the_others_alone_predict() -> None:
    values = np.array([0.3, -1.4, 2.2, 0.9, -0.6, 24.0, 1.6])
    errors = np.array([0.4, 1.1, 0.7, 0.5, 2.0, 0.6, 0.9])
    fleet = pooled(values, errors, LEVEL)
    assert list(np.flatnonzero(fleet.odd)) == [5]
    for k in range(values.size):
        others = (np.arange(values.size) != k) & ~fleet.odd
        alone = pooled(values[others], errors[others], -np.inf)
        off = (values[k] - alone.mean) / np.sqrt(errors[k] ** 2 + alone.tau**2 + alone.error**2)
        assert np.exp(fleet.deviation_log_p[k]) == pytest.approx(2.0 * student.sf(abs(off), others.sum() - 1))


def test_p_values_of_drawn_fleets_are_as_often_small_as_they_should_be() -> None:
    rng = np.random.default_rng(8)
    small = 0
    for _ in range(60):
        errors = 0.3 * np.exp(0.3 * rng.standard_normal(20))
        values = rng.standard_normal(20) + errors * rng.standard_normal(20)
        small += int((pooled(values, errors, LEVEL).deviation_log_p < np.log(0.01)).sum())
    # 12 of 1,200 are expected, with a standard deviation of 3.4.
    assert 4 <= small <= 22


def test_an_estimate_as_uncertain_as_the_fleet_is_spread_moves_half_way() -> None:
    values, errors = np.array([-3.0, 0.0, 5.0]), np.full(3, 1.5)
    fleet = Pooled(1.0, 0.5, 1.5, 0.5, 0.0, np.array([False, False, True]), np.zeros(3))
    near, error = shrunk(values, errors, fleet)
    assert near.tolist() == [-1.0, 0.5, 5.0]
    assert error == pytest.approx([np.sqrt(0.5 * 1.5**2 + 0.25 * 0.25)] * 2 + [1.5])


def fleet_of(values: Sequence[float], batches: str) -> list[UnitNumbers]:
    """Vehicles with these offsets, each with an error of 0.1, and of these batches."""
    term = FleetTerm("offset", "value")
    return [
        UnitNumbers(
            ((term, Sessions(np.full(4, value), np.full(4, 0.04), np.full(4, 0.25))),), (), 400, 0.0, 40, (), words
        )
        for value, words in zip(values, [(("batch", batch), ("maker", "X")) for batch in batches], strict=True)
    ]


def offset_of(values: Sequence[float], batches: str) -> tuple[tuple[Group, ...], Number]:
    units = fleet_of(values, batches)
    vehicles = [f"V{k}" for k in range(len(units))]
    groups = groups_of(units, vehicles)
    (number,) = numbers_of(units, LEVEL, vehicles, groups).values()
    return groups, number


BATCH = [0.2, -0.5, 4.9, 4.4, 0.4, 5.6, -0.3, 0.0, 0.3, -0.2]


def test_a_batch_that_a_column_names_is_told_from_the_others() -> None:
    groups, number = offset_of(BATCH, "AABBABAAAA")
    assert groups == (Group("batch B", frozenset({2, 3, 5})),)
    assert number.apart is not None
    others = [value for k, value in enumerate(BATCH) if k not in (2, 3, 5)]
    assert number.apart.size == pytest.approx(np.mean([4.9, 4.4, 5.6]) - np.mean(others), abs=0.02)
    # It is no vehicle's own, and the others are as sure as without the batch.
    assert number.odd == frozenset()
    assert number.fleet.mean == pytest.approx(np.mean(others), abs=0.02)
    # Nothing is apart without such a column, nor by one that says something else.
    assert offset_of(BATCH, "A" * 10)[0] == ()
    assert offset_of(BATCH, "ABABABABAB")[1].apart is None


def test_one_odd_vehicle_does_not_make_its_batch_differ() -> None:
    values = [0.3 * float(value) for value in np.random.default_rng(3).standard_normal(40)]
    values[0] += 10.0
    groups, number = offset_of(values, "BB" + "A" * 38)
    assert [group.units for group in groups] == [frozenset({0, 1})]
    assert number.apart is None
    assert number.odd == frozenset({0})


def test_a_word_that_sensors_of_a_vehicle_differ_in_makes_no_group() -> None:
    units = fleet_of(BATCH, "ABABABABAB")
    assert groups_of(units, [f"V{k // 2}" for k in range(10)]) == ()


def sessions(value: np.ndarray, variance: np.ndarray) -> Sessions:
    return Sessions(value, variance, np.full(value.size, 1.0 / value.size))


def test_a_change_is_found_at_its_session_with_its_size_and_error() -> None:
    # Eight sessions; after the fourth they are 6 larger.
    value = np.array([0.0, 0.0, 0.0, 0.0, 6.0, 6.0, 6.0, 6.0])
    found = over_sessions(sessions(value, np.ones(8)), 0.0)
    assert found is not None
    assert (found.kind, found.first, found.size) == ("change", 4, 6.0)
    # Two means of four numbers of error 1 differ with the variance 1/4 + 1/4.
    assert found.error == pytest.approx(np.sqrt(0.5))
    assert found.log_p == pytest.approx(np.log(2.0 * 5.0) + norm.logsf(6.0 / np.sqrt(0.5)))
    # Sessions of which one is known less well: the mean of the others counts.
    value[7], variance = 60.0, np.ones(8)
    variance[7] = 1e6
    unsure = over_sessions(sessions(value, variance), 0.0)
    assert unsure is not None
    assert unsure.first == 4
    assert unsure.size == pytest.approx(6.0, abs=0.001)
    # The variance between sessions adds to that of each.
    drift = over_sessions(sessions(np.linspace(-6.0, 6.0, 8), np.full(8, 0.4)), 0.6)
    assert drift is not None
    assert drift.kind == "drift"
    assert drift.size == pytest.approx(12.0)
    assert drift.error == pytest.approx(7.0 / np.sqrt(42.0))
    assert over_sessions(sessions(value[:3], np.ones(3)), 0.0) is None


def test_the_spread_between_sessions_is_that_of_the_median_vehicle() -> None:
    rng = np.random.default_rng(3)
    quiet = [Sessions(0.5 * rng.standard_normal(12), np.full(12, 0.25), np.full(12, 1.0 / 12.0)) for _ in range(40)]
    loud = [each._replace(value=each.value + 1.5 * rng.standard_normal(12)) for each in quiet]
    assert np.sqrt(between_sessions(quiet)) < 0.3
    assert np.sqrt(between_sessions(loud)) == pytest.approx(1.5, rel=0.15)
    # One vehicle that changed does not move it.
    changed = [loud[0]._replace(value=loud[0].value + 30.0 * (np.arange(12) > 5)), *loud[1:]]
    assert between_sessions(changed) == pytest.approx(between_sessions(loud), rel=0.1)


def test_a_folder_that_is_no_dataset_is_a_users_mistake(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no dataset of readings; 'msp-lab import"):
        units_of(tmp_path, None, 1)
