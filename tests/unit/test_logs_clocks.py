"""The difference of two clocks, from the same flight in both; refused where it cannot be known."""

import csv
from pathlib import Path

import numpy as np
import pytest

from msp_lab.logs.elsewhere import clock_difference_s
from msp_lab.logs.log import Series
from msp_lab.logs.opening import open_log
from msp_range.arrays import Array
from msp_range.recording.error import RecordingError
from tests.support.log_import import LOGS, imported
from tests.support.programs import run


def flown_cm(time_s: Array) -> Array:
    """A climb, a hover with two changes of height, and a landing."""
    return np.interp(time_s, [0, 10, 16, 40, 43, 60, 62, 80, 95], [20, 20, 400, 400, 250, 250, 500, 500, 20])


def both(difference_s: float, seed: int = 1, first_s: float = 0.0, last_s: float = 100.0) -> tuple[Series, Series]:
    rng = np.random.default_rng(seed)
    time_s = np.sort(rng.uniform(0.0, 100.0, 900))
    reading_cm = flown_cm(time_s) + rng.normal(0.0, 3.0, time_s.size)
    reading_cm[rng.random(time_s.size) < 0.1] = 30.0
    reading_cm[rng.random(time_s.size) < 0.2] = np.nan
    seen_s = np.arange(first_s, last_s, 0.01)
    return Series("", time_s, reading_cm), Series("", seen_s - difference_s, flown_cm(seen_s) / 100.0 + 7.0)


@pytest.mark.parametrize("difference_s", [-1.79e9, -12.34, 0.0, 3.3, 5000.0])
@pytest.mark.parametrize(("first_s", "last_s"), [(0.0, 100.0), (-500.0, 300.0), (5.0, 70.0)])
def test_the_difference_is_found(difference_s: float, first_s: float, last_s: float) -> None:
    readings, height = both(difference_s, 1, first_s, last_s)
    assert clock_difference_s(readings, height) == pytest.approx(difference_s, abs=0.5)


def test_another_flight_is_refused() -> None:
    readings, height = both(0.0)
    turned = Series("", height.time_s, height.values[::-1] * 0.2 + np.sin(height.time_s / 2.0))
    with pytest.raises(RecordingError, match="do not show the same flight"):
        clock_difference_s(readings, turned)


def test_a_flight_that_repeats_itself_is_refused() -> None:
    time_s = np.arange(0.0, 120.0, 0.1)
    wave = np.sin(2.0 * np.pi * time_s / 20.0)
    with pytest.raises(RecordingError, match="fit each other about as well"):
        clock_difference_s(Series("", time_s, 300.0 + 100.0 * wave), Series("", time_s[300:800], wave[300:800]))


def test_a_hover_is_refused() -> None:
    rng = np.random.default_rng(1)
    time_s = np.arange(0.0, 60.0, 0.1)
    with pytest.raises(RecordingError, match="do not show the same flight"):
        clock_difference_s(
            Series("", time_s, rng.normal(300.0, 1.0, 600)), Series("", time_s, rng.normal(3.0, 0.01, 600))
        )


def test_a_reference_in_a_table_with_another_clock(tmp_path: Path) -> None:
    """The simulator's height of the ArduPilot log, as a motion capture's computer would have written it."""
    log = open_log(LOGS / "arducopter.BIN")
    height = next(each.series for each in log.references if each.kind == "simulator")
    with (tmp_path / "mocap.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["frame", "timestamp", "z_mm"])
        for number, (time_s, value) in enumerate(zip(height.time_s, height.values, strict=True)):
            writer.writerow([number, round((1.79e9 + time_s) * 1e9), f"{1e3 * (value - 580.0):.1f}"])
    (found,) = imported(
        LOGS / "arducopter.BIN", "--truth", f"column:z_mm*0.001@{tmp_path / 'mocap.csv'}", "--out", tmp_path / "set"
    )
    assert found["truth_source"] == "z_mm"
    assert found["is_shifted"]
    (ranger,) = found["rangers"]
    assert ranger["scatter_cm"] < 2.0
    (note,) = found["notes"]
    said_s = float(note.split("differs by ")[1].split(" s")[0])
    # With the simulator's own times the readings are 0.112 s late; part of that is in the difference of the clocks.
    assert ranger["lag_s"][0] + (said_s + 1.79e9) == pytest.approx(0.112, abs=0.02)


@pytest.mark.parametrize(
    ("truth", "expected"),
    [
        ("mocap@{csv}", "of a CSV file --truth needs the column"),
        ("column:height@{csv}", "there is no column 'height'"),
        ("column:word@{csv}", "column 'word': found 'up', expected a number"),
        ("others@{csv}", "expected a reference that another file has"),
        ("rtk@{px4}", "no rtk in this log"),
        ("column:flat@{csv}", "do not show the same flight"),
    ],
)
def test_what_cannot_be_used_is_a_line(tmp_path: Path, truth: str, expected: str) -> None:
    rows = [f"{time_s:.1f},up,{0.001 * (time_s % 1.0)}" for time_s in np.arange(0.0, 60.0, 0.1)]
    (tmp_path / "a.csv").write_text("\n".join(["t,word,flat", *rows]))
    given = truth.format(csv=tmp_path / "a.csv", px4=LOGS / "px4.ulg")
    done = run("msp-lab import", LOGS / "arducopter.BIN", "--truth", given, "--out", tmp_path / "set", code=3)
    assert expected in done.output
