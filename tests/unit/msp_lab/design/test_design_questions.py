"""What a gap run left open becomes questions with their answers."""

from dataclasses import replace
from pathlib import Path

import pytest

from msp_lab.design.questions import NONE, Answer, open_questions
from msp_lab.gap.findings import Alternative, FoundEffect, GapFindings, Kind, NotTestable, PossibleCause
from msp_range.yaml_file import ConfigError

HERE = Path("gaps/june")


EXPLAINED = GapFindings("explained", rows=1000, runs=10)


def effect(name: str, verdict: Kind, *alternatives: str) -> FoundEffect:
    others = tuple(Alternative(each, 1.5) for each in alternatives)
    return FoundEffect(name, verdict, {}, 0.1, 5.0, others, doubt="it may be 0")


def test_effects_that_cannot_be_told_apart_are_one_question() -> None:
    (question,) = open_questions(
        replace(EXPLAINED, effects=(effect("range_scale", "indistinguishable", "bend", "bend"),)), HERE
    )
    assert question.answers == (Answer("range_scale"), Answer("bend"))
    assert "true_range_cm" in question.columns
    assert "bend 1.5" in question.why


def test_a_suggested_effect_may_be_none() -> None:
    (question,) = open_questions(replace(EXPLAINED, effects=(effect("multipath", "suggested"),)), HERE)
    assert question.answers == (Answer("multipath"), NONE)
    assert question.why == "it may be 0"


def test_an_absorbed_number_asks_for_the_column_that_did_not_vary() -> None:
    cause = PossibleCause("sigma_cm", "rotor_noise", "throttle", True, "")
    (question,) = open_questions(replace(EXPLAINED, verdict="absorbed", causes=(cause,)), HERE)
    assert question.answers == (Answer("rotor_noise"), NONE)
    assert question.why == "sigma_cm changed, and throttle hardly varied"


def test_what_could_not_be_tested_is_asked_only_where_something_has_no_name() -> None:
    humid = NotTestable("humidity", ("humidity_pct",))
    (question,) = open_questions(replace(EXPLAINED, verdict="partly explained", not_testable=(humid,)), HERE)
    assert question.why == "humidity_pct is not recorded"
    with pytest.raises(ConfigError, match=r"nothing to decide \(explained\); next: fly model.yaml"):
        open_questions(replace(EXPLAINED, not_testable=(humid,), next_step="fly model.yaml"), HERE)


def test_a_run_that_did_not_end_is_refused() -> None:
    with pytest.raises(ConfigError, match="run 'msp-lab add gaps/june' first"):
        open_questions(replace(EXPLAINED, verdict=None), HERE)
