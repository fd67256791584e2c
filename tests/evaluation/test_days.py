"""Tables of slow data and of flights with words hide what their kind says, at ten standard errors of least squares."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from evaluation.days.command import make_result, outcome
from evaluation.days.generator import KINDS, case

MOVES: dict[str, Callable[[dict[str, Any]], Any]] = {
    "slow:scale": lambda of: of["true_range_cm"] / 100.0,
    "slow:temperature": lambda of: of["true_range_cm"] * (np.sqrt(295.65 / (of["air_temperature_c"] + 273.15)) - 1.0),
    "slow:day": lambda of: np.cos((of["time_s"] / 3600.0 - 14.4) * np.radians(15.0)),
    "slow:supply": lambda of: of["supply_v"] - 5.0,
    "slow:warm_up": lambda of: np.exp(-of["uptime_s"] / 900.0),
    "words:surface": lambda of: np.where(of["surface"] == "grass", 1.0, 0.0),
    "words:battery": lambda of: of["battery"] - 3.0,
    "words:scale": lambda of: of["true_range_cm"] / 100.0,
    "weather:session": lambda of: np.where(
        of["run"] == np.unique(of["run"])[(np.unique(of["run"]).size - 1) // 2], 1, 0
    ),
    "weather:scale": lambda of: of["true_range_cm"] / 100.0,
}
"""By what a size of 1 moves each reading [cm]."""
EFFECT = {"title": "battery", "names": [], "variable": "battery", "size": 1.0}


def size_of(runs: dict[str, Any], truth: dict[str, Any], moves: Callable[[dict[str, Any]], Any]) -> tuple[float, float]:
    """Size of an effect and its standard error by the hits, next to an offset and another scale: least squares."""
    error_cm = runs["reading_cm"] - runs["true_range_cm"]
    columns = np.column_stack([moves(runs), np.ones(error_cm.size), runs["true_range_cm"]])
    columns = columns[:, : 2 if truth["kind"].endswith("scale") else 3]
    known, right = np.zeros((columns.shape[1], columns.shape[1])), np.zeros(columns.shape[1])
    for run in np.unique(runs["run"]):
        rows = np.flatnonzero((runs["run"] == run) & (np.abs(error_cm) < 12.0))
        apart_s = np.abs(runs["time_s"][rows, None] - runs["time_s"][rows])
        noise_cm2 = truth["lasting_cm"] ** 2 * np.exp(-apart_s / truth["lasts_s"]) + truth["of_runs_cm"] ** 2
        noise_cm2 += truth["white_cm"] ** 2 * np.eye(rows.size)
        known += columns[rows].T @ np.linalg.solve(noise_cm2, columns[rows])
        right += columns[rows].T @ np.linalg.solve(noise_cm2, error_cm[rows])
    return float(np.linalg.solve(known, right)[0]), float(np.sqrt(np.linalg.inv(known)[0, 0]))


def said(names: list[str], curves: list[str]) -> dict[str, object]:
    return {
        "crash": "",
        "effects": [{"name": name, "alternatives": []} for name in names],
        "curves": [{"channel": "bias", "variables": [name]} for name in curves],
    }


@pytest.mark.parametrize(
    ("hidden", "names", "curves", "expected"),
    [
        ([], [], [], "right"),
        ([], ["range_scale"], [], "wrong"),
        ([EFFECT], [], [], "nothing"),
        ([EFFECT], [], ["battery"], "right"),
        ([EFFECT], ["run_offsets"], [], "wrong"),
        ([EFFECT], ["run_offsets"], ["battery"], "more"),
        ([EFFECT | {"names": ["range_scale"]}], ["range_scale"], [], "right"),
    ],
)
def test_what_is_said_is_compared_with_what_was_hidden(
    hidden: list[dict[str, object]], names: list[str], curves: list[str], expected: str
) -> None:
    assert outcome({"effects": hidden, "of_runs_cm": 0.2}, said(names, curves)) == expected


def test_offsets_of_runs_that_are_there_may_be_named() -> None:
    assert outcome({"effects": [], "of_runs_cm": 0.5}, said(["run_offsets"], [])) == "right"
    assert outcome({"effects": [], "of_runs_cm": 0.5}, said(["run_offsets"], ["battery"])) == "wrong"


@pytest.mark.parametrize("kind", KINDS)
def test_an_effect_is_in_the_readings(kind: str) -> None:
    made, again = case(kind, 5), case(kind, 5)
    for name, column in made.runs.items():
        np.testing.assert_array_equal(column, again.runs[name])
    error_cm = made.runs["reading_cm"] - made.runs["true_range_cm"]
    hit = np.abs(error_cm) < 12.0
    lasts_cm = float(np.hypot(made.truth["white_cm"], made.truth["lasting_cm"]))
    assert np.std(error_cm[hit]) == pytest.approx(lasts_cm, rel=0.5)
    assert 0.97 < hit.mean() < 0.999
    assert np.std(made.bench["reading_cm"] - made.bench["true_range_cm"]) > 0.0
    for effect in made.truth["effects"]:
        size, error = size_of(made.runs, made.truth, MOVES[kind])
        assert error == pytest.approx(abs(effect["size"]) / 10.0, rel=0.1)
        assert size == pytest.approx(effect["size"], abs=3.0 * error)


@pytest.mark.parametrize(
    ("kind", "seed"),
    [
        pytest.param("slow:day", 1, id="a swing with the hour is a day cycle, and no temperature or warm-up"),
        pytest.param("words:battery", 4, id="ten runs with five batteries differ by the battery, and not at random"),
        pytest.param("words:surface", 3, id="three runs of thirteen over grass"),
        pytest.param("words:surface", 107, id="four runs over grass, one of which is farthest off"),
        pytest.param("words:surface", 314, id="three runs of fourteen, which differ by more than what is left"),
        pytest.param("slow:null", 106, id="a slow process whose neighbours look independent"),
        pytest.param("words:null", 7, id="runs that differ at random by 1 mm"),
    ],
)
def test_the_workflow_names_what_lasts_as_long_as_a_run(kind: str, seed: int) -> None:
    row = make_result(kind, seed)
    assert row["outcome"] == "right", row["found"]
