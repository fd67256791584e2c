"""Meta-analysis over a fleet, against published examples, quadrature and numbers worked by hand."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm
from scipy.stats import t as student

from msp_lab.fleet.findings import FleetFindings
from msp_lab.fleet.meta import Spread, pooled, shrunk
from msp_lab.fleet.statistics import between_sessions, over_sessions
from msp_lab.fleet.vehicles import units_of
from msp_lab.fleet.words import sentence_of
from msp_range.errors import UserError

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


def bcg() -> tuple[np.ndarray, np.ndarray]:
    """Logarithms of the relative risk, and their standard errors."""
    cases, others, cases_without, others_without = BCG.T
    with_, without = cases + others, cases_without + others_without
    variance = 1 / cases - 1 / with_ + 1 / cases_without - 1 / without
    return np.log(cases / with_ / (cases_without / without)), np.sqrt(variance)


def test_bcg_trials_give_the_published_mean_and_spread() -> None:
    # By REML, Viechtbauer (2010, J. Stat. Softw. 36:3) has -0.7145 (0.1798), tau^2 0.3132 and I^2 92 %.
    fleet = pooled(*bcg())
    assert fleet.mean == pytest.approx(-0.7145, abs=0.002)
    assert fleet.error == pytest.approx(0.1798, abs=0.002)
    assert fleet.tau == pytest.approx(np.sqrt(0.3132), rel=0.02)
    assert fleet.ordinary.all()
    assert fleet.i2 == pytest.approx(0.9212, abs=0.0005)


def test_equal_estimates_have_no_spread_and_the_error_of_their_mean() -> None:
    fleet = pooled(np.full(4, 2.0), np.ones(4))
    assert (fleet.mean, fleet.error, fleet.tau) == (2.0, 0.5, 0.0)


def test_estimates_without_errors_are_compared_by_students_t() -> None:
    rng = np.random.default_rng(5)
    values = rng.standard_normal(20)
    fleet = pooled(values, np.zeros(20))
    for k in range(20):
        others = np.delete(values, k)
        t = abs(values[k] - others.mean()) / (others.std(ddof=1) * np.sqrt(1.0 + 1.0 / 19.0))
        assert fleet.log_p[k] == pytest.approx(np.log(2.0 * student.sf(t, 18)), abs=1e-3)
    t = abs(values.mean()) / (values.std(ddof=1) / np.sqrt(20.0))
    assert fleet.log_p_of_mean == pytest.approx(np.log(2.0 * student.sf(t, 19)), abs=1e-3)


def test_a_p_value_is_the_mean_over_the_spread_by_likelihood_and_prior() -> None:
    values, errors = np.array([0.3, -1.4, 2.2, 0.9, -0.6, 1.6]), np.array([0.4, 1.1, 0.7, 0.5, 2.0, 0.9])

    def weight(tau: float) -> tuple[float, float, float]:
        """Likelihood times prior, mean, and variance of the mean."""
        w = 1.0 / (errors**2 + tau**2)
        mean = float(np.average(values, weights=w))
        likelihood = np.sqrt(w.prod() / w.sum()) * np.exp(-0.5 * float((w * (values - mean) ** 2).sum()))
        return likelihood * tau * np.sqrt((w**2).sum()), mean, 1.0 / float(w.sum())

    def tail(tau: float, value: float, error: float) -> float:
        each, mean, variance = weight(tau)
        return float(each * 2.0 * norm.sf(abs(value - mean) / np.sqrt(error**2 + tau**2 + variance)))

    places = [0.1, 0.3, 1.0, 3.0, 10.0]
    whole = quad(lambda tau: weight(tau)[0], 0.0, 200.0, points=places, limit=500)[0]
    for value, error in ((3.0, 0.3), (12.0, 0.3), (5.0, 2.0)):
        expected = quad(tail, 0.0, 200.0, args=(value, error), points=places, limit=500)[0] / whole
        assert Spread.of(values, errors).log_p_of(value, error) == pytest.approx(np.log(expected), abs=0.01)


def test_three_odd_vehicles_of_twenty_do_not_hide_each_other() -> None:
    rng = np.random.default_rng(5)
    values, errors = rng.standard_normal(20), np.ones(20)
    values[:3] += 12.0
    fleet = pooled(values, errors)
    assert list(np.flatnonzero(~fleet.ordinary)) == [0, 1, 2]
    assert fleet.log_p[:3].max() < np.log(1e-6)
    assert fleet.log_p[3:].min() > np.log(1e-3)
    # All of them together are no odd ones, but what the fleet shares.
    everyone = pooled(values[3:] + 10.0, errors[3:])
    assert everyone.ordinary.all()
    assert everyone.mean == pytest.approx(10.0, abs=0.6)
    assert everyone.log_p_of_mean < np.log(1e-12)


def test_fleets_without_odd_vehicles_have_as_many_small_p_values_as_they_should() -> None:
    rng = np.random.default_rng(11)
    smallest = []
    for spread in (0.0, 0.5, 2.0) * 50:
        errors = np.exp(0.5 * rng.standard_normal(20))
        smallest.append(pooled(rng.normal(0.0, np.hypot(spread, errors)), errors).log_p.min())
    # Of 150 fleets 7.5 have a p-value below 0.05 / 20.
    assert 1 <= np.sum(np.array(smallest) < np.log(0.05 / 20.0)) <= 15


def test_an_estimate_as_uncertain_as_the_fleet_is_spread_moves_half_way() -> None:
    # Three estimates at 0 and two 3 from it have the variance 4.5; with errors of 1.5, half of it is the spread.
    values, errors = np.array([-3.0, 0.0, 0.0, 3.0, 0.0]), np.full(5, 1.5)
    fleet = pooled(values, errors)
    assert fleet.tau == pytest.approx(1.5, rel=0.02)
    near, error = shrunk(values, errors, fleet)
    assert near == pytest.approx(values / 2.0, rel=0.03)
    assert error[0] == pytest.approx(np.sqrt(0.5 * 2.25 + 0.25 * 4.5 / 5.0), rel=0.02)


def test_a_change_is_found_at_its_session_with_its_size_and_error() -> None:
    value = np.array([0.0, 0.0, 0.0, 0.0, 6.0, 6.0, 6.0, 6.0])
    found = over_sessions(value, np.ones(8), 0.0)
    assert found is not None
    assert (found.kind, found.first, found.size) == ("change", 4, 6.0)
    # Two means of four numbers of error 1 differ with the variance 1/4 + 1/4.
    assert found.error == pytest.approx(np.sqrt(0.5))
    # Sessions that differ by as much as a rule make it less certain.
    wider = over_sessions(value, np.ones(8), np.sqrt(3.0))
    assert wider is not None
    assert wider.error == pytest.approx(np.sqrt(2.0))
    drift = over_sessions(np.linspace(-6.0, 6.0, 8), np.ones(8), 0.0)
    assert drift is not None
    assert drift.kind == "drift"
    assert drift.size == pytest.approx(12.0)
    assert over_sessions(value[:3], np.ones(3), 0.0) is None


def test_the_spread_between_sessions_is_that_of_the_median_vehicle() -> None:
    rng = np.random.default_rng(3)
    quiet = [(0.5 * rng.standard_normal(12), np.full(12, 0.5)) for _ in range(40)]
    loud = [(value + 1.5 * rng.standard_normal(12), error) for value, error in quiet]
    assert between_sessions(quiet) < 0.3
    assert between_sessions(loud) == pytest.approx(1.5, rel=0.15)
    # One vehicle that changed does not move it.
    changed = [(loud[0][0] + 30.0 * (np.arange(12) > 5), loud[0][1]), *loud[1:]]
    assert between_sessions(changed) == pytest.approx(between_sessions(loud), rel=0.1)


def test_a_folder_that_is_no_dataset_is_a_users_mistake(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no dataset of readings; 'msp-lab import"):
        units_of(tmp_path, None, 1)
