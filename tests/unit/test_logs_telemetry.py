"""A ground station's log as pymavlink reads it, with two senders, cut, damaged, and as none."""

import contextlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink import mavutil

from msp_lab.logs.telemetry import read_telemetry
from msp_range.mavlink.dialect import dialect
from msp_range.recording.error import RecordingError

START_US = 1_790_000_000_000_000
Messages = list[tuple[float, int, Any]]


def nothing(share: float) -> None:
    pass


def height_m(time_s: float) -> float:
    return float(3.0 + 2.0 * np.sin(time_s / 3.0))


def flight(posz: float = 1.0) -> Messages:
    """What an autopilot (component 1) and the bridge (191) send in 30 s, with the component of each message."""
    found: Messages = [
        (0.0, 1, dialect.MAVLink_param_value_message(name.encode(), value, 9, 2, number))
        for number, (name, value) in enumerate({"EK3_SRC1_POSZ": posz, "EK3_RNG_USE_HGT": -1.0}.items())
    ]
    for step in range(600):
        time_s = 0.05 * step
        range_cm = round(100.0 * height_m(time_s - 0.1)) if step % 50 else 800
        distance = dialect.MAVLink_distance_sensor_message
        found.append((time_s, 191, distance(step * 50, 20, 765, range_cm, 0, 10, 25, 4, signal_quality=100)))
        if step % 2:  # every other one has an invalid signal
            found.append((time_s, 1, distance(step * 50, 20, 765, 300, 0, 0, 0, 0, signal_quality=step % 4 == 1)))
        found.append((time_s, 1, dialect.MAVLink_attitude_message(step * 50, 0.1, -0.2, 1.0, 0.0, 0.0, 0.0)))
        rate_cm_s = round(100.0 * 2.0 / 3.0 * np.cos(time_s / 3.0))
        place = (step * 50, 0, 0, 0, round(1e3 * height_m(time_s)), 0, 0, -rate_cm_s, 0)
        found.append((time_s, 1, dialect.MAVLink_global_position_int_message(*place)))
        found.append((time_s, 1, dialect.MAVLink_vfr_hud_message(0.0, 0.0, 0, 42, 0.0, 0.0)))
    return found


def written(path: Path, messages: Messages) -> Path:
    link = dialect.MAVLink(None, 1, 1)
    with path.open("wb") as file:
        for time_s, component, message in messages:
            link.srcComponent = component
            file.write(round(START_US + 1e6 * time_s).to_bytes(8, "big") + message.pack(link))
    return path


def test_readings_context_and_reference(tmp_path: Path) -> None:
    log = read_telemetry(written(tmp_path / "a.tlog", flight()), nothing)
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
    (refused,) = read_telemetry(written(tmp_path / "b.tlog", flight(posz=2.0)), nothing).references
    assert "EK3_SRC1_POSZ is 2" in refused.refused


def test_frames_are_those_of_pymavlink(tmp_path: Path) -> None:
    path = written(tmp_path / "a.tlog", flight())
    readings, heights = [], []
    with contextlib.closing(mavutil.mavlink_connection(str(path))) as peer:
        while (message := peer.recv_match()) is not None:
            if message.get_type() == "DISTANCE_SENSOR" and message.id == 10:
                readings.append((message._timestamp - START_US / 1e6, min(message.current_distance, 765)))
            elif message.get_type() == "GLOBAL_POSITION_INT":
                heights.append(message.relative_alt / 1e3)
    log = read_telemetry(path, nothing)
    np.testing.assert_allclose(log.rangers[0].series.time_s, [each[0] for each in readings], atol=2e-6)
    assert log.rangers[0].series.values.tolist() == [each[1] for each in readings]
    np.testing.assert_allclose(log.references[0].series.values, heights, rtol=1e-14)


def test_any_field_of_a_message(tmp_path: Path) -> None:
    path = written(tmp_path / "a.tlog", flight())
    reference = read_telemetry(path, nothing, "VFR_HUD.throttle").references[-1]
    assert (reference.kind, reference.series.values[0]) == ("column", 42.0)
    with pytest.raises(RecordingError, match=r"common messages have no VFR_HUD\.thrott"):
        read_telemetry(path, nothing, "VFR_HUD.thrott")


def test_a_cut_and_damaged_log_gives_what_is_whole(tmp_path: Path) -> None:
    path = written(tmp_path / "a.tlog", flight())
    content = bytearray(path.read_bytes())
    content[30_000:30_500] = b"\x00\xfd\x05" * 166 + b"\xff\xff"
    path.write_bytes(content[:-20])
    log = read_telemetry(path, nothing)
    assert 580 <= len(log.rangers[0].series) < 600
    assert log.notes[1].endswith("bytes that belong to no message are left out.")
    assert 400 < int(log.notes[1].split()[0]) < 800


@pytest.mark.parametrize(
    "content", [b"", b"\xfd", b"no log at all " * 100, bytes(3_000_000), np.random.default_rng(1).bytes(300_000)]
)
def test_what_is_no_log_is_a_line(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "bad.tlog"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=r"bad\.tlog: no telemetry log"):
        read_telemetry(path, nothing)
