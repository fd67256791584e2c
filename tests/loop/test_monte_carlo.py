"""`msp-sim monte-carlo` with the real bridge: what it writes, and that any flight is flown again to the byte."""

import csv
import json
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml

from msp_sim.flight import results
from msp_sim.flight.flying import fly_scenario, planned_flight
from msp_sim.flight.results import Results
from msp_sim.monte_carlo import command
from msp_sim.monte_carlo.command import FlightOptions, fly_monte_carlo
from msp_sim.monte_carlo.outcome import Flights, draw_sample, fly_sample
from msp_sim.workers import workers

AIRFRAME = Path(__file__).parents[2] / "configs" / "quad_pallet.yaml"
FILES = ("flights.csv", "summary.json", "flights.png")


@pytest.fixture
def no_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    """Drawing takes longer than all flights of these tests."""
    for module in (command, results):
        monkeypatch.setattr(module, "missing", lambda extra: "matplotlib")


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    """A flight of 8 s in which temperature, height and faults vary."""
    content = {
        "name": "short",
        "airframe": str(AIRFRAME),
        "duration_s": 8,
        "flight": {"altitude": [{"kind": "climb", "to_m": 1.0}, {"kind": "hold", "duration_s": 2}, {"kind": "land"}]},
        "vary": {
            "parameters": {
                "air.ground_c": {"kind": "uniform", "low": -10, "high": 40},
                "ground.surface": {"kind": "choice", "of": ["grass", "concrete"]},
            },
            "faults": {"share": 0.5},
        },
    }
    path = tmp_path / "short.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def table(folder: Path) -> list[dict[str, str]]:
    with (folder / "flights.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def bad_flight(flights: Flights, index: int) -> dict[str, Any]:
    """Fails in flight 2."""
    if index == 2:
        raise ZeroDivisionError("a defect")
    return fly_sample(flights, index)


def fly(scenario: Path, flights: int, seed: int, out: Path, *, model_only: bool = False, jobs: int = 1) -> None:
    options = FlightOptions(scenario, seed, None, ())
    fly_monte_carlo(options, flights, out, model_only, workers(jobs, None, "msp-sim monte-carlo"))


@pytest.mark.usefixtures("no_picture")
def test_a_flight_of_the_table_is_flown_again_to_the_byte(
    scenario: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fly(scenario, 3, 5, tmp_path / "out")
    shown = capsys.readouterr().out
    assert max(map(len, shown.split("fly the worst")[0].splitlines())) <= 80
    rows = table(tmp_path / "out")
    assert [row["flight"] for row in rows] == ["0", "1", "2"]
    assert len({row["sha256"] for row in rows}) == len({row["air.ground_c"] for row in rows}) == 3
    worst = json.loads((tmp_path / "out" / "summary.json").read_text())["worst"]
    again = worst[0]["fly_again"].split()
    assert again == ["msp-sim", "fly", str(scenario), "--seed", "5", "--sample", str(worst[0]["flight"])]
    folder = tmp_path / "again"
    fly_scenario(planned_flight(scenario, None, 5, int(again[-1])), Results(folder, False))
    found = json.loads((folder / "summary.json").read_text())
    assert found["link"]["sha256"] == worst[0]["sha256"] == rows[int(again[-1])]["sha256"]
    assert found["sample"]["values"]["ground.surface"] == worst[0]["ground.surface"]
    # The scenario next to it is the one with the drawn values.
    flown = yaml.safe_load((folder / "scenario.yaml").read_text())
    assert flown["air"]["ground_c"] == worst[0]["air.ground_c"]
    assert "vary" not in flown


@pytest.mark.usefixtures("no_picture")
def test_flights_in_the_folder_are_not_flown_again_and_bad_ones_are_named(
    scenario: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(command, "fly_sample", bad_flight)
    with pytest.raises(typer.Exit) as ended:
        fly(scenario, 3, 1, tmp_path / "out")
    assert ended.value.exit_code == 4
    assert "flight 2: ZeroDivisionError: a defect" in capsys.readouterr().out
    assert [row["flight"] for row in table(tmp_path / "out")] == ["0", "1"]
    flown: list[int] = []

    def noted(flights: Flights, index: int) -> dict[str, Any]:
        flown.append(index)
        return fly_sample(flights, index)

    monkeypatch.setattr(command, "fly_sample", noted)
    fly(scenario, 3, 1, tmp_path / "out")
    assert flown == [2]
    monkeypatch.setattr(command, "fly_sample", fly_sample)
    fly(scenario, 3, 1, tmp_path / "once")
    for name in FILES[:2]:
        assert (tmp_path / "out" / name).read_bytes() == (tmp_path / "once" / name).read_bytes()


@pytest.mark.usefixtures("no_picture")
def test_readings_of_the_model_alone(scenario: Path, tmp_path: Path) -> None:
    fly(scenario, 4, 1, tmp_path / "out", model_only=True)
    rows = table(tmp_path / "out")
    assert all(0.0 <= float(row["wrong_share"]) < 0.2 for row in rows)
    # Sound is slower in cold air, which no bridge corrects here: by 5 % of a metre at -10 deg C.
    cold = min(rows, key=lambda row: float(row["air.ground_c"]))
    assert float(cold["error_p95_cm"]) > 0.0


def test_the_model_alone_draws_as_the_emulated_sensors_do(scenario: Path) -> None:
    """Same scenario, same model: the share of missed echoes agrees with that of what the bridge polled."""
    from msp_range.clock import VirtualClock
    from msp_sim.flight.flight import Simulation
    from msp_sim.flight.sampled import Sampled
    from msp_sim.flight.scenario import load_scenario

    sampled = Sampled(load_scenario(scenario).model_copy(update={"vary": None}), "short")
    sampled.vary = sampled.vary.model_copy(update={"faults": None})
    drawn = [draw_sample(Flights(sampled, 1), index) for index in range(20)]
    missed = []
    for index in range(5):
        sample = sampled.sample(1, index)
        simulation = Simulation(sample.scenario, VirtualClock(), sample.seed)
        for _ in simulation.fly():
            pass
        tracks = simulation.flight.tracks.values()
        pairs = [pair for track in tracks for pair in zip(track.truth_m, track.raw_m, strict=True)]
        missed += [raw is None for truth, raw in pairs if truth is not None]
    share = sum(each["missed_share"] for each in drawn) / len(drawn)
    assert share == pytest.approx(sum(missed) / len(missed), abs=0.03)


@pytest.mark.slow
def test_the_same_bytes_whatever_the_number_of_jobs(scenario: Path, tmp_path: Path) -> None:
    for jobs in (1, 3):
        fly(scenario, 10, 3, tmp_path / str(jobs), jobs=jobs)
    for name in FILES:
        assert (tmp_path / "1" / name).read_bytes() == (tmp_path / "3" / name).read_bytes()
