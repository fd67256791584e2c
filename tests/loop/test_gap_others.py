"""``msp-lab gap --truth others`` on flights of four sensors, one of which has a scale of its own."""

import json
from pathlib import Path

import numpy as np
import pytest

from msp_range.reading_model.sensor_model import load_sensor_model
from msp_range.recording.csv_form import write_csv
from msp_sim.model.model import Model
from tests.support.programs import run

NAMES = ("front", "left", "rear", "right")
MODEL = "configs/sensors/mb1242_bench.yaml"
SENSOR = load_sensor_model(MODEL).model_copy(update={"effects": ()})


def written(path: Path, scale_pct: float, runs: int, n: int) -> Path:
    """Readings in flights that no reference saw."""
    rng = np.random.default_rng(7)
    run = np.repeat([f"flight_{k}" for k in range(runs)], n)
    time_s = np.tile(0.1 * np.arange(n), runs)
    phase = np.repeat(rng.uniform(0.0, 6.0, runs), n)
    true_cm = 260.0 + 100.0 * np.sin(0.5 * time_s + phase) + 50.0 * np.sin(0.13 * time_s)
    sensor = np.array(NAMES)[np.arange(run.size) % 4]
    plain, scaled = Model(SENSOR), Model(SENSOR).adding("range_scale", scale_pct=scale_pct)
    contexts = {"true_range_cm": true_cm}
    reading_cm = np.where(sensor == "left", scaled.sample(contexts, rng), plain.sample(contexts, rng))
    write_csv(path, {"time_s": time_s, "sensor": sensor, "run": run, "reading_cm": reading_cm})
    return path


@pytest.mark.slow
def test_the_sensor_that_differs_is_named_and_the_others_are_not(tmp_path: Path) -> None:
    table = written(tmp_path / "flights.csv", 3.0, runs=6, n=480)
    out = tmp_path / "gap"
    done = run("msp-lab gap --truth others --until add", table, "--model", MODEL, "--out", out)
    found = {each["sensor"]: each for each in json.loads((out / "sensors.json").read_text())}
    assert found.keys() == set(NAMES)
    assert [name for name in NAMES if found[name]["named"]] == ["left"]
    effect = json.loads((out / "left" / "gap.json").read_text())["effects"][0]
    # Over these ranges a bend and a walk of the threshold are nearly a scale.
    assert effect["name"] in ("range_scale", "bend", "threshold_walk")
    assert all(each["doubted"] is None for each in found.values())
    assert "cannot be seen: the air's temperature" in " ".join(done.output.split())
    assert (out / "left" / "model.yaml").exists()


@pytest.mark.parametrize("command", ["compare", "gap --until name"])
def test_only_the_whole_workflow_goes_from_sensor_to_sensor(tmp_path: Path, command: str) -> None:
    table = written(tmp_path / "flights.csv", 0.0, runs=1, n=200)
    options = ["--truth", "others", "--model", MODEL, "--out", tmp_path / "gap"]
    assert "--truth others: 'gap' does it" in run(f"msp-lab {command}", table, *options, code=3).output
