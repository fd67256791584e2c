"""The gap workflow ends with a model that loads and draws, for every shipped sensor, whatever its readings are."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from msp_lab.gap.findings import GapFindings, Settings
from msp_lab.gap.findings_file import read_findings
from msp_lab.gap.steps import Steps
from msp_range.clock import VirtualClock
from msp_range.recording.csv_form import write_csv
from msp_sim.model.model import load_model
from tests.support.known import known
from tests.support.measured import EVERY_SENSOR, ROOT, SENSORS
from tests.support.slow import slow_but

CONFIGS = ROOT / "configs" / "sensors"
N, RUNS = 300, 6


def quiet(what: str, share: float) -> None:
    pass


def table(file: Path, offset_cm: float = 0.0, scale: float = 1.0, missed: float = 0.02) -> dict[str, Any]:
    """Readings of a plain sensor with this file's limits and spread: hits and no echoes only."""
    sensor = load_model(file).sensor
    rng = np.random.default_rng(5)
    true_cm = np.round(rng.uniform(sensor.minimum_cm + 15.0, min(0.8 * sensor.maximum_cm, 400.0), N), 1)
    sigma_cm = sensor.reading_model.sigma_cm
    reading_cm = np.rint(offset_cm + scale * true_cm + sigma_cm * rng.standard_normal(N))
    reading_cm = np.clip(reading_cm, sensor.minimum_cm, sensor.maximum_cm)
    reading_cm = np.where(rng.random(N) < missed, sensor.maximum_cm, reading_cm)
    return {
        "time_s": 0.1 * np.arange(N),
        "sensor": np.full(N, "down"),
        "run": np.array([f"run {i * RUNS // N}" for i in range(N)]),
        "true_range_cm": true_cm,
        "reading_cm": reading_cm,
    }


def added(folder: Path, file: Path, columns: dict[str, Any]) -> GapFindings:
    write_csv(folder / "measured.csv", columns)
    Steps(folder / "out", VirtualClock(), quiet).all([folder / "measured.csv"], Settings(str(file)), "add")
    model = load_model(folder / "out" / "model.yaml")
    drawn = model.sample(dict(columns), np.random.default_rng(1))
    assert np.isfinite(drawn).all()
    return read_findings(folder / "out")


@pytest.mark.parametrize("file", EVERY_SENSOR, ids=lambda each: each.stem)
def test_five_centimetres_off(file: Path, tmp_path: Path) -> None:
    found = added(tmp_path, file, table(file, 5.0 if SENSORS.index(file) % 2 else -5.0))
    assert found.gap is not None
    assert found.gap.bias_cm.before == pytest.approx(5.0, abs=1.5)
    assert known(found.gap.bias_cm.after) < 2.5
    assert not any("is not written" in each for each in found.messages)


@pytest.mark.slow
def test_three_per_cent_off(tmp_path: Path) -> None:
    file = CONFIGS / "hcsr04.yaml"
    found = added(tmp_path, file, table(file, 0.0, 0.97))
    assert found.gap is not None
    assert known(found.gap.bias_cm.after) < 2.5


@pytest.mark.parametrize("missed", slow_but([0.999], [0.0, 0.999]))
@pytest.mark.parametrize("file", [CONFIGS / "mb1242.yaml", CONFIGS / "tof_ranger.yaml"], ids=lambda each: each.stem)
def test_one_kind_of_reading_only(file: Path, missed: float, tmp_path: Path) -> None:
    found = added(tmp_path, file, table(file, missed=missed))
    assert np.isfinite(known(known(found.gap).nats_per_reading.after))
