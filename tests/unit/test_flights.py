"""Flights and their reference: the truth at the time of each echo, and nothing where the reference is silent."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from rich.console import Console

from msp_lab.campaigns.flights import FlightArchive, collect_flights, load_flights
from msp_range.clock import VirtualClock
from msp_range.recording.csv_form import read_csv
from msp_range.recording.error import RecordingError
from msp_range.recording.writer import Recorder
from msp_range.yaml_file import ConfigError
from tests.support.programs import run
from tests.support.shipped import CONFIGS


class ClockAt(VirtualClock):
    """A clock that knows what UTC its time is."""

    def utc(self) -> float:
        return 1_700_000_000.0 + self.now()


def campaign_file(folder: Path, **changed: Any) -> Path:
    content = {
        "campaign": "air",
        "reference": {"method": "a laser", "uncertainty_cm": 2},
        "airframe": str(CONFIGS / "loopback.yaml"),
        "flights": [
            {
                "flight": "hover",
                "how": "Hover.",
                "target": "concrete",
                "scenario": str(CONFIGS / "scenarios/hover.yaml"),
            },
            {"flight": "climb", "how": "Climb.", "target": "grass"},
        ],
    } | changed
    path = folder / "air.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


def recording(folder: Path, readings_cm: list[int], start_s: float = 100.0) -> Path:
    """A recording with a reading each tenth of a second."""
    path = folder / f"recorded-{len(list(folder.iterdir()))}.mcap"
    recorder = Recorder(path, ClockAt(start_s))
    for number, reading_cm in enumerate(readings_cm):
        time_s = start_s + 0.1 * number
        status = "clock_fault" if reading_cm & 0x8000 else "ok"
        message = {"time_s": time_s, "ping_s": time_s, "read_s": time_s, "status": status, "raw": reading_cm}
        recorder.write("/range/down", time_s, message)
    recorder.close()
    return path


def archive(folder: Path) -> FlightArchive:
    return FlightArchive(folder / "out", load_flights(campaign_file(folder)))


@pytest.mark.parametrize(("column", "offset_s"), [("time_s", 0.0), ("utc_s", 1_700_000_000.0)])
def test_truth_is_that_at_the_time_of_the_echo(column: str, offset_s: float, tmp_path: Path) -> None:
    reference = tmp_path / "laser.csv"
    # From 100.25 s on, 10 cm/s, and silent from 101.05 to 103.05 s.
    times = [100.25, 100.5, 101.05, 103.05, 104.0]
    lines = [f"{offset_s + each},{300 + 10 * (each - 100)}" for each in times]
    reference.write_text("\n".join([f"{column},true_range_cm", *lines]))
    there = archive(tmp_path)
    flight = load_flights(campaign_file(tmp_path)).flights[0]
    there.keep(flight, recording(tmp_path, [300] * 35), reference)
    data = there.readings()
    known = (data["time_s"] >= 100.25) & ((data["time_s"] <= 101.05) | (data["time_s"] >= 103.05))
    expected = np.where(known, 300 + 10 * (data["time_s"] - 100), np.nan)
    np.testing.assert_allclose(data["true_range_cm"], expected, atol=1e-5)
    assert set(data["condition"]) == {"hover"}
    assert set(data["target"]) == {"concrete"}


def test_a_fault_is_an_empty_reading(tmp_path: Path) -> None:
    there = archive(tmp_path)
    there.keep(load_flights(campaign_file(tmp_path)).flights[0], recording(tmp_path, [300, 0x8000 | 300]), None)
    np.testing.assert_array_equal(there.readings()["reading_cm"], [300, np.nan])


def test_of_a_flight_flown_twice_the_last_one_counts(tmp_path: Path) -> None:
    there, flights = archive(tmp_path), load_flights(campaign_file(tmp_path)).flights
    for flight, reading_cm in ((flights[1], 90), (flights[0], 100), (flights[0], 200)):
        there.keep(flight, recording(tmp_path, [reading_cm] * 3), None)
    assert there.readings()["reading_cm"].tolist() == [200] * 3 + [90] * 3
    assert sorted(path.name for path in (tmp_path / "out/flights").iterdir()) == [
        "climb-001.mcap", "hover-001.mcap", "hover-002.mcap",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time_s,range_cm\n1,2", "'true_range_cm' is missing"),
        ("when,true_range_cm\n1,2", "no column time_s"),
        ("time_s,true_range_cm\n2,2\n1,2", "times that do not increase"),
        ("time_s,true_range_cm\n2,2\n3,2", "its times do not overlap"),
    ],
)
def test_a_reference_of_no_use_is_refused(text: str, message: str, tmp_path: Path) -> None:
    reference = tmp_path / "laser.csv"
    reference.write_text(text)
    with pytest.raises(RecordingError, match=message):
        archive(tmp_path).keep(load_flights(campaign_file(tmp_path)).flights[0], recording(tmp_path, [300]), reference)
    assert not list(tmp_path.glob("out/flights/*"))


def test_the_operator_is_led_through_and_a_wrong_answer_is_reported(tmp_path: Path) -> None:
    flown = recording(tmp_path, [250] * 3)
    answers = iter(["nothing.mcap", "", str(flown), "", "s"])
    console = Console(record=True, width=200, file=(tmp_path / "screen").open("w"))
    there = archive(tmp_path)
    campaign = load_flights(campaign_file(tmp_path))
    collect_flights(campaign, there, console, lambda text: next(answers))
    shown = console.export_text()
    assert "1 of 2: hover" in shown
    assert "nothing.mcap: cannot be read" in shown
    assert [len(there.recordings(flight)) for flight in campaign.flights] == [1, 0]
    console.file.close()


def test_the_same_flight_twice_is_refused(tmp_path: Path) -> None:
    twice = [{"flight": "hover", "how": "Hover.", "target": "grass"}] * 2
    with pytest.raises(ConfigError, match="flight hover is given more than once"):
        load_flights(campaign_file(tmp_path, flights=twice))


@pytest.mark.slow
def test_simulated_and_real_flights_do_not_mix(tmp_path: Path) -> None:
    run("msp-lab collect --simulate", campaign_file(tmp_path), "--out", tmp_path / "out")
    data = read_csv(tmp_path / "out/readings.csv")
    assert set(data["condition"]) == {"hover"}
    hovering = data.select((data["time_s"] > 10) & (data["time_s"] < 50))
    assert abs(float(np.median(hovering["reading_cm"] - hovering["true_range_cm"]))) < 3
    with pytest.raises(RecordingError, match="of a simulated flight; name another folder"):
        archive(tmp_path).keep(load_flights(campaign_file(tmp_path)).flights[1], recording(tmp_path, [90] * 3), None)
    (simulated,) = (tmp_path / "out/flights").glob("*.mcap")
    real = tmp_path / "real"
    real.mkdir()
    with pytest.raises(RecordingError, match="of a simulated flight, expected one of msp-range run"):
        archive(real).keep(load_flights(campaign_file(real)).flights[0], simulated, None)


def test_no_flight_is_lost_where_an_earlier_one_was_deleted(tmp_path: Path) -> None:
    there, flights = archive(tmp_path), load_flights(campaign_file(tmp_path)).flights
    folder = tmp_path / "out/flights"
    for reading_cm in (100, 200):
        there.keep(flights[0], recording(tmp_path, [reading_cm] * 3), None)
    second = (folder / "hover-002.mcap").read_bytes()
    (folder / "hover-001.mcap").unlink()
    there.keep(flights[0], recording(tmp_path, [300] * 3), None)
    assert (folder / "hover-002.mcap").read_bytes() == second
    assert sorted(path.name for path in folder.iterdir()) == ["hover-002.mcap", "hover-003.mcap"]
    assert there.readings()["reading_cm"].tolist() == [300] * 3


def test_a_reference_stays_with_its_own_recording(tmp_path: Path) -> None:
    """Its recording was deleted, and the next flight has none."""
    reference = tmp_path / "laser.csv"
    reference.write_text("time_s,true_range_cm\n100,111\n101,111\n")
    there, flights = archive(tmp_path), load_flights(campaign_file(tmp_path)).flights
    there.keep(flights[0], recording(tmp_path, [100] * 3), reference)
    (tmp_path / "out/flights/hover-001.mcap").unlink()
    there.keep(flights[0], recording(tmp_path, [300] * 3), None)
    assert np.isnan(there.readings()["true_range_cm"]).all()


def test_a_flight_that_came_meanwhile_is_not_overwritten(tmp_path: Path) -> None:
    """Two programs collect into one folder."""
    there, flights = archive(tmp_path), load_flights(campaign_file(tmp_path)).flights
    making = there.making(flights[1])
    path = making.__enter__()
    path.write_bytes(b"simulated")
    (path.parent / "climb-001.mcap").write_bytes(b"flown meanwhile")
    with pytest.raises(RecordingError, match=r"climb-001\.mcap: there is a file already"):
        making.__exit__(None, None, None)
    assert (tmp_path / "out/flights/climb-001.mcap").read_bytes() == b"flown meanwhile"


def test_of_a_thousand_flights_the_last_one_counts(tmp_path: Path) -> None:
    there, flights = archive(tmp_path), load_flights(campaign_file(tmp_path)).flights
    there.keep(flights[0], recording(tmp_path, [100] * 3), None)
    (tmp_path / "out/flights/hover-001.mcap").rename(tmp_path / "out/flights/hover-999.mcap")
    there.keep(flights[0], recording(tmp_path, [200] * 3), None)
    assert [path.name for path in there.recordings(flights[0])] == ["hover-999.mcap", "hover-1000.mcap"]


def test_a_table_from_elsewhere_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out/readings.csv").write_text("of another campaign")
    with pytest.raises(RecordingError, match=r"readings\.csv: not collected here"):
        archive(tmp_path)
