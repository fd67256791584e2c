"""A log's reading of no echo in the code of the model that it is compared with."""

from pathlib import Path

import numpy as np
import pytest

from msp_lab.readings.dataset import read_dataset
from msp_lab.readings.intake import load_readings
from msp_lab.readings.no_echo import NO_ECHO, in_code_of
from msp_range.recording.csv_form import MeasuredData, write_csv
from tests.support.flight_logs import telemetry, write_telemetry
from tests.support.programs import run
from tests.support.shipped import SENSOR
from tests.support.slow import slow


def readings(*rows: tuple[float, float, float]) -> MeasuredData:
    """Of a reading, the log's reading of no echo and the true range each."""
    reading_cm, no_echo_cm, true_cm = np.array(rows).T
    return MeasuredData({"reading_cm": reading_cm, NO_ECHO: no_echo_cm, "true_range_cm": true_cm})


@pytest.mark.parametrize("maximum_cm", [700.0, 1200.0])
def test_the_maximum_of_the_log_becomes_that_of_the_model(maximum_cm: float) -> None:
    data = readings(
        (maximum_cm, maximum_cm, 300.0), (300.0, maximum_cm, 300.0), (np.nan, maximum_cm, 1.0), (700.0, np.nan, 700.0)
    )
    found, (message,) = in_code_of(SENSOR, data)
    np.testing.assert_array_equal(found["reading_cm"], [765.0, 300.0, np.nan, 700.0])
    np.testing.assert_array_equal(found[NO_ECHO], [765.0, 765.0, 765.0, np.nan])
    assert message == f"No echo is {maximum_cm:g} cm in the log and 765 cm in the model: 1 readings."


def test_where_the_log_hides_what_the_model_could_read_a_reading_is_left_out() -> None:
    """A sensor of 765 cm at 720 cm reads 720, which an autopilot with a maximum of 700 cm cuts."""
    data = readings((700.0, 700.0, 600.0), (700.0, 700.0, 720.0), (700.0, 700.0, 900.0), (700.0, 700.0, np.nan))
    found, (message,) = in_code_of(SENSOR, data)
    np.testing.assert_array_equal(found["reading_cm"], [765.0, np.nan, 765.0, 765.0])
    assert "Left out: 1 of these, at true ranges from 95 % of the log's maximum to the model's" in message


def test_the_same_maximum_changes_nothing() -> None:
    data = readings((765.0, 765.0, 300.0), (300.0, 765.0, 300.0))
    found, messages = in_code_of(SENSOR, data)
    assert found["reading_cm"].tolist() == [765.0, 300.0]
    assert messages == []


def test_a_table_made_of_an_imported_log_has_it_too(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    true_cm = rng.uniform(100.0, 500.0, 100)
    reading_cm = np.where(rng.random(100) < 0.2, 600.0, np.round(true_cm))
    columns = {"time_s": np.arange(100.0), "sensor": np.full(100, "a"), "true_range_cm": true_cm}
    write_csv(tmp_path / "a.csv", {**columns, "reading_cm": reading_cm, NO_ECHO: np.full(100, 600.0)})
    found = load_readings([tmp_path / "a.csv"], SENSOR).data
    assert (found["reading_cm"] == 765.0).sum() == (reading_cm == 600.0).sum() > 10
    assert NO_ECHO not in found
    write_csv(tmp_path / "b.csv", {**columns, "reading_cm": reading_cm, NO_ECHO: np.full(100, "none")})
    assert load_readings([tmp_path / "b.csv"], SENSOR).data["reading_cm"].max() == 600.0


@pytest.mark.parametrize("truth", ["ekf", *slow("others")])
def test_an_imported_log_with_another_maximum_has_the_misses_of_the_model(tmp_path: Path, truth: str) -> None:
    messages = telemetry()
    for _, _, message in messages:
        if message.get_type() == "DISTANCE_SENSOR":
            message.max_distance = 650
            # Three that look down, for the others.
            message.orientation, message.id = (25, message.id) if message.id == 10 else (0, 0)
    path = write_telemetry(tmp_path / "a.tlog", messages)
    if truth == "others":
        down = [each for each in messages if getattr(each[2], "orientation", -1) == 25]
        for number in (11, 12):
            for time_s, component, message in down:
                values = {name: getattr(message, name) for name in message.fieldnames} | {"id": number}
                messages.append((time_s + 0.001 * number, component, type(message)(**values)))
        messages.sort(key=lambda each: each[0])
        path = write_telemetry(tmp_path / "a.tlog", messages)
    done = run("msp-lab import", path, "--truth", truth, "--out", tmp_path / "set")
    shown = " ".join(done.output.split())
    assert "12 without an echo within" in shown
    loaded = load_readings([tmp_path / "set"], SENSOR, sensors=["distance_sensor_10"])
    assert (loaded.data["reading_cm"] == 765.0).sum() == 12
    assert not (loaded.data["reading_cm"] == 650.0).any()
    assert NO_ECHO not in loaded.data
    # Next to others it had the code of the model while they were compared, so that no echo was no distance.
    kept = read_dataset(tmp_path / "set")
    assert set(kept[NO_ECHO]) == {650.0 if truth == "ekf" else 765.0}
