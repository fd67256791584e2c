"""Meta-analysis over a fleet, against published examples and numbers worked by hand."""

from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import chi2, norm
from scipy.stats import t as student

from msp_lab.fleet.findings import FleetFindings
from msp_lab.fleet.meta import left_out, paule_mandel, pooled, shrunk
from msp_lab.fleet.statistics import NumberOverSessions, between_sessions, over_sessions
from msp_lab.fleet.terms import FleetTerm
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
    # By REML, Viechtbauer (2010, J. Stat. Softw. 36:3) has -0.7145 (0.1798), tau^2 0.3132 and I^2 92 %; the equation of
    # Paule and Mandel has the root 0.318.
    values, errors = bcg()
    mean, error, tau = paule_mandel(values, errors)
    assert mean == pytest.approx(-0.7145, abs=0.001)
    assert error == pytest.approx(0.1798, abs=0.002)
    assert tau**2 == pytest.approx(0.318, abs=0.0005)
    weight = 1.0 / (errors**2 + tau**2)
    assert float(weight @ (values - mean) ** 2) == pytest.approx(12.0, abs=1e-6)
    fleet = pooled(values, errors)
    assert fleet.ordinary.all()
    assert fleet.i2 == pytest.approx(0.9212, abs=0.0005)
    assert np.exp(fleet.log_p) == pytest.approx(2.0 * student.sf(abs(mean) / error, 12))


def test_equal_estimates_have_no_spread_and_the_error_of_their_mean() -> None:
    mean, error, tau = paule_mandel(np.full(4, 2.0), np.ones(4))
    assert (mean, error, tau) == (2.0, 0.5, 0.0)


def test_three_odd_vehicles_of_twenty_do_not_hide_each_other() -> None:
    rng = np.random.default_rng(5)
    values, errors = rng.standard_normal(20), np.ones(20)
    values[:3] += 10.0
    fleet = pooled(values, errors)
    deviation, log_p = left_out(values, errors, fleet)
    assert list(np.flatnonzero(~fleet.ordinary)) == [0, 1, 2]
    assert log_p[:3].max() < np.log(1e-6)
    assert log_p[3:].min() > np.log(1e-3)
    assert (deviation[:3] > 5.0).all()
    # In a number in which vehicles always differ the same deviation is less certain.
    wider = left_out(values, errors, fleet, always_differ=True)
    assert wider[0] == pytest.approx(deviation)
    assert (wider[1][:3] > log_p[:3] + 5.0).all()
    # All of them together are no odd ones, but what the fleet shares.
    everyone = pooled(values[3:] + 10.0, errors[3:])
    assert everyone.ordinary.all()
    assert everyone.mean == pytest.approx(10.0, abs=0.6)
    assert everyone.tau == 0.0
    assert everyone.log_p == pytest.approx(np.log(2.0) + norm.logsf(everyone.mean / everyone.error))


def test_each_vehicle_is_compared_with_what_the_others_alone_predict() -> None:
    values = np.array([0.3, -1.4, 2.2, 0.9, -0.6, 14.0, 1.6])
    errors = np.array([0.4, 1.1, 0.7, 0.5, 2.0, 0.6, 0.9])
    fleet = pooled(values, errors)
    assert list(np.flatnonzero(~fleet.ordinary)) == [5]
    deviation, log_p = left_out(values, errors, fleet)
    for k in range(values.size):
        others = np.array([each != k for each in range(values.size)]) & fleet.ordinary
        b, s = values[others], errors[others]

        def mean_of(tau2: float, b: np.ndarray = b, s: np.ndarray = s) -> float:
            return float(np.average(b, weights=1.0 / (s**2 + tau2)))

        def excess(tau2: float, b: np.ndarray = b, s: np.ndarray = s) -> float:
            return float(((b - mean_of(tau2)) ** 2 / (s**2 + tau2)).sum() - chi2.ppf(0.3, b.size - 1))

        tau2 = brentq(excess, 0.0, 1e4)
        predicted = tau2 + 1.0 / (1.0 / (s**2 + tau2)).sum()
        own = errors[k] ** 2
        away = (values[k] - mean_of(tau2)) / np.sqrt(own + predicted)
        assert deviation[k] == pytest.approx(away, rel=1e-6)
        # Satterthwaite: of the sum of two variances only `predicted` is estimated, with n - 2 degrees.
        freedom = (b.size - 2) * (own + predicted) ** 2 / predicted**2
        assert np.exp(log_p[k]) == pytest.approx(2.0 * student.sf(abs(away), freedom), rel=1e-6)


def test_an_estimate_as_uncertain_as_the_fleet_is_spread_moves_half_way() -> None:
    # Estimates 0 and 4 of error 1 have tau^2 = 7; between more of them tau = error where the variance is 2.
    values, errors = np.array([-np.sqrt(1.5), 0.0, 0.0, np.sqrt(1.5), 0.0]) * 2.0, np.ones(5) * np.sqrt(1.5)
    fleet = pooled(values, errors)
    assert fleet.tau**2 == pytest.approx(1.5)
    near, error = shrunk(values, errors, fleet)
    assert near == pytest.approx(values / 2.0)
    assert error[0] == pytest.approx(np.sqrt(0.5 * 1.5 + 0.25 * 3.0 / 5.0))


def test_a_change_is_found_at_its_session_with_its_size_and_error() -> None:
    # Eight sessions of information 1; their estimates are their scores. After the fourth they are 6 larger.
    score = np.array([0.0, 0.0, 0.0, 0.0, 6.0, 6.0, 6.0, 6.0]) - 3.0
    found = over_sessions(score, np.ones(8), np.ones(8), 0.0)
    assert found is not None
    assert (found.kind, found.first, found.size) == ("change", 4, 6.0)
    # Two means of four numbers of error 1 differ with the variance 1/4 + 1/4.
    assert found.error == pytest.approx(np.sqrt(0.5))
    # Sessions that differ by as much as a rule make it less certain.
    wider = over_sessions(score, np.ones(8), np.ones(8), 3.0)
    assert wider is not None
    assert wider.error == pytest.approx(np.sqrt(2.0))
    drift = over_sessions(np.linspace(-6.0, 6.0, 8), np.ones(8), np.ones(8), 0.0)
    assert drift is not None
    assert drift.kind == "drift"
    assert drift.size == pytest.approx(12.0)
    assert over_sessions(score[:3], np.ones(3), np.ones(3), 0.0) is None


def test_the_spread_between_sessions_is_that_of_the_median_vehicle() -> None:
    rng = np.random.default_rng(3)
    information = tuple(np.full(12, 4.0) for _ in range(40))
    quiet = tuple(2.0 * rng.standard_normal(12) for _ in range(40))

    def series(score: tuple[np.ndarray, ...]) -> NumberOverSessions:
        units = tuple(range(len(score)))
        return NumberOverSessions(
            FleetTerm("offset", "value"), units, np.zeros(len(score)), score, information, information
        )

    loud = tuple(each + 4.0 * 1.5 * rng.standard_normal(12) for each in quiet)
    assert np.sqrt(between_sessions(series(quiet))) < 0.3
    assert np.sqrt(between_sessions(series(loud))) == pytest.approx(1.5, rel=0.15)
    # One vehicle that changed does not move it.
    changed = (loud[0] + 4.0 * 30.0 * (np.arange(12) > 5), *loud[1:])
    assert between_sessions(series(changed)) == pytest.approx(between_sessions(series(loud)), rel=0.1)


def test_a_folder_that_is_no_dataset_is_a_users_mistake(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no dataset of readings; 'msp-lab import"):
        units_of(tmp_path, None, 1)
