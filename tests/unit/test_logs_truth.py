"""Which true range a log gives: what counts, what is refused, and what replaces a recorded one."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from msp_lab.logs import ardupilot, px4, truth
from msp_lab.logs.fused import by_any, by_ekf2_of_ardupilot, by_px4
from msp_lab.logs.log import LoggedFlight, LogRequest, Series, VehicleLog
from msp_lab.logs.recorded import rangers_of
from msp_lab.readings.dataset import read_dataset
from msp_range.recording.csv_form import MeasuredData, write_csv
from tests.support.flight_logs import telemetry, write_telemetry
from tests.support.log_import import LOGS, imported
from tests.support.measured import readings
from tests.support.programs import run


def test_a_height_counts_until_the_range_is_fused_into_it() -> None:
    height = Series("z", np.arange(10.0), np.arange(10.0))
    stamps = np.array([0, 6_500_000])
    flags: dict[str, dict[str, Any]] = {"estimator_status_flags": {"timestamp": stamps, "cs_rng_hgt": np.array([0, 1])}}
    kept, refused = px4._without_fused(height, flown(flags), {"EKF2_HGT_REF": 1})
    assert refused == ""
    assert kept is not None
    assert np.flatnonzero(np.isfinite(kept.values)).tolist() == list(range(7))
    assert px4._without_fused(height, LoggedFlight(), {"EKF2_HGT_REF": 1, "EKF2_RNG_CTRL": 0})[1] == ""
    assert "may be fused" in px4._without_fused(height, LoggedFlight(), {"EKF2_HGT_REF": 1, "EKF2_RNG_CTRL": 1})[1]


def flown(topics: dict[str, dict[str, Any]]) -> LoggedFlight:
    """Topics of PX4."""
    return LoggedFlight(
        {name: px4.messages_of(name, data, np.arange(data["timestamp"].size)) for name, data in topics.items()}
    )


def old_px4(flags: list[int]) -> LoggedFlight:
    """Topics of PX4 1.9 over 10 s: all flags in one number, and no topic for the thrust."""
    stamps = np.arange(10) * 10**6
    topics: dict[str, dict[str, Any]] = {
        "vehicle_local_position": {"timestamp": stamps, "z": -np.arange(10.0)},
        "estimator_status": {"timestamp": stamps, "control_mode_flags": np.array(flags, dtype=np.uint32)},
        "actuator_controls_0": {"timestamp": stamps, "control[3]": np.full(10, 0.4, dtype=np.float32)},
    }
    return flown(topics)


def test_old_logs_of_px4_have_the_flag_of_the_range_in_a_number() -> None:
    tilted, in_range = 0b1, 0b1 | 1 << 10
    (kept,) = filter(
        None, px4._references(old_px4([tilted] * 7 + [in_range] * 3), {"EKF2_HGT_MODE": 0, "EKF2_RNG_AID": 1})
    )
    assert (kept.kind, kept.refused) == ("ekf", "")
    assert np.isfinite(kept.series.values).tolist() == [True] * 7 + [False] * 3
    (refused,) = filter(
        None, px4._references(old_px4([in_range] * 9 + [tilted]), {"EKF2_HGT_MODE": 0, "EKF2_RNG_AID": 1})
    )
    assert refused.refused == (
        "bit 10 of estimator_status.control_mode_flags is set for 90 % of the time, so the range is fused into it from "
        "0 s on"
    )


@pytest.mark.parametrize(("field", "altitude"), [("altitude_msl_m", 584.0), ("alt", 584_000)])
def test_an_altitude_of_px4_is_in_metres_by_both_of_its_names(field: str, altitude: float) -> None:
    gps = {"timestamp": np.arange(2) * 10**6, "fix_type": np.array([6, 3]), field: np.full(2, altitude)}
    (rtk,) = filter(None, px4._references(flown({"vehicle_gps_position": gps}), {}))
    assert rtk.kind == "rtk"
    assert rtk.series.values.tolist() == pytest.approx([584.0, np.nan], nan_ok=True)


def test_old_logs_of_px4_have_the_throttle_among_the_controls() -> None:
    throttle = px4._throttle(old_px4([0] * 10))
    assert throttle is not None
    assert throttle.source == "actuator_controls_0.control[3]"
    assert throttle.values == pytest.approx(np.full(10, 0.4))


@pytest.mark.parametrize(
    ("log", "column", "expected"),
    [
        ("px4.ulg", "vehicle_local_position.z*-1", "cs_rng_hgt is set for 93 % of the time"),
        ("px4.ulg", "vehicle_local_position.dist_bottom", "is what a range finder of this vehicle reads"),
        ("px4.ulg", "distance_sensor.current_distance", "sensor:NAME compares with another one"),
        ("arducopter.BIN", "RFND.Dist", "the log has RNGFND1"),
        ("arducopter.BIN", "CTUN.SAlt", "is what a range finder of this vehicle reads"),
    ],
)
def test_a_column_into_which_the_range_is_fused_is_refused_too(
    tmp_path: Path, log: str, column: str, expected: str
) -> None:
    done = run("msp-lab import", LOGS / log, "--truth", f"column:{column}", "--out", tmp_path / "set", code=3)
    assert expected in " ".join(done.output.split())


def test_heights_into_which_the_range_is_fused_are_known_by_parameters() -> None:
    baro = {"EK3_SRC1_POSZ": 1.0, "EK3_SRC2_POSZ": 0.0, "EK3_RNG_USE_HGT": -1.0}
    assert by_any(baro) == ""
    assert "EK3_SRC2_POSZ is 2" in by_any(baro | {"EK3_SRC2_POSZ": 2.0})
    assert "EK3_RNG_USE_HGT is 70" in by_any(baro | {"EK3_RNG_USE_HGT": 70.0})
    assert "may be fused" in by_any({})
    assert "EKF2_HGT_REF is 2" in by_any({"EKF2_HGT_REF": 2.0})
    assert "may be fused" in by_any({"EKF2_HGT_REF": 0.0})
    # PX4 before 1.14.
    assert by_px4({"EKF2_HGT_MODE": 0, "EKF2_RNG_AID": 0}) == ""
    assert "EKF2_RNG_AID is 1" in by_any({"EKF2_HGT_MODE": 0.0, "EKF2_RNG_AID": 1.0})
    assert "EKF2_HGT_MODE is 2" in by_any({"EKF2_HGT_MODE": 2.0, "EKF2_RNG_AID": 0.0})
    assert by_ekf2_of_ardupilot({"EK2_ALT_SOURCE": 0.0}) == ""
    assert by_ekf2_of_ardupilot({"EK2_ALT_SOURCE": 1.0}) != ""


def test_any_field_can_be_the_truth(tmp_path: Path) -> None:
    (found,) = imported(LOGS / "arducopter.BIN", "--truth", "column:SIM.Alt*0.5", "--out", tmp_path / "set")
    assert (found["truth"], found["truth_source"]) == ("column", "SIM.Alt")
    half = read_dataset(tmp_path / "set")["true_range_cm"]
    imported(LOGS / "arducopter.BIN", "--out", tmp_path / "whole")
    assert np.nanstd(half) == pytest.approx(0.5 * np.nanstd(read_dataset(tmp_path / "whole")["true_range_cm"]), 1e-3)


@pytest.mark.parametrize(
    ("column", "error"), [("BARO.Alt", "SIM.Alt"), ("SIM.Alt", "GPS.Alt"), ("XKF1.PD*-1", ""), ("GPS.Alt", "SIM.Alt")]
)
def test_a_column_is_not_compared_with_itself(tmp_path: Path, column: str, error: str) -> None:
    """Nor with what is fused into it: an error of the reference is by another one."""
    (found,) = imported(LOGS / "arducopter.BIN", "--truth", f"column:{column}", "--out", tmp_path / "set")
    (ranger,) = found["rangers"]
    assert (error in ranger["reference_std_from"]) if error else ranger["reference_std_from"] == ""
    source = column.partition("*")[0]
    assert source not in ranger["reference_std_from"]
    assert source not in found["others"].values()


@pytest.mark.parametrize(
    ("parameters", "message", "refused"),
    [
        ({"EK3_SRC1_POSZ": 2.0}, "XKF1", "EK3_SRC1_POSZ is 2"),
        ({"EK3_SRC1_POSZ": 1.0}, "XKF1", ""),
        ({"EK2_ALT_SOURCE": 1.0}, "NKF1", "by EK2_ALT_SOURCE"),
        ({"EK2_ALT_SOURCE": 0.0}, "NKF1", ""),
    ],
)
def test_a_column_of_an_ekf_is_refused_by_the_parameters_of_that_ekf(
    monkeypatch: pytest.MonkeyPatch, parameters: dict[str, float], message: str, refused: str
) -> None:
    found = {
        message: {"TimeUS": np.arange(3) * 10**6, "PD": np.arange(3.0), "VD": np.zeros(3)},
        "PARM": {"Name": np.array(list(parameters), "S16"), "Value": np.array(list(parameters.values()))},
    }
    monkeypatch.setattr(ardupilot, "read_messages", lambda path, wanted, progress: (found, ""))
    log = ardupilot.read_ardupilot(Path("a.bin"), LogRequest(field=f"{message}.PD"))
    (column,) = [each for each in log.references if each.kind == "column"]
    assert column.refused.startswith(refused)
    assert bool(column.refused) == bool(refused)


def test_a_height_is_refused_from_when_the_range_was_fused() -> None:
    """Here from 4 s on, which is more than a half of the log; a landing alone is cut off."""
    height = Series("z", np.arange(2.0, 12.0), np.arange(10.0))
    for first_s, refused in ((6.0, True), (9.0, False)):
        stamps = np.array([0, first_s * 1e6])
        flags: dict[str, dict[str, Any]] = {
            "estimator_status_flags": {"timestamp": stamps, "cs_rng_hgt": np.array([0, 1])}
        }
        why = px4._without_fused(height, flown(flags), {})[1]
        assert bool(why) == refused
        assert ("from 4 s on" in why) == refused


def test_a_fixed_solution_is_that_of_the_receiver_that_has_it() -> None:
    stamps = np.repeat(np.arange(5) * 10**6, 2)
    gps = {
        "TimeUS": stamps,
        "I": np.tile([0.0, 1.0], 5),
        "Status": np.tile([3.0, 6.0], 5),
        "Alt": np.arange(10.0),
    }
    (rtk,) = filter(None, ardupilot._references(ardupilot.flight_of({"GPS": gps}), {}))
    assert (rtk.kind, rtk.series.source) == ("rtk", "GPS[1].Alt")
    assert rtk.series.values.tolist() == [1.0, 3.0, 5.0, 7.0, 9.0]
    assert not any(ardupilot._references(ardupilot.flight_of({"GPS": gps | {"Status": np.full(10, 3.0)}}), {}))


def test_a_code_of_no_echo_is_no_distance_where_the_log_states_no_maximum(tmp_path: Path) -> None:
    columns = {
        "time_s": np.arange(4.0),
        "sensor": np.full(4, "a"),
        "reading_cm": np.array([100.0, 765.0, 900.0, np.nan]),
    }
    rangers = rangers_of(tmp_path, MeasuredData(columns), 765.0)
    found = truth.choose(VehicleLog(tmp_path, "CSV table", tuple(rangers), {}, ()), truth.parse_truth("sensor:a"))
    assert found is not None
    assert found.series.values.tolist() == pytest.approx([1.0, np.nan, 9.0, np.nan], nan_ok=True)


def test_without_truth_a_table_has_none(tmp_path: Path) -> None:
    write_csv(tmp_path / "bench.csv", readings(400, runs=2))
    (found,) = imported(tmp_path / "bench.csv", "--truth", "none", "--out", tmp_path / "set")
    assert found["truth"] == "none"
    assert found["rangers"][0]["with_truth"] == 0
    assert "true_range_cm" not in read_dataset(tmp_path / "set")


def three_sensors(path: Path) -> Path:
    """Three range finders side by side over a vehicle's climbs; the last one reads 4 cm too far."""
    rng = np.random.default_rng(1)
    time_s = np.arange(0.0, 40.0, 0.05)
    height_cm = 250.0 + 80.0 * np.sin(time_s / 3.0)
    names = np.array(["left", "right", "far"])[np.arange(time_s.size) % 3]
    reading_cm = np.round(height_cm + rng.normal(0.0, 1.0, time_s.size) + 4.0 * (names == "far"))
    write_csv(path, {"time_s": time_s, "sensor": names, "reading_cm": reading_cm})
    return path


def test_another_sensor_of_the_log_is_the_truth(tmp_path: Path) -> None:
    table = three_sensors(tmp_path / "three.csv")
    (found,) = imported(table, "--truth", "sensor:right", "--out", tmp_path / "set")
    offsets_cm = {each["name"]: each["offset_cm"] for each in found["rangers"]}
    assert offsets_cm["right"] is None
    assert abs(offsets_cm["left"]) < 0.6
    assert abs(offsets_cm["far"] - 4.0) < 0.6
    data = read_dataset(tmp_path / "set")
    data = data.select(data["sensor"] == "far")
    assert set(data["sensor"]) == {"far"}
    # It knows the ground, so nothing is taken off.
    assert 3.0 < np.nanmedian(data["reading_cm"] - data["true_range_cm"]) < 5.0
    # The one before in time is another sensor's, 0.05 s earlier.
    assert np.nanmedian(data["neighbour_lag_ms"]) == 50.0


def test_the_other_sensors_are_the_truth(tmp_path: Path) -> None:
    table = three_sensors(tmp_path / "three.csv")
    (found,) = imported(table, "--truth", "others", "--out", tmp_path / "set")
    assert found["truth"] == "others"
    assert all(each["with_truth"] > 200 for each in found["rangers"])
    (note,) = found["notes"]
    # By the rest of the sensors, with the model's own bias taken off.
    assert 2.5 < float(note.split("far +")[1].split(" cm")[0]) < 4.5
    data = read_dataset(tmp_path / "set")
    data = data.select(data["sensor"] == "far")
    assert set(data["reference"]) == {"others"}
    assert np.nanmedian(np.abs(data["reading_cm"] - data["true_range_cm"])) < 1.5


def test_forward_sensors_are_no_reference_for_each_other(tmp_path: Path) -> None:
    forward = [each for each in telemetry() if getattr(each[2], "orientation", 0) != 25]
    path = write_telemetry(tmp_path / "forward.tlog", forward)
    done = run("msp-lab import", path, "--truth", "others", "--out", tmp_path / "set", code=3)
    assert "no range finder that looks down" in done.output


def test_a_truth_that_no_reading_has_is_a_line_or_none(tmp_path: Path) -> None:
    """Of a log of 2 s: what was asked for is missing; without --truth the readings are imported without one."""
    short = write_telemetry(tmp_path / "short.tlog", [each for each in telemetry() if each[0] < 2.0])
    done = run("msp-lab import", short, "--truth", "ekf", "--out", tmp_path / "asked", code=3)
    assert (
        "--truth ekf: distance_sensor_10: no true range: found 39 readings with an echo and GLOBAL_POSITION_INT"
        in done.output
    )
    shown = run("msp-lab import", short, "--out", tmp_path / "set", code=0)
    printed = " ".join(shown.output.split())
    assert "true range: none" in printed
    assert "--model" not in printed
    assert "without a true range there is nothing that 'msp-lab gap' could compare them with" in printed
    assert "distance_sensor_10: no true range: found 39 readings" in printed
    (found,) = imported(short, "--out", tmp_path / "json")
    assert (found["truth"], found["truth_source"]) == ("", "")
    forward = write_telemetry(
        tmp_path / "forward.tlog", [each for each in telemetry() if getattr(each[2], "orientation", 0) != 25]
    )
    done = run("msp-lab import", forward, "--truth", "ekf", "--out", tmp_path / "asked", code=3)
    assert "no range finder looks down" in done.output
