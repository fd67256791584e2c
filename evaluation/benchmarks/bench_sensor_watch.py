"""Cost of the sensor watch a reading: all of it, its leave-one-out reference alone, and its share of a virtual flight.

Drawn readings of four sensors, and the same calls as in the bridge. A figure is the fastest of some rounds: whatever
else runs on the computer only adds to it.
"""

import time
from collections.abc import Callable

import numpy as np

from evaluation import CONFIGS
from evaluation.benchmarks.figure import Figures, at_most, figure
from evaluation.sensor_watch.drawn import STD_M, TURN_S, Drawn, Ground, draw, feed, watch_of
from msp_range.clock import VirtualClock
from msp_range.health import GroundUse, SensorWatch
from msp_range.health.neighbours import Sighting, reference
from msp_range.health.sensor_watch import MOST_NEIGHBOURS
from msp_sim.flight.flight import Simulation
from msp_sim.flight.scenario import load_scenario

SCENARIO = CONFIGS / "scenarios" / "demo.yaml"
HOURS, ROUNDS = 0.2, 7


def run() -> Figures:
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
        figure("sensor_watch", watch_us, "us a reading, without the reference", at_most(20)),
        figure("sensor_watch_reference", others_us, "us a reading, leave-one-out height"),
        figure("sensor_watch_of_a_virtual_flight", share, "% of its time", at_most(2)),
    ]


class _Idle(SensorWatch):
    """A watch that does nothing, to know what feeding costs."""

    def update(self, *_: object) -> None:
        pass


def _windows(drawn: Drawn) -> list[list[Sighting]]:
    """Readings of the ground with those around them."""
    seen = [
        Sighting(str(sensor), time_s, GroundUse.GROUND, range_m, STD_M, None, climb_m_s, None, range_m)
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
