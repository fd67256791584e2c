"""Logs into a dataset and from there into an answer, by the commands."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from numpy.typing import NDArray

from msp_lab.logs import px4, show
from msp_lab.logs.join import Joined, join
from msp_lab.logs.log import TILT, LoggedFlight, Ranger, Series, TruthSource, VehicleLog, make_ranger
from msp_lab.logs.recorded import rangers_of
from msp_lab.readings.dataset import read_dataset
from msp_lab.readings.intake import load_readings
from msp_range.arrays import Array
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_range.recording.csv_form import MeasuredData, read_csv, write_csv
from tests.support.flight_logs import telemetry, write_telemetry
from tests.support.log_import import LOGS, imported
from tests.support.measured import MODEL, readings
from tests.support.programs import run

RECORDING = Path(__file__).parents[1] / "loop" / "recordings" / "old_keys.mcap"


def follows(data: MeasuredData) -> bool:
    """Whether the rate is that of the true range, upwards positive."""
    rate_cm_s = np.gradient(data["true_range_cm"], data["time_s"])
    known = np.isfinite(rate_cm_s) & np.isfinite(data["range_rate_cm_s"])
    return bool(np.corrcoef(rate_cm_s[known], data["range_rate_cm_s"][known])[0, 1] > 0.8)


def test_an_ardupilot_log_has_readings_context_and_truth(tmp_path: Path) -> None:
    (found,) = imported(LOGS / "arducopter.BIN", "--out", tmp_path / "set")
    assert found["form"].startswith("ArduPilot dataflash log, ArduCopter V4.7.0-dev")
    assert (found["truth"], found["truth_source"]) == ("simulator", "SIM.Alt")
    (ranger,) = found["rangers"]
    # Three silences of seconds, each a status of no data.
    assert (ranger["readings"], ranger["silent"], ranger["high_cm"]) == (890, 173, 623.0)
    lag_s, low_s, high_s = ranger["lag_s"]
    # The bridge's own recordings of these flights say 0.06 s to the echo; polling and RFND's 20 Hz add the rest.
    assert low_s < lag_s < high_s
    assert 0.05 < low_s < high_s < 0.16
    assert {each["column"] for each in found["missing"]} == {"air_temperature_c", "humidity_pct", "neighbour_lag_ms"}
    data = read_dataset(tmp_path / "set")
    assert set(data["run"]) == {"arducopter"}
    flown = data["true_range_cm"] > 100.0
    assert 550.0 < np.nanmax(data["true_range_cm"]) < 650.0
    assert 0.3 < np.nanmedian(data["throttle"][flown]) < 0.4
    assert np.nanmax(np.abs(data["range_rate_cm_s"])) < 300.0
    assert np.nanmax(data["incidence_deg"]) < 10.0
    assert follows(data)
    error_cm = (data["reading_cm"] - data["true_range_cm"])[flown]
    assert abs(np.nanmedian(error_cm)) < 3.0
    table = pq.read_table(
        tmp_path / "set" / "run=arducopter" / "sensor=RNGFND1" / "readings.parquet", partitioning=None
    )
    assert "run" not in table.column_names


def test_the_example_of_the_document_is_what_is_printed(tmp_path: Path) -> None:
    text = (LOGS.parents[2] / "docs" / "logs.md").read_text()
    shown = text.split("arducopter.BIN --out build/logs/set\n")[1].split("      ...\n")[0]
    printed = run("msp-lab import", LOGS / "arducopter.BIN", "--out", tmp_path / "set").output
    lines = {line.strip() for line in printed.splitlines()}
    missing = [line for line in shown.splitlines() if line.strip() not in lines | {""} and "arducopter.BIN" not in line]
    assert missing == []


def test_the_lag_is_taken_off_where_it_is_asked_for(tmp_path: Path) -> None:
    imported(LOGS / "arducopter.BIN", "--out", tmp_path / "left")
    imported(LOGS / "arducopter.BIN", "--out", tmp_path / "off", "--align")
    scatter = {}
    for name in ("left", "off"):
        data = read_dataset(tmp_path / name)
        moving = np.abs(data["range_rate_cm_s"]) > 50.0
        scatter[name] = np.nanmedian(np.abs(data["reading_cm"] - data["true_range_cm"])[moving])
    assert scatter["off"] < 0.5 * scatter["left"]


def test_a_reference_that_stays_while_the_range_changes_is_named(tmp_path: Path) -> None:
    """A vehicle that was not moved, whose sensor was turned to other things: seen in a real log of ArduSub."""
    messages = telemetry()
    for _, _, message in messages:
        if message.get_type() == "GLOBAL_POSITION_INT":
            message.relative_alt = -5 + message.time_boot_ms % 3
    path = write_telemetry(tmp_path / "bench.tlog", messages)
    (found,) = imported(path, "--out", tmp_path / "set")
    down = found["rangers"][0]
    assert down["lag_s"] is None
    assert down["reference_span_cm"] == pytest.approx(0.2, abs=0.01)
    printed = " ".join(run("msp-lab import", path, "--out", tmp_path / "shown").output.split())
    assert "the reference changes by 0.2 cm in all, and the readings differ from it by more" in printed


def test_a_px4_log_has_readings_and_its_height_is_refused(tmp_path: Path) -> None:
    (found,) = imported(LOGS / "px4.ulg", "--out", tmp_path / "set")
    assert found["form"] == "PX4 ULog, PX4 1.17.0"
    (ranger,) = found["rangers"]
    assert ranger["readings"] == ranger["with_truth"] == 596
    lag_s, low_s, high_s = ranger["lag_s"]
    assert 0.0 < low_s < lag_s < high_s < 0.12
    assert follows(read_dataset(tmp_path / "set"))
    assert "cs_rng_hgt is set" in found["others"]["ekf"]
    done = run("msp-lab import", LOGS / "px4.ulg", "--truth", "ekf", "--out", tmp_path / "other", code=3)
    assert "cs_rng_hgt is set for 93 % of the time" in done.output
    assert "Independent references in the log: barometer, simulator" in done.output


def test_an_invalid_signal_of_px4_or_a_reading_below_its_minimum_is_no_answer() -> None:
    def flown(topic: dict[str, NDArray[Any]]) -> LoggedFlight:
        return LoggedFlight(distance_sensor=px4.messages_of("distance_sensor", topic, np.arange(3)))

    topic = {
        "timestamp": np.arange(3) * 10**6,
        "current_distance": np.array([2.0, 2.0, 0.2]),
        "min_distance": np.full(3, 0.4),
        "max_distance": np.full(3, 7.0),
        "signal_quality": np.array([100, 0, -1]),
    }
    (ranger,) = px4._rangers(flown(topic))
    assert np.isnan(ranger.series.values).tolist() == [False, True, True]
    assert ranger.too_near == 1
    (ranger,) = px4._rangers(flown({key: topic[key] for key in topic if key != "min_distance"}))
    assert np.isnan(ranger.series.values).tolist() == [False, True, False]


@pytest.mark.parametrize(
    ("log", "name", "damaged"),
    [
        ("px4.ulg", b"max_distance", b"max_distancf"),
        ("arducopter.BIN", b"TimeUS,Instance,Dist", b"TimeUR,Instance,Dist"),
        ("arducopter.BIN", b"PARMQNff", b"PARMQfff"),
    ],
)
def test_a_log_with_a_damaged_definition_is_a_line(tmp_path: Path, log: str, name: bytes, damaged: bytes) -> None:
    content = (LOGS / log).read_bytes()
    path = tmp_path / log
    assert name in content
    path.write_bytes(content.replace(name, damaged))
    done = run("msp-lab import", path, "--truth", "ekf", "--out", tmp_path / "set", code=3)
    assert done.output.count("\n") == 1


@pytest.mark.parametrize("size", [16, 300, 37_302])
def test_a_log_that_is_cut_in_its_definitions_is_a_line(tmp_path: Path, size: int) -> None:
    (tmp_path / "cut.ulg").write_bytes((LOGS / "px4.ulg").read_bytes()[:size])
    done = run("msp-lab import", tmp_path / "cut.ulg", "--out", tmp_path / "set", code=3)
    assert done.output.count("\n") == 1


def test_a_recording_and_a_table_keep_what_they_have(tmp_path: Path) -> None:
    write_csv(tmp_path / "bench.csv", readings(400, runs=2))
    found = imported(RECORDING, tmp_path / "bench.csv", "--out", tmp_path / "set")
    assert [each["truth"] for each in found] == ["recorded", "recorded"]
    data = read_dataset(tmp_path / "set")
    assert set(data["run"]) == {"old_keys", "bench/run0", "bench/run1"} or len(set(data["run"])) == 3
    given, kept = read_csv(tmp_path / "bench.csv"), data.select(np.char.startswith(data["run"], "bench"))
    for name in ("reading_cm", "true_range_cm"):
        assert sorted(kept[name].tolist()) == sorted(given[name].tolist())


def test_readings_at_one_time_all_stay_in_their_order() -> None:
    near = make_ranger(
        "a",
        Series("a", np.array([2.0, 1.0, 1.0]), np.array([0.5, 0.05, 0.6])),
        True,
        np.full(3, 7.0),
        np.array([0, 1, 0]) > 0,
        np.zeros(3, dtype=bool),
    )
    np.testing.assert_array_equal(near.series.values, [np.nan, 60.0, 50.0])
    assert near.series.time_s.tolist() == [1.0, 1.0, 2.0]
    assert near.too_near == 1


def test_rows_of_a_table_are_put_in_the_order_of_their_times(tmp_path: Path) -> None:
    table = {"time_s": np.array([2.0, 1.0]), "sensor": np.array(["a", "a"]), "reading_cm": np.array([20.0, 10.0])}
    (ranger,) = rangers_of(tmp_path, MeasuredData(table), 765.0)
    assert ranger.series.values.tolist() == [10.0, 20.0]


def test_without_a_datum_and_too_few_readings_there_is_no_truth() -> None:
    """An altitude above the sea is no range."""
    time_s = np.arange(30.0)
    ranger = Ranger("down", Series("a", time_s, np.full(30, 300.0)))
    altitude = TruthSource("rtk", Series("GPS.Alt", time_s, np.full(30, 584.0)))
    (joined,) = join(VehicleLog(Path("a"), "", (ranger,), {}, (altitude,)), altitude, np.random.default_rng(1))
    assert "true_range_cm" not in joined.data
    assert joined.notes == (
        "no true range: found 30 readings with an echo and GPS.Alt, expected at least 50 to find the constant between "
        "the two",
    )


def flown(
    tilt_deg: Array, reference: Series, kind: str = "ekf", *, is_down: tuple[bool, ...] = (True,)
) -> list[Joined]:
    """Readings at 10 Hz for 30 s over a climb of 1 to 5 m, at these tilts, compared with a reference."""
    time_s = np.arange(300) / 10.0
    rangers = [
        Ranger(f"r{number}", Series("a", time_s, 100.0 * height_of(time_s)), down)
        for number, down in enumerate(is_down)
    ]
    source = TruthSource(kind, reference)
    context = {TILT: Series("ATT", time_s, tilt_deg)}
    return join(VehicleLog(Path("a"), "", tuple(rangers), context, (source,)), source, np.random.default_rng(1))


def height_of(time_s: Array) -> Array:
    return 3.0 + 2.0 * np.sin(time_s / 3.0)


def height_at(time_s: Array) -> Series:
    return Series("XKF1.PD", time_s, height_of(time_s))


def test_a_reference_that_is_late_is_called_so() -> None:
    """As an altitude of GNSS, which comes 0.5 s after a lidar."""
    assert show._lag(-0.524, -0.818, -0.255, is_shifted=False) == (
        "0.524 s earlier than the reference (0.255 to 0.818), left in: so much later than the range finder is the "
        "reference, or its clock"
    )
    assert show._lag(-0.02, -0.05, 0.01, is_shifted=True) == (
        "0.020 s earlier than the reference (-0.010 to 0.050), taken off"
    )


def test_a_lag_that_cannot_be_seen_has_the_numbers_that_say_why() -> None:
    found = show._why_no_lag("its 95 % interval is -0.61 to 0.95 s", 57.0, 1216.0)
    assert found == (
        "its 95 % interval is -0.61 to 0.95 s; the reference changes by 1216.0 cm, the readings scatter about it by "
        "57.0 cm"
    )


def test_an_overturned_sensor_has_no_true_range_and_a_steep_one_a_line() -> None:
    """As before the attitude is known, and in a crash; 'gap' refuses an incidence above 90 deg."""
    tilt_deg = np.full(300, 5.0)
    tilt_deg[:2], tilt_deg[-3:], tilt_deg[100:104] = 90.94, 128.0, 60.0
    (joined,) = flown(tilt_deg, height_at(np.arange(300) / 10.0))
    assert np.flatnonzero(np.isnan(joined.data["true_range_cm"])).tolist() == [0, 1, 297, 298, 299]
    assert np.nanmax(joined.data["incidence_deg"]) == 60.0
    overturned, steep = joined.notes
    assert overturned.startswith("no true range and no incidence_deg for 5 readings at a tilt of 90 deg or more")
    assert steep.startswith("the height is the true range of 4 readings at tilts above 45 deg too")


def test_readings_that_lose_their_truth_in_holes_of_the_reference_are_counted() -> None:
    time_s = np.arange(300) / 10.0
    there = (time_s > 1.95) & ~((time_s > 10.05) & (time_s < 12.95)) & (time_s < 28.95)
    (joined,) = flown(np.zeros(300), height_at(time_s[there]))
    (note,) = joined.notes
    # 0 to 1.9 s and 29 to 29.9 s are outside, 10.1 to 13.0 s in the hole.
    assert note == (
        "no true range for 60 readings: 30 before the reference begins or after it ends, 30 in holes of the reference "
        "of more than 1 s"
    )
    assert np.isnan(joined.data["true_range_cm"]).sum() == 60


def test_a_column_is_no_truth_of_a_sensor_that_does_not_look_down_next_to_one_that_does() -> None:
    whole = height_at(np.arange(300) / 10.0)
    down, forward = flown(np.zeros(300), whole, "column", is_down=(True, False))
    assert "true_range_cm" in down.data
    assert "true_range_cm" not in forward.data
    # Of sensors on a bench that all look forward, a column can be the distance to the wall.
    (alone,) = flown(np.zeros(300), whole, "column", is_down=(False,))
    assert "true_range_cm" in alone.data


def test_the_same_sensor_of_another_log_is_a_reference(tmp_path: Path) -> None:
    mine, other = (write_telemetry(tmp_path / name, telemetry()) for name in ("mine.tlog", "other.tlog"))
    (found,) = imported(mine, "--truth", f"sensor:distance_sensor_10@{other}", "--out", tmp_path / "set")
    down, forward = found["rangers"]
    assert (down["with_truth"], forward["with_truth"]) == (598, 0)


def test_folders_with_a_dot_tell_logs_of_one_name_apart(tmp_path: Path) -> None:
    for folder in ("v1.0", "v1.1"):
        (tmp_path / folder).mkdir()
        write_csv(tmp_path / folder / "bench.csv", readings(100, runs=1))
    found = imported(*sorted(tmp_path.glob("v*/bench.csv")), "--out", tmp_path / "set")
    assert [each["runs"] for each in found] == [["v1.0/bench/flight-1"], ["v1.1/bench/flight-1"]]


def test_a_dataset_is_read_like_its_files(tmp_path: Path) -> None:
    write_csv(tmp_path / "bench.csv", readings(400, runs=4))
    imported(tmp_path / "bench.csv", "--out", tmp_path / "set")
    model = load_sensor_model(MODEL)
    direct, through = (load_readings([path], model) for path in (tmp_path / "bench.csv", tmp_path / "set"))
    for name in ("reading_cm", "true_range_cm", "previous_reading_cm"):
        assert np.nansum(direct.data[name]) == np.nansum(through.data[name])
    assert len(set(through.data["run"])) == 4
    again = load_readings([tmp_path / "set"], model)
    assert again.sources == through.sources


@pytest.mark.slow
def test_a_log_becomes_an_answer_in_one_command(tmp_path: Path) -> None:
    out = tmp_path / "gap"
    log, model = LOGS / "arducopter.BIN", MODEL.parent / "mb1242.yaml"
    imported(log, "--out", out / "readings")  # what an earlier comparison left
    done = run("msp-lab compare", log, "--truth", "simulator", "--model", model, "--out", out)
    assert "0.112 s later than the reference" in done.output
    findings = json.loads((out / "gap.json").read_text())
    assert findings["sources"][0]["path"] == str(out / "readings")
    run("msp-lab name", out)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["{logs}/arducopter.BIN", "--truth", "rtk2"], "--truth rtk2: expected recorded:"),
        (["{logs}/px4.ulg", "--truth", "mocap"], "no mocap in this log. References that it has: barometer, simulator"),
        (["{logs}/px4.ulg", "--truth", "sensor:lidar"], "no range finder 'lidar' in this log; it has distance_sensor"),
        (["{logs}/px4.ulg", "--truth", "column:a.b"], "no column:a.b in this log"),
        (
            ["{logs}/px4.ulg", "--truth", "recorded"],
            "this PX4 ULog, PX4 1.17.0 has no true_range_cm next to its readings",
        ),
        (["{logs}/px4.ulg", "--map", "reading_cm=a"], "--map is for CSV tables"),
        (["{tmp}/empty.bin"], "empty"),
        (["{tmp}/none.bin"], "cannot be read: No such file"),
        (["{tmp}/cut.ulg"], "cut.ulg"),
        (["{tmp}/picture.png"], "no log that is known"),
        (["{logs}/px4.ulg", "{logs}/px4.ulg"], "px4"),
    ],
)
def test_what_cannot_be_imported_is_a_line(tmp_path: Path, arguments: list[str], expected: str) -> None:
    (tmp_path / "empty.bin").touch()
    (tmp_path / "cut.ulg").write_bytes((LOGS / "px4.ulg").read_bytes()[:12])
    (tmp_path / "picture.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(100))
    given = [each.format(logs=LOGS, tmp=tmp_path) for each in arguments]
    done = run("msp-lab import", *given, "--out", tmp_path / "set", code=3)
    assert expected in done.output
    assert done.output.count("\n") == 1


def test_every_bad_file_is_named_and_the_others_are_imported(tmp_path: Path) -> None:
    bad = tmp_path / "one.png", tmp_path / "cut.ulg"
    bad[0].write_bytes(b"\x89PNG\r\n\x1a\n")
    bad[1].write_bytes((LOGS / "px4.ulg").read_bytes()[:12])
    done = run("msp-lab import", bad[0], LOGS / "px4.ulg", bad[1], "--out", tmp_path / "set", code=4)
    assert "2 of 3 logs could not be imported" in done.stderr
    assert set(read_dataset(tmp_path / "set")["run"]) == {"px4"}
    other = run("msp-lab import", *bad, "--out", tmp_path / "other", code=3)
    for lines in (done.stderr.splitlines()[-2:], other.output.splitlines()):
        picture, cut = lines
        assert "one.png: no log that is known" in picture
        assert "cut.ulg: " in cut


def test_a_run_is_added_once(tmp_path: Path) -> None:
    imported(LOGS / "px4.ulg", "--out", tmp_path / "set")
    imported(LOGS / "arducopter.BIN", "--out", tmp_path / "set")
    done = run("msp-lab import", LOGS / "px4.ulg", "--out", tmp_path / "set", code=3)
    assert "there is a run 'px4' already" in done.output
    assert set(read_dataset(tmp_path / "set")["run"]) == {"px4", "arducopter"}


@pytest.mark.slow
def test_the_same_dataset_whatever_the_number_of_jobs(tmp_path: Path) -> None:
    logs = LOGS / "px4.ulg", LOGS / "arducopter.BIN"
    for jobs in (1, 2):
        imported(*logs, "--out", tmp_path / str(jobs), "--jobs", jobs)
    files = [sorted(path for path in (tmp_path / jobs).rglob("*") if path.is_file()) for jobs in "12"]
    assert len(files[0]) == 3
    for one, two in zip(*files, strict=True):
        assert one.relative_to(tmp_path / "1") == two.relative_to(tmp_path / "2")
        assert one.read_bytes() == two.read_bytes()


def test_a_format_that_cannot_be_loaded_leaves_the_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    metadata = tmp_path / "site" / "somebodys_logs-1.0.dist-info"
    metadata.mkdir(parents=True)
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: somebodys-logs\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text("[msp_lab.logs]\nbroken = somebodys_missing_logs:FORMAT\n")
    monkeypatch.syspath_prepend(tmp_path / "site")
    write_csv(tmp_path / "bench.csv", readings(100))
    (found,) = imported(tmp_path / "bench.csv", "--out", tmp_path / "set")
    assert found["form"] == "CSV table"
    (tmp_path / "log.pilot").write_bytes(b"PILOT 1\n")
    done = run("msp-lab import", tmp_path / "log.pilot", "--out", tmp_path / "other", code=3)
    assert "no log that is known" in done.output
    assert "the log format 'broken' (somebodys_missing_logs:FORMAT) cannot be loaded" in done.output
