"""Readings that a candidate explains count as one where they come in a clump, in time or at few values."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from msp_lab.gap.clumps import clumping
from msp_lab.gap.problem import Problem, _replaces_base, first_state, with_candidate
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_sim.model.model import Model
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


def nats(name: str, contexts: dict[str, NDArray[np.generic]], reading_cm: Array) -> tuple[float, float]:
    """Evidence for an effect, and its plain gain in likelihood."""
    problem = Problem.of(MODEL, contexts, reading_cm, RUN.astype(np.intp), np.random.default_rng(1))
    state = first_state(problem)
    candidate = next(each for each in problem.candidates if each.key[0] == name)
    fit = with_candidate(problem, state.fit, candidate, 0.1)
    return problem.candidate_nats(state.fit, fit, candidate, False), fit.log_likelihood - state.fit.log_likelihood


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


def test_a_fault_that_leaves_the_hits_as_they_are_is_not_what_all_readings_have() -> None:
    contexts, reading_cm = flight(8)
    contexts["true_range_cm"] = np.asarray(contexts["true_range_cm"], dtype=float) / 2.0
    problem = Problem.of(MODEL, contexts, np.rint(reading_cm / 2.0), RUN.astype(np.intp), np.random.default_rng(1))
    for name, replaced in (("lost_high_byte", True), ("coarse_rounding", False)):
        candidate = next(each for each in problem.candidates if each.key[0] == name)
        fit = replace(problem.base, effects=(candidate.at(0.999),))
        assert _replaces_base(problem, fit, candidate) == replaced
