"""A delay's value: the likelihood is that of an offset of each run, correlated and white noise, and holds its value."""

from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray

from msp_lab.gap.prepared import Prepared
from msp_lab.gap.refit import refit
from msp_lab.gap.shift_value import MEMORIES, SHARES, Hits, with_shifts
from msp_range.reading_model.rows import Base
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_sim.effects.path import with_path
from msp_sim.model.model import Model, Term, make_term
from tests.support.measured import MODEL

Array = NDArray[np.float64]
PLAIN = Model.of(load_sensor_model(MODEL).model_copy(update={"effects": ()}))


def late(delay_ms: float) -> Term:
    return make_term("latency", None, {"delay_ms": delay_ms})


def errors(rng: np.random.Generator, time_s: Array, memory_s: float) -> Array:
    """An autoregressive process with a standard deviation of 3 cm, on bursts of 10 cm, and white noise of 1 cm."""
    keep = np.exp(-np.diff(time_s, prepend=time_s[0] - 0.1) / memory_s)
    slow, found = 0.0, np.empty(time_s.size)
    for i, each in enumerate(keep):
        slow = each * slow + np.sqrt(1.0 - each**2) * rng.standard_normal()
        found[i] = 3.0 * slow
    return np.asarray(found + rng.standard_normal(time_s.size))


def flown(delay_s: float, runs: int = 4, n: int = 600) -> Prepared:
    """Runs at 10 readings a second in which the vehicle hovers for most of the time, with an offset of each of 4 cm."""
    rng = np.random.default_rng(8)
    time_s = np.cumsum(0.1 + 0.01 * rng.random(n))
    parts = []
    for _ in range(runs):
        knots_s = np.arange(-2.0, time_s[-1] + 10.0, 8.0)
        legs_cm = 200.0 + 80.0 * np.where(rng.random(knots_s.size) < 0.4, rng.choice([-1.0, 1.0], knots_s.size), 0.0)
        true_cm, there_cm = (np.interp(at, knots_s, legs_cm) for at in (time_s, time_s - delay_s))
        parts.append((true_cm, np.round(there_cm + errors(rng, time_s, 1.5) + 4.0 * rng.standard_normal())))
    contexts = {
        "time_s": np.tile(time_s, runs),
        "run": np.repeat([f"run {i}" for i in range(runs)], n),
        "true_range_cm": np.concatenate([true_cm for true_cm, _ in parts]),
    }
    contexts["range_rate_cm_s"] = np.gradient(contexts["true_range_cm"], contexts["time_s"])
    return Prepared.of(PLAIN, with_path(contexts), np.concatenate([reading_cm for _, reading_cm in parts]), 0.1)


@pytest.mark.parametrize("start_ms", [-100.0, 120.0, 400.0])
def test_a_delay_is_found_next_to_noise_that_neighbours_have_in_common(start_ms: float) -> None:
    (found,) = with_shifts(flown(0.25), Base(log_sigma=0.7), [late(start_ms)])
    assert found.values["delay_ms"] == pytest.approx(250.0, abs=40.0)
    (again,) = with_shifts(flown(0.25), Base(log_sigma=0.7), [found])
    assert again.values["delay_ms"] == pytest.approx(found.values["delay_ms"], abs=3.0)


def test_a_value_that_is_as_likely_stays_and_another_one_goes() -> None:
    prepared = flown(0.25)
    (found,) = with_shifts(prepared, Base(log_sigma=0.7), [late(100.0)])
    near = found.values["delay_ms"] + 3.0
    assert with_shifts(prepared, Base(log_sigma=0.7), [late(near)])[0].values == {"delay_ms": near}
    assert with_shifts(prepared, Base(log_sigma=0.7), [late(near + 150.0)])[0].values["delay_ms"] < near + 60.0


def test_a_fit_ends_at_no_value_that_is_not_likely() -> None:
    prepared = flown(0.25)
    fit = refit(prepared, [late(400.0)], Base(log_sigma=0.7, correlation=0.5))
    assert with_shifts(prepared, fit.base, fit.effects) == fit.effects
    own = fit.names.index("0.delay_ms")
    assert fit.covariance()[own, own] > 0.0
    assert fit.effects[0].values["delay_ms"] == pytest.approx(250.0, abs=40.0)


def test_the_likelihood_is_that_of_the_whole_covariance() -> None:
    rng = np.random.default_rng(2)
    steps, starts = rng.uniform(0.5, 3.0, 39), np.zeros(40, dtype=bool)
    starts[[0, 15]] = True
    sigma_cm, error_cm = rng.uniform(1.0, 2.0, 40), 3.0 * rng.standard_normal(40)
    hits = Hits(np.arange(40), starts, steps, sigma_cm)
    series = np.cumsum(starts)
    at = np.concatenate([[0.0], np.cumsum(steps)])

    def whole(share: float, memory: float) -> float:
        apart = np.abs(np.subtract.outer(at, at)) / memory
        covariance = share * np.exp(-apart) * np.equal.outer(series, series) + (1.0 - share) * np.eye(40)
        inverse = np.linalg.inv(covariance)
        own, ones = error_cm / sigma_cm, np.stack([(series == each) / sigma_cm for each in (1, 2)], axis=1)
        left = own - ones @ np.linalg.solve(ones.T @ inverse @ ones, ones.T @ inverse @ own)
        size = float(np.linalg.slogdet(covariance)[1])
        return 0.5 * (40 * float(np.log(left @ inverse @ left / 40)) + size)

    tried = zip(product(SHARES, MEMORIES), hits.noises(), strict=True)
    for numbers, noise in tried:
        assert noise.loss(error_cm) == pytest.approx(whole(*numbers), rel=1e-9)


def test_of_few_hits_a_value_stays_as_it_is() -> None:
    prepared = flown(0.25, runs=1, n=20)
    (found,) = with_shifts(prepared, Base(), [late(77.0)])
    assert found.values == {"delay_ms": 77.0}
