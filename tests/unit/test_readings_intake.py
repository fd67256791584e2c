"""The one intake of readings: several files as one table, their runs, and what is refused before any analysis."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from msp_lab.readings.column_map import Codes, load_map
from msp_lab.readings.intake import LoadedReadings, load_readings, without_impossible
from msp_lab.readings.resolution import measured_step, step_of
from msp_range.recording.csv_form import MeasuredData, read_csv, write_csv
from msp_range.recording.error import RecordingError
from msp_sim.model.model import Model
from tests.support.plain_bench import point, table
from tests.support.shipped import SENSOR

Columns = dict[str, NDArray[Any]]


def data(seed: int = 1, n: int = 100, **changes: Callable[[Columns], NDArray[Any]]) -> MeasuredData:
    rng = np.random.default_rng(seed)
    columns = dict(table(*(point(rng, z, n=n) for z in (60, 100, 140))).columns)
    return MeasuredData(columns | {name: change(columns) for name, change in changes.items()})


def noticed(found: LoadedReadings) -> tuple[str, ...]:
    """Its messages but for what was computed from other columns."""
    return tuple(each for each in found.messages if " is computed from " not in each)


def written(folder: Path, content: MeasuredData, name: str = "readings.csv") -> Path:
    write_csv(folder / name, content)
    return folder / name


def test_files_are_joined_and_named(tmp_path: Path) -> None:
    one = written(tmp_path, data(1), "one.csv")
    two = written(tmp_path, data(2, air_temperature_c=lambda c: np.full(300, 20.0)), "two.csv")
    found = load_readings([one, two], SENSOR)
    assert len(found.data) == 600
    assert [(each.name, each.rows, len(each.sha256)) for each in found.sources] == [
        ("one.csv", 300, 64),
        ("two.csv", 300, 64),
    ]
    assert np.isnan(found.data["air_temperature_c"][:300]).all()
    assert (found.data["air_temperature_c"][300:] == 20.0).all()
    assert noticed(found) == ("The run 'day' is in 2 files and counts as 2 runs.",)


def test_the_same_file_twice_is_refused(tmp_path: Path) -> None:
    one, copy = written(tmp_path, data(), "one.csv"), written(tmp_path, data(), "copy.csv")
    with pytest.raises(RecordingError, match=r"copy.csv: has the same content as .*one.csv"):
        load_readings([one, copy], SENSOR)


def test_readings_that_are_in_two_files_are_refused(tmp_path: Path) -> None:
    """As in a session's recording and the table that collect makes of all sessions."""
    whole = data()
    one = written(tmp_path, whole, "one.csv")
    part = written(tmp_path, whole.select(np.arange(100, 300)), "part.csv")
    for paths in ([one, part], [part, one]):
        with pytest.raises(RecordingError, match=r"200 of its readings are in .* too; each may count once"):
            load_readings(paths, SENSOR)


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
def test_what_cannot_be_characterised_is_reported_in_a_line(
    tmp_path: Path, content: MeasuredData, message: str
) -> None:
    with pytest.raises(RecordingError, match=message) as raised:
        load_readings([written(tmp_path, content)], SENSOR)
    assert "\n" not in str(raised.value)


def test_readings_that_the_sensor_cannot_make_are_no_answer(tmp_path: Path) -> None:
    def faulty(columns: Columns) -> NDArray[Any]:
        reading: NDArray[Any] = columns["reading_cm"].copy()
        reading[:3] = 0x8000 + 100
        return reading

    loaded = load_readings([written(tmp_path, data(reading_cm=faulty))], SENSOR)
    assert loaded.data["reading_cm"][0] == 32868.0
    found = without_impossible(loaded, SENSOR)
    assert np.isnan(found.data["reading_cm"][:3]).all()
    assert noticed(found) == ("3 readings are outside of the sensor's 20 to 765 cm and count as no answer: 32868",)


def test_a_maps_note_comes_along(tmp_path: Path) -> None:
    path = written(tmp_path, data())
    note = tmp_path / "map.yaml"
    note.write_text("columns: {reading_cm: reading_cm}\nnote: a borrowed ruler\n", encoding="utf-8")
    assert noticed(load_readings([path], SENSOR, load_map([str(note)]))) == ("a borrowed ruler",)


def test_what_a_bridge_made_of_readings_is_no_context(tmp_path: Path) -> None:
    """Else an effect might be found over the very readings that it explains."""
    path = written(
        tmp_path, data(1, corrected_cm=lambda c: c["reading_cm"], rejected=lambda c: np.full(300, "outlier"))
    )
    found = load_readings([path], SENSOR).data
    assert {"corrected_cm", "rejected"} & found.columns.keys() == set()
    assert "reading_cm" in found


def test_flights_that_were_exported_are_a_run_each(tmp_path: Path) -> None:
    """`msp-range export flights/1/flight.mcap 1.csv` calls the run after the recording, as for every other flight."""
    paths = [
        written(tmp_path, data(seed, run=lambda c: np.full(300, "flight")), f"{seed}.csv")
        for seed in (1, 2, 3, 4, 5, 6)
    ]
    found = load_readings(paths, SENSOR)
    assert np.unique(found.data["run"]).tolist() == [f"{seed}/flight" for seed in (1, 2, 3, 4, 5, 6)]
    assert noticed(found) == ("The run 'flight' is in 6 files and counts as 6 runs.",)
    # Each has its own first reading, which none comes before.
    assert np.flatnonzero(np.isnan(found.data["previous_reading_cm"])).tolist() == [0, 300, 600, 900, 1200, 1500]
    together = load_readings(paths, SENSOR, run_column="run")
    assert np.unique(together.data["run"]).tolist() == ["flight"]


def test_runs_of_one_file_keep_their_names(tmp_path: Path) -> None:
    one = written(tmp_path, data(1, run=lambda c: np.repeat(["a", "b", "c"], 100)), "one.csv")
    two = written(tmp_path, data(2, run=lambda c: np.repeat(["c", "", "two"], 100)), "two.csv")
    found = load_readings([one, two], SENSOR)
    assert list(dict.fromkeys(found.data["run"].tolist())) == ["a", "b", "one/c", "two/c", "two"]


def test_rows_stay_in_the_order_and_resolution_of_the_file(tmp_path: Path) -> None:
    """A file in millimetres, backwards in time, with two sensors in turn and five rows twice."""
    content = data(reading_cm=lambda c: c["reading_cm"] + 0.3, sensor=lambda c: np.array(["left", "right"] * 150))
    rows = np.concatenate([np.arange(300)[::-1], np.arange(5)])
    found = load_readings([written(tmp_path, content.select(rows))], SENSOR)
    assert noticed(found) == ("5 duplicate rows are dropped.",)
    assert found.data["reading_cm"].tolist() == content["reading_cm"][::-1].tolist()
    previous = found.data["previous_reading_cm"][::-1]
    assert np.isnan(previous[:2]).all()
    assert previous[2:].tolist() == content["reading_cm"][:-2].tolist()


def test_without_times_nothing_came_before(tmp_path: Path) -> None:
    """Rows of a table without times may be the beams of a scanner, or sorted: equal neighbours are no repeats."""
    rows = [f"{reading},{true}" for reading, true in zip(range(100, 140), range(101, 141), strict=True)]
    path, names = tmp_path / "beams.csv", tmp_path / "map.yaml"
    names.write_text("columns: {reading_cm: r, true_range_cm: z, sensor: {value: laser}}\n", encoding="utf-8")
    path.write_text("r,z\n" + "\n".join(rows) + "\n", encoding="utf-8")
    found = load_readings([path], SENSOR, load_map([str(names)])).data
    assert np.isnan(found["previous_reading_cm"]).all()
    assert np.isnan(found["time_in_run_s"]).all()
    assert "range_rate_cm_s" not in found
    path.write_text("r,z,time_s\n" + "\n".join(f"{row},{k}" for k, row in enumerate(rows)), encoding="utf-8")
    assert load_readings([path], SENSOR, load_map([str(names)])).data["previous_reading_cm"][1] == 100.0


@pytest.mark.parametrize(
    ("step_cm", "ranges_cm", "found_cm"),
    [
        (5.0, np.arange(43.0, 350.0, 11.3), 5.0),
        (10.0, np.arange(43.0, 350.0, 11.3), 10.0),
        (1.0, np.arange(43.0, 350.0, 11.3), 1.0),
        # A quiet sensor of whole centimetres at ranges that are tens.
        (1.0, np.arange(40.0, 350.0, 10.0), 1.0),
    ],
)
def test_the_step_of_a_bench_is_that_of_its_readings(step_cm: float, ranges_cm: Any, found_cm: float) -> None:
    true_cm = np.repeat(ranges_cm, 50)
    reading_cm = step_cm * np.rint((true_cm + 0.1 * np.random.default_rng(1).standard_normal(true_cm.size)) / step_cm)
    words = {name: np.full(true_cm.size, "a") for name in ("run", "sensor")}
    data = MeasuredData({"true_range_cm": true_cm, "reading_cm": reading_cm, **words})
    assert measured_step(data, Model.of(SENSOR)) == found_cm


def test_readings_that_are_all_no_echo_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "bench.csv"
    rows = "".join(f"{k},a,765,{50 + k}\n" for k in range(60))
    path.write_text("time_s,sensor,reading_cm,true_range_cm\n" + rows, encoding="utf-8")
    with pytest.raises(RecordingError, match="all 60 readings are 765 cm, the sensor's code of no echo"):
        load_readings([path], SENSOR)
    path.write_text(path.read_text("utf-8").replace(",765,", ",,"), encoding="utf-8")
    with pytest.raises(RecordingError, match="no row has a reading: reading_cm is empty in all 60"):
        load_readings([path], SENSOR)
    path.write_text("time_s,sensor,reading_cm\nnan,a,100\n", encoding="utf-8")
    with pytest.raises(RecordingError, match="found 'nan', expected a number"):
        read_csv(path)


def test_a_files_step_is_found() -> None:
    rng = np.random.default_rng(1)
    millimetres = np.rint(rng.uniform(300.0, 5000.0, 500))
    assert step_of(millimetres / 10.0) == 0.1
    assert step_of((millimetres / 1000.0).astype(np.float32).astype(float) * 100.0) == 0.1
    assert step_of(np.rint(millimetres / 10.0)) == 1.0
    assert step_of(2.54 * np.rint(millimetres / 25.4)) == 2.54
    assert step_of(rng.uniform(30.0, 500.0, 30)) == 0.0
    with_a_mean = np.append(np.rint(millimetres / 10.0), 400.37)
    assert (step_of(with_a_mean), step_of(with_a_mean, 0.95)) == (0.01, 1.0)


def test_selected_sensors_only(tmp_path: Path) -> None:
    path = written(tmp_path, data(sensor=lambda c: np.array(["left", "right"] * 150)))
    found: LoadedReadings = load_readings([path], SENSOR, sensors=["left"])
    assert (set(found.data["sensor"]), len(found.data), found.sensors) == ({"left"}, 150, ("left",))
    with pytest.raises(RecordingError, match=r"no readings of the sensor 'centre'; there are some of left, right"):
        load_readings([path], SENSOR, sensors=["centre"])


def test_the_time_in_the_run_is_made_from_the_time(tmp_path: Path) -> None:
    half = np.arange(300) >= 150
    columns = data(run=lambda c: np.where(half, "b", "a"), time_s=lambda c: 1000.0 * half + 0.1 * np.arange(300))
    found = load_readings([written(tmp_path, columns)], SENSOR).data["time_in_run_s"]
    assert (found[0], found[150]) == (0.0, 0.0)
    assert [found[149], found[299]] == pytest.approx([14.9, 14.9])


def test_a_time_since_power_up_is_not_doubled(tmp_path: Path) -> None:
    known = written(tmp_path, data(uptime_s=lambda c: c["time_s"] + 5.0))
    assert "time_in_run_s" not in load_readings([known], SENSOR).data


def line(tmp_path: Path, text: str, **options: Any) -> LoadedReadings:
    (tmp_path / "table.csv").write_text(text)
    return load_readings([tmp_path / "table.csv"], SENSOR, **options)


RANGES_CM = range(50, 250)


def test_a_reading_and_a_true_range_are_enough(tmp_path: Path) -> None:
    rows = "".join(f"{cm + 1},{cm}\n" for cm in RANGES_CM)
    found = line(tmp_path, f"reading_cm,true_range_cm\n{rows}")
    assert (found.data["reading_cm"] - found.data["true_range_cm"]).tolist() == [1.0] * 200
    assert np.unique(found.data["sensor"]).tolist() == ["table"]
    # Numbers of rows are no time: nothing drifts over them, and no reading is the one before.
    assert np.isnan(found.data["previous_reading_cm"]).all()
    # A name that is like the missing one is a misspelling, and no context.
    with pytest.raises(RecordingError, match=r"'time_s' is missing\. Is it 'time'\?.*--map NAME=COLUMN"):
        line(tmp_path, "time,reading_cm,true_range_cm\n1,50,50\n")
    with pytest.raises(RecordingError, match="'reading_cm' is missing"):
        line(tmp_path, "dist,true_range_cm\n1,2\n")


@pytest.mark.parametrize("zone", ["Z", "+00:00", ""])
def test_times_of_iso_8601_are_times(tmp_path: Path, zone: str) -> None:
    rows = "".join(
        f"2026-05-01T12:{i // 600:02d}:{i / 10 % 60:06.3f}{zone},a,{cm},{cm}\n" for i, cm in enumerate(RANGES_CM)
    )
    found = line(tmp_path, f"time_s,sensor,reading_cm,true_range_cm\n{rows}")
    np.testing.assert_allclose(np.diff(found.data["time_s"]), 0.1, atol=1e-6)
    np.testing.assert_allclose(found.data["range_rate_cm_s"], 10.0, rtol=1e-4)
    mapped = line(tmp_path, f"when,sensor,reading_cm,true_range_cm\n{rows}", column_map=load_map(["time_s=when"]))
    np.testing.assert_array_equal(mapped.data["time_s"], found.data["time_s"])


def test_negative_readings_are_codes_and_no_distances(tmp_path: Path) -> None:
    rows = "".join(f"{i / 10},a,{-1 if i == 7 else -2 if i == 9 else cm},{cm}\n" for i, cm in enumerate(RANGES_CM))
    found = line(tmp_path, f"time_s,sensor,reading_cm,true_range_cm\n{rows}")
    assert np.flatnonzero(np.isnan(found.data["reading_cm"])).tolist() == [7, 9]
    note = next(each for each in found.messages if "negative" in each)
    assert "2 negative readings are codes and no distances, and count as no answer: -2, -1" in note
    codes = load_map(["reading_cm=reading_cm"]).model_copy(update={"codes": Codes(no_echo=(-1.0,))})
    declared = line(tmp_path, (tmp_path / "table.csv").read_text(), column_map=codes)
    assert declared.data["reading_cm"][[7, 9]].tolist() == pytest.approx([765.0, np.nan], nan_ok=True)


def test_angles_of_a_flight_are_no_set_ups(tmp_path: Path) -> None:
    """A breakaway angle at each of hundreds of ranges would be made of them."""
    rng = np.random.default_rng(1)
    for angles, is_kept in ((rng.uniform(0.0, 4.0, 300), False), (np.repeat((0.0, 5.0, 10.0), 100), True)):
        flown = MeasuredData({**data().columns, "incidence_deg": angles})
        found = without_impossible(load_readings([written(tmp_path, flown, f"{is_kept}.csv")], SENSOR), SENSOR)
        assert ("incidence_deg" in found.data) == is_kept
        assert any("no angle was set up" in each for each in found.messages) != is_kept
