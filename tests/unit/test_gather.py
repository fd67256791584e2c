"""Readings from several files, and what is told before anything is analysed."""

from pathlib import Path

import numpy as np
import pytest

from msp_lab.readings.column_map import load_map
from msp_lab.readings.gather import gather
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_range.recording.csv_form import MeasuredData, write_csv
from msp_range.recording.error import RecordingError
from tests.support.plain_bench import point, table

SENSOR = load_sensor_model(Path(__file__).parents[2] / "configs" / "sensors" / "mb1242.yaml")


def data(seed: int = 1, n: int = 100, **changes) -> MeasuredData:
    rng = np.random.default_rng(seed)
    columns = dict(table(*(point(rng, z, n=n) for z in (60, 100, 140))).columns)
    return MeasuredData(columns | {name: change(columns) for name, change in changes.items()})


def written(folder: Path, content: MeasuredData, name: str = "readings.csv") -> Path:
    write_csv(folder / name, content)
    return folder / name


def test_files_are_joined_and_named(tmp_path: Path) -> None:
    one = written(tmp_path, data(1), "one.csv")
    two = written(tmp_path, data(2, air_temperature_c=lambda c: np.full(300, 20.0)), "two.csv")
    found = gather([one, two], SENSOR)
    assert len(found.data) == 600
    assert [(each.name, each.rows, len(each.sha256)) for each in found.sources] == [
        ("one.csv", 300, 64),
        ("two.csv", 300, 64),
    ]
    assert np.isnan(found.data["air_temperature_c"][:300]).all()
    assert (found.data["air_temperature_c"][300:] == 20.0).all()
    assert found.warnings == ()


def test_the_same_file_twice_is_refused(tmp_path: Path) -> None:
    one, copy = written(tmp_path, data(), "one.csv"), written(tmp_path, data(), "copy.csv")
    with pytest.raises(RecordingError, match=r"copy.csv: has the same content as .*one.csv"):
        gather([one, copy], SENSOR)


def test_readings_that_are_in_two_files_are_refused(tmp_path: Path) -> None:
    """As in a sitting's recording and the table that collect makes of all sittings."""
    whole = data()
    one = written(tmp_path, whole, "one.csv")
    part = written(tmp_path, whole.select(np.arange(100, 300)), "part.csv")
    for paths in ([one, part], [part, one]):
        with pytest.raises(RecordingError, match=r"200 of its readings are in .* too; each may count once"):
            gather(paths, SENSOR)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (data(n=3), "found 9 readings with a true range, expected at least 30"),
        (data(true_range_cm=lambda c: np.full(300, np.nan)), "no true_range_cm"),
        (data(true_range_cm=lambda c: c["true_range_cm"] / 100), r"Is true_range_cm in metres\? .*COLUMN\*100"),
        (data(reading_cm=lambda c: c["reading_cm"] / 100), r"Is reading_cm in metres\?"),
        (data(reading_cm=lambda c: np.rint(c["reading_cm"] / 2.54)), r"Is reading_cm in inches\? .*COLUMN\*2.54"),
        (
            data(reading_cm=lambda c: c["reading_cm"] / 100, true_range_cm=lambda c: c["true_range_cm"] / 100),
            "Are both in metres",
        ),
    ],
)
def test_what_cannot_be_characterised_is_told_in_a_line(tmp_path: Path, content: MeasuredData, message: str) -> None:
    with pytest.raises(RecordingError, match=message) as told:
        gather([written(tmp_path, content)], SENSOR)
    assert "\n" not in str(told.value)


def test_readings_that_the_sensor_cannot_make_are_no_answer(tmp_path: Path) -> None:
    def faulty(columns):
        reading = columns["reading_cm"].copy()
        reading[:3] = 0x8000 + 100
        return reading

    found = gather([written(tmp_path, data(reading_cm=faulty))], SENSOR)
    assert np.isnan(found.data["reading_cm"][:3]).all()
    assert found.warnings == ("3 readings are outside of the sensor's 20 to 765 cm and count as no answer: 32868",)


def test_a_maps_note_comes_along(tmp_path: Path) -> None:
    path = written(tmp_path, data())
    note = tmp_path / "map.yaml"
    note.write_text("columns: {reading_cm: reading_cm}\nnote: a borrowed ruler\n", encoding="utf-8")
    assert gather([path], SENSOR, load_map([str(note)])).warnings == ("a borrowed ruler",)
