"""A characterisation ends with a model that loads and gives every reading, for every shipped sensor and odd readings.

The readings are those of a plain sensor with the file's limits; shares no code with the reading model.
"""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from msp_range.reading_model.mixture import ReadingModel
from msp_range.reading_model.sensor_model import SensorModel, load_sensor_model
from msp_range.recording.csv_form import write_csv
from tests.support.data import measured_data
from tests.support.measured import EVERY_SENSOR, QUICK_SENSORS, ROOT, SENSORS
from tests.support.programs import app_of, run
from tests.support.slow import slow_but

HCSR04 = ROOT / "configs" / "sensors" / "hcsr04.yaml"
SHARES = {"missed": 0.02, "short": 0.02, "random": 0.01}
RANGES = 8
READINGS = 60
"""At each range."""


def table(
    file: Path, offset_cm: float = 0.0, scale: float = 1.0, shares: Mapping[str, float] = SHARES
) -> dict[str, Any]:
    sensor, rng = load_sensor_model(file), np.random.default_rng(7)
    lowest, highest = sensor.minimum_cm, sensor.maximum_cm
    true_cm = np.repeat(np.linspace(lowest + 20.0, min(0.7 * highest, 400.0), RANGES).round(1), READINGS)
    n = true_cm.size
    reading_cm = np.clip(np.rint(offset_cm + scale * true_cm + 1.2 * rng.standard_normal(n)), lowest, highest - 1)
    share = {**SHARES, **shares}
    kind = rng.random(n)
    limit = 0.0
    for name, other_cm in (
        ("missed", np.full(n, highest)),
        ("short", np.rint(rng.uniform(lowest, true_cm))),
        ("random", rng.integers(round(lowest), round(highest), n)),
    ):
        reading_cm = np.where((kind >= limit) & (kind < limit + share[name]), other_cm, reading_cm)
        limit += share[name]
    return {
        "time_s": 0.1 * np.arange(n),
        "sensor": np.full(n, "down"),
        "run": np.array([f"{each:g} cm" for each in true_cm]),
        "true_range_cm": true_cm,
        "reading_cm": reading_cm.astype(float),
        "air_temperature_c": np.full(n, 22.5),
    }


def characterised(folder: Path, file: Path, columns: dict[str, Any]) -> tuple[SensorModel, str]:
    """The new model, which gives each of the readings, and what was printed."""
    write_csv(folder / "bench.csv", columns)
    out = folder / "model.yaml"
    command = ["msp-lab characterise", folder / "bench.csv", "--out", out, "--sensor", file]
    result = run(*command, env={"COLUMNS": "500"})
    model = load_sensor_model(out)
    given = ReadingModel.of(model)
    log_prob = given.log_prob(columns["reading_cm"], {"true_range_cm": columns["true_range_cm"]})
    assert np.isfinite(log_prob).all()
    drawn = given.sample({"true_range_cm": columns["true_range_cm"]}, np.random.default_rng(1))
    assert np.isfinite(drawn).all()
    return model, result.output


@pytest.mark.parametrize("offset_cm", slow_but([-5.0], [-5.0, 5.0]))
@pytest.mark.parametrize("file", EVERY_SENSOR, ids=lambda each: each.stem)
def test_an_offset_is_calibrated(file: Path, offset_cm: float, tmp_path: Path) -> None:
    """Also where it takes the shortest reading, or the reading of a range of 0, below 0."""
    model, _ = characterised(tmp_path, file, table(file, offset_cm))
    corrected = model.calibration_curve.forward(200.0) - 200.0
    assert corrected == pytest.approx(offset_cm, abs=1.0)
    assert model.calibration != ()


@pytest.mark.parametrize("scale", slow_but([1.05], [0.95, 1.05]))
@pytest.mark.parametrize("file", EVERY_SENSOR, ids=lambda each: each.stem)
def test_a_scale_is_calibrated(file: Path, scale: float, tmp_path: Path) -> None:
    model, _ = characterised(tmp_path, file, table(file, scale=scale))
    curve = model.calibration_curve
    assert (curve.forward(250.0) - curve.forward(150.0)) / 100.0 == pytest.approx(scale, abs=0.01)


@pytest.mark.parametrize("absent", [("missed",), ("missed", "short", "random")], ids=" ".join)
@pytest.mark.parametrize("file", EVERY_SENSOR, ids=lambda each: each.stem)
def test_a_kind_of_reading_that_never_comes_has_a_floor_and_a_mark(
    file: Path, absent: tuple[str, ...], tmp_path: Path
) -> None:
    model, printed = characterised(tmp_path, file, table(file, shares=dict.fromkeys(absent, 0.0)))
    weights = model.reading_model.weights.model_dump()
    assert min(weights.values()) >= 0.99e-4
    text = (tmp_path / "model.yaml").read_text(encoding="utf-8").replace("\n# ", " ")
    for name in absent:
        assert weights[name] < 0.01, name
        if weights[name] < 1.01e-4:
            assert re.search(rf"weights\.{name} +z_\w+ +0\.[01]+[^\n]* at its bound", printed), printed
            assert text.count("at its bound") >= 1


@pytest.mark.parametrize("kind", ["missed", "short", "random"])
@pytest.mark.parametrize("file", EVERY_SENSOR, ids=lambda each: each.stem)
def test_one_kind_of_reading_only_is_a_note_or_a_refusal(file: Path, kind: str, tmp_path: Path) -> None:
    shares = dict.fromkeys(SHARES, 0.0) | {kind: 1.0}
    write_csv(tmp_path / "bench.csv", table(file, shares=shares))
    command = ["characterise", tmp_path / "bench.csv", "--out", tmp_path / "m.yaml", "--sensor", file]
    result = CliRunner().invoke(app_of("msp-lab"), [*map(str, command)])
    assert result.exit_code in (0, 3), result.output
    assert result.exception is None or isinstance(result.exception, SystemExit)
    if result.exit_code == 0:
        load_sensor_model(tmp_path / "m.yaml")


def test_few_readings_leave_the_goodness_of_fit_open(tmp_path: Path) -> None:
    columns = {name: column[::8] for name, column in table(HCSR04, shares=dict.fromkeys(SHARES, 0.0)).items()}
    _, printed = characterised(tmp_path, HCSR04, columns)
    assert "too few to test" in printed


@pytest.mark.parametrize("file", slow_but(QUICK_SENSORS[:1], SENSORS))
def test_every_model_flies(file: Path, tmp_path: Path) -> None:
    """Also that of a sensor whose readings the airframe's sensors cannot answer, such as 18 cm."""
    run("msp-sim fly no_autopilot", "--model", file, "--out", tmp_path / "out")
    assert (tmp_path / "out" / "summary.json").exists()


def test_echoes_that_are_missed_near_only_give_a_model_that_the_gap_can_use(tmp_path: Path) -> None:
    """The MB1433 misses echoes nearer than 50 cm: its share at 3 m was 1e-17 with a growth of -13 per metre."""
    columns = ["--map", ROOT / "configs/maps/enmt482-sonar2.yaml"]
    out, sensor = tmp_path / "m.yaml", ROOT / "configs/sensors/mb1433.yaml"
    bench = measured_data("enmt482/calibration.csv")
    run("msp-lab characterise", bench, *columns, "--sensor", sensor, "--out", out)
    model = load_sensor_model(out).reading_model
    assert model.weights.missed >= 1e-4
    assert abs(model.missed_growth_per_m) <= 10.0
    flight = measured_data("enmt482/training1.csv")
    run("msp-lab compare", flight, *columns, "--model", out, "--out", tmp_path / "gap")
    gap = json.loads((tmp_path / "gap" / "gap.json").read_text(encoding="utf-8"))["gap"]
    assert 0.0 < gap["nats_per_reading"]["before"] < 5.0
