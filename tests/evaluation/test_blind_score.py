"""What counts as right, and how the blind table is counted."""

import json
from pathlib import Path
from typing import Any

import pytest

from evaluation.blind.report import by_mechanism, closed, collect, counts, score
from evaluation.blind.score import accepted_names, judge

pytestmark = pytest.mark.slow

NAMES = accepted_names()
CLOCK = {"mechanism": "slow_clock", "wanted": 10.0, "standard_errors": 10.0}
ANSWER = {"kind": "one", "regime": "iid", "hidden": [CLOCK]}
NAMED: dict[str, Any] = {"name": "range_scale", "verdict": "named", "alternatives": []}
OTHER: dict[str, Any] = {"name": "latency", "verdict": "named", "alternatives": []}


def gap_of(*effects: dict[str, Any], **more: object) -> dict[str, Any]:
    return {"effects": list(effects), **more}


def with_rival(correlation: float | None) -> dict[str, Any]:
    rival = {"name": "range_scale", "correlation": correlation}
    return {"name": "air_temperature", "verdict": "indistinguishable", "alternatives": [rival], "experiment": "vary it"}


def test_a_name_is_right_alone_or_in_a_class() -> None:
    assert judge(ANSWER, gap_of(NAMED), NAMES).exact
    assert judge(ANSWER, gap_of(with_rival(0.99)), NAMES).exact
    assert not judge(ANSWER, gap_of(NAMED, OTHER), NAMES).exact
    assert not judge(ANSWER, gap_of(), NAMES).exact
    assert judge(ANSWER, gap_of(OTHER), NAMES).wrong == ("latency",)
    assert judge(ANSWER, gap_of(OTHER), NAMES).resolved_wrongly
    assert not judge(ANSWER, gap_of(with_rival(0.99)), NAMES).resolved_wrongly
    # A wrong name besides is another matter.
    assert not judge(ANSWER, gap_of(with_rival(0.99), OTHER), NAMES).resolved_wrongly
    assert judge({"kind": "null", "hidden": []}, gap_of(), NAMES).exact


def test_a_class_may_not_hold_what_the_data_separate() -> None:
    """10 sqrt(1 - rho^2) is 3 at rho = 0.954; an unreported correlation is none."""
    assert judge(ANSWER, gap_of(with_rival(-0.96)), NAMES).exact
    for correlation in (0.95, None):
        outcome = judge(ANSWER, gap_of(with_rival(correlation)), NAMES)
        assert outcome.separable == ("range_scale",)
        assert outcome.met == (True,)
        assert not outcome.exact


def test_a_base_parameter_counts_as_reported() -> None:
    exhaust = {"kind": "one", "hidden": [{"mechanism": "exhaust", "wanted": 10.0}]}
    outcome = judge(exhaust, gap_of(calibration=[{"parameter": "missed_growth_per_m"}]), NAMES)
    assert outcome.exact
    assert outcome.reported == ("missed_growth_per_m",)


def test_an_unknown_effect_has_channel_and_variables() -> None:
    fog = {"mechanism": "fog", "wanted": 10.0, "channel": "missed", "variables": ["humidity_pct"]}
    answer = {"kind": "unknown", "hidden": [fog]}
    unknown = {"channel": "missed", "variables": ["humidity_pct"]}
    assert judge(answer, gap_of(unknown=[unknown]), NAMES).found_unknown
    assert not judge(answer, gap_of(unknown=[unknown | {"channel": "bias"}]), NAMES).found_unknown
    assert not judge(answer, gap_of(NAMED, unknown=[unknown]), NAMES).found_unknown
    assert not judge(ANSWER, gap_of(NAMED, unknown=[unknown]), NAMES).exact


def test_a_pair_is_in_one_class_with_its_experiment() -> None:
    answer = ANSWER | {"kind": "confounded", "pair": ["air_not_compensated", "slow_clock"]}
    assert judge(answer, gap_of(with_rival(0.99)), NAMES).both
    assert not judge(answer, gap_of(with_rival(0.99) | {"experiment": ""}), NAMES).both
    assert not judge(answer, gap_of(NAMED | {"experiment": "alone"}), NAMES).both


@pytest.mark.parametrize(
    ("before", "after", "floor", "over_floor", "of_all"),
    [
        (0.030, 0.000, 0.010, 1.0, 1.0),
        (0.030, 0.006, 0.010, 1.0, 0.8),
        (0.030, 0.015, 0.010, 0.75, 0.5),
        (0.030, -0.001, 0.010, 1.0, 1.0),
        (0.005, 0.001, 0.010, None, 0.8),
        (0.030, 0.040, 0.010, -0.5, -1.0 / 3.0),
    ],
)
def test_what_is_closed(before: float, after: float, floor: float, over_floor: float | None, of_all: float) -> None:
    nats: dict[str, float | None] = {"before": before, "after": after, "noise_floor": floor}
    gap = {"nats_per_reading": nats}
    found = judge(ANSWER, gap_of(NAMED, gap=gap), NAMES).closed
    assert found is not None
    assert found.over_floor == (None if over_floor is None else pytest.approx(over_floor))
    assert found.of_all == pytest.approx(of_all)
    nats["after"] = None
    assert judge(ANSWER, gap_of(NAMED, gap=gap), NAMES).closed is None


def test_the_table_counts_what_was_reported(tmp_path: Path) -> None:
    null = {"kind": "null", "regime": "ar1", "hidden": []}
    fog = {"mechanism": "fog", "wanted": 20.0, "channel": "missed", "variables": ["humidity_pct"]}
    gap = {"nats_per_reading": {"before": 0.03, "after": 0.0, "noise_floor": 0.01}}
    tables = [
        (null, gap_of()),
        (null, gap_of(OTHER)),
        (null, gap_of(unknown=[{"channel": "bias", "variables": ["throttle"]}])),
        (ANSWER, gap_of(NAMED, gap=gap)),
        (ANSWER, gap_of(OTHER, gap=gap)),
        ({"kind": "unknown", "regime": "iid", "hidden": [fog]}, gap_of()),
        ({"kind": "three", "regime": "iid", "hidden": [CLOCK, fog | {"mechanism": "gravel"}]}, gap_of(NAMED)),
        (ANSWER, None),
    ]
    for number, (answer, result) in enumerate(tables):
        (tmp_path / "answers").mkdir(exist_ok=True)
        (tmp_path / "answers" / f"{number:04d}.json").write_text(json.dumps(answer), encoding="utf-8")
        if result is not None:
            folder = tmp_path / "tables" / f"{number:04d}" / "gap"
            folder.mkdir(parents=True)
            (folder / "gap.json").write_text(json.dumps(result), encoding="utf-8")
    scored, missing = collect(tmp_path)
    assert missing == ["0007"]
    assert {what: (count, of) for what, count, of in counts(scored)} == {
        "nothing hidden, ar1: a name": (1, 3),
        "nothing hidden, ar1: an unknown curve": (1, 3),
        "one effect, 10 s.e.: exact set": (1, 2),
        "one effect, 10 s.e.: a wrong name": (1, 2),
        "three effects, 20 s.e.: exact set": (0, 1),
        "three effects, 20 s.e.: a wrong name": (0, 1),
        "not in the catalogue, 20 s.e.: called unknown, channel and variable right": (0, 1),
        "not in the catalogue, 20 s.e.: a wrong name": (0, 1),
        "not in the catalogue, 20 s.e.: nothing reported": (1, 1),
        "all tables: a wrong name": (2, 7),
    }
    assert "2 of 2 | 1.000 | 1.000 to 1.000" in closed(scored)[0]
    rows = by_mechanism(scored)
    assert "| one | slow_clock | 10 | 1 | 2 | 1 x latency |" in rows
    assert "| three | gravel | 20 | 0 | 1 | 1 x missed (nothing else) |" in rows
    text = score(tmp_path)
    assert "Without a result, and not counted: 0007" in text
    outcomes = json.loads((tmp_path / "outcomes.json").read_text(encoding="utf-8"))
    assert [each["outcome"]["exact"] for each in outcomes] == [True, False, False, True, False, False, False]
