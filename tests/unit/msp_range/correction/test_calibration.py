"""A sensor's calibration curve: there and back, beyond its knots, and on its way through model, file and bridge."""

import copy
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from msp_range.bridge import correct
from msp_range.correction.calibration import IDENTITY, Calibration
from msp_range.reading import Reading, Status
from msp_range.reading_model.mixture import ReadingModel
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_range.yaml_file import ConfigError
from tests.support.shipped import MB1242

BENT = Calibration(true_cm=(50.0, 100.0, 300.0), reading_cm=(52.0, 101.0, 305.0))


def test_it_passes_through_its_knots_and_goes_on_straight() -> None:
    assert [BENT.forward(x) for x in (50.0, 100.0, 300.0)] == pytest.approx([52.0, 101.0, 305.0])
    assert BENT.forward(75.0) == pytest.approx(76.5)
    assert BENT.forward(0.0) == pytest.approx(52.0 - 0.98 * 50.0)
    assert BENT.forward(500.0) == pytest.approx(305.0 + 1.02 * 200.0)


@given(st.floats(1.0, 2000.0), st.lists(st.tuples(st.floats(1.0, 200.0), st.floats(0.5, 2.0)), min_size=1, max_size=6))
def test_backwards_is_backwards(range_cm: float, pieces: list[tuple[float, float]]) -> None:
    true_cm, reading_cm = [10.0], [12.0]
    for run, slope in pieces:
        true_cm.append(true_cm[-1] + run)
        reading_cm.append(reading_cm[-1] + min(max(slope, 0.501), 1.999) * run)
    curve = Calibration(tuple(true_cm), tuple(reading_cm))
    assert curve.inverse(curve.forward(range_cm)) == pytest.approx(range_cm)


def test_arrays_and_numbers_agree_and_no_echo_stays() -> None:
    x = np.array([0.0, 50.0, 99.0, 100.0, 250.0, 800.0])
    assert BENT.forward(x).tolist() == [BENT.forward(float(each)) for each in x]
    assert BENT.inverse(x).tolist() == [BENT.inverse(float(each)) for each in x]
    assert np.isnan(BENT.forward(np.array([np.nan]))).all()
    assert BENT.forward(np.array([np.inf])).tolist() == [math.inf]
    assert IDENTITY.forward(x) is x


@pytest.mark.parametrize(
    ("true_cm", "reading_cm"),
    [
        ((100.0,), (101.0,)),
        ((100.0, 200.0), (101.0,)),
        ((100.0, 100.0), (101.0, 102.0)),
        ((100.0, 200.0), (202.0, 101.0)),
        ((100.0, 200.0), (100.0, 140.0)),
        ((100.0, 200.0), (100.0, 301.0)),
        ((100.0, math.nan), (100.0, 200.0)),
    ],
)
def test_impossible_knots_are_refused(true_cm: tuple[float, ...], reading_cm: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="knots"):
        Calibration(true_cm, reading_cm)


def sensor_file(folder: Path, knots: list[dict[str, float]]) -> Path:
    content: dict[str, Any] = copy.deepcopy(yaml.safe_load(MB1242.read_text(encoding="utf-8")))
    content["calibration"] = knots
    path = folder / "sensor.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def test_a_sensor_model_file_has_it(tmp_path: Path) -> None:
    assert load_sensor_model(MB1242).calibration_curve.is_identity
    sensor = load_sensor_model(
        sensor_file(tmp_path, [{"true_cm": 50, "reading_cm": 52}, {"true_cm": 100, "reading_cm": 101}])
    )
    assert sensor.calibration_curve == Calibration((50.0, 100.0), (52.0, 101.0))


@pytest.mark.parametrize(
    ("knots", "message"),
    [
        ([{"true_cm": 50, "reading_cm": 52}], "at least two"),
        ([{"true_cm": 50, "reading_cm": 52}, {"true_cm": 90, "reading_cm": 60}], "0.5 to 2 times"),
    ],
)
def test_user_errors_in_the_file_are_reported(tmp_path: Path, knots: list[dict[str, float]], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        load_sensor_model(sensor_file(tmp_path, knots))


def test_the_readings_of_the_model_are_about_the_curve() -> None:
    content = {
        "weights": {"hit": 1, "short": 0, "missed": 0, "random": 0},
        "sigma_cm": 1.0,
        "short_rate_per_m": 1,
        "saturated_fraction": 0,
    }
    sensor = load_sensor_model(MB1242)
    parameters = type(sensor.reading_model).model_validate(content)
    model = ReadingModel(parameters, 20, 765, BENT)
    rng = np.random.default_rng(5)
    contexts = {"true_range_cm": np.full(20_000, 300.0)}
    assert model.sample(contexts, rng).mean() == pytest.approx(305.0, abs=0.05)
    readings = np.arange(20.0, 766.0)
    p = np.exp(model.log_prob(readings, {"true_range_cm": np.full(readings.size, 300.0)}))
    assert (p * readings).sum() == pytest.approx(305.0, abs=1e-6)
    assert model.sample({"true_range_cm": [np.nan]}, rng) == 765


def test_the_bridge_takes_it_back_before_it_corrects_for_the_air() -> None:
    def corrected_m(air_c: float) -> float | None:
        return correct(Reading(0.0, "a", Status.OK, 3.05), air_c, 22.5, BENT).range_m

    assert corrected_m(22.5) == pytest.approx(3.0)
    # 100 cm of range at 0 deg C arrive as at 100 / sqrt(273.15 / 295.65) cm, and that is what the curve reads.
    apparent_cm = 100.0 / math.sqrt(273.15 / 295.65)
    reading = Reading(0.0, "a", Status.OK, BENT.forward(apparent_cm) / 100)
    assert correct(reading, 0.0, 22.5, BENT).range_m == pytest.approx(1.0)
    no_echo = Reading(0.0, "a", Status.NO_ECHO)
    assert correct(no_echo, 0.0, 22.5, BENT) is no_echo


def test_what_reads_less_than_at_range_0_is_a_range_of_0() -> None:
    """A sensor that reads 5 cm too far and has a shortest reading of 1 cm: -4 cm is no range."""
    far = Calibration((100.0, 500.0), (105.0, 505.0))
    assert correct(Reading(0.0, "a", Status.OK, 0.01), 22.5, 22.5, far).range_m == 0.0
    assert correct(Reading(0.0, "a", Status.OK, 0.06), 22.5, 22.5, far).range_m == pytest.approx(0.01)
