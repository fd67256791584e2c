"""The second generator's scoring, and a case through both commands."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from evaluation.second_hand.command import make_result
from evaluation.second_hand.draws import same
from evaluation.second_hand.score import failures, outcome, table
from evaluation.shares import wilson

pytestmark = pytest.mark.slow
"""Tests of the tests' own tools."""

LATE: dict[str, Any] = {
    "title": "latency",
    "names": ["latency"],
    "channel": "bias",
    "variable": "",
    "size": 0.1,
    "between_runs": False,
}
COLD = {**LATE, "title": "air_not_corrected", "names": ["air_temperature"], "between_runs": True}
GROWS = {**LATE, "title": "spread_with_range", "names": ["spread_with_range"], "channel": "spread"}
RIPPLE = {**LATE, "title": "ripple", "names": [], "variable": "time_s"}


def truth(kind: str, *effects: dict[str, Any]) -> dict[str, Any]:
    return {"kind": kind, "seed": 1, "effects": list(effects), "base": {"correlation": 0.5}, "runs": 8}


def found(
    *names: str, curves: Sequence[tuple[str, str]] = (), calibration: Sequence[str] = (), crash: str = ""
) -> dict[str, Any]:
    """Each name is one named effect; words after the first are its alternatives."""
    effects = [{"name": each.split()[0], "alternatives": each.split()[1:], "parameters": {}} for each in names]
    return {
        "effects": effects,
        "curves": [{"channel": channel, "variables": [column], "formula": ""} for channel, column in curves],
        "calibration": list(calibration),
        "verdict": "",
        "crash": crash,
    }


@pytest.mark.parametrize(
    ("hidden", "reported", "expected"),
    [
        (truth("null:0"), found(), "clean"),
        (truth("null:0"), found("stale"), "wrong name"),
        (truth("null:0"), found(crash="gap: LinAlgError"), "crash"),
        (truth("one:10", LATE), found("latency"), "exact"),
        (truth("one:10", LATE), found("motion_during_ping latency"), "exact"),
        (truth("one:10", LATE), found("latency", "stale"), "wrong name"),
        (truth("one:10", LATE), found(), "nothing"),
        (truth("one:10", LATE), found(curves=[("bias", "throttle")]), "other curve"),
        (truth("one:10", GROWS), found(calibration=["sigma_growth_cm_per_m"]), "calibrated"),
        (truth("one:10", LATE), found(calibration=["sigma_growth_cm_per_m"]), "nothing"),
        (truth("two:10", LATE, COLD), found("latency", "air_temperature"), "exact"),
        (truth("two:10", LATE, COLD), found("latency"), "missing"),
        (truth("two:10", LATE, COLD), found("latency air_temperature", "latency"), "exact"),
        (truth("two:10", LATE, COLD), found("latency", "latency"), "wrong name"),
        (truth("unknown:10", RIPPLE), found(curves=[("bias", "time_s")]), "exact"),
        (truth("unknown:10", RIPPLE), found(curves=[("spread", "time_s")]), "other curve"),
        (truth("unknown:10", RIPPLE), found("stale", curves=[("bias", "time_s")]), "wrong name"),
    ],
)
def test_outcomes(hidden: dict[str, Any], reported: dict[str, Any], expected: str) -> None:
    assert outcome(hidden, reported) == expected


def test_wilson_interval_is_that_of_the_textbook() -> None:
    # Newcombe 1998, Stat. Med. 17, 857, table I: 81 of 263 is 0.2553 to 0.3662, 0 of 20 is 0 to 0.1611.
    assert wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=1e-4)
    assert wilson(0, 20) == pytest.approx((0.0, 0.1611), abs=1e-4)


def test_effects_between_runs_have_a_row_of_their_own() -> None:
    results = [
        {"truth": truth("one:10", LATE), "found": found("latency")},
        {"truth": truth("one:10", COLD), "found": found("stale")},
    ]
    lines = table(results).splitlines()
    assert lines[2].startswith("| one:10 | 1 | 1 |")
    assert lines[3].startswith("| one:10 (between runs) | 1 | 0 |")
    assert "air_not_corrected" in failures(results)
    assert "latency" not in failures(results)


def test_a_case_goes_through_both_commands(tmp_path: Path) -> None:
    # 20 standard errors of a thermometer that shows too much: the class is known, and so is its size.
    result = make_result("one:20", 22)
    assert result["truth"]["effects"][0]["title"] == "thermometer_bias"
    assert result["found"]["crash"] == ""
    names = {name for each in result["found"]["effects"] for name in (each["name"], *each["alternatives"])}
    assert {"thermometer_offset", "range_scale"} & names
    assert result["outcome"] in ("exact", "wrong name")


@pytest.mark.parametrize(
    ("one", "other", "alike"),
    [
        (found(), found(), True),
        (found("bend range_scale"), found("range_scale bend"), True),
        (found("bend"), found("range_scale bend"), True),
        (found("bend", "stale"), found("bend"), False),
        (found("bend", "stale"), found("stale", "latency"), False),
        (found(curves=[("bias", "time_s")]), found(), False),
        (found("bend", curves=[("bias", "time_s")]), found("bend", curves=[("bias", "time_s")]), True),
    ],
)
def test_two_draws_of_the_splits_say_the_same(one: dict[str, Any], other: dict[str, Any], alike: bool) -> None:
    assert same(one, other) == same(other, one) == alike
