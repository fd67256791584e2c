"""The beam beyond the measured angles: the tables of the shipped files, and files without one or with one of others."""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.special import jv

from msp_lab.characterise.beam import predict_breakaway, with_prediction
from msp_range.arrays import Array
from msp_range.check import lines
from msp_range.config import load_airframe
from msp_range.plausible import doubts
from msp_range.reading_model.sensor_model import SensorModel, load_sensor_model
from msp_range.yaml_file import ConfigError
from tests.support.programs import run
from tests.support.shipped import CONFIGS, MB1242

SENSOR = load_sensor_model(MB1242)
TEXT = MB1242.read_text(encoding="utf-8")
TABLE = TEXT[TEXT.index("predicted_breakaway:") : TEXT.index("# Report 4.3.2")].rstrip() + "\n"


def write(folder: Path, *changes: tuple[str, str]) -> Path:
    """The shipped file with changes."""
    text = TEXT
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = folder / "mine.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def half_angles_deg(sensor: SensorModel) -> list[float]:
    return [round(math.degrees(sensor.beam.half_angle_rad(range_m)), 2) for range_m in (2.0, 2.5, 7.65)]


def test_the_table_is_that_of_an_independent_fit() -> None:
    """Level L - 20 log10 R + s R + 40 log10 (2 J1(x) / x), x = q sin(angle): absorption and gain are one slope s."""
    x = np.linspace(1e-6, 3.8317, 400_001)
    down_db = -40.0 * np.log10(2.0 * jv(1, x) / x)

    def angles_deg(parameters: Array, ranges_m: Array) -> Array:
        level_db, slope_db_per_m, log_q = parameters
        spare_db = level_db - 20.0 * np.log10(ranges_m) + slope_db_per_m * ranges_m
        sines: Array = np.minimum(np.interp(spare_db, down_db, x) / math.exp(log_q), 1.0)
        return np.degrees(np.arcsin(sines))

    ranges_m, measured_deg = np.array([0.5, 1.0, 1.5, 2.0]), np.array([23.4, 18.0, 14.4, 12.6])
    fitted = minimize(
        lambda parameters: np.square(angles_deg(parameters, ranges_m) - measured_deg).sum(),
        (5.0, 1.0, 1.5),
        method="Nelder-Mead",
        options={"xatol": 1e-9, "fatol": 1e-13, "maxiter": 10_000, "maxfev": 10_000},
    ).x
    assert SENSOR.predicted_breakaway is not None
    rows = SENSOR.predicted_breakaway.rows
    assert [row.range_cm for row in rows] == [225, 250, 275, 300]
    expected_deg = angles_deg(fitted, np.array([row.range_cm / 100.0 for row in rows]))
    assert [row.half_angle_deg for row in rows] == pytest.approx(expected_deg, abs=1e-4)
    # Behind them the equation's beam would widen, so the last angle is held.
    assert angles_deg(fitted, np.array([3.25]))[0] > rows[-1].half_angle_deg


@pytest.mark.parametrize("path", sorted((CONFIGS / "sensors").glob("*.yaml")), ids=lambda path: path.stem)
def test_shipped_files_have_the_table_of_their_numbers(path: Path) -> None:
    sensor = load_sensor_model(path)
    assert sensor.beam_doubt == ""
    assert sensor.predicted_breakaway == (predict_breakaway(sensor) if sensor.medium == "sound" else None)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ((TABLE, ""), "no predicted_breakaway"),
        (("half_angle_deg: 12.6", "half_angle_deg: 11.0"), "predicted_breakaway is of other numbers"),
        (("heard_on_axis_cm: 500", "heard_on_axis_cm: 501"), "predicted_breakaway is of other numbers"),
        (("maximum_cm: 765", "maximum_cm: 764"), "predicted_breakaway is of other numbers"),
        (("frequency_hz: 42000", "frequency_hz: 41999"), "predicted_breakaway is of other numbers"),
    ],
)
def test_a_file_without_its_table_flies_and_a_command_makes_the_table(
    tmp_path: Path, change: tuple[str, str], why: str
) -> None:
    path = write(tmp_path, change)
    sensor, before = load_sensor_model(path), path.read_text(encoding="utf-8")
    last_deg = sensor.breakaway[-1].half_angle_deg
    assert half_angles_deg(sensor) == [last_deg] * 3
    text = (CONFIGS / "quad_pallet.yaml").read_text(encoding="utf-8")
    airframe = tmp_path / "airframe.yaml"
    airframe.write_text(text.replace("sensors/mb1242.yaml", "mine.yaml"), encoding="utf-8")
    (doubt,) = doubts(load_airframe(airframe))
    assert doubt.startswith(f"mine.yaml: {why}")
    held = f"so the beam's half angle is held at {last_deg:g} deg beyond 200 cm; to predict it: msp-lab beam mine.yaml"
    assert doubt.endswith(held)
    assert f"warning: {doubt}" in list(lines(load_airframe(airframe)))

    assert "225 cm: " in run("msp-lab beam", path).output
    made = load_sensor_model(path)
    assert made.predicted_breakaway == predict_breakaway(sensor)
    assert half_angles_deg(made)[1] < last_deg
    assert list(doubts(load_airframe(airframe))) == []
    assert (tmp_path / "mine.yaml.1").read_text(encoding="utf-8") == before
    if change[1] == "":
        assert path.read_text(encoding="utf-8") == TEXT
    assert "has this prediction already" in run("msp-lab beam", path).output
    assert not (tmp_path / "mine.yaml.2").exists()


def test_digits_that_files_do_not_keep_change_no_hash() -> None:
    finer = SensorModel.model_validate(SENSOR.model_dump() | {"frequency_hz": 42_000.004})
    assert finer.beam_inputs == SENSOR.beam_inputs


def test_one_angle_is_held_without_a_doubt(tmp_path: Path) -> None:
    first, table = TEXT.index("  - {range_cm: 100, half"), TEXT.index("predicted_breakaway:")
    path = write(tmp_path, (TEXT[first:table], ""))
    assert "no narrower beam is predicted: the last measured angle is held" in run("msp-lab beam", path).output
    sensor = load_sensor_model(path)
    assert sensor.beam_doubt == ""
    assert half_angles_deg(sensor) == [23.4] * 3


def test_angles_that_were_measured_up_to_the_longest_range_need_no_table(tmp_path: Path) -> None:
    sensor = load_sensor_model(
        write(tmp_path, (TABLE, ""), ("range_cm: 200", "range_cm: 765"), ("axis_cm: 500", "axis_cm: 765"))
    )
    assert sensor.beam_doubt == ""
    assert predict_breakaway(sensor).rows == ()


def test_a_table_that_widens_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path, ("half_angle_deg: 11.9271277", "half_angle_deg: 13"))
    with pytest.raises(ConfigError, match=r"found 13 deg at 225 cm after 12\.6 deg at 200 cm"):
        load_sensor_model(path)


@pytest.mark.parametrize("inputs", ["12345678", "54c3c91d", "crc32-54c3c91", "crc32-54c3c91dd", "crc32-xyzxyzxy"])
def test_a_hash_has_its_name_and_eight_digits(tmp_path: Path, inputs: str) -> None:
    with pytest.raises(ConfigError, match=r"predicted_breakaway\.inputs: found"):
        load_sensor_model(write(tmp_path, ('"crc32-54c3c91d"', inputs)))


def test_layouts_of_files() -> None:
    """Line ends, comments and the order of keys stay; a table between others is replaced where it is."""
    assert SENSOR.predicted_breakaway is not None
    older = TEXT.replace("11.9271277", "12").replace("54c3c91d", "00000000")
    assert with_prediction(older, SENSOR.predicted_breakaway) == TEXT
    inline = "name: X\nbreakaway: [{range_cm: 1, half_angle_deg: 2}]  # one"
    assert with_prediction(inline, SENSOR.predicted_breakaway) == f"{inline}\n{TABLE.rstrip()}"
    for awkward in ("{breakaway: [], name: X}\n", "'breakaway': []\n"):
        with pytest.raises(ConfigError, match=r"has to be changed by hand; it lacks:\npredicted_breakaway:"):
            with_prediction(awkward, SENSOR.predicted_breakaway)


def test_light_has_no_prediction(tmp_path: Path) -> None:
    path = tmp_path / "laser.yaml"
    path.write_text((CONFIGS / "sensors" / "lidar_lite_v3.yaml").read_text(encoding="utf-8"), encoding="utf-8")
    assert "ranges with light" in run("msp-lab beam", path, code=3).output
    assert load_sensor_model(path).beam_doubt == ""
