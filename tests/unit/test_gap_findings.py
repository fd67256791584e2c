"""gap.json is written and read back, and says what it has to; the verdict follows from its numbers."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from msp_lab.gap.findings import (
    Alternative,
    CalibrationFinding,
    FittedValue,
    FoundEffect,
    Gap,
    GapFindings,
    Measure,
    NotTestable,
    OddsMeasures,
    PathStep,
    ReadingsFile,
    Settings,
    UnknownEffect,
)
from msp_lab.gap.findings_file import as_json, from_json, read_findings, write_findings
from msp_lab.gap.verdict import verdict
from msp_range.yaml_file import ConfigError
from msp_sim.model.model import load_model
from tests.support.known import known
from tests.support.measured import MODEL

GIVEN = load_model(MODEL)
ONE = Measure(1.0, 1.0, 1.1, 1.0, 1.05)
EFFECT = FoundEffect(
    "range_scale",
    "indistinguishable",
    {"scale_pct": FittedValue(0.8, 0.7, 0.9, "%")},
    0.4,
    12.0,
    (Alternative("thermometer_offset", 1.2, 0.99),),
    "vary air_temperature_c by 6 C",
)


def gap(after: float, bias_cm: float = 0.05, low: float = 0.001) -> Gap:
    return Gap(
        Measure(0.5, after, 0.003, low, 0.01),
        Measure(2.0, bias_cm, 0.06, 0.01, 0.1),
        ONE,
        OddsMeasures(ONE, ONE, ONE, ONE),
    )


FULL = GapFindings(
    "explained",
    rows=2000,
    runs=10,
    gap=gap(0.002),
    effects=(EFFECT,),
    unknown=(
        UnknownEffect("bias", ("throttle",), "1.2 throttle^2", 0.1, ((0.0, 0.0, -0.1, 0.1), (1.0, 1.2, 1.0, 1.4))),
    ),
    calibration=(CalibrationFinding("sigma_cm", "sigma_cm is 2.1", 1.9, 2.1, 2.0, 2.2, "cm"),),
    not_testable=(NotTestable("humidity", ("humidity_pct",)),),
    seconds=1.5,
    selection_path=(PathStep("", 0.5, -2.8), PathStep("range_scale", 0.002, -2.3)),
    sources=(ReadingsFile("flight.csv", "ab" * 32, 2000),),
    settings=Settings("model.yaml", map=("a=b",)),
)


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    write_findings(FULL, tmp_path)
    assert read_findings(tmp_path) == FULL


def test_the_keys_are_those_that_were_promised() -> None:
    content = json.loads(as_json(FULL))
    promised = {
        "verdict",
        "rows",
        "runs",
        "gap",
        "effects",
        "unknown",
        "calibration",
        "not_testable",
        "slices",
        "seconds",
    }
    assert promised <= set(content)
    assert {"nats_per_reading", "bias_cm", "spread_ratio", "odds"} == set(content["gap"])
    measure = {"before", "after", "noise_floor", "low", "high"}
    assert set(content["gap"]["bias_cm"]) == measure
    assert set(content["gap"]["odds"]) == {"short", "missed", "random", "code"}
    assert set(content["gap"]["odds"]["code"]) == measure
    assert {"name", "verdict", "parameters", "gain_nats", "z", "alternatives", "experiment"} <= set(
        content["effects"][0]
    )
    assert set(content["effects"][0]["parameters"]["scale_pct"]) == {"value", "low", "high", "unit"}
    assert {"channel", "variables", "formula", "gain_nats"} <= set(content["unknown"][0])


def test_what_is_not_known_is_null_and_never_nan() -> None:
    text = as_json(replace(FULL, gap=gap(float("nan"))))
    assert "NaN" not in text
    assert known(from_json(text).gap).nats_per_reading.after is None


@pytest.mark.parametrize(("content", "message"), [(None, "no such file"), ("{", "gap.json"), ("[1]", "not written by")])
def test_a_file_that_is_not_one_of_findings_is_reported(tmp_path: Path, content: str | None, message: str) -> None:
    if content is not None:
        (tmp_path / "gap.json").write_text(content, encoding="utf-8")
    with pytest.raises(ConfigError, match=message):
        read_findings(tmp_path)


@pytest.mark.parametrize(
    ("effects", "gap_left", "expected"),
    [
        ((), gap(0.002), "absorbed"),
        ((), gap(0.4), "unexplained"),
        ((EFFECT,), gap(0.002), "explained"),
        ((EFFECT,), gap(0.2), "partly explained"),
        ((EFFECT,), gap(0.2, low=0.0), "explained"),
        ((), gap(0.2, low=0.0), "unexplained"),
        ((EFFECT,), gap(0.49), "unexplained"),
        ((EFFECT,), gap(0.002, bias_cm=0.5), "partly explained"),
    ],
)
def test_verdicts(effects: tuple[FoundEffect, ...], gap_left: Gap, expected: str) -> None:
    found = replace(FULL, verdict=None, effects=effects, unknown=(), gap=gap_left)
    assert verdict(found, GIVEN) == expected


def test_what_was_added_and_made_it_worse_explains_nothing() -> None:
    """A gap that was within the bound before is no excuse for one that is not any more."""
    worse = Gap(
        Measure(0.002, 0.3, 0.003, 0.2, 0.4), Measure(0.05, 0.9, 0.06, 0.5, 1.1), ONE, OddsMeasures(ONE, ONE, ONE, ONE)
    )
    found = replace(FULL, verdict=None, unknown=(), gap=worse)
    assert verdict(found, GIVEN) == "unexplained"
    assert verdict(replace(found, effects=()), GIVEN) == "nothing missing"


def test_a_gap_that_random_variation_may_make_decides_nothing() -> None:
    """Of sixty readings the bounds are narrower than what two draws of one model differ by."""
    small = replace(gap(0.1), nats_per_reading=Measure(0.1, 0.1, 0.14), bias_cm=Measure(0.05, 0.05, 0.06))
    found = replace(FULL, verdict=None, effects=(), unknown=(), gap=small)
    suggested = replace(EFFECT, verdict="suggested", alternatives=())
    assert verdict(found, GIVEN) == "undecided"
    assert verdict(replace(found, effects=(suggested,)), GIVEN) == "undecided"
    large = replace(small, nats_per_reading=Measure(0.25, 0.25, 0.14))
    assert verdict(replace(found, gap=large), GIVEN) == "unexplained"


def test_an_effect_that_leaves_no_more_than_random_variation_explains_all() -> None:
    """A gap of 0.21 of which 0.16 is left, where tables of the model itself show up to 0.36."""
    left = replace(gap(0.16), nats_per_reading=Measure(0.21, 0.16, 0.36))
    assert verdict(replace(FULL, verdict=None, unknown=(), gap=left), GIVEN) == "explained"
    biased = replace(left, bias_cm=Measure(2.0, 0.5, 0.06))
    assert verdict(replace(FULL, verdict=None, unknown=(), gap=biased), GIVEN) == "partly explained"


def test_nothing_is_missing_only_where_nothing_was() -> None:
    """A gap that the base's own numbers close is absorbed in them; one that was closed before is none."""
    found = replace(FULL, verdict=None, effects=(), unknown=())
    assert verdict(found, GIVEN) == "absorbed"
    closed = replace(gap(0.002), nats_per_reading=Measure(0.002, 0.002, 0.003), bias_cm=Measure(0.05, 0.05, 0.06))
    assert verdict(replace(found, gap=closed), GIVEN) == "nothing missing"
    suggested = replace(EFFECT, verdict="suggested", alternatives=())
    assert verdict(replace(found, gap=closed, effects=(suggested,)), GIVEN) == "nothing missing"
