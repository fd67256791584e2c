"""Correlated noise: what is drawn has the correlation, the score follows the draw, and slopes are derivatives."""

from dataclasses import replace

import numpy as np
import pytest

from msp_lab.gap.prepared import BASE, Prepared, channel_slopes
from msp_lab.gap.refit import fit_base
from msp_lab.gap.runs import dependence, previous, spacing_s
from msp_range.reading_model.rows import Base
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_sim.model.history import History
from msp_sim.model.model import Model
from msp_sim.model.rows import log_prob
from msp_sim.model.streams import RandomStreams
from tests.support.measured import MODEL as FILE

SENSOR = load_sensor_model(FILE).model_copy(update={"effects": ()})


def model(correlation: float, sigma_cm: float = 3.0) -> Model:
    mixture = SENSOR.reading_model.model_copy(
        update={"correlation": correlation, "correlation_spacing_s": 0.1, "sigma_cm": sigma_cm}
    )
    return Model.of(SENSOR.model_copy(update={"reading_model": mixture}))


def flown(runs: int = 8, n: int = 300) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(5)
    return {
        "true_range_cm": rng.uniform(100.0, 400.0, runs * n),
        "throttle": rng.uniform(0.2, 0.9, runs * n),
        "run": np.repeat([f"run {i}" for i in range(runs)], n),
        "time_s": np.tile(0.1 * np.arange(n), runs),
    }


def residuals(reading_cm: np.ndarray, contexts: dict[str, np.ndarray]) -> np.ndarray:
    off_cm: np.ndarray = reading_cm - contexts["true_range_cm"]
    return np.where(np.abs(off_cm - np.median(off_cm)) < 15.0, off_cm - np.median(off_cm), np.nan)


def test_drawn_errors_have_the_correlation_and_the_same_spread() -> None:
    contexts = flown(runs=20)
    given, plain = (residuals(model(each).sample(contexts, np.random.default_rng(1)), contexts) for each in (0.7, 0.0))
    for off_cm, wanted in ((given, 0.7), (plain, 0.0)):
        off = off_cm.reshape(20, 300)
        pairs = np.isfinite(off[:, 1:]) & np.isfinite(off[:, :-1])
        measured = np.corrcoef(off[:, 1:][pairs], off[:, :-1][pairs])[0, 1]
        assert measured == pytest.approx(wanted, abs=0.04)
    assert np.nanstd(given) == pytest.approx(np.nanstd(plain), rel=0.05)


def test_correlation_decays_with_time_and_is_lost_between_runs() -> None:
    contexts = flown(runs=20)
    contexts["time_s"] = contexts["time_s"] * 2.0
    off = residuals(model(0.7).sample(contexts, np.random.default_rng(2)), contexts).reshape(20, 300)
    pairs = np.isfinite(off[:, 1:]) & np.isfinite(off[:, :-1])
    assert np.corrcoef(off[:, 1:][pairs], off[:, :-1][pairs])[0, 1] == pytest.approx(0.49, abs=0.05)
    ends = np.isfinite(off[1:, 0]) & np.isfinite(off[:-1, -1])
    assert abs(np.corrcoef(off[1:, 0][ends], off[:-1, -1][ends])[0, 1]) < 0.6


def test_readings_one_at_a_time_are_those_of_a_table() -> None:
    contexts = flown(runs=1, n=60)
    whole = model(0.8).sample(contexts, np.random.default_rng(3))
    streams = RandomStreams(np.random.default_rng(3))
    single = [
        model(0.8).sample({name: column[i : i + 1] for name, column in contexts.items()}, streams)[0] for i in range(60)
    ]
    assert np.array_equal(whole, single)


def test_the_score_prefers_the_correlation_that_was_drawn() -> None:
    contexts = flown(runs=10)
    reading_cm = model(0.6).sample(contexts, np.random.default_rng(4))
    scores = {each: float(model(each).log_prob(reading_cm, contexts).sum()) for each in (0.0, 0.3, 0.6, 0.8)}
    assert max(scores, key=lambda each: scores[each]) == 0.6
    assert scores[0.6] - scores[0.0] > 300.0


def test_the_probabilities_after_the_readings_before_sum_to_one() -> None:
    contexts = flown(runs=1, n=6)
    first_cm = model(0.7).sample(contexts, np.random.default_rng(6))
    codes = np.arange(SENSOR.minimum_cm, SENSOR.maximum_cm + 1, dtype=float)
    total = 0.0
    for code in codes:
        trial = first_cm.copy()
        trial[-1] = code
        total += float(np.exp(model(0.7).log_prob(trial, contexts)[-1]))
    assert total == pytest.approx(1.0, abs=1e-9)


def test_slopes_are_the_derivatives_of_the_log_likelihood() -> None:
    contexts = flown(runs=4)
    reading_cm = model(0.6).sample(contexts, np.random.default_rng(7))
    prepared = Prepared.of(model(0.5), contexts, reading_cm)
    here = channel_slopes(prepared.at(Base(), []), reading_cm)
    for k in (0, 1, 7):
        steps = (Base(**{BASE[k]: step}) for step in (1e-5, -1e-5))
        up, down = (log_prob(prepared.at(step, []), reading_cm).sum() for step in steps)
        assert here.by[:, k].sum() == pytest.approx((up - down) / 2e-5, rel=2e-3, abs=0.05), BASE[k]


def test_a_template_counts_against_what_the_hit_before_carries_over() -> None:
    contexts = flown(runs=4)
    reading_cm = model(0.6).sample(contexts, np.random.default_rng(8))
    prepared = Prepared.of(model(0.6), contexts, reading_cm)
    rows = prepared.at(Base(), [])
    here = channel_slopes(rows, reading_cm)
    template = contexts["throttle"] ** 2
    for channel, moved in ((0, "centre_cm"), (1, "sigma_cm")):
        up, down = (
            replace(rows, centre_cm=rows.centre_cm + sign * 1e-5 * template)
            if moved == "centre_cm"
            else replace(rows, sigma_cm=rows.sigma_cm * np.exp(sign * 1e-5 * template))
            for sign in (1.0, -1.0)
        )
        numeric = (log_prob(up, reading_cm) - log_prob(down, reading_cm)) / 2e-5
        same = np.isclose(here.score(channel, template), numeric, rtol=1e-3, atol=1e-3)
        assert same.mean() > 0.98, moved


def test_a_fit_finds_the_correlation_and_leaves_independent_residuals() -> None:
    contexts = flown(runs=10)
    reading_cm = model(0.6).sample(contexts, np.random.default_rng(9))
    unit = np.repeat(np.arange(10), 300)
    plain = fit_base(Prepared.of(model(0.0), contexts, reading_cm))
    assert dependence(plain.here.by[:, 0], unit, contexts["time_s"]).dependent
    fit = fit_base(Prepared.of(model(0.0), contexts, reading_cm, spacing_s(contexts)))
    error = 1.0 / np.sqrt(fit.at.information[7, 7])
    assert abs(fit.base[7] - 0.6) < 4.0 * error < 0.2
    assert not dependence(fit.here.by[:, 0], unit, contexts["time_s"]).dependent


def test_history_goes_by_time_sensor_and_run() -> None:
    contexts = {
        "run": np.array(["a", "b", "a", "a", "b"]),
        "time_s": np.array([0.3, 0.0, 0.1, 0.2, 0.5]),
    }
    history = History.of(contexts, 5, 0.5, 0.1)
    before, age_s = history.before(np.array([True, True, True, False, True]))
    assert before.tolist() == [2, -1, -1, 2, 1]
    assert age_s[[0, 3, 4]] == pytest.approx([0.2, 0.1, 0.5])
    assert history.correlation_over(np.array([0.1, 0.2])) == pytest.approx([0.5, 0.25])
    reading_cm = np.array([5.0, 7.0, 6.0, 8.0, 9.0])
    assert previous({**contexts, "true_range_cm": reading_cm}, reading_cm)[[0, 3, 4]].tolist() == [8.0, 6.0, 7.0]
