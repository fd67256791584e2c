"""Speed of the mixture's fit: seconds, growth with the number of readings, and against general-purpose optimisers.

Two sets of rows: every true range another one, so that no two rows are alike, which is the hard case and what the goals
are held to; and a campaign's few ranges, where equal rows can be counted, which is part of the time. The general
optimiser gets the same likelihood, with this fit's own exact gradients, and a start as good as a person's guess.
"""

import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit

from evaluation import CONFIGS
from evaluation.benchmarks.figure import Figures, at_least, at_most, figure
from msp_lab.mixture_fit.fit import fit_readings
from msp_lab.mixture_fit.grid import ReadingGrid
from msp_lab.mixture_fit.likelihood import Likelihood
from msp_lab.mixture_fit.parameters import Numbers
from msp_range.reading_model.mixture import ReadingModel
from msp_range.reading_model.sensor_model import MixtureParameters, SensorModel, load_sensor_model

_Array = NDArray[np.float64]

READINGS = 1_000_000
FEWER = 10_000
NUMERIC = 100_000
"""Readings of the comparison with differences for gradients, which takes ten times as long."""
REPEATS = 5
SENSOR = CONFIGS / "sensors" / "mb1242.yaml"
START = np.array([-3.0, -3.0, -3.0, np.log(3.0), np.log(0.01), 0.0])
"""Log odds of the weights, 3 cm, 1/m, and half of the codes saturated."""


def run() -> Figures:
    """Measure the fit, and the same by `scipy.optimize.minimize`."""
    sensor = load_sensor_model(SENSOR)
    grid = ReadingGrid.of(sensor)
    rng = np.random.default_rng(1)
    true_cm = rng.uniform(15.0, 790.0, READINGS)
    reading_cm = ReadingModel.of(sensor).sample({"true_range_cm": true_cm}, rng)
    campaign_cm = 40.0 + 20.0 * rng.integers(0, 24, READINGS)
    campaign_reading_cm = ReadingModel.of(sensor).sample({"true_range_cm": campaign_cm}, rng)

    hard_s, hard_cpu_s = _median_s(lambda: fit_readings(reading_cm, true_cm, grid))
    best = fit_readings(reading_cm, true_cm, grid).log_likelihood
    likelihood = Likelihood(grid, reading_cm, true_cm, np.ones(READINGS), np.zeros(READINGS))
    general_cpu_s = min(
        _general_cpu_s(_with_gradient(likelihood), READINGS, best, method, has_gradient=True)
        for method in ("L-BFGS-B", "TNC", "SLSQP", "BFGS")
    )
    _, fewer_cpu_s = _median_s(lambda: fit_readings(reading_cm[:FEWER], true_cm[:FEWER], grid))
    campaign_s, _ = _median_s(lambda: fit_readings(campaign_reading_cm, campaign_cm, grid))

    few_reading_cm, few_true_cm = reading_cm[:NUMERIC], true_cm[:NUMERIC]
    few_best = fit_readings(few_reading_cm, few_true_cm, grid).log_likelihood
    _, few_cpu_s = _median_s(lambda: fit_readings(few_reading_cm, few_true_cm, grid))
    numeric_cpu_s = _general_cpu_s(_plain(sensor, few_reading_cm, few_true_cm), NUMERIC, few_best)

    return [
        figure("fit_1e6_all_ranges_differ", hard_s, "s for 1,000,000 readings, four densities, codes", at_most(3.0)),
        figure("fit_1e6_campaign", campaign_s, "s for 1,000,000 readings at 24 ranges, given uncounted", at_most(3.0)),
        figure(
            "fit_cost_growth",
            hard_cpu_s / fewer_cpu_s,
            "times the time for 100 times the readings (10,000 to 1,000,000)",
            at_most(100),
        ),
        figure(
            "fit_1e6_over_general",
            general_cpu_s / hard_cpu_s,
            "times faster than the best of four scipy methods with exact gradients, ranges differ",
            at_least(5),
        ),
        figure(
            "fit_1e5_over_numeric",
            numeric_cpu_s / few_cpu_s,
            "times faster than L-BFGS-B on ReadingModel.log_prob, 100,000 readings",
            at_least(5),
        ),
    ]


def _median_s(work: Callable[[], Any]) -> tuple[float, float]:
    """Median time, and median time of the processor: ratios of it do not depend on who else uses the machine."""
    taken_s, cpu_s = [], []
    for _ in range(REPEATS):
        start_s, start_cpu_s = time.perf_counter(), time.process_time()
        work()
        taken_s.append(time.perf_counter() - start_s)
        cpu_s.append(time.process_time() - start_cpu_s)
    return statistics.median(taken_s), statistics.median(cpu_s)


def _general_cpu_s(
    negative: Callable[[_Array], Any],
    readings: int,
    best: float,
    method: str = "L-BFGS-B",
    *,
    has_gradient: bool = False,
) -> float:
    """Time of the processor for one `minimize`; infinite where it ends short of the maximum."""
    options = {"ftol": 1e-13, "gtol": 1e-8} if method == "L-BFGS-B" else {}
    start_s = time.process_time()
    found = minimize(negative, START, jac=has_gradient, method=method, options=options)
    taken_s = time.process_time() - start_s
    # A tenth of a log-likelihood unit is less than half a standard error.
    return taken_s if -found.fun * readings > best - 0.1 else np.inf


def _with_gradient(likelihood: Likelihood) -> Callable[[_Array], tuple[float, _Array]]:
    def negative(x: _Array) -> tuple[float, _Array]:
        short, missed, random, log_sigma, log_rate, logit = x
        numbers = Numbers(log_sigma, short, missed, random, 100.0 * np.exp(log_rate), expit(logit), 0.0, 0.0)
        value, (gradient, _) = likelihood.slopes(np.array(numbers))
        by = Numbers(*gradient)
        by_odds = by.log_odds_short, by.log_odds_missed, by.log_odds_random
        by_saturated = by.saturated * numbers.saturated * (1.0 - numbers.saturated)
        by_x = np.array([*by_odds, by.log_sigma, by.rate * numbers.rate, by_saturated])
        return -value / likelihood.readings, -by_x / likelihood.readings

    return negative


def _plain(sensor: SensorModel, reading_cm: _Array, true_cm: _Array) -> Callable[[_Array], float]:
    def negative(x: _Array) -> float:
        shares = np.exp([0.0, *x[:3]])
        parameters = {
            "weights": dict(zip(("hit", "short", "missed", "random"), shares / shares.sum(), strict=True)),
            "sigma_cm": np.exp(x[3]),
            "short_rate_per_m": 100.0 * np.exp(x[4]),
            "saturated_fraction": expit(x[5]),
        }
        model = ReadingModel(MixtureParameters.model_validate(parameters), sensor.minimum_cm, sensor.maximum_cm)
        return -float(model.log_prob(reading_cm, {"true_range_cm": true_cm}).mean())

    return negative
