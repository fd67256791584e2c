"""What the gap workflow once said or did wrongly, each with a test.

Offsets of runs where there is one run are in `test_gap_robust.py`, and columns that `msp-sim sample` can derive in
`test_derived_columns.py`.
"""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from msp_lab.gap.before_after import add, compare
from msp_lab.gap.conclusion import with_words
from msp_lab.gap.estimates import formula
from msp_lab.gap.findings import GapFindings, Settings
from msp_lab.gap.findings_file import extended_text
from msp_lab.gap.intake import Comparison, read_readings
from msp_lab.gap.naming import AllReadings, ExtendedModels, name, name_effects
from msp_lab.gap.runs import draw_splits
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_range.recording.csv_form import write_csv
from msp_sim.model.model import Model
from tests.support.measured import MODEL as FILE
from tests.support.measured import sensor
from tests.support.slow import slow

SENSOR = load_sensor_model(FILE).model_copy(update={"effects": ()})
N, RUNS = 2400, 12


def flown(seed: int) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    run = np.arange(N) * RUNS // N
    time_s = 0.1 * (np.arange(N) % (N // RUNS))
    return {
        "time_s": time_s,
        "sensor": np.full(N, "front"),
        "run": np.array([f"run{k:02d}" for k in run]),
        "true_range_cm": 200.0 + 120.0 * np.sin(0.5 * time_s + run),
        "range_rate_cm_s": 60.0 * np.cos(0.5 * time_s + run),
        "throttle": rng.uniform(0.2, 0.9, N),
    }


def given(saturated: float) -> Model:
    mixture = SENSOR.reading_model.model_copy(update={"saturated_fraction": saturated})
    return Model.of(SENSOR.model_copy(update={"reading_model": mixture}))


def explained(
    folder: Path, model: Model, contexts: dict[str, Any], reading_cm: list[float]
) -> tuple[GapFindings, ExtendedModels]:
    def quiet(what: str, share: float) -> None:
        """Report nothing."""

    write_csv(folder / "flights.csv", contexts | {"reading_cm": np.array(reading_cm)})
    comparison = Comparison.of(read_readings([folder / "flights.csv"], model), model, Settings("model.yaml"))
    findings, models = name(comparison, compare(comparison, "2026-01-01", quiet), quiet)
    return add(comparison, findings, models, quiet), models


@pytest.mark.parametrize("before", [0.2, *slow(0.0)])
def test_a_saturated_share_does_not_move_unseen(tmp_path: Path, before: float) -> None:
    """It went from 0 to 0.68 in the model file, and nothing said so."""
    contexts = flown(1)
    reading_cm = sensor(second_share=0.68, hit=0.86, missed=0.12).readings(contexts["true_range_cm"].tolist(), 1)
    findings, models = explained(tmp_path, given(before), contexts, reading_cm)
    after = models.final_fit.sensor.reading_model.saturated_fraction
    said = {each.name for each in findings.calibration} | {each.name for each in findings.effects}
    assert said & {"saturated_fraction", "code", "saturated_byte", "or_ed_bytes"}
    assert after == pytest.approx(before, abs=1e-3) or "saturated_fraction" in said


def test_no_calibration_says_that_a_number_is_itself(tmp_path: Path) -> None:
    """'is 0.5 (0.5 to 0.5) and not 0.5'."""
    contexts = flown(2)
    reading_cm = sensor(second_share=0.5).readings(contexts["true_range_cm"].tolist(), 2)
    findings, _ = explained(tmp_path, given(0.5), contexts, reading_cm)
    numbers = re.findall(r"is (\S+?)(?: \S+)? \(.* and not (\S+)$", "\n".join(x.finding for x in findings.calibration))
    assert all(after != before for after, before in numbers)


@pytest.mark.parametrize("values", [[0.0, 0.0], [1.0, 1.0, 1.0], [0.0, 1e-12, 0.0], [1e6, -1e6, 1e6]])
def test_no_formula_is_empty(values: list[float]) -> None:
    at = np.linspace(0.0, 1.0, len(values))
    for deviation in (0.0, 0.1, 1e9):
        assert "throttle" in formula("throttle", at, np.array(values), np.full(len(values), deviation))


@pytest.mark.slow
def test_page_and_file_have_one_value_of_a_parameter(tmp_path: Path) -> None:
    contexts = flown(3)
    late_cm = contexts["true_range_cm"] - 0.05 * contexts["range_rate_cm_s"]
    findings, models = explained(tmp_path, given(0.5), contexts, sensor().readings(late_cm.tolist(), 3))
    (effect,) = findings.effects
    assert effect.name == "latency"
    (entry,) = yaml.safe_load(extended_text(models.final_fit, findings, "test"))["effects"]
    written = entry["parameters"]["delay_ms"]
    assert written["value"] == pytest.approx(effect.parameters["delay_ms"].value, rel=1e-5)
    said = with_words(findings).sentence
    number, unit = re.findall(r"are (\S+) (m?s) behind the reference", said)[0]
    assert float(number) * (1000.0 if unit == "s" else 1.0) == pytest.approx(written["value"], rel=0.06)


@pytest.mark.slow
def test_an_effect_that_the_model_had_keeps_its_own_value_in_the_file(tmp_path: Path) -> None:
    contexts = flown(3)
    late_cm = contexts["true_range_cm"] - 0.05 * contexts["range_rate_cm_s"]
    before = given(0.5).adding("latency", delay_ms=-100.0)
    findings, models = explained(tmp_path, before, contexts, sensor().readings(late_cm.tolist(), 3))
    had, added = yaml.safe_load(extended_text(models.final_fit, findings, "test"))["effects"]
    assert had == {"name": "latency", "parameters": {"delay_ms": -100.0}}
    assert added["parameters"]["delay_ms"]["value"] == pytest.approx(150.0, rel=0.1)
    assert "are 0.15 s behind the reference, on top of what the model says" in with_words(findings).sentence


def test_where_nothing_is_missing_no_number_of_the_base_is_said_to_move() -> None:
    """Neighbours share a part of the reference's error, so a correlation is fitted: it starts at 0.2."""
    contexts = flown(3) | {"reference": np.full(N, "others")}
    rng = np.random.default_rng(3)
    reading_cm = given(0.0).sample(contexts, rng)
    found = name_effects(given(0.0), AllReadings(contexts, reading_cm, draw_splits(contexts, rng)), rng)
    assert found.calibration == ()
    assert found.models.final_fit.sensor.reading_model.correlation == 0.0
