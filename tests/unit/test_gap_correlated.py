"""Correlated noise through the gap workflow's parts: simulated replicates, measures, and the picture of the PIT."""

from unittest.mock import Mock

import numpy as np
import pytest
from numpy.typing import NDArray

from msp_lab.gap.cells import partitions
from msp_lab.gap.evidence import evidence_nats
from msp_lab.gap.measures import HeldOutReadings, measure, places, replicates
from msp_lab.gap.problem import Problem
from msp_lab.gap.screen import replicate
from msp_range.arrays import numbered
from msp_range.reading_model.rows import Base
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_sim.model.model import Model
from msp_sim.model.sampler import Sampler
from tests.support.measured import MODEL as FILE

SENSOR = load_sensor_model(FILE).model_copy(update={"effects": ()})
Columns = dict[str, NDArray[np.generic]]


def model(correlation: float) -> Model:
    numbers = {"correlation": correlation, "correlation_spacing_s": 0.1, "sigma_cm": 3.0}
    return Model.of(SENSOR.model_copy(update={"reading_model": SENSOR.reading_model.model_copy(update=numbers)}))


def flown(runs: int, n: int) -> Columns:
    return {
        "true_range_cm": np.full(runs * n, 250.0),
        "run": np.repeat([f"run {i}" for i in range(runs)], n),
        "time_s": np.tile(0.1 * np.arange(n), runs),
    }


def correlation_of(one_cm: NDArray[np.float64], other_cm: NDArray[np.float64]) -> float:
    """Correlation of the errors where both are hits."""
    hits = (np.abs(one_cm - 250.0) < 12.0) & (np.abs(other_cm - 250.0) < 12.0)
    return float(np.corrcoef(one_cm[hits], other_cm[hits])[0, 1])


def test_copies_of_the_contexts_are_series_of_their_own() -> None:
    rng = np.random.default_rng(1)
    drawn = replicate(model(0.9), Base(), (), flown(1, 500), rng, rows=2000, spacing_s=0.1)
    copies = drawn.reading_cm.reshape(4, 500)
    assert correlation_of(copies[:, 1:].ravel(), copies[:, :-1].ravel()) == pytest.approx(0.9, abs=0.05)
    # Were they at the same times, the second reading of a time would repeat the error of the first.
    assert abs(correlation_of(copies[1:].ravel(), copies[:-1].ravel())) < 0.3
    assert drawn.rows.history is not None
    _, age_s = drawn.rows.history.before(np.ones(2000, dtype=bool))
    assert (age_s > 1e6).sum() == 4


def test_thinned_contexts_keep_their_neighbours() -> None:
    rng = np.random.default_rng(2)
    drawn = replicate(model(0.9), Base(), (), flown(1, 20_000), rng, rows=2000, spacing_s=0.1)
    assert drawn.rows.history is not None
    steps_s = np.diff(drawn.rows.history.time_s)
    assert np.mean(steps_s < 0.11) > 0.98
    # Spread over the whole flight of 2,000 s.
    assert drawn.rows.history.time_s[[0, -1]].tolist() == pytest.approx([0.0, 1999.9], abs=100.0)
    assert correlation_of(drawn.reading_cm[1:], drawn.reading_cm[:-1]) == pytest.approx(0.9, abs=0.05)


def test_a_model_uses_the_columns_that_order_readings_where_its_noise_is_correlated() -> None:
    order = {"run", "sensor", "time_s"}
    assert model(0.5).columns - model(0.0).columns == order
    # Two runs, their readings in turn: neighbours in the table are not neighbours in time.
    contexts = flown(2, 2000)
    mixed = np.arange(4000).reshape(2, 2000).T.ravel()
    turns = {name: column[mixed] for name, column in contexts.items()}
    drawn_cm = model(0.9).sample(turns, np.random.default_rng(3)).reshape(2000, 2)
    assert abs(correlation_of(drawn_cm[:, 0], drawn_cm[:, 1])) < 0.3
    assert correlation_of(drawn_cm[1:, 0], drawn_cm[:-1, 0]) == pytest.approx(0.9, abs=0.05)


def test_the_emulated_sensor_draws_correlated_noise() -> None:
    contexts = flown(1, 400)
    whole_cm = model(0.9).sample(contexts, np.random.default_rng(4))
    sampler = Sampler(model(0.9), np.random.default_rng(4))
    single_cm = [sampler.sample_one({name: column[i] for name, column in contexts.items()}) for i in range(400)]
    assert single_cm == whole_cm.tolist()


@pytest.mark.parametrize("correlation", [0.0, 0.9])
def test_an_offset_is_measured_in_centimetres_also_where_noise_is_correlated(correlation: float) -> None:
    """The reading before has the same offset, so that it must not be asked."""
    contexts = flown(40, 100)
    reading_cm = model(correlation).sample(contexts, np.random.default_rng(5))
    reading_cm = np.where(reading_cm < 700.0, reading_cm + 4.0, reading_cm)
    unit = np.repeat(np.arange(40), 100)
    table = HeldOutReadings(reading_cm, contexts, unit)
    parts = partitions(contexts, pairs=False)
    drawn = replicates(model(correlation), table, parts, 4, np.random.default_rng(6))
    found = measure(model(correlation), table, parts, drawn)
    assert found.numbers["bias_cm"].value == pytest.approx(4.0, abs=0.5)


def test_the_noise_floor_is_that_of_correlated_readings() -> None:
    """Four tables of the model itself: an error that lasts looks like a bias of what lasts as long."""
    contexts = flown(40, 100) | {"throttle": np.tile(np.repeat(np.linspace(0.2, 0.9, 10), 10), 40)}
    unit = np.repeat(np.arange(40), 100)
    parts = partitions(contexts, pairs=False)
    found = []
    for seed in range(4):
        reading_cm = model(0.9).sample(contexts, np.random.default_rng(seed))
        table = HeldOutReadings(reading_cm, contexts, unit)
        drawn = replicates(model(0.9), table, parts, 10, np.random.default_rng(6))
        found.append(measure(model(0.9), table, parts, drawn).numbers["bias_cm"].value)
        # The mean of 4,000 such readings has a standard error of 0.2 cm, and that of a tenth of them 0.5 cm.
        assert 0.4 < drawn.noise_floor["bias_cm"] < 1.0
    assert np.median(found) < 0.8


def test_the_pit_of_the_right_model_is_even_and_without_memory() -> None:
    contexts = flown(10, 300)
    reading_cm = model(0.9).sample(contexts, np.random.default_rng(7))
    table = HeldOutReadings(reading_cm, contexts, np.repeat(np.arange(10), 300))
    transformed = places(model(0.9), table, np.random.default_rng(8))
    counts, _ = np.histogram(transformed, 10, (0.0, 1.0))
    assert ((counts - 300.0) ** 2 / 300.0).sum() < 27.9  # the 99.9 % quantile of 9 degrees of freedom
    off = transformed.reshape(10, 300) - 0.5
    assert abs(np.mean(off[:, 1:] * off[:, :-1])) < 0.2 / 12.0


@pytest.mark.parametrize("correlation", [0.0, 0.7])
def test_a_gain_counts_less_where_neighbours_still_follow_each_other(correlation: float) -> None:
    """Of n readings (1 - r) / (1 + r) n say as much about a mean, where the fit leaves a correlation r."""
    contexts = flown(6, 200)
    contexts["true_range_cm"] = 200.0 + np.tile(np.linspace(0.0, 100.0, 200), 6)
    drawn_cm = model(correlation).sample(contexts, np.random.default_rng(1))
    rng = np.random.default_rng(2)
    problem = Problem.of(model(0.0), contexts, 1.01 * drawn_cm, numbered(contexts["run"]), rng)
    scale = next(each for each in problem.candidates if each.effect.name == "range_scale")
    larger = problem.refit([scale.at(scale.neutral)], problem.base.base)
    whole = evidence_nats(problem.at_correlation(problem.base, larger.base), larger, problem.unit)
    counted = problem.evidence_nats(problem.base, larger, by_run=True)
    left = problem.dependence(larger).lag_correlation
    assert (left > 0.1) == (correlation > 0.0)
    assert counted == pytest.approx(whole * (1.0 - left) / (1.0 + left) if correlation else whole)


def test_an_offset_of_one_run_is_judged_by_what_the_others_scatter_and_not_by_runs_as_well() -> None:
    contexts = flown(9, 200)
    off_cm = np.where(contexts["run"] == "run 3", 1.5, 0.0)
    reading_cm = np.rint(model(0.0).sample(contexts, np.random.default_rng(1)) + off_cm)
    problem = Problem.of(model(0.0), contexts, reading_cm, numbered(contexts["run"]), np.random.default_rng(2))
    (candidate,) = [each for each in problem.candidates if each.key == ("session_offset", "run 3")]
    larger = problem.refit([candidate.at(1.5)], problem.base.base)
    counted = problem.candidate_nats(problem.base, larger, candidate, by_run=True)
    assert counted == problem.candidate_nats(problem.base, larger, candidate, by_run=False)
    assert counted > 8.0


def test_blocks_that_stand_in_for_runs_are_said_to_be_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """What one run has passed once is in few of them: a scatter over them is known from all."""
    contexts = flown(6, 200)
    reading_cm = model(0.0).sample(contexts, np.random.default_rng(1))
    unit, asked = numbered(contexts["run"]), Mock(return_value=1.0)
    monkeypatch.setattr("msp_lab.gap.problem.evidence_nats", asked)
    for run, of_blocks in ((contexts["run"], False), (np.full(1200, "flight"), True)):
        problem = Problem.of(model(0.0), {**contexts, "run": run}, reading_cm, unit, np.random.default_rng(2))
        problem.evidence_nats(problem.base, problem.base, by_run=True)
        assert asked.call_args.args[-1] is of_blocks
