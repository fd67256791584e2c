"""Readings that a candidate explains count as one where they come in a clump, in time or at few values."""

import numpy as np
import pytest
from numpy.typing import NDArray

from msp_lab.gap.evidence import clumping
from msp_lab.gap.problem import Problem, with_candidate
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_sim.model.model import Model, Term, make_term
from tests.support.measured import MODEL as FILE
from tests.support.measured import sensor

Array = NDArray[np.float64]
MODEL = Model.of(load_sensor_model(FILE).model_copy(update={"effects": ()}))
N = 1200
RUN = np.arange(N) * 4 // N


def test_independent_readings_are_no_clumps_however_rare() -> None:
    rng = np.random.default_rng(1)
    for share in (0.5, 0.05, 0.005):
        explained = rng.random(N) < share
        slope = np.where(explained, 1.0 / share, 0.0) - 1.0
        assert clumping(slope, RUN) == pytest.approx(1.0, abs=0.5)


def test_a_clump_counts_as_one() -> None:
    slope = np.full(N, -0.1)
    for first in (100, 500, 900):
        slope[first : first + 32] = 0.9 * (N - 96) / (9 * 96)
    assert 15.0 < clumping(slope, RUN) < 40.0


def test_readings_of_one_value_are_one_clump() -> None:
    """What comes at three values of forty is no grid, however it is spread over time."""
    rng = np.random.default_rng(2)
    value = rng.integers(0, 40, N).astype(float)
    assert clumping(np.where(value < 3.0, 12.0, -1.0), RUN, value) > 10.0
    assert clumping(rng.standard_normal(N), RUN, value) == 1.0


def nats(
    name: str,
    contexts: dict[str, NDArray[np.generic]],
    reading_cm: Array,
    model: Model = MODEL,
    others: tuple[Term, ...] = (),
) -> tuple[float, float]:
    """Evidence for an effect next to others, and its plain gain in likelihood."""
    problem = Problem.of(model, contexts, reading_cm, RUN.astype(np.intp), np.random.default_rng(1))
    before = problem.refit(others, problem.base.base)
    candidate = next(each for each in problem.candidates if each.key[0] == name)
    fit = with_candidate(problem, before, candidate, 0.1)
    return problem.candidate_nats(before, fit, candidate, False), fit.log_likelihood - before.log_likelihood


def flight(seed: int) -> tuple[dict[str, NDArray[np.generic]], Array]:
    rng = np.random.default_rng(seed)
    true_cm = rng.uniform(120.0, 350.0, N)
    contexts: dict[str, NDArray[np.generic]] = {
        "true_range_cm": true_cm,
        "time_s": 0.1 * np.arange(N),
        "run": np.array(["a", "b", "c", "d"])[RUN],
    }
    return contexts, np.array(sensor().readings(true_cm.tolist(), seed))


def test_an_object_that_stood_there_twice_is_no_clutter() -> None:
    contexts, reading_cm = flight(3)
    rng = np.random.default_rng(4)
    at_25_cm = np.rint(25.0 + rng.standard_normal(N))
    always = rng.random(N) < 0.08
    twice = np.isin(np.arange(N) // 48, (5, 17))
    evidence, gained = nats("clutter", contexts, np.where(always, at_25_cm, reading_cm))
    assert evidence > 0.7 * gained > 60.0
    evidence, gained = nats("clutter", contexts, np.where(twice, at_25_cm, reading_cm))
    assert gained > 100.0
    assert evidence < 0.1 * gained


def test_other_surfaces_at_few_values_are_no_grid() -> None:
    """Readings of a wall behind, which happen to be whole inches; and a table that is in inches."""
    contexts, reading_cm = flight(5)
    behind = np.random.default_rng(6).random(N) < 0.1
    inches = np.rint(np.floor(reading_cm / 2.54 + 0.5) * 2.54)
    surfaces = np.random.default_rng(7).choice([450.0, 455.0, 460.0, 462.0], N)
    evidence, gained = nats("coarse_rounding", contexts, np.where(behind, surfaces, reading_cm))
    assert gained > 10.0
    assert evidence < 0.3 * gained
    evidence, gained = nats("coarse_rounding", contexts, inches)
    assert evidence > 0.7 * gained > 100.0


def in_millimetres(seed: int) -> tuple[dict[str, NDArray[np.generic]], Array]:
    """Readings of which half are held; a tenth are surfaces behind, in stretches, and differ by millimetres there."""
    rng = np.random.default_rng(seed)
    contexts, _ = flight(seed)
    reading_cm = np.round(np.asarray(contexts["true_range_cm"]) + 1.9 * rng.standard_normal(N), 1)
    for first in rng.choice(N // 10, 12, replace=False) * 10:
        surface_cm = rng.uniform(440.0, 470.0)
        reading_cm[first : first + 10] = np.round(surface_cm + rng.normal(0.0, 0.15, 10), 1)
    for i in (np.flatnonzero(rng.random(N - 1) < 0.5) + 1).tolist():
        reading_cm[i] = reading_cm[i - 1]
    contexts["previous_reading_cm"] = np.concatenate([[np.nan], reading_cm[:-1]])
    return contexts, reading_cm


@pytest.mark.slow
def test_values_that_nearly_come_again_are_no_grid() -> None:
    """Some are multiples of a step by chance, next to a value that is not: between the steps there are as many."""
    model, held, most = MODEL.with_step(0.1), (make_term("stale", None, {"share": 0.5}),), 0.0
    for seed in range(10, 16):
        contexts, reading_cm = in_millimetres(seed)
        evidence, gained = nats("coarse_rounding", contexts, reading_cm, model, held)
        assert evidence < 3.0
        most = max(most, gained)
    assert most > 10.0
    rounded = np.random.default_rng(9).random(N) < 0.3
    contexts, reading_cm = in_millimetres(9)
    inches = np.where(rounded, np.round(2.54 * np.rint(reading_cm / 2.54), 1), reading_cm)
    evidence, _ = nats("coarse_rounding", contexts, inches, model, held)
    assert evidence > 100.0


def test_one_jump_of_the_truth_makes_no_repeats() -> None:
    """The truth jumps by an error of its own while the reading is as it was: one reading, however improbable."""
    contexts, _ = flight(12)
    contexts["true_range_cm"] = 200.0 + 0.1 * np.arange(N)
    noise_cm = 1.9 * np.random.default_rng(12).standard_normal(N)
    reading_cm = np.rint(np.asarray(contexts["true_range_cm"]) + noise_cm)
    np.asarray(contexts["true_range_cm"])[650] -= 150.0
    reading_cm[650] = reading_cm[649]
    contexts["previous_reading_cm"] = np.concatenate([[np.nan], reading_cm[:-1]])
    found, gained = nats("stale", contexts, reading_cm)
    assert found <= 5.0 < gained


def test_four_readings_are_no_dead_zone_whatever_they_gain() -> None:
    """All four missed echoes of a table came from near surfaces."""
    contexts, _ = flight(5)
    true_cm = np.linspace(22.0, 350.0, N)[np.random.default_rng(5).permutation(N)]
    contexts["true_range_cm"] = true_cm
    reading_cm = np.rint(true_cm + np.random.default_rng(6).normal(0.0, 1.9, N))
    near = np.flatnonzero(true_cm < 40.0)
    for count, is_named in ((4, False), (12, True)):
        changed = reading_cm.copy()
        changed[near[:: near.size // count][:count]] = 765.0
        evidence, gained = nats("dead_zone_maximum", contexts, changed)
        assert gained > 6.0
        assert (evidence > 6.0) == is_named
