"""A ground station's log as pymavlink reads it, with two senders, cut, damaged, and as none."""

import contextlib
from pathlib import Path

import numpy as np
import pytest
from fastcrc.crc16 import mcrf4xx
from pymavlink import mavutil

from msp_lab.logs import telemetry_frames
from msp_lab.logs.elsewhere import reference_of
from msp_lab.logs.log import LogRequest
from msp_lab.logs.opening import open_log
from msp_lab.logs.truth import Truth
from msp_range.mavlink.dialect import dialect
from msp_range.recording.error import RecordingError
from tests.support.flight_logs import START_US, Messages, height_m, telemetry, write_telemetry


def test_readings_context_and_reference(tmp_path: Path) -> None:
    log = open_log(write_telemetry(tmp_path / "a.tlog", telemetry()))
    down, forward = log.rangers
    assert (down.name, forward.name) == ("distance_sensor_10", "distance_sensor_0")
    assert (down.is_down, forward.is_down, down.maximum_cm) == (True, False, 765.0)
    assert down.series.values[:3].tolist() == [765.0, round(100 * height_m(-0.05)), round(100 * height_m(0.0))]
    # Of the one that looks forward, every other one has an invalid signal.
    assert np.isnan(forward.series.values).sum() == 150
    assert down.series.time_s[1] == pytest.approx(0.05, abs=2e-6)
    # cos(tilt) = cos(roll) cos(pitch)
    assert log.context["tilt_deg"].values[0] == pytest.approx(np.degrees(np.arccos(np.cos(0.1) * np.cos(0.2))), 1e-6)
    assert log.context["throttle"].values[0] == pytest.approx(0.42)
    assert log.context["climb_m_s"].values[0] == pytest.approx(0.67)
    (reference,) = log.references
    assert (reference.kind, reference.refused) == ("ekf", "")
    assert reference.series.values[20] == pytest.approx(height_m(1.0), abs=1e-3)
    (refused,) = open_log(write_telemetry(tmp_path / "b.tlog", telemetry(posz=2.0))).references
    assert "EK3_SRC1_POSZ is 2" in refused.refused


def test_heights_of_an_ekf_are_refused_in_a_column_by_the_parameters(tmp_path: Path) -> None:
    named = "GLOBAL_POSITION_INT.relative_alt"
    for posz, begins in ((1.0, ""), (2.0, "EK3_SRC1_POSZ is 2")):
        path = write_telemetry(tmp_path / f"{posz:g}.tlog", telemetry(posz=posz))
        found = open_log(path, LogRequest(field=named)).references
        column = next(each for each in found if each.kind == "column")
        assert column.refused.startswith(begins)
        assert bool(column.refused) == bool(begins)


def with_gps(late_s: float = 0.0) -> Messages:
    """The flight with an altitude above the sea: a fixed RTK solution in every other message."""
    fixes: Messages = [
        (
            0.2 * step + late_s,
            1,
            dialect.MAVLink_gps_raw_int_message(
                0, 6 - 3 * (step % 2), 0, 0, round(1e3 * (584.0 + height_m(0.2 * step))), 0, 0, 0, 0, 9, v_acc=20
            ),
        )
        for step in range(150)
    ]
    return [(time_s + late_s, component, message) for time_s, component, message in telemetry()] + fixes


def test_an_altitude_counts_with_a_fixed_rtk_solution(tmp_path: Path) -> None:
    log = open_log(write_telemetry(tmp_path / "a.tlog", with_gps()))
    rtk = next(each for each in log.references if each.kind == "rtk")
    assert np.isfinite(rtk.series.values).tolist() == [True, False] * 75
    messages = with_gps()
    for _, _, message in messages:
        if hasattr(message, "fix_type"):
            message.fix_type = 3
    without = open_log(write_telemetry(tmp_path / "b.tlog", messages))
    assert [each.kind for each in without.references] == ["ekf"]


def test_a_reference_of_another_log_keeps_its_accuracy_at_its_times(tmp_path: Path) -> None:
    log = open_log(write_telemetry(tmp_path / "a.tlog", telemetry()))
    other = write_telemetry(tmp_path / "b.tlog", with_gps(late_s=7.0))
    reference, difference_s = reference_of(other, Truth("rtk"), log, np.inf)
    assert reference.std is not None
    assert reference.std.time_s.tolist() == reference.series.time_s.tolist()
    assert abs(difference_s) < 0.5


def test_a_maximum_of_zero_is_none(tmp_path: Path) -> None:
    """Some drivers state none; every reading would be beyond it."""
    messages = telemetry()
    for _, _, message in messages:
        if hasattr(message, "max_distance"):
            message.max_distance = 0
    down, _ = open_log(write_telemetry(tmp_path / "a.tlog", messages)).rangers
    assert down.maximum_cm == np.inf
    assert down.series.values[1] == round(100 * height_m(-0.05))


def test_a_reading_nearer_than_the_minimum_is_no_answer(tmp_path: Path) -> None:
    messages = telemetry()
    for _, _, message in messages:
        if message.get_type() == "DISTANCE_SENSOR":
            message.min_distance = 101 if message.id == 10 else 0
    down, forward = open_log(write_telemetry(tmp_path / "a.tlog", messages)).rangers
    near = sum(round(100 * height_m(0.05 * step - 0.1)) < 101 for step in range(600) if step % 50)
    assert down.too_near == np.isnan(down.series.values).sum() == near > 5
    assert np.nanmin(down.series.values) >= 101.0
    assert forward.too_near == 0


def test_frames_are_those_of_pymavlink(tmp_path: Path) -> None:
    path = write_telemetry(tmp_path / "a.tlog", telemetry())
    readings, heights = [], []
    with contextlib.closing(mavutil.mavlink_connection(str(path))) as peer:
        while (message := peer.recv_match()) is not None:
            if message.get_type() == "DISTANCE_SENSOR" and message.id == 10:
                readings.append((message._timestamp - START_US / 1e6, min(message.current_distance, 765)))
            elif message.get_type() == "GLOBAL_POSITION_INT":
                heights.append(message.relative_alt / 1e3)
    log = open_log(path)
    np.testing.assert_allclose(log.rangers[0].series.time_s, [each[0] for each in readings], atol=2e-6)
    assert log.rangers[0].series.values.tolist() == [each[1] for each in readings]
    np.testing.assert_allclose(log.references[0].series.values, heights, rtol=1e-14)


def test_any_field_of_a_message(tmp_path: Path) -> None:
    path = write_telemetry(tmp_path / "a.tlog", telemetry())
    reference = open_log(path, LogRequest(field="VFR_HUD.throttle")).references[-1]
    assert (reference.kind, reference.series.values[0]) == ("column", 42.0)
    for wrong in ("VFR_HUD.thrott", "ODOMETRY.q", "STATUSTEXT.text"):
        with pytest.raises(RecordingError, match=rf"common messages have no number {wrong}"):
            open_log(path, LogRequest(field=wrong))


def test_a_cut_and_damaged_log_gives_what_is_whole(tmp_path: Path) -> None:
    path = write_telemetry(tmp_path / "a.tlog", telemetry())
    content = bytearray(path.read_bytes())
    content[30_000:30_500] = b"\x00\xfd\x05" * 166 + b"\xff\xff"
    path.write_bytes(content[:-20])
    log = open_log(path)
    assert 580 <= len(log.rangers[0].series) < 600
    assert log.notes[1].endswith("bytes that belong to no message are left out.")
    assert 400 < int(log.notes[1].split()[0]) < 800


@pytest.mark.parametrize("piece_bytes", [300, 1000, 4096])
def test_a_log_is_the_same_in_pieces_of_any_size(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, piece_bytes: int
) -> None:
    path = write_telemetry(tmp_path / "a.tlog", with_gps())
    content = bytearray(path.read_bytes())
    content[30_000:30_500] = b"\x00\xfd\x05" * 166 + b"\xff\xff"
    path.write_bytes(content[:-20])
    whole = open_log(path)
    monkeypatch.setattr(telemetry_frames, "_PIECE_BYTES", piece_bytes)
    in_pieces = open_log(path)
    assert in_pieces.notes == whole.notes
    assert in_pieces.context.keys() == whole.context.keys()
    pairs = [(whole.context[name], each) for name, each in in_pieces.context.items()]
    pairs += [(one.series, other.series) for one, other in zip(whole.rangers, in_pieces.rangers, strict=True)]
    pairs += [(one.series, other.series) for one, other in zip(whole.references, in_pieces.references, strict=True)]
    for one, other in pairs:
        np.testing.assert_array_equal(one.time_s, other.time_s)
        np.testing.assert_array_equal(one.values, other.values)


@pytest.mark.parametrize("form", ["version 1", "signed"])
def test_frames_of_version_1_and_signed_ones(tmp_path: Path, form: str) -> None:
    expected = open_log(write_telemetry(tmp_path / "a.tlog", telemetry()))
    link = dialect.MAVLink(None, 1, 1)
    link.signing.secret_key, link.signing.sign_outgoing = bytes(32), form == "signed"
    path = tmp_path / "b.tlog"
    with path.open("wb") as file:
        for time_s, component, message in telemetry():
            link.srcComponent = component
            frame = message.pack(link, force_mavlink1=form == "version 1")
            assert frame[0] == (0xFE if form == "version 1" else 0xFD)
            file.write((START_US + round(1e6 * time_s)).to_bytes(8, "big") + frame)
    found = open_log(path)
    np.testing.assert_array_equal(found.rangers[0].series.values, expected.rangers[0].series.values)
    np.testing.assert_array_equal(found.rangers[0].series.time_s, expected.rangers[0].series.time_s)
    np.testing.assert_array_equal(found.context["tilt_deg"].values, expected.context["tilt_deg"].values)


@pytest.mark.parametrize("wrong", ["flag", "field", "checksum"])
def test_a_frame_with_an_unknown_flag_or_a_wrong_checksum_is_not_read(tmp_path: Path, wrong: str) -> None:
    path = write_telemetry(tmp_path / "a.tlog", telemetry())
    expected = open_log(path).context["tilt_deg"].values
    message = dialect.MAVLink_attitude_message(50, 1.1, -0.2, 1.0, 0.0, 0.0, 0.0)
    frame = bytearray(message.pack(dialect.MAVLink(None, 1, 1)))
    frame[{"flag": 2, "field": 20, "checksum": -1}[wrong]] ^= 2
    if wrong == "flag":
        frame[-2:] = mcrf4xx(bytes(frame[1:-2]) + bytes((message.crc_extra,))).to_bytes(2, "little")
    path.write_bytes(START_US.to_bytes(8, "big") + frame + path.read_bytes())
    np.testing.assert_array_equal(open_log(path).context["tilt_deg"].values, expected)


def test_nothing_is_read_after_more_than_a_megabyte_of_no_frames(tmp_path: Path) -> None:
    path = write_telemetry(tmp_path / "a.tlog", telemetry())
    content = path.read_bytes() * 40
    few, many = bytes(700_000), bytes(2_500_000)
    path.write_bytes(4 * (content + few))
    assert len(open_log(path).rangers[0].series) == 4 * 40 * 600
    path.write_bytes(content + many + path.read_bytes()[:100_000])
    assert len(open_log(path).rangers[0].series) == 40 * 600


def test_a_frame_inside_a_damaged_one_is_not_read(tmp_path: Path) -> None:
    """It has no time of its own, and may be of a message that nothing is made of."""
    link = dialect.MAVLink(None, 1, 1)
    whole = dialect.MAVLink_attitude_message(50, 0.1, -0.2, 1.0, 0.0, 0.0, 0.0).pack(link)
    inside = dialect.MAVLink_manual_control_message(1, 2, 3, 4, 5, 6).pack(link)
    damaged = bytearray(whole)
    damaged[1] = 200
    damaged[10:] = inside.ljust(202, b"\0")
    stamp = START_US.to_bytes(8, "big")
    path = write_telemetry(tmp_path / "a.tlog", telemetry())
    expected = open_log(path)
    path.write_bytes(stamp + bytes(damaged) + path.read_bytes())
    found = open_log(path)
    assert found.notes == expected.notes
    np.testing.assert_array_equal(found.context["tilt_deg"].values, expected.context["tilt_deg"].values)


@pytest.mark.parametrize(
    "content", [b"\xfd", b"no log at all " * 100, bytes(3_000_000), np.random.default_rng(1).bytes(300_000)]
)
def test_what_is_no_log_is_a_line(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "bad.tlog"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=r"bad\.tlog: no telemetry log"):
        open_log(path)


@pytest.mark.parametrize("sent", [50, 5000])
def test_humidity_is_in_per_cent_by_px4_and_by_ardupilot(tmp_path: Path, sent: int) -> None:
    hygrometer = dialect.MAVLink_hygrometer_sensor_message(0, 2150, sent)
    messages = [*telemetry(), *((0.5 * i, 1, hygrometer) for i in range(20))]
    path = write_telemetry(tmp_path / "a.tlog", sorted(messages, key=lambda each: each[0]))
    context = open_log(path).context
    assert set(context["humidity_pct"].values.tolist()) == {50.0}
    assert context["air_temperature_c"].values[0] == pytest.approx(21.5)
