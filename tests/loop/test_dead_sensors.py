"""Flights in which most of the sensors die: how often those that are left are read."""

from itertools import chain, pairwise
from pathlib import Path

import pytest

from msp_range.clock import VirtualClock
from msp_sim.flight.flight import Simulation
from msp_sim.flight.flight_log import FlightResult
from msp_sim.flight.scenario import load_scenario

AIRFRAME = Path(__file__).parents[2] / "configs" / "quad_pallet.yaml"
NAMES = ("front_left", "front_right", "rear_left", "rear_right")
END_S = 11.0
SETTLED_S = 1.3
"""Three rounds of four sensors 0.1 s apart, after which the slots of dead ones are the others'."""
SCENARIO = """
name: descent
airframe: {airframe}
duration_s: {end_s}
flight:
  altitude:
    - {{kind: climb, to_m: 6.0, speed_m_s: 3, acceleration_m_s2: 4}}
    - {{kind: hold, duration_s: 4.5}}
    - {{kind: climb, to_m: 1.0, speed_m_s: {speed_m_s}, acceleration_m_s2: 4}}
faults: [{faults}]
"""


def descend(folder: Path, speed_m_s: float, dead: tuple[str, ...], kind: str, from_s: float) -> FlightResult:
    """A flight that descends from about 7.3 s on."""
    faults = ", ".join(f"{{kind: {kind}, sensor: {name}, from_s: {from_s}, to_s: {END_S}}}" for name in dead)
    path = folder / "descent.yaml"
    path.write_text(SCENARIO.format(airframe=AIRFRAME, end_s=END_S, speed_m_s=speed_m_s, faults=faults))
    simulation = Simulation(load_scenario(path), VirtualClock(), 1)
    for _ in simulation.fly():
        pass
    return simulation.flight


@pytest.mark.parametrize("from_s", [0.0, 5.5])
@pytest.mark.parametrize("survivors", [("rear_left",), ("front_left", "rear_right")])
@pytest.mark.parametrize("speed_m_s", [2.0, 3.0])
def test_the_survivors_of_four_are_read_ten_times_a_second(
    tmp_path: Path, speed_m_s: float, survivors: tuple[str, ...], from_s: float
) -> None:
    dead = tuple(name for name in NAMES if name not in survivors)
    flight = descend(tmp_path, speed_m_s, dead, "silent", from_s)
    settled_s = from_s + SETTLED_S
    read_s = {name: [each for each in flight.tracks[name].time_s if each > settled_s] for name in survivors}
    together_s = sorted(chain(*read_s.values()))
    assert len(together_s) >= 10 * (END_S - settled_s) - 1
    # A ping each 100 ms; its echo is there up to 22 ms later.
    assert max(late - early for early, late in pairwise(together_s)) < 0.123
    # Each has every turn but those in which another one is asked out of turn, which shows whether answers are late.
    order = [name for _, name in sorted((time_s, name) for name in survivors for time_s in read_s[name])]
    twice = [name for name, after in pairwise(order) if name == after]
    in_turn = [order.count(name) - twice.count(name) for name in survivors]
    assert max(in_turn) - min(in_turn) <= 1
    assert len(survivors) == 1 or len(twice) <= 0.05 * len(order)


def test_where_the_dead_answer_nonsense_a_survivor_is_read_eight_times_a_second(tmp_path: Path) -> None:
    """They acknowledge their pings, so that a retry makes a sound and takes a slot: three of twenty."""
    dead = ("front_left", "front_right", "rear_right")
    flight = descend(tmp_path, 3.0, dead, "clock_fault", 5.5)
    settled_s = 5.5 + SETTLED_S
    read_s = [each for each in flight.tracks["rear_left"].time_s if each > settled_s]
    assert len(read_s) >= 8.5 * (END_S - settled_s) - 1
    assert max(late - early for early, late in pairwise(read_s)) < 0.223
