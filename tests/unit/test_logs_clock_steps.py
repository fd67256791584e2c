"""Logs of every kind whose clock was set while they were written: by NTP, or by a computer that started again."""

from collections.abc import Callable
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from msp_lab.logs import importing, px4
from msp_lab.logs.importing import Import
from msp_lab.logs.log import make_continuous
from msp_lab.logs.opening import open_log
from msp_lab.logs.truth import Truth
from msp_lab.readings.clock_runs import Stamps, continuous
from msp_lab.readings.dataset import read_dataset
from msp_lab.readings.intake import load_readings
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_range.recording.csv_form import MeasuredData, write_csv
from msp_sim.workers import Workers
from tests.support.flight_logs import FORMS, Clock, right, set_by, write_bag, write_log
from tests.support.log_import import imported
from tests.support.measured import MODEL, readings
from tests.support.slow import slow_but

TRUTH = {"tlog": "ekf", "ros1": "mocap", "sqlite3": "mocap", "mcap": "mocap", "bin": "simulator", "ulg": "simulator"}
"""Form of a log -> the reference that it has."""


def read(folder: Path, form: str, clock: Clock, path: Path | None = None) -> tuple[list[dict[str, Any]], MeasuredData]:
    """What an import of a log with this clock says, and the readings that look down."""
    folder.mkdir(exist_ok=True)
    found = imported(
        path or write_log(folder, form, clock), "--truth", TRUTH.get(form, "recorded"), "--out", folder / "set"
    )
    data = read_dataset(folder / "set")
    return found, data.select(data["sensor"] != "distance_sensor_0")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], MeasuredData]:
    """The readings of a log of this form whose clock is right."""
    return cache(lambda form: read(tmp_path_factory.mktemp("right"), form, right)[1])


def assert_same(found: MeasuredData, expected: MeasuredData) -> None:
    """Every reading is there, in its order, with the true range that it has with a clock that is right."""
    np.testing.assert_array_equal(found["reading_cm"], expected["reading_cm"])
    there = np.isfinite(found["true_range_cm"])
    assert there.sum() > 0.97 * np.isfinite(expected["true_range_cm"]).sum()
    assert np.abs(found["true_range_cm"] - expected["true_range_cm"])[there].max() < 4.0


@pytest.mark.parametrize("step_s", slow_but([-0.6], [-0.6, -14.0]))
@pytest.mark.parametrize("form", FORMS)
def test_a_clock_that_is_set_back_begins_a_run(
    tmp_path: Path, form: str, step_s: float, whole: Callable[[str], MeasuredData]
) -> None:
    found, data = read(tmp_path / "set", form, set_by(step_s))
    assert_same(data, whole(form))
    assert sorted(set(data["run"].tolist())) == ["flight", "flight/2"]
    notes = [note for each in found for note in each["notes"] if "clock steps back" in note]
    assert len(notes) == 1
    assert "a new run begins" in notes[0]
    # Times are still those of the log.
    later = data["run"] == "flight/2"
    assert np.all(np.diff(data["time_s"][later]) >= 0.0)
    assert data["time_s"][later][0] - data["time_s"][~later][-1] == pytest.approx(step_s, abs=0.5)


@pytest.mark.parametrize("form", [form for form in FORMS if form not in ("recording", "ulg")])
def test_a_clock_that_is_set_forward_begins_a_run_where_another_contradicts_it(
    tmp_path: Path, form: str, whole: Callable[[str], MeasuredData]
) -> None:
    """Of autopilots the satellites', of a ground station the autopilot's, of a bag the recorder's."""
    (tmp_path / "set").mkdir()
    is_bag = form in ("ros1", "sqlite3", "mcap")
    path = write_bag(tmp_path / "set", form, clock=set_by(100.0), arrived=right) if is_bag else None
    found, data = read(tmp_path / "set", form, set_by(100.0), path)
    assert_same(data, whole(form))
    assert sorted(set(data["run"].tolist())) == ["flight", "flight/2"]
    assert sum("goes forward by 100 s where another clock does not" in note for each in found for note in each["notes"])


def test_a_clock_of_px4_that_is_set_forward_is_contradicted_by_the_satellites() -> None:
    time_us = np.arange(100) * 200_000
    jumped_us = time_us + np.where(time_us > 9e6, 100_000_000, 0)
    found: dict[str, dict[str, NDArray[Any]]] = {
        "vehicle_gps_position": {"timestamp": jumped_us, "time_utc_usec": 1_790_000_000_000_000 + time_us},
        "distance_sensor": {"timestamp": jumped_us + 1000, "timestamp_sample": np.zeros(100)},
        "vehicle_attitude": {"timestamp": jumped_us + 21_000, "timestamp_sample": jumped_us + 1000},
    }
    topics = [px4.messages_of(name, data, 3 * np.arange(100) + k) for k, (name, data) in enumerate(found.items())]
    _, run = make_continuous(topics)
    assert run.step_s == pytest.approx(100.2)
    for topic in topics:
        assert (topic.series("timestamp").time_s >= run.start_s).sum() == 54
    # Where the messages say when they were measured, that counts; where they do not, when they were published.
    published_s, sampled_s = (topic.series("timestamp").time_s for topic in topics[1:])
    assert sampled_s == pytest.approx(published_s)


@pytest.mark.parametrize("form", ["tlog", "csv", "mcap"])
def test_a_pause_in_a_log_is_no_step(tmp_path: Path, form: str) -> None:
    """All clocks go on in it: the vehicle stood still, or the radio was silent."""
    path = write_log(tmp_path, form)
    if form == "csv":
        lines = path.read_text().splitlines()
        path.write_text("\n".join([*lines[:200], *lines[300:]]))
    assert open_log(path).clock == ()


def test_messages_that_were_delayed_together_are_no_step() -> None:
    """A radio link that was silent for 5 s sends at once what it had kept."""
    other_s = np.arange(0.0, 20.0, 0.1)
    time_s = np.array([13.0 + 1e-3 * each if 8.0 < each < 13.0 else each for each in other_s])
    (found_s,), runs = continuous([Stamps(np.arange(200), time_s, other_s)])
    assert runs == ()
    assert found_s is time_s


def test_an_autopilot_that_starts_again_begins_a_run() -> None:
    """By the clock of a ground station, which goes on: heights count from somewhere else now."""
    time_s = np.arange(0.0, 40.0, 0.1) + np.repeat((0.0, 5.0), 200)
    boot_s = 600.0 + np.arange(0.0, 40.0, 0.1) - np.repeat((0.0, 620.0), 200)
    (found_s,), runs = continuous([Stamps(np.arange(400), time_s, boot_s)])
    assert [run.step_s for run in runs] == pytest.approx([0.0, 5.1])
    assert (found_s >= runs[1].start_s).sum() == 200


@pytest.mark.parametrize("is_time", [False, True])
def test_a_clock_that_is_rounded_to_four_digits_is_no_step(is_time: bool) -> None:
    """12,345 s is 12,340 s. At the end of a table few readings say what the clocks differ by."""
    for rows in range(396, 412):
        exact_s = 9000.0 + 71.3 * np.arange(rows)
        rounded_s = np.array([float(f"{each:.4g}") for each in exact_s])
        clocks = (rounded_s, exact_s) if is_time else (exact_s, rounded_s)
        assert continuous([Stamps(np.arange(rows), *clocks)])[1] == ()


def test_a_step_is_seen_by_a_clock_that_is_rounded_to_less() -> None:
    exact_s = 9000.0 + 71.3 * np.arange(400)
    rounded_s = np.array([float(f"{each:.4g}") for each in exact_s])
    set_s = exact_s + 5000.0 * (np.arange(400) >= 200)
    _, runs = continuous([Stamps(np.arange(400), set_s, rounded_s)])
    assert [each.step_s for each in runs] == pytest.approx([0.0, 5071.3])


def test_one_step_is_one_however_many_senders_see_it() -> None:
    """The third is too slow to see it itself."""
    senders = []
    for number, rate_hz in enumerate((50.0, 10.0, 0.5)):
        time_s = np.arange(0.003 * number, 40.0, 1.0 / rate_hz)
        stamps_s = np.array([set_by(-1.0, 20.0)(each) for each in time_s])
        senders.append(Stamps((1e6 * time_s).astype(np.int64), stamps_s, np.full(time_s.size, np.nan)))
    times_s, runs = continuous(senders)
    assert [round(run.step_s, 2) for run in runs] == [0.0, -0.98]
    for sender, time_s in zip(senders, times_s, strict=True):
        assert np.all(np.diff(time_s) > 0.0)
        assert (time_s >= runs[1].start_s).sum() == (sender.place >= 2e7).sum()


def test_a_log_of_several_runs_is_hashed_and_listed_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each costs what the whole log and the whole list cost; of 100 MB with 97 runs that was two thirds of the time."""
    calls = []

    def counted(name: str, of: Callable[..., Any]) -> Callable[..., Any]:
        def call(*given: Any) -> Any:
            calls.append(name)
            return of(*given)

        return call

    for name in ("sha256", "record_runs"):
        monkeypatch.setattr(importing, name, counted(name, getattr(importing, name)))
    log = write_log(tmp_path, "tlog", set_by(-14.0))
    common = Import(tmp_path / "set", Truth("none"), load_sensor_model(MODEL))
    found, _ = importing.import_logs([log], common, Workers())
    assert [each.runs for each in found] == [("flight",), ("flight/2",)]
    assert found[0].sha256 == found[1].sha256 == sha256(log.read_bytes()).hexdigest()
    assert calls == ["sha256", "record_runs"]


def test_the_readings_of_a_table_that_gap_reads_are_split_too(tmp_path: Path) -> None:
    table = readings(400, runs=1)
    del table["run"]
    table["time_s"][200:] -= 12.0
    write_csv(tmp_path / "flight.csv", table)
    found = load_readings([tmp_path / "flight.csv"], load_sensor_model(MODEL))
    assert np.unique(found.data["run"]).tolist() == ["flight", "flight/2"]
    assert len(found.data) == 400
    note = f"{tmp_path}/flight.csv: The log's clock steps back by 11.9 s: a new run begins, flight/2."
    assert note in found.messages


def test_a_table_that_is_in_no_order_is_sorted_and_not_split(tmp_path: Path) -> None:
    table = readings(400, runs=1)
    order = np.argsort(table["true_range_cm"])
    write_csv(tmp_path / "sorted.csv", {name: column[order] for name, column in table.items()})
    found = load_readings([tmp_path / "sorted.csv"], load_sensor_model(MODEL))
    assert np.unique(found.data["run"]).tolist() == ["flight-1"]
