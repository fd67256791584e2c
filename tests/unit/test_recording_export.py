"""Recordings as measured data in the one CSV form."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from msp_range.clock import VirtualClock
from msp_range.recording.csv_form import read_csv
from msp_range.recording.export import export, measured_data
from msp_range.recording.reader import Recording
from msp_range.recording.writer import Recorder


def reading(ping_s: float, status: str, raw: int | None) -> dict[str, Any]:
    echo_s = ping_s + 29e-6 * raw if status == "ok" and raw is not None else ping_s
    return {"time_s": echo_s, "ping_s": ping_s, "read_s": ping_s + 0.05, "status": status, "raw": raw}


def warm(source: str) -> dict[str, Any]:
    return {"temperature_c": 15.5, "temperature_source": source}


def recorded(path: Path, messages: list[tuple[str, float, dict[str, Any]]]) -> Recording:
    recorder = Recorder(path, VirtualClock())
    for topic, time_s, message in messages:
        recorder.write(topic, time_s, message)
    recorder.close()
    return Recording(path)


def test_one_row_is_one_ping_with_the_sensors_own_word(tmp_path: Path) -> None:
    recorded(
        tmp_path / "flight7.mcap",
        [
            ("/range/left", 0.05, reading(0.0, "ok", 400) | warm("SCALED_PRESSURE.temperature")),
            ("/range/right", 0.15, reading(0.1, "no_echo", 765) | warm("fixed")),
            ("/fused", 0.15, {"range_m": 4.0}),
            ("/range/left", 0.25, reading(0.2, "no_answer", None)),
            ("/range/right", 0.35, reading(0.3, "clock_fault", 0x8000 + 400) | warm("held")),
            ("/range/right", 0.45, reading(0.4, "part_info", 300)),
        ],
    )
    assert export(tmp_path / "flight7.mcap", tmp_path / "flight7.csv") == 5
    data = read_csv(tmp_path / "flight7.csv")
    assert list(data.columns) == [
        "time_s",
        "sensor",
        "run",
        "reading_cm",
        "true_range_cm",
        "air_temperature_c",
        "neighbour_lag_ms",
        "status",
        "rejected",
        "corrected_cm",
        "filtered_cm",
        "fused_cm",
        "fused_std_cm",
    ]
    assert data["status"].tolist() == ["ok", "no_echo", "no_answer", "clock_fault", "part_info"]
    np.testing.assert_array_equal(data["fused_cm"], [np.nan, 400.0, np.nan, np.nan, np.nan])
    assert data["time_s"].tolist() == [29e-6 * 400, 0.1, 0.2, 0.3, 0.4]
    assert data["sensor"].tolist() == ["left", "right", "left", "right", "right"]
    assert set(data["run"]) == {"flight7"}
    np.testing.assert_array_equal(data["reading_cm"], [400, 765, np.nan, 0x8000 + 400, np.nan])
    assert np.isnan(data["true_range_cm"]).all()
    # Only a temperature that was measured then is known; the airframe's constant and an old value are not.
    np.testing.assert_array_equal(data["air_temperature_c"], [15.5, np.nan, np.nan, np.nan, np.nan])
    # Rounded to microseconds.
    np.testing.assert_allclose(data["neighbour_lag_ms"], [np.nan, 100, 100, 100, 200], atol=5e-4)


def test_a_measured_humidity_is_a_column(tmp_path: Path) -> None:
    """Per cent belong to a temperature: with the airframe's constant they are not known."""
    humid = {"humidity_pct": 80.0}
    recording = recorded(
        tmp_path / "flight.mcap",
        [
            ("/range/left", 0.05, reading(0.0, "ok", 400) | warm("HYGROMETER_SENSOR.temperature") | humid),
            ("/range/left", 0.15, reading(0.1, "ok", 400) | warm("fixed") | humid),
        ],
    )
    np.testing.assert_array_equal(measured_data(recording)["humidity_pct"], [80.0, np.nan])


def test_the_truth_of_a_ping_goes_to_its_reading_and_to_no_other(tmp_path: Path) -> None:
    recording = recorded(
        tmp_path / "flight.mcap",
        [
            ("/truth/left", 0.0, {"true_range_cm": 399.5, "air_temperature_c": 10.0, "target": "grass", "wind_m_s": 3}),
            ("/truth/right", 0.0, {"true_range_cm": 200.5, "neighbour_lag_ms": 7.0}),
            ("/range/left", 0.05, reading(0.0, "ok", 400) | warm("file")),
            ("/range/right", 0.05, reading(0.0, "ok", 200)),
            ("/range/left", 0.15, reading(0.1, "no_answer", None)),
            ("/truth/left", 0.2, {"true_range_cm": 1.0}),
            ("/truth/left", 0.3, {"true_range_cm": 410.5}),
            ("/range/left", 0.35, reading(0.3, "ok", 411)),
        ],
    )
    data = measured_data(recording)
    np.testing.assert_array_equal(data["true_range_cm"], [399.5, 200.5, np.nan, 410.5])
    np.testing.assert_array_equal(data["air_temperature_c"], [10.0, np.nan, np.nan, np.nan])
    np.testing.assert_array_equal(data["wind_m_s"], [3.0, np.nan, np.nan, np.nan])
    assert data["target"].tolist() == ["grass", "", "", ""]
    assert data["neighbour_lag_ms"][1] == 7.0


def test_sensors_that_ping_together(tmp_path: Path) -> None:
    """The lag goes by the times of the pings, not by the order in which the answers came."""
    recording = recorded(
        tmp_path / "flight.mcap",
        [
            ("/range/b", 0.03, reading(0.002, "ok", 100)),
            ("/range/a", 0.06, reading(0.0, "ok", 600)),
            ("/range/a", 0.16, reading(0.1, "ok", 600)),
            ("/range/c", 0.26, reading(0.2, "ok", 600)),
        ],
    )
    np.testing.assert_allclose(measured_data(recording)["neighbour_lag_ms"], [2.0, np.nan, 98.0, 100.0], atol=5e-4)


@pytest.mark.parametrize("size", [0, 200])
def test_a_recording_without_readings_gives_a_header(tmp_path: Path, size: int) -> None:
    recorded(tmp_path / "whole.mcap", [("/range/left", 0.05, reading(0.0, "ok", 400))])
    (tmp_path / "cut.mcap").write_bytes((tmp_path / "whole.mcap").read_bytes()[:size])
    assert export(tmp_path / "cut.mcap", tmp_path / "cut.csv") == 0
    assert len(read_csv(tmp_path / "cut.csv")) == 0
