"""What the gap workflow takes in, and what it says of tables that are wrong, thin or odd."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from msp_lab.gap.intake import Readings, read_readings
from msp_lab.readings.column_map import load_map
from msp_range.clock import VirtualClock
from msp_range.recording.csv_form import write_csv
from msp_range.recording.error import RecordingError
from msp_range.recording.writer import Recorder
from msp_range.yaml_file import ConfigError
from msp_sim.model.model import load_model
from tests.support import log_import
from tests.support.measured import MODEL, readings

MODEL_GIVEN = load_model(MODEL)


def taken(folder: Path, columns: dict[str, Any], **options: Any) -> Readings:
    write_csv(folder / "flight.csv", columns)
    return read_readings([folder / "flight.csv"], MODEL_GIVEN, **options)


def test_a_clean_table_comes_in_whole(tmp_path: Path) -> None:
    columns = readings(400)
    found = taken(tmp_path, columns)
    assert len(found.data) == 400
    assert (found.messages, found.calibration) == ((), ())
    assert found.sources[0].rows == 400
    assert len(found.sources[0].sha256) == 64


def test_the_reading_before_is_that_of_the_same_sensor_and_run(tmp_path: Path) -> None:
    columns = readings(200, runs=2)
    columns["sensor"] = np.array(["left", "right"] * 100)
    found = taken(tmp_path, columns).data
    for run in np.unique(found["run"]):
        for name in ("left", "right"):
            rows = (found["run"] == run) & (found["sensor"] == name)
            order = np.argsort(found["time_s"][rows])
            previous = found["previous_reading_cm"][rows][order]
            assert np.isnan(previous[0])
            assert previous[1:].tolist() == found["reading_cm"][rows][order][:-1].tolist()


def test_what_follows_from_other_columns_is_computed_and_said(tmp_path: Path) -> None:
    columns = readings(400, runs=2)
    columns["true_range_cm"] = 300.0 + 100.0 * np.sin(columns["time_s"])
    columns |= {"roll_deg": np.full(400, 3.0), "pitch_deg": np.tile([4.0, -4.0], 200)}
    found = taken(tmp_path, columns)
    np.testing.assert_allclose(found.data["range_rate_cm_s"][2:198], 100.0 * np.cos(columns["time_s"][2:198]), atol=1.0)
    np.testing.assert_allclose(found.data["incidence_deg"], 5.0, rtol=1e-3)
    assert found.messages[:2] == (
        "range_rate_cm_s is computed from true_range_cm over time_s.",
        "incidence_deg is computed from roll_deg and pitch_deg, over level ground.",
    )
    columns["range_rate_cm_s"] = np.full(400, 7.0)
    (tmp_path / "flight.csv").unlink()
    assert set(taken(tmp_path, columns).data["range_rate_cm_s"]) == {7.0}


def test_files_without_runs_are_runs(tmp_path: Path) -> None:
    paths = []
    for seed in (1, 2):
        columns = readings(100, seed)
        del columns["run"]
        write_csv(tmp_path / f"day{seed}.csv", columns)
        paths.append(tmp_path / f"day{seed}.csv")
    found = read_readings(paths, MODEL_GIVEN)
    assert np.unique(found.data["run"]).tolist() == ["day1", "day2"]
    assert any("Found 2 runs" in each and "pauses" not in each for each in found.messages)


def test_flights_in_one_table_are_noticed_by_their_pauses(tmp_path: Path) -> None:
    columns = readings(400)
    del columns["run"]
    columns["time_s"] = columns["time_s"] + 300.0 * (np.arange(400) // 100)
    (message,) = (each for each in taken(tmp_path, columns).messages if "Found 1 run" in each)
    assert "3 pauses of over 30 s" in message
    assert "--map run=COLUMN" in message


def test_files_of_one_name_in_several_folders_are_several_runs(tmp_path: Path) -> None:
    paths = []
    for flight in ("one", "two"):
        columns = readings(200)
        columns["reading_cm"] = columns["reading_cm"] + (flight == "two")
        del columns["run"]
        (tmp_path / flight).mkdir()
        paths.append(tmp_path / flight / "flight.csv")
        write_csv(paths[-1], columns)
    assert set(read_readings(paths, MODEL_GIVEN).data["run"]) == {"one/flight", "two/flight"}


def test_a_column_may_name_the_runs(tmp_path: Path) -> None:
    columns = readings(100)
    columns["battery"] = np.repeat(np.arange(5.0), 20)
    assert np.unique(taken(tmp_path, columns, run_column="battery").data["run"]).tolist() == ["0", "1", "2", "3", "4"]
    with pytest.raises(ConfigError, match=r"--run-column pack: .* has the columns .*battery"):
        read_readings([tmp_path / "flight.csv"], MODEL_GIVEN, run_column="pack")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: {**c, "reading_cm": c["reading_cm"] / 100}, r"Is reading_cm in metres\?"),
        (lambda c: {**c, "true_range_cm": c["true_range_cm"] / 100}, r"Is true_range_cm in metres\?"),
        (lambda c: {name: each[:10] for name, each in c.items()}, "found 10 readings with a true range, expected"),
        (lambda c: {**c, "true_range_cm": np.full(400, np.nan)}, "no true_range_cm"),
    ],
    ids=["readings in metres", "truth in metres", "ten readings", "no truth"],
)
def test_what_cannot_be_compared_is_reported_in_a_line(tmp_path: Path, change: Any, message: str) -> None:
    with pytest.raises(RecordingError, match=message) as raised:
        taken(tmp_path, change(readings(400)))
    assert "\n" not in str(raised.value)


def test_missing_values_are_left_out_and_counted(tmp_path: Path) -> None:
    columns = readings(400)
    columns["reading_cm"][:7] = np.nan
    columns["true_range_cm"][10:15] = np.nan
    found = taken(tmp_path, columns)
    assert len(found.data) == 388
    assert any("7 rows have no reading" in each for each in found.messages)
    assert any("5 readings have no true range" in each for each in found.messages)


def test_rows_that_are_there_twice_count_once(tmp_path: Path) -> None:
    columns = {name: np.concatenate([each, each[:20]]) for name, each in readings(400).items()}
    found = taken(tmp_path, columns)
    assert len(found.data) == 400
    assert any("20 duplicate rows are dropped" in each for each in found.messages)


def test_times_that_are_equal_are_reported(tmp_path: Path) -> None:
    columns = readings(400)
    columns["time_s"] = np.floor(columns["time_s"])
    found = taken(tmp_path, columns)
    assert len(found.data) == 400
    assert any("have the time of the one before" in each for each in found.messages)


def test_readings_off_the_grid_are_rounded_and_called_calibration(tmp_path: Path) -> None:
    columns = readings(400)
    columns["reading_cm"] = np.round(columns["reading_cm"] * 1.013, 1)
    found = taken(tmp_path, columns)
    assert (found.data["reading_cm"] == np.rint(found.data["reading_cm"])).all()
    assert [each.name for each in found.calibration] == ["resolution"]
    assert found.calibration[0].after == 0.1


def test_a_coarser_grid_is_called_calibration(tmp_path: Path) -> None:
    columns = readings(400)
    columns["reading_cm"] = np.rint(columns["reading_cm"] / 5) * 5
    assert taken(tmp_path, columns).calibration[0].after == 5.0


def test_a_code_that_the_model_does_not_declare_is_set_aside(tmp_path: Path) -> None:
    columns = readings(1000)
    columns["reading_cm"][::20] = 511.0
    found = taken(tmp_path, columns)
    assert [each.name for each in found.calibration] == ["code"]
    assert "511 cm comes in 5" in found.calibration[0].finding
    assert not (found.data["reading_cm"] == 511.0).any()


def test_runs_that_go_whole_are_named(tmp_path: Path) -> None:
    """A session of zeros was gone without a line on the terminal."""
    columns = readings(1000)
    dead = np.isin(columns["run"], ["flight-2", "flight-3", "flight-5", "flight-7"])
    columns["reading_cm"] = np.where(dead, 0.0, columns["reading_cm"])
    columns["reading_cm"][900:] = np.nan
    found = taken(tmp_path, columns)
    (code,) = found.calibration
    assert code.finding.endswith(
        "these 400 readings are set aside; nothing else is in 4 runs: flight-2, flight-3, flight-5 and 1 more"
    )
    assert "100 rows have no reading (no answer) and are left out; nothing else is in one run: flight-10." in (
        found.messages
    )


def test_what_stands_in_the_beam_is_no_undeclared_code(tmp_path: Path) -> None:
    columns = readings(2000)
    strut_cm = np.rint(np.random.default_rng(3).normal(33.0, 0.4, 200))
    columns["reading_cm"][::10] = strut_cm
    found = taken(tmp_path, columns)
    assert found.calibration == ()
    assert len(found.data) == 2000


def test_a_table_without_rows_has_no_readings(tmp_path: Path) -> None:
    empty = {name: column[:0] for name, column in readings(10).items()}
    with pytest.raises(RecordingError, match="no readings"):
        taken(tmp_path, empty)


def test_a_fault_at_one_range_is_no_code(tmp_path: Path) -> None:
    """300 cm without its high byte is 44 again and again, but at that range alone: a name will say so."""
    rng = np.random.default_rng(3)
    columns = readings(1200)
    columns["true_range_cm"] = rng.choice([100.0, 200.0, 300.0], 1200)
    fault = (columns["true_range_cm"] == 300.0) & (rng.random(1200) < 0.2)
    columns["reading_cm"] = np.where(fault, 44.0, columns["true_range_cm"])
    found = taken(tmp_path, columns)
    assert [each.name for each in found.calibration if each.name == "code"] == []
    assert (found.data["reading_cm"] == 44.0).sum() == fault.sum()


def test_declared_codes_and_far_offsets_are_no_undeclared_codes(tmp_path: Path) -> None:
    columns = readings(1000, missed=0.2, hit=0.78)
    assert taken(tmp_path, columns).calibration == ()
    columns = readings(1000, seed=2, bias=lambda _: 40.0)
    assert read_readings([_written(tmp_path, columns)], MODEL_GIVEN).calibration == ()


def test_a_context_that_never_changes_is_reported(tmp_path: Path) -> None:
    columns = readings(400)
    columns["air_temperature_c"] = np.full(400, 21.0) + np.arange(400) * 1e-13
    columns["true_range_cm"] = np.full(400, 150.0)
    columns["reading_cm"] = np.where(columns["reading_cm"] > 700, 765.0, 150.0)
    found = taken(tmp_path, columns)
    constant = {each.partition(",")[0] for each in found.messages if " is constant (" in each}
    assert constant == {"air_temperature_c is constant (21)", "range_rate_cm_s is constant (0)"}
    assert any("All readings are at one true range (150 cm)" in each for each in found.messages)
    assert any("air_temperature_c is constant (21)" in each for each in found.messages)


def test_the_same_file_twice_is_refused(tmp_path: Path) -> None:
    path = _written(tmp_path, readings(100))
    with pytest.raises(RecordingError, match="has the same content as"):
        read_readings([path, path], MODEL_GIVEN)


def test_a_cosine_becomes_an_angle(tmp_path: Path) -> None:
    columns = readings(100)
    columns["tilt"] = np.cos(np.radians(np.linspace(0.0, 30.0, 100)))
    path = _written(tmp_path, columns)
    mapping = tmp_path / "map.yaml"
    mapping.write_text("columns: {incidence_deg: {column: tilt, unit: cos}}\n", encoding="utf-8")
    found = read_readings([path], MODEL_GIVEN, load_map([str(mapping)]))
    assert np.sort(found.data["incidence_deg"]) == pytest.approx(np.linspace(0.0, 30.0, 100), abs=1e-5)


def _written(folder: Path, columns: dict[str, Any]) -> Path:
    path = folder / "more.csv"
    write_csv(path, columns)
    return path


@pytest.mark.parametrize(("command", "truth"), [("gap", "recorded"), ("gap", "others"), ("compare", "recorded")])
def test_a_recording_without_a_reading_is_a_line(tmp_path: Path, command: str, truth: str) -> None:
    Recorder(tmp_path / "flight.mcap", VirtualClock()).close()
    done = log_import.run(
        command, tmp_path / "flight.mcap", "--model", MODEL, "--truth", truth, "--out", tmp_path / "out"
    )
    assert done.exit_code == 3
    assert done.stderr.splitlines()[-1] == f"{tmp_path}/flight.mcap: no readings, only a header"
