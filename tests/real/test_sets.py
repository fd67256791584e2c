"""Each measured set end to end: no crash, no forbidden name, and what is required is found.

What does not hold yet is in `known.csv`, by cause; a line there that no longer happens has to be taken out.
"""

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from evaluation.real.columns import read_table
from evaluation.real.names import Line
from evaluation.real.run import Outcome, compare_names, found_in, run_set
from evaluation.real.sets import SETS, MeasuredSet
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


def late_by_what_scatters_least(gap: dict[str, Any], data: Path) -> None:
    """The MB1433: held readings have a name of their own, so the delay of least scatter holds more than the latency."""
    table = read_table(data / "enmt482" / "training1.csv")
    time_s, true_cm, reading_cm = table["time"], 100.0 * table["range"], 100.0 * table["sonar2"]
    near = (np.abs(reading_cm - true_cm) < 25.0) & (true_cm > 35.0)
    delays_s = np.arange(0.2, 0.6, 0.01)
    scatter = [np.std((reading_cm - np.interp(time_s - each, time_s, true_cm))[near]) for each in delays_s]
    least_ms = 1000.0 * delays_s[np.argmin(scatter)]
    assert least_ms - 120.0 < effect(gap, "latency")["delay_ms"]["value"] < least_ms + 60.0
    assert effect(gap, "stale")
    assert left(gap, "nats_per_reading") < 0.1
    # Wheel noise and the dead zone are left: it reports so.
    assert gap["verdict"] == "partly explained"
    (resolution,) = [each for each in gap["calibration"] if each["name"] == "resolution"]
    assert resolution["after"] == 0.1
    assert any("1 run" in each for each in gap["messages"])


def slant_of_the_cosine(gap: dict[str, Any], data: Path) -> None:
    """A tilted laser: share 1 is the cosine's; 0 would be the nearest point, as of a wide beam."""
    share = effect(gap, "slant_range")["share"]
    assert share["low"] > 0.5
    assert 0.7 < share["value"] < 1.5
    assert left(gap, "bias_cm") < 0.6
    assert gap["rows"] == read_table(data / "util-uwb" / "0607__tdoa2-obs-log1.csv")["t_s"].size


def ruler_misses_something(gap: dict[str, Any], data: Path) -> None:
    """The HC-SR04 at ruler distances."""
    assert gap["verdict"] in ("partly explained", "explained")
    assert gap["runs"] == 22
    assert left(gap, "nats_per_reading") < 0.6


IN_NUMBERS = {
    "robot_mb1433": late_by_what_scatters_least,
    "drone_0607": slant_of_the_cosine,
    "ruler": ruler_misses_something,
}
"""What can be seen in the pictures of a set, found by another way."""


def effect(gap: dict[str, Any], name: str) -> dict[str, Any]:
    """Parameters of an effect that was found."""
    (found,) = [each for each in gap["effects"] if each["name"] == name]
    return dict(found["parameters"])


def left(gap: dict[str, Any], measure: str) -> float:
    """The share of a gap that is left."""
    return float(gap["gap"][measure]["after"] / gap["gap"][measure]["before"])


@pytest.mark.slow
@pytest.mark.parametrize("measured", SETS, ids=lambda each: each.name)
def test_set_end_to_end(measured: MeasuredSet, tmp_path: Path) -> None:
    files = [measured_data(each) for each in (*measured.readings, *measured.bench)]
    data = files[0].parent.parent
    outcome = run_set(measured, data, tmp_path)
    now, known = problems(outcome), known_problems(measured.name)
    assert not now - known, f"{outcome.command}\n{outcome.failure}"
    assert not known - now, f"these hold now: take them out of {KNOWN.name} and of docs/real_data.md"
    if measured.name in IN_NUMBERS:
        IN_NUMBERS[measured.name](json.loads((tmp_path / "gap/gap.json").read_text(encoding="utf-8")), data)


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
