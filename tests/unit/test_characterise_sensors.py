"""`msp-lab characterise --each sensor`: a model for each sensor of a table, the same as of its readings alone."""

import csv
from pathlib import Path

import numpy as np
import pytest

from msp_range.reading_model.sensor_model import load_sensor_model
from msp_range.recording.csv_form import write_csv
from tests.support.programs import run


@pytest.fixture
def bench(tmp_path: Path) -> Path:
    """Two sensors with different noise at four ranges, and a third one without a single answer."""
    rng = np.random.default_rng(1)
    parts = []
    for sensor, sigma_cm in (("quiet", 1.0), ("rough", 3.0), ("dead", np.nan)):
        true_cm = np.repeat([50.0, 150.0, 250.0, 350.0], 40)
        reading_cm = np.round(true_cm + sigma_cm * rng.normal(size=true_cm.size))
        parts.append((np.arange(160.0), np.full(160, sensor), reading_cm, true_cm))
    names = ("time_s", "sensor", "reading_cm", "true_range_cm")
    path = tmp_path / "bench.csv"
    write_csv(path, {name: np.concatenate([part[i] for part in parts]) for i, name in enumerate(names)})
    return path


@pytest.mark.slow
def test_each_sensor_has_its_own_model(bench: Path, tmp_path: Path) -> None:
    options = ["--each", "sensor", "--date", "2026-11-22"]
    shown = run("msp-lab characterise", bench, "--out", tmp_path / "models", *options, code=4).output
    assert "dead: no model: " in shown
    options = ["--of", "rough", "--date", "2026-11-22"]
    run("msp-lab characterise", bench, "--out", tmp_path / "rough.yaml", *options)
    assert (tmp_path / "models" / "rough.yaml").read_bytes() == (tmp_path / "rough.yaml").read_bytes()
    with (tmp_path / "models" / "sensors.csv").open(encoding="utf-8", newline="") as file:
        rows = {row["sensor"]: row for row in csv.DictReader(file)}
    assert list(rows) == ["dead", "quiet", "rough"]
    quiet, rough = (load_sensor_model(rows[name]["model"]).reading_model.sigma_cm for name in ("quiet", "rough"))
    assert 2.0 < rough / quiet < 5.0
    assert rows["dead"]["model"] == ""


def test_several_jobs_need_several_models(bench: Path, tmp_path: Path) -> None:
    shown = run("msp-lab characterise --jobs 2", bench, "--out", tmp_path / "model.yaml", code=3).output
    assert "give --each sensor" in shown


@pytest.mark.slow
def test_the_same_models_whatever_the_number_of_jobs(bench: Path, tmp_path: Path) -> None:
    for jobs in (1, 2):
        options = ["--each", "sensor", "--jobs", jobs, "--date", "2026-11-22"]
        run("msp-lab characterise", bench, "--out", tmp_path / str(jobs), *options, code=4)
    for name in ("quiet.yaml", "rough.yaml"):
        assert (tmp_path / "1" / name).read_bytes() == (tmp_path / "2" / name).read_bytes()
