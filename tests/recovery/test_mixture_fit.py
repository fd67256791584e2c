"""The fit gets known parameters back from a plain sampler's readings, with intervals that hold, or says why not."""

import gzip
import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from evaluation.benchmarks.bench_fit_coverage import coverage
from msp_lab.mixture_fit.fit import fit_readings
from msp_lab.mixture_fit.fit_result import FitError, FitResult
from msp_lab.mixture_fit.grid import ReadingGrid
from msp_lab.mixture_fit.pit import goodness_of_fit, pit_values
from msp_range.reading_model.mixture import ReadingModel
from msp_range.reading_model.sensor_model import MixtureParameters
from tests.support.data import measured_data
from tests.support.plain_sampler import PlainSensor
from tests.support.slow import slow

MB1242 = ReadingGrid(20, 765, saturates=True)
GROWTHS = {"sigma_growth_cm_per_m", "missed_growth_per_m"}
ROUGH = PlainSensor(0.80, 0.06, 0.08, 0.06, 1.6, 0.7, 0.25)


def drawn(
    sensor: PlainSensor, readings: int, seed: int, ranges_cm: NDArray[np.float64] | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Readings and true ranges: any from 40 to 500 cm, or some of those given."""
    rng = np.random.default_rng(seed)
    true_cm = rng.uniform(40.0, 500.0, readings) if ranges_cm is None else rng.choice(ranges_cm, readings)
    return np.array(sensor.readings(true_cm.tolist(), seed)), true_cm


def recovered(result: FitResult, sensor: PlainSensor, errors: float = 4.0) -> None:
    """Every parameter is within so many standard errors."""
    truth = {"saturated_fraction": sensor.second_share, **vars(sensor)}
    for name, value in result.estimates.items():
        if name not in result.at_bound and name not in result.not_identified and name in truth:
            assert value == pytest.approx(truth[name], abs=errors * result.standard_errors[name]), name


def p_value(result: FitResult, reading_cm: NDArray[np.float64], true_cm: NDArray[np.float64]) -> float:
    """That of the goodness of fit, which is known."""
    found = goodness_of_fit(result, reading_cm, true_cm, np.random.default_rng(12)).chi_square_p_value
    assert found is not None
    return found


def test_missed_echoes_are_judged_where_the_readings_are() -> None:
    """Those that grow with range are nearly all of the readings at 3 m, to which their share refers."""
    near = PlainSensor(0.97, 0.01, 0.9999, 0.02, 1.6, 0.7, 0.25, missed_growth_per_m=5.0)
    reading_cm, true_cm = drawn(near, 10_000, 3, np.arange(40.0, 120.0, 10.0))
    result = fit_readings(reading_cm, true_cm, MB1242, growth=True)
    assert (reading_cm != 765).mean() > 0.7
    assert result.estimates["missed"] > 0.99
    assert result.estimates["missed_growth_per_m"] == pytest.approx(5.0, abs=0.3)


def test_a_sensor_of_short_range_has_its_weights_at_its_longest() -> None:
    sensor = PlainSensor(
        *(0.87, 0.01, 0.1, 0.02, 0.2, 5.0),
        missed_growth_per_m=9.0,
        minimum_cm=1.0,
        maximum_cm=60.0,
        step_cm=0.1,
        no_echo_cm=60.0,
    )
    reading_cm, true_cm = drawn(sensor, 10_000, 4, np.arange(5.0, 58.0, 3.0))
    result = fit_readings(reading_cm, true_cm, ReadingGrid(1.0, 60.0, 0.1), growth=True)
    recovered(result, sensor)
    assert "missed_growth_per_m" in result.estimates
    model = ReadingModel(result.parameters, 1.0, 60.0, resolution_cm=0.1)
    assert model.shares(60.0)[2] == pytest.approx(result.estimates["missed"])
    assert model.shares(30.0)[2] == pytest.approx((reading_cm[true_cm == 29.0] == 60.0).mean(), abs=0.01)


@pytest.mark.slow
def test_intervals_hold_the_truth() -> None:
    """The whole figure is `python -m evaluation fit_coverage`; one in twenty may miss."""
    shares = coverage(range(400, 416))
    assert 0.88 <= sum(shares.values()) / len(shares) <= 0.995
    assert min(shares.values()) >= 0.75


@pytest.mark.parametrize("ranges_cm", [None, 40.0 + 20.0 * np.arange(12)], ids=["all differ", "campaign"])
def test_known_parameters_come_back(ranges_cm: NDArray[np.float64] | None) -> None:
    reading_cm, true_cm = drawn(ROUGH, 20_000, 1, ranges_cm)
    result = fit_readings(reading_cm, true_cm, MB1242)
    recovered(result, ROUGH)
    assert result.at_bound == result.not_identified == ()
    assert sum(result.estimates[name] for name in ("hit", "short", "missed", "random")) == pytest.approx(1.0)


def test_counted_rows_are_the_same_fit() -> None:
    reading_cm, true_cm = drawn(ROUGH, 5_000, 2, np.array([80.0, 300.0]))
    counted = fit_readings(reading_cm, true_cm, MB1242)
    # A millionth of a centimetre makes every range another one.
    one_by_one = fit_readings(reading_cm, true_cm + 1e-6 * np.random.default_rng(1).random(5_000), MB1242)
    assert len(counted._likelihood) < 500 < len(one_by_one._likelihood)
    assert counted.log_likelihood == pytest.approx(one_by_one.log_likelihood, abs=1e-3)
    for name, value in counted.estimates.items():
        assert value == pytest.approx(one_by_one.estimates[name], abs=0.01 * counted.standard_errors[name])


def test_growth_with_range_comes_back_and_is_kept() -> None:
    sensor = PlainSensor(0.9, 0.03, 0.04, 0.03, 1.2, 0.7, 0.25, sigma_growth_cm_per_m=0.5, missed_growth_per_m=0.4)
    result = fit_readings(*drawn(sensor, 20_000, 4), MB1242, growth=True)
    assert set(result.estimates) >= GROWTHS
    recovered(result, sensor)
    assert result.parameters.missed_growth_per_m == result.estimates["missed_growth_per_m"]


@pytest.mark.slow
def test_the_error_of_growth_is_what_it_scatters_by() -> None:
    rng = np.random.default_rng(31)
    grid, expected_cm = ReadingGrid(20, 765), np.linspace(100.0, 600.0, 600)
    found, errors = [], []
    for _ in range(60):
        sigma_cm = np.hypot(1.0, 0.01 * expected_cm)
        result = fit_readings(
            np.rint(expected_cm + sigma_cm * rng.standard_normal(600)), expected_cm, grid, growth=True
        )
        found.append(result.estimates["sigma_growth_cm_per_m"])
        errors.append(result.standard_errors["sigma_growth_cm_per_m"])
    # A standard deviation of 60 is known to 9 %.
    assert np.median(errors) == pytest.approx(np.std(found, ddof=1), rel=0.3)
    assert np.mean(found) == pytest.approx(1.0, abs=0.05)


def test_growth_that_is_not_there_is_left_out() -> None:
    result = fit_readings(*drawn(ROUGH, 20_000, 5), MB1242, growth=True)
    assert not GROWTHS & set(result.estimates)
    assert result.parameters.sigma_growth_cm_per_m == result.parameters.missed_growth_per_m == 0.0
    one_range = fit_readings(*drawn(ROUGH, 5_000, 5, np.array([300.0])), MB1242, growth=True)
    assert not GROWTHS & set(one_range.estimates)


def test_another_sensors_grid_and_codes() -> None:
    sensor = PlainSensor(
        0.85, 0.05, 0.06, 0.04, 0.8, 0.9, 0.4,
        minimum_cm=2.0, maximum_cm=401.0, step_cm=0.5, no_echo_cm=401.0,
    )  # fmt: skip
    grid = ReadingGrid(2.0, 401.0, 0.5, saturates=True)
    rng = np.random.default_rng(6)
    true_cm = rng.uniform(10.0, 350.0, 20_000)
    recovered(fit_readings(sensor.readings(true_cm.tolist(), 6), true_cm, grid), sensor)


def test_ranges_at_which_nothing_is_heard_count_as_missed() -> None:
    rng = np.random.default_rng(7)
    true_cm = np.where(rng.random(20_000) < 0.2, np.inf, rng.uniform(40.0, 500.0, 20_000))
    recovered(fit_readings(ROUGH.readings(true_cm.tolist(), 7), true_cm, MB1242), ROUGH)


def test_a_weight_of_nothing_has_an_upper_limit() -> None:
    clean = PlainSensor(1.0, 0.0, 0.0, 0.0, 1.6, 0.5)
    result = fit_readings(*drawn(clean, 5_000, 8), MB1242)
    assert set(result.at_bound) == {"short", "missed", "random"}
    assert set(result.not_identified) == {"short_rate_per_m", "saturated_fraction"}
    assert result.parameters.weights.hit == 1.0
    for name in ("missed", "random"):
        low, high = result.interval(name)
        # None of n: the likelihood drops by 1.92 at about 1.92 / n.
        assert low == 0.0
        assert 1.8 / 5_000 < high < 2.5 / 5_000
    assert result.interval("hit") == pytest.approx((1.0 - 1.92 / 5_000, 1.0), abs=1e-5)
    assert result.interval("saturated_fraction") == (0.0, 1.0)
    assert math.isnan(result.standard_errors["missed"])


def test_a_few_of_a_kind_have_an_interval_that_is_not_symmetric() -> None:
    reading_cm, true_cm = drawn(PlainSensor(1.0, 0.0, 0.0, 0.0, 1.6, 0.5), 5_000, 9)
    reading_cm[:3] = 765.0
    low, high = fit_readings(reading_cm, true_cm, MB1242).interval("missed")
    # Likelihood-ratio limits of a Poisson mean with 3 seen: 0.75 and 7.75.
    assert (5_000 * low, 5_000 * high) == pytest.approx((0.75, 7.75), rel=0.05)


def test_readings_that_never_differ_bound_the_spread_from_above() -> None:
    result = fit_readings(np.full(500, 300.0), np.full(500, 300.0), MB1242)
    assert result.estimates["sigma_cm"] < 0.2
    low, high = result.interval("sigma_cm")
    assert low == pytest.approx(0.01)
    assert 0.1 < high < 0.25


def test_pit_is_uniform_for_the_right_model_and_not_for_a_wrong_one() -> None:
    reading_cm, true_cm = drawn(ROUGH, 20_000, 10)
    fitted = fit_readings(reading_cm, true_cm, MB1242)
    fresh = drawn(ROUGH, 20_000, 11)
    rng = np.random.default_rng(12)
    assert p_value(fitted, *fresh) > 0.01
    same = goodness_of_fit(fitted, reading_cm, true_cm, rng)
    assert sum(same.pit_histogram) == 20_000
    # 19 degrees of freedom; six parameters were fitted to these readings and take as many.
    chi_square = sum((count - 1000) ** 2 / 1000 for count in same.pit_histogram)
    lower, upper = stats.chi2.sf(chi_square, [13, 19])
    assert same.chi_square_p_value == pytest.approx(lower)
    assert lower > 0.01
    assert same.note.startswith("The 6 parameters were fitted to the same readings")
    assert f"between {lower:.2g} and {upper:.2g}." in same.note
    wider = drawn(PlainSensor(**{**vars(ROUGH), "sigma_cm": 1.8}), 20_000, 13)
    assert p_value(fitted, *wider) < 1e-3
    assert np.isnan(pit_values(fitted, [300.5], [300.0], rng)).all()
    # From centimetres to metres and back: the float next to 255 is 255 all the same.
    assert MB1242.nearest([0.01 * 255.0 * 100.0 + 1e-12]).tolist() == [255.0]


def test_a_fit_that_has_not_converged_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    def stays(value_of: Any, slopes_of: Any, start: Any, *_: Any, **__: Any) -> Any:
        return start, *value_of(start)

    monkeypatch.setattr("msp_lab.mixture_fit.likelihood.maximise", stays)
    with pytest.raises(FitError, match="does not converge"):
        fit_readings(*drawn(ROUGH, 5_000, 10), MB1242)


GOOD_CM = np.tile([298.0, 299.0, 300.0, 301.0, 302.0], 40)
TRUE_CM = np.full(200, 300.0)


@pytest.mark.parametrize(
    ("reading_cm", "true_cm", "message"),
    [
        (GOOD_CM[:30], TRUE_CM[:30], r"found 30 readings, expected at least 50; take more"),
        (np.full(200, 765.0), TRUE_CM, r"nothing but codes for 'no echo' in 200 readings"),
        (GOOD_CM, np.full(200, 100.0), r"hits with a spread of .* do the ranges belong to these readings"),
    ],
)
def test_what_cannot_be_fitted_is_refused_in_a_line(
    reading_cm: NDArray[np.float64], true_cm: NDArray[np.float64], message: str
) -> None:
    with pytest.raises(FitError, match=message):
        fit_readings(reading_cm, true_cm, MB1242)


def test_the_mixture_of_a_measured_lidar() -> None:
    """Beams against a map that was made of the same scans, so that the hits' share and spread are flattered."""
    with gzip.open(measured_data("carmen-fhw/fhw-pairs-derived.csv.gz"), "rt") as file:
        columns = np.genfromtxt(file, delimiter=",", names=True)
    grid = ReadingGrid(minimum_cm=40, maximum_cm=5105, resolution_cm=5)
    measured_cm = 100.0 * columns["measured_m"]
    # 51.05 m is no echo, and 13 of 40,000 say 51.10.
    reading_cm = np.where(measured_cm > 5102.5, 5105.0, grid.nearest(measured_cm))
    expected_cm = 100.0 * columns["expected_m"]
    # The mean of the hits: they read 2.9 cm far.
    expected_cm += 2.9
    result = fit_readings(reading_cm, expected_cm, grid)
    assert result.estimates["short"] == pytest.approx(0.129, abs=0.002)
    assert result.estimates["missed"] == pytest.approx(0.007, abs=0.0005)
    # What reads short here hardly gets rarer with range.
    assert result.interval("short_rate_per_m")[1] < 0.03
    assert result.interval("saturated_fraction") == (0.0, 0.0)
    assert p_value(result, reading_cm, expected_cm) < 1e-6


@pytest.mark.parametrize("seed", [2, 23, *slow(154, 198, 217, 288, 685)])
def test_awkward_sensors_are_fitted_at_least_as_well_as_by_the_truth(seed: int) -> None:
    """Few readings, hits that read 255, kinds of reading that hardly occur; 800 seeds were tried by hand."""
    rng = np.random.default_rng(seed)
    weights = rng.dirichlet([8.0, 0.4, 0.4, 0.4])
    readings = int(10 ** rng.uniform(1.8, 4.0))
    sensor = PlainSensor(*(*weights, *(10.0 ** rng.uniform([-1.0, -1.0], [1.0, 0.7])), rng.random()))
    kind = rng.integers(4)
    true_cm = (
        rng.uniform(25.0, 700.0, readings),
        np.full(readings, rng.uniform(30.0, 500.0)),
        np.full(readings, 254.7),
        rng.choice([60.0, 120.0, 300.0], readings),
    )[kind]
    reading_cm = np.array(sensor.readings(true_cm.tolist(), seed))
    result = fit_readings(reading_cm, true_cm, MB1242, growth=bool(rng.integers(2)))
    truth = {
        "weights": dict(zip(("hit", "short", "missed", "random"), weights / weights.sum(), strict=True)),
        "sigma_cm": sensor.sigma_cm,
        "short_rate_per_m": sensor.short_rate_per_m,
        "saturated_fraction": sensor.second_share,
    }
    of_truth = ReadingModel(MixtureParameters.model_validate(truth), 20, 765)
    log_p = of_truth.log_prob(reading_cm, {"true_range_cm": true_cm})
    assert result.log_likelihood > log_p.sum() - 0.01
    for name, value in result.estimates.items():
        low, high = result.interval(name)
        assert low - 1e-9 <= value <= high + 1e-9
