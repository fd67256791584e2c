"""Tables of slow data and of flights with words hide what their kind says, at ten standard errors of least squares."""

import numpy as np
import pytest

from evaluation.days.command import make_result, outcome
from evaluation.days.generator import KINDS, case

EFFECT = {"title": "battery", "names": [], "variable": "battery", "size": 1.0}


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
    assert outcome({"effects": hidden}, said(names, curves)) == expected


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
    if kind == "words:surface":
        grass = made.runs["surface"] == "grass"
        step_cm = np.median(error_cm[hit & grass]) - np.median(error_cm[hit & ~grass])
        assert step_cm == pytest.approx(made.truth["effects"][0]["size"], abs=0.5)


@pytest.mark.parametrize(
    ("kind", "seed"),
    [
        pytest.param("slow:day", 1, id="a swing with the hour is a day cycle, and no temperature or warm-up"),
        pytest.param("words:battery", 4, id="ten runs with five batteries differ by the battery, and not at random"),
        pytest.param("words:surface", 3, id="three runs of thirteen over grass"),
        pytest.param("words:null", 7, id="runs that differ at random by 1 mm"),
    ],
)
def test_the_workflow_names_what_lasts_as_long_as_a_run(kind: str, seed: int) -> None:
    row = make_result(kind, seed)
    assert row["outcome"] == "right", row["found"]
