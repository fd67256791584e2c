"""What the gap workflow finds in other people's measurements; what is asserted can be seen in the pictures."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from msp_lab.gap import workflow
from msp_lab.gap.findings import GapFindings, Settings
from msp_lab.gap.intake import read_readings
from msp_lab.readings.column_map import load_map
from msp_range.recording.csv_form import MeasuredData
from msp_sim.model.model import load_model
from tests.support.data import measured_data
from tests.support.known import known
from tests.support.measured import ROOT


def found(sensor: str, mapping: str, *files: str) -> tuple[GapFindings, MeasuredData]:
    paths = tuple(measured_data(file) for file in files)
    return _found(sensor, mapping, paths)


@cache
def _found(sensor: str, mapping: str, paths: tuple[Path, ...]) -> tuple[GapFindings, MeasuredData]:
    file = ROOT / "configs" / "sensors" / f"{sensor}.yaml"
    model = load_model(file)
    readings = read_readings(paths, model, load_map([str(ROOT / "configs" / "maps" / f"{mapping}.yaml")]))

    def quiet(what: str, share: float) -> None:
        pass

    comparison = workflow.Comparison.of(readings, model, Settings(str(file)))
    findings = workflow.compare(comparison, "2026-11-21", quiet)
    findings, models = workflow.name(comparison, findings, quiet)
    return workflow.add(comparison, findings, models, quiet), readings.data


@pytest.mark.slow
def test_the_mb1433_is_four_tenths_of_a_second_late() -> None:
    findings, data = found("mb1433", "enmt482-sonar2", "enmt482/training1.csv")
    latency = {each.name: each for each in findings.effects}["latency"]
    # By another way: the delay at which the readings scatter least about the true range at that time.
    time_s, true_cm, reading_cm = data["time_s"], data["true_range_cm"], data["reading_cm"]
    near = (np.abs(reading_cm - true_cm) < 25.0) & (true_cm > 35.0)
    delays_s = np.arange(0.2, 0.6, 0.01)
    scatter = [np.std((reading_cm - np.interp(time_s - each, time_s, true_cm))[near]) for each in delays_s]
    # That delay holds what readings that are held add to it, which has its own name.
    least_ms = 1000.0 * delays_s[np.argmin(scatter)]
    assert least_ms - 120.0 < latency.parameters["delay_ms"].value < least_ms + 60.0
    assert {each.name for each in findings.effects} >= {"latency", "stale"}
    gap = findings.gap
    assert gap is not None
    assert known(gap.nats_per_reading.after) < 0.1 * known(gap.nats_per_reading.before)
    # Wheel noise and the dead zone are left: it reports so.
    assert findings.verdict == "partly explained"


@pytest.mark.slow
def test_the_tilted_ranger_reads_the_slant_range() -> None:
    findings, data = found("tof_ranger", "util-uwb", "util-uwb/0607__tdoa2-obs-log1.csv")
    slant = {each.name: each for each in findings.effects}["slant_range"]
    # 1 is the cosine's; 0 would be the nearest point, as of a wide beam.
    assert slant.parameters["share"].low is not None
    assert slant.parameters["share"].low > 0.5
    assert 0.7 < slant.parameters["share"].value < 1.5
    assert findings.gap is not None
    assert known(findings.gap.bias_cm.after) < 0.6 * known(findings.gap.bias_cm.before)
    assert findings.rows == len(data)


@pytest.mark.slow
def test_millimetres_are_calibration_and_no_effect() -> None:
    findings, _ = found("mb1433", "enmt482-sonar2", "enmt482/training1.csv")
    resolution = {each.name: each for each in findings.calibration}["resolution"]
    assert resolution.after == 0.1
    assert any("1 run" in each for each in findings.messages)


@pytest.mark.slow
def test_the_hcsr04_at_a_ruler_is_reported_to_miss_something() -> None:
    findings, _ = found("hcsr04", "hcsr04-ccu", "hcsr04-ccu/readings.csv")
    assert findings.verdict in ("partly explained", "explained")
    assert findings.runs == 22
    assert findings.gap is not None
    assert known(findings.gap.nats_per_reading.after) < 0.5 * known(findings.gap.nats_per_reading.before)
