"""Tables of late readings hold what their kind says, and are scored by the delay that was hidden."""

import numpy as np
import pytest

from evaluation.delay.command import scored
from evaluation.delay.flights import draw_flights, draw_log, late
from evaluation.delay.generator import case
from evaluation.second_hand.generator import FINAL_SEED, SeedError


def error_cm(kind: str, seed: int, delay_s: float) -> float:
    """Median error of the readings against the logged ranges so long before them, of a log without pauses."""
    runs, errors = case(kind, seed).runs, []
    for run in np.unique(runs["run"]):
        rows = runs["run"] == run
        path_cm = np.interp(runs["time_s"][rows] - delay_s, runs["time_s"][rows], runs["true_range_cm"][rows])
        errors.append(np.abs(runs["reading_cm"][rows] - path_cm))
    return float(np.median(np.concatenate(errors)))


@pytest.mark.parametrize(("kind", "seed"), [("late", 4), ("early", 2), ("late", 10)])
def test_readings_are_of_the_range_that_was_there(kind: str, seed: int) -> None:
    delay_s = case(kind, seed).truth["delay_ms"] / 1e3
    assert error_cm(kind, seed, delay_s) < 3.0
    assert error_cm(kind, seed, delay_s) < min(error_cm(kind, seed, delay_s + each) for each in (-0.1, 0.1))


def test_a_table_without_a_delay_is_of_its_stamps_and_a_seed_gives_one_table() -> None:
    assert case("none", 2).truth["delay_ms"] == 0.0
    assert error_cm("none", 2, 0.0) < error_cm("none", 2, 0.1)
    for name, column in case("with", 3).runs.items():
        np.testing.assert_array_equal(column, case("with", 3).runs[name])
    with pytest.raises(SeedError):
        case("late", FINAL_SEED)


def test_a_shift_is_that_of_the_path_and_not_of_the_table() -> None:
    rng = np.random.default_rng(1)
    rows = draw_flights(rng, draw_log(rng, 2000))
    np.testing.assert_array_equal(late(rows, 0.0).true_cm, rows.true_cm)
    np.testing.assert_array_equal(late(rows, 0.25).true_cm, rows.range_before(0.25))


def test_the_score_counts_names_and_the_interval() -> None:
    parameters = {"delay_ms": {"value": 110.0, "low": 95.0, "high": 125.0}}
    latency = {"name": "latency", "alternatives": [], "parameters": parameters}
    slip = {"name": "cycle_slip", "alternatives": ["heavy_tails"], "parameters": {}}
    truth = {"delay_ms": 100.0, "effects": [{"title": "stale", "names": ["stale"]}]}
    found = scored(truth, {"effects": [latency, slip], "curves": []})
    assert found == {
        "late": True, "second": False, "wrong": 1, "curves": 0, "off_ms": 10.0, "half_ms": 15.0, "covered": True,
    }  # fmt: skip
    assert scored({"delay_ms": 0.0, "effects": []}, {"effects": [latency], "curves": []})["wrong"] == 1
