"""Recorded flights and measured data through the bridge again."""

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common

from msp_lab.gap.intake import read_readings
from msp_lab.readings.intake import load_readings
from msp_range.clock import VirtualClock
from msp_range.fusion import Acceleration, Angles, PressureHeight, Received
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_range.recording.csv_form import read_csv, write_csv
from msp_range.recording.pings import read_recorded
from msp_range.recording.reader import Recording
from msp_range.recording.writer import Recorder
from msp_range.replay import Nowhere, replay
from msp_sim.model.model import load_model
from tests.support.bench import FUSED_ID, START_S, Bench, airframe
from tests.support.data import measured_data
from tests.support.programs import run
from tests.support.shipped import CONFIGS


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("flight")
    run("msp-sim fly", CONFIGS / "scenarios" / "faults.yaml", "--out", folder)
    return folder / "flight.mcap"


def ranges(path: Path) -> list[tuple[str, list[Any]]]:
    keys = ("time_s", "status", "raw", "range_m", "corrected_m", "filtered_m", "variance_m2", "rejected")
    return [
        (topic, [message.get(key) for key in keys])
        for topic, _, message in Recording(path)
        if topic.startswith("/range/")
    ]


def messages(path: Path, *topics: str) -> list[tuple[str, float, Any]]:
    return [each for each in Recording(path) if each[0] in topics]


@pytest.mark.slow
def test_a_replayed_flight_is_the_flight(flight: Path, tmp_path: Path) -> None:
    """Every stage of every reading, faults and all, down to the last digit, from the recording alone."""
    again = tmp_path / "again.mcap"
    result = run("msp-range replay", flight, "--record", again)
    assert "front_left" in result.output
    assert ranges(again) == ranges(flight)
    # What was received after the last reading is no part of the replay.
    for topic in ("/attitude", "/motion"):
        moved, played = messages(flight, topic), messages(again, topic)
        assert played == moved[: len(played)]
        assert len(played) > 0.99 * len(moved)


def test_a_replay_has_the_attitudes_and_accelerations_of_the_flight_when_they_were_received(tmp_path: Path) -> None:
    """A vehicle that leans by 0.4 rad from the fifth second on: from then on its axis is not straight down."""
    path, again = tmp_path / "flight.mcap", tmp_path / "again.mcap"
    recorder = Recorder(path, VirtualClock(START_S))
    vehicle = airframe()
    Bench(vehicle, lambda name, time_s: 300, recorder=recorder).fly(10.0)
    recorder.close()
    recorded = read_recorded(path)
    begins_s = recorded.first_ping_s
    received: list[tuple[float, Received]] = []
    for i in range(50):
        time_s = begins_s + 5.0 + 0.1 * i
        received += [(time_s, Angles(time_s - 0.02, 0.4, 0.0, 0.0)), (time_s, Acceleration(time_s, 0.01))]
        received += [(time_s + 0.01, PressureHeight(time_s + 0.01, 100.0 + 0.01 * i))]
    clock = VirtualClock(begins_s)
    recorder = Recorder(again, clock)
    replay(vehicle, recorded._replace(received=received), path, clock, Nowhere(), recorder)
    recorder.close()
    kept = messages(again, "/attitude", "/motion")
    assert [time_s for _, time_s, _ in kept] == pytest.approx([time_s for time_s, _ in received], abs=1e-8)
    assert [each for _, _, each in kept] == [each._asdict() for _, each in received]
    # What was recorded is read again; and what makes no sense is not recorded, as in flight.
    assert [each for _, each in read_recorded(again).received] == [each for _, each in received]
    odd = [(time_s, each) for time_s, each in received if time_s < begins_s + 6.0]
    wrong = (begins_s + 6.0, begins_s + 6.1, begins_s + 6.2)
    odd += [
        (wrong[0], Angles(wrong[0], 9.0, 0.0, 0.0)),
        (wrong[1], Acceleration(wrong[1], 900.0)),
        (wrong[2], PressureHeight(wrong[2], 900.0)),
    ]
    clock = VirtualClock(begins_s)
    recorder = Recorder(tmp_path / "odd.mcap", clock)
    replay(vehicle, recorded._replace(received=odd), path, clock, Nowhere(), recorder)
    recorder.close()
    assert [time_s for _, time_s, _ in messages(tmp_path / "odd.mcap", "/attitude", "/motion")] == pytest.approx(
        [time_s for time_s, _ in odd[:-3]], abs=1e-8
    )
    along = [(time_s, each["height_m"] / each["range_m"]) for _, time_s, each in messages(again, "/fused")]
    assert {share for time_s, share in along if time_s < begins_s + 5.0} == {1.0}
    assert along[-1][1] < 0.99


@pytest.mark.slow
def test_a_replay_has_the_air_of_the_flight_and_how_well_it_was_known(tmp_path: Path) -> None:
    """A thermometer that dies in flight: what was sent, variances and all, is sent again, and nothing is reported."""
    thermometer = tmp_path / "temp1_input"
    thermometer.write_text("-5000")
    sources = [{"source": "file", "path": str(thermometer)}]
    vehicle = airframe(temperature={"fixed_c": 22.5, "sources": sources})
    recorder = Recorder(tmp_path / "flight.mcap", VirtualClock(START_S))
    bench = Bench(vehicle, lambda name, time_s: 500 + round(2 * math.sin(7 * time_s)), recorder=recorder).fly(10.0)
    thermometer.unlink()
    bench.fly(200.0)
    recorder.close()
    path, again = tmp_path / "flight.mcap", tmp_path / "again.mcap"
    recorded = read_recorded(path)
    clock = VirtualClock(recorded.first_ping_s)
    recorder = Recorder(again, clock)
    replay(vehicle, recorded, path, clock, Nowhere(), recorder)
    recorder.close()

    def stages(recording: Path, *keys: str) -> list[list[Any]]:
        return [[each[key] for key in keys] for topic, _, each in Recording(recording) if topic.startswith("/range/")]

    keys = ("time_s", "corrected_m", "temperature_c", "temperature_std_c", "temperature_source")
    assert stages(again, *keys) == stages(path, *keys)
    assert {source for *_, source in stages(path, *keys)} == {str(thermometer), "held"}

    def covariances(recording: Path) -> list[int]:
        frames = [
            bytes.fromhex(each["hex"])
            for topic, _, each in Recording(recording)
            if topic == "/mavlink/sent" and each["name"] == "DISTANCE_SENSOR"
        ]
        return [message.covariance for each in frames for message in common.MAVLink(None).parse_buffer(each)]

    sent = covariances(path)
    assert covariances(again) == sent
    assert sent[50] < 5 < 10 < sent[-1]
    assert [each["text"] for topic, _, each in Recording(again) if topic == "/health"] == ["Range: all 4 sensors good"]


def test_a_flight_with_send_nothing_replays(tmp_path: Path) -> None:
    """With the same file it sends nothing again; with the file that is to be flown it sends what was withheld."""
    streams = {"fused": {"id": FUSED_ID}}
    path, again = tmp_path / "flight.mcap", tmp_path / "again.mcap"
    recorder = Recorder(path, VirtualClock(START_S))
    trial = airframe(send=streams | {"nothing": True})
    Bench(trial, lambda name, time_s: 300 + round(2 * math.sin(7 * time_s)), recorder=recorder).fly(10.0)
    recorder.close()
    recorded = read_recorded(path)

    def distances(recording: Path, topic: str) -> list[bytes]:
        frames = [bytes.fromhex(each["hex"]) for found, _, each in Recording(recording) if found == topic]
        return [frame[10:-2] for frame in frames if int.from_bytes(frame[7:10], "little") == 132]

    withheld = distances(path, "/mavlink/withheld")
    assert len(withheld) > 90
    for nothing, topic, other in (
        (True, "/mavlink/withheld", "/mavlink/sent"),
        (False, "/mavlink/sent", "/mavlink/withheld"),
    ):
        clock = VirtualClock(recorded.first_ping_s)
        recorder = Recorder(again, clock)
        vehicle = airframe(send=streams | {"nothing": nothing})
        outcome = replay(vehicle, recorded, path, clock, Nowhere(), recorder)
        recorder.close()
        assert distances(again, topic) == withheld
        assert distances(again, other) == []
        assert outcome.sent.get("DISTANCE_SENSOR", 0) == (0 if nothing else len(withheld))
        again.unlink()


@pytest.mark.slow
def test_a_cut_flight_replays_and_exports(flight: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(flight.read_bytes()[: flight.stat().st_size // 2])
    run("msp-range replay", cut, "--record", tmp_path / "again.mcap")
    whole = ranges(flight)
    part = ranges(tmp_path / "again.mcap")
    assert 0.2 * len(whole) < len(part) < 0.8 * len(whole)
    assert part == whole[: len(part)]
    run("msp-range export", cut, tmp_path / "cut.csv")
    assert len(read_csv(tmp_path / "cut.csv")) == len(part)
    run("msp-range recover", cut, tmp_path / "closed.mcap")
    assert ranges(tmp_path / "closed.mcap") == part


@pytest.mark.slow
def test_what_was_saved_and_what_was_lost_is_reported(flight: Path, tmp_path: Path) -> None:
    whole = len(list(Recording(flight)))
    recovered = run("msp-range recover", flight, tmp_path / "a.mcap").output
    assert f"{whole} messages and 2 attached files; lost: nothing" in recovered
    data = bytearray(flight.read_bytes())
    damaged = tmp_path / "damaged.mcap"
    data[data.index(b"\x04\0\0\0zstd", len(data) // 2) + 100] ^= 0x10
    damaged.write_bytes(data)
    for args in (
        ("recover", damaged, tmp_path / "b.mcap"),
        ("export", damaged, tmp_path / "b.csv"),
        ("replay", damaged),
    ):
        printed = run("msp-range", *args).output
        assert "lost: 1 damaged chunk (" in printed
    assert len(ranges(tmp_path / "b.mcap")) == len(read_csv(tmp_path / "b.csv")) < len(ranges(flight))
    # The tables that models are made from report it too.
    sensor = load_sensor_model(CONFIGS / "sensors" / "mb1242.yaml")
    (warning,) = (each for each in load_readings([damaged], sensor).messages if "damaged" in each)
    assert warning.startswith(f"{damaged}: The file is damaged; lost: 1 damaged chunk")
    messages = read_readings([damaged], load_model(CONFIGS / "sensors" / "mb1242.yaml")).messages
    assert any(each.startswith(f"{damaged}: The file is damaged; lost: 1 damaged chunk") for each in messages)


@pytest.mark.slow
def test_an_exported_flight_replays_as_the_flight(flight: Path, tmp_path: Path) -> None:
    """A table has no early answers and no fixed temperature; everything else is the same."""
    run("msp-range export", flight, tmp_path / "flight.csv")
    args = ["--airframe", CONFIGS / "loopback.yaml", "--record", tmp_path / "again.mcap"]
    run("msp-range replay", tmp_path / "flight.csv", *args)
    statuses = [columns[1] for _, columns in ranges(flight) if columns[1] not in ("impossible", "part_info")]
    replayed = [columns[1] for _, columns in ranges(tmp_path / "again.mcap")]
    assert len(replayed) == pytest.approx(len(statuses), rel=0.02)
    assert replayed.count("ok") >= statuses.count("ok")


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["missing.mcap"], "cannot be read"),
        (["table.csv"], "--airframe"),
        (["table.csv", "--airframe", str(CONFIGS / "canted_pallet.yaml")], "readings of front_left"),
    ],
)
def test_user_errors_are_reported_in_a_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, args: Sequence[str], message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("table.csv").write_text("time_s,sensor,reading_cm\n1,front_left,200\n")
    result = run("msp-range replay", *args, code=3)
    assert message in result.output
    assert "Traceback" not in result.output


def test_measured_readings_of_a_maxsonar_go_through_the_whole_bridge(tmp_path: Path) -> None:
    """A MaxBotix MB1433 on a robot before a wall (enmt482): no code comes out, and no error is added.

    The sensor's no-echo code of 5 m becomes ours; what it clamps at 30 cm stays a range. The reference is the robot's
    own.
    """
    columns_used = {1: "time", 2: "range", 9: "sonar2"}
    table = np.loadtxt(
        measured_data("enmt482/calibration.csv"),
        delimiter=",",
        skiprows=1,
        usecols=list(columns_used),
        dtype=[(column, float) for column in columns_used.values()],
    )
    reading_cm = np.where(table["sonar2"] >= 4.9995, 765.0, np.round(table["sonar2"] * 100))
    columns = {
        "time_s": table["time"],
        "sensor": np.full(len(table), "sonar2"),
        "reading_cm": reading_cm,
        "true_range_cm": table["range"] * 100,
    }
    write_csv(tmp_path / "enmt482.csv", columns)
    airframe = tmp_path / "robot.yaml"
    airframe.write_text(
        f"""vehicle: robot
sensors:
  - name: sonar2
    id: 1
    address: 0x70
    model: {CONFIGS}/sensors/mb1242.yaml
    position_m: [0, 0, 0]
    rotation_deg: {{pitch: 0}}
link: {{url: "udpout:127.0.0.1:14550"}}
send: {{sensors: all}}
"""
    )
    again = tmp_path / "again.mcap"
    run("msp-range replay", tmp_path / "enmt482.csv", "--airframe", airframe, "--record", again)
    messages = [message for topic, _, message in Recording(again) if topic == "/range/sonar2"]
    assert len(messages) == len(table)
    truth_m = np.interp([message["time_s"] for message in messages], table["time"], table["range"])
    raw_m = np.array([message.get("corrected_m", np.nan) for message in messages])
    filtered_m = np.array([message.get("filtered_m", np.nan) for message in messages])
    # No code became a distance: not on the way in, and not on the way out.
    assert np.isnan(raw_m[table["sonar2"] >= 4.9995]).all()
    assert np.isnan(filtered_m[np.isnan(raw_m)]).all()
    # Nearer than 30 cm the sensor reads anything; from there on the filters remove outliers, and add nothing.
    reach = truth_m > 0.35
    used = reach & ~np.isnan(filtered_m)
    assert used.sum() > 0.9 * reach.sum()
    raw_error = np.abs(raw_m - truth_m)
    filtered_error = np.abs(filtered_m - truth_m)[used]
    assert np.percentile(filtered_error, 99.5) < np.nanpercentile(raw_error[reach], 99.5) + 0.005
    # These readings are late by 0.4 s, so the largest error is motion; the filter may differ from it by the noise.
    assert filtered_error.max() <= np.nanmax(raw_error[reach]) + 0.02
    assert np.median(filtered_error) <= 1.2 * np.nanmedian(raw_error[reach])
    sent = json.dumps([message for topic, _, message in Recording(again) if topic == "/mavlink/sent"])
    assert sent.count("DISTANCE_SENSOR") > 0.8 * len(table)
