"""Each measured set end to end: no crash, no forbidden name, and what is required is found.

What does not hold yet is in `known.csv`, by cause; a line there that no longer happens has to be taken out.
"""

import csv
from pathlib import Path
from typing import Any

import pytest

from tests.real.names import Line
from tests.real.run import Outcome, compare_names, found_in, run_set
from tests.real.sets import SETS, MeasuredSet
from tests.support.data import measured_data

KNOWN = Path(__file__).parent / "known.csv"


def known_problems(name: str) -> set[str]:
    """What does not hold yet for a set."""
    with KNOWN.open(encoding="utf-8", newline="") as file:
        return {row["what"] for row in csv.DictReader(file) if row["set"] == name}


def problems(outcome: Outcome) -> set[str]:
    """What does not hold, in the words of `known.csv`."""
    if outcome.failure:
        return {"failure"}
    return {f"forbidden {each}" for each in outcome.forbidden} | {f"missing {each}" for each in outcome.missing}


@pytest.mark.slow
@pytest.mark.parametrize("measured", SETS, ids=lambda each: each.name)
def test_set_end_to_end(measured: MeasuredSet, tmp_path: Path) -> None:
    files = [measured_data(each) for each in (*measured.readings, *measured.bench)]
    outcome = run_set(measured, files[0].parent.parent, tmp_path)
    now, known = problems(outcome), known_problems(measured.name)
    assert not now - known, f"{outcome.command}\n{outcome.failure}"
    assert not known - now, f"these hold now: take them out of {KNOWN.name} and of docs/real_data.md"


def test_indistinguishable_names_are_right_if_one_is() -> None:
    lines = [
        Line("required", ("latency",), "delay_ms 300 480", ""),
        Line("allowed", ("range_scale",), "", ""),
        Line("forbidden", ("stale",), "", ""),
    ]
    gap: dict[str, Any] = {
        "effects": [
            {"name": "thermometer_offset", "verdict": "indistinguishable", "alternatives": [{"name": "range_scale"}]},
            {"name": "stale", "verdict": "named", "alternatives": []},
            {"name": "multipath", "verdict": "rejected"},
        ],
        "unknown": [{"channel": "bias", "variables": ["time_s"]}],
        "calibration": [{"name": "sigma_cm"}],
    }
    assert compare_names(found_in(gap), lines) == (("stale",), ("latency",))
    gap["effects"][1] |= {"name": "latency", "parameters": {"delay_ms": {"value": 363.0}}}
    assert compare_names(found_in(gap), lines) == ((), ())
    gap["effects"][0]["alternatives"] = [{"name": "humidity"}]
    assert compare_names(found_in(gap), lines) == (("humidity/thermometer_offset",), ())
    gap["effects"][1]["parameters"]["delay_ms"]["value"] = 36.3
    assert compare_names(found_in(gap), lines)[1] == ("latency",)
