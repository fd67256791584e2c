"""Cost of the sensor watch a reading: all of it, its leave-one-out reference alone, and its share of a virtual flight.

Drawn readings of four sensors, and the same calls as in the bridge. A figure is the fastest of some rounds: whatever
else runs on the computer only adds to it.
"""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from msp_range.clock import VirtualClock
from msp_range.health import GroundUse, SensorWatch
from msp_range.health.neighbours import Sighting, reference
from msp_range.health.sensor_watch import MOST_NEIGHBOURS
from msp_sim.flight.flight import Simulation
from msp_sim.flight.scenario import load_scenario
from tests.sensor_watch.drawn import STD_M, TURN_S, Drawn, Ground, draw, feed, watch_of

SCENARIO = Path(__file__).parents[1] / "configs" / "scenarios" / "demo.yaml"
HOURS, ROUNDS = 0.2, 7


def run() -> list[dict[str, Any]]:
    """All figures of this file."""
    drawn = draw(np.random.default_rng(1), HOURS, Ground())
    count = drawn.time_s.size
    windows = _windows(drawn)
    whole_us = _fastest_us(lambda: list(feed(watch_of(), drawn)), count)
    nothing_us = _fastest_us(lambda: list(feed(_Idle({}, TURN_S), drawn)), count)
    others_us = _fastest_us(lambda: [reference(each, MOST_NEIGHBOURS, 1.0) for each in windows], len(windows))
    watch_us = whole_us - nothing_us - others_us
    flight_us = _flight_us()
    share = 100.0 * (whole_us - nothing_us) / flight_us
    return [
        _figure("sensor_watch", watch_us, "us a reading, without the reference", "at most 20", watch_us <= 20.0),
        _figure("sensor_watch_reference", others_us, "us a reading, leave-one-out height", None, None),
        _figure("sensor_watch_of_a_virtual_flight", share, "% of its time", "at most 2", share <= 2.0),
    ]


class _Idle(SensorWatch):
    """A watch that does nothing, to know what feeding costs."""

    def update(self, *_: object) -> None:
        pass


def _windows(drawn: Drawn) -> list[list[Sighting]]:
    """Readings of the ground with those around them."""
    seen = [
        Sighting(time_s, str(sensor), range_m, STD_M, GroundUse.GROUND, range_m, None, climb_m_s, None)
        for time_s, sensor, range_m, climb_m_s in zip(
            *(each.tolist() for each in (drawn.time_s, drawn.sensor, drawn.height_m, drawn.climb_m_s)), strict=True
        )
    ]
    width = 2 * MOST_NEIGHBOURS + 1
    return [seen[i : i + width] for i in range(len(seen) - width)]


def _fastest_us(run_once: Callable[[], object], count: int) -> float:
    """Time for each of ``count`` readings, of the fastest round [us]."""
    times_s = []
    for _ in range(ROUNDS):
        started_s = time.thread_time()
        run_once()
        times_s.append(time.thread_time() - started_s)
    return 1e6 * min(times_s) / count


def _flight_us() -> float:
    """Time of a virtual flight for each reading [us]."""
    scenario = load_scenario(SCENARIO)
    readings = 0

    def fly() -> None:
        nonlocal readings
        simulation = Simulation(scenario, VirtualClock(), 1)
        readings = sum([len(steps) for steps in simulation.fly()])

    fly()
    return _fastest_us(fly, readings)


def _figure(key: str, value: float, unit: str, goal: str | None, met: bool | None) -> dict[str, Any]:
    return {"key": key, "value": round(value, 2), "unit": unit, "goal": goal, "met": met}
