"""The sensor watch in simulated flights: it finds the sensor that differs from its model, and nothing else."""

import math
from pathlib import Path

import pytest

from msp_range.assembly import sensor_watch_of
from msp_range.clock import VirtualClock
from msp_range.health import SensorWatch
from msp_range.reading_model.sensor_model import SensorModel
from msp_sim.flight.flight import Simulation
from msp_sim.flight.scenario import PlannedFault, Scenario, load_scenario

SCENARIOS = Path(__file__).parents[2] / "configs" / "scenarios"
GROUNDS = ("demo", "flat", "slope", "steps", "boxes", "rough_grass", "terrain", "hover", "sinusoid", "canted")


def texts(scenario: Scenario, seed: int, model: SensorModel | None = None) -> list[str]:
    """What the watch found in a flight."""
    simulation = Simulation(scenario, VirtualClock(), seed, model=model)
    found: list[str] = []
    for steps in simulation.fly():
        if steps:
            found += [each.text for each in simulation.bridge.sensor_findings if each.text not in found]
    assert [text for _, _, text in simulation.flight.texts if text in found] == found, "the pilot gets each"
    return found


@pytest.mark.parametrize(
    ("fault", "starts"),
    [
        pytest.param({"kind": "no_echo", "probability": 0.2}, "Range front_left: ", marks=pytest.mark.slow),
        ({"kind": "offset", "offset_cm": -80, "probability": 0.2}, "Range front_left: "),
        ({"kind": "noisy", "spread_cm": 5}, "Range front_left: "),
    ],
    ids=["20 % missed", "20 % short", "wider"],
)
def test_a_sensor_that_degrades_is_named_to_the_pilot(fault: dict[str, object], starts: str) -> None:
    demo = load_scenario(SCENARIOS / "demo.yaml")
    planned = PlannedFault.model_validate({"sensor": "front_left", "from_s": 12.0, "to_s": demo.duration_s} | fault)
    found = texts(demo.model_copy(update={"faults": (planned,)}), 1)
    assert len(found) == 1
    assert found[0].startswith(starts)


@pytest.mark.parametrize("name", ["rough_grass", "boxes"])
def test_nothing_is_found_of_sensors_in_order(name: str) -> None:
    assert texts(load_scenario(SCENARIOS / f"{name}.yaml"), 7) == []


def test_a_vehicle_that_begins_to_move_over_rough_grass_has_no_noisy_sensor() -> None:
    """Steps of 14 cm below one sensor, while the others' scatter was still that of a hover."""
    assert texts(load_scenario(SCENARIOS / "rough_grass.yaml"), 121) == []


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_nothing_is_found_where_the_effects_are_those_of_the_model(seed: int, tmp_path: Path) -> None:
    """By the model file's ``in_flight``: without it the watch is off, and says so."""
    models, terrain = SCENARIOS.parent / "sensors", SCENARIOS / "terrain.yaml"
    airframe = (SCENARIOS.parent / "quad_pallet.yaml").read_text()
    (tmp_path / "airframe.yaml").write_text(airframe.replace("sensors/mb1242.yaml", f"{models}/mb1242_in_flight.yaml"))
    (tmp_path / "terrain.yaml").write_text(terrain.read_text().replace("../quad_pallet.yaml", "airframe.yaml"))
    scenario = load_scenario(tmp_path / "terrain.yaml")
    assert isinstance(sensor_watch_of(scenario.airframe), SensorWatch)
    assert texts(scenario, seed) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", GROUNDS)
def test_nothing_is_found_in_ten_hours_of_flights(name: str) -> None:
    """An hour over each ground: on a slow computer all of them take longer than one test may."""
    scenario = load_scenario(SCENARIOS / f"{name}.yaml")
    for seed in range(100, 100 + math.ceil(3600.0 / scenario.duration_s)):
        assert texts(scenario, seed) == [], seed
