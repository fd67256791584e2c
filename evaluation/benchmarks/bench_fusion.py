"""How well the fused height is known on simulated flights, what faults cost it, and how soon objects are found.

The raw stream is one sensor's readings as they come, at the times of their echoes; 'hits' leaves its outliers out,
which no receiver can. The single stream through the same filter is an airframe whose fused stream has that sensor only.
"""

import math
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.random import Generator, default_rng

from evaluation import CONFIGS
from evaluation.benchmarks.figure import Figures, Goal, at_least, at_most, figure
from msp_range.clock import VirtualClock
from msp_range.config import Airframe, FusedSettings, Send
from msp_sim.flight.flight import Simulation
from msp_sim.flight.flight_log import FlightResult, SensorTrack
from msp_sim.flight.scenario import PlannedFault, Scenario, load_scenario
from tests.loop.test_objects_below import NAMES, SLOT_S, Hover

SCENARIOS = CONFIGS / "scenarios"
GROUNDS = ("flat", "slope", "steps", "boxes", "rough_grass")
SEEDS = range(4)
WILD_M = 0.15
"""A reading this far off is not one of the ground [m]."""
NEAREST_M = 0.30
"""Nearer to the ground the sensors read their minimum, 20 cm, and no filter is needed to know it [m]."""
FAULT_FROM_S = 12.0
OBJECTS = 600
FLAT_S = 10000
DROP = """
name: drop
airframe: {airframe}
duration_s: 15
flight:
  altitude: [{{kind: climb, to_m: 2.5}}, {{kind: hold, duration_s: 11}}]
  track: {{legs: [{{duration_s: 6}}, {{duration_s: 8, speed_m_s: 1.0, heading_deg: 0}}]}}
  attitude: {{sway: {{roll_rms_deg: 1.0, pitch_rms_deg: 1.0, period_s: 2.0}}}}
ground: {{surface: concrete, steps: [{{at_m: {at_m}, rise_m: -{deep_m}}}]}}
"""
"""Over the edge of a drop at 1 m/s and 2.5 m: 0.83 s later it is no longer in the beam of the last sensor."""
DROPS_M, EDGES_M = (0.5, 1.2), np.linspace(2.0, 2.5, 40)
"""How deep, and where the edge is: at any time of a sensor's turn."""
NONE = Goal("none in 1000 s", lambda per_1000_s: per_1000_s < 0.5)


def run() -> Figures:
    """All figures of this file."""
    return heights() + drops() + objects()


def heights() -> Figures:
    """Ratios of the error of height, the worst of the five grounds; and the cost of a fault over all of them."""
    of_raw, of_hits, of_one, good = [], [], [], []
    faulty: dict[str, list[Any]] = {"silent": [], "stuck": []}
    gaps_s = []
    for ground in GROUNDS:
        scenario = load_scenario(SCENARIOS / f"{ground}.yaml")
        flights = _fly(scenario)
        fused_m = _fused(flights)
        raw = [
            np.concatenate([_errors_m(flight.tracks[name], flight.tracks[name].raw_m) for flight in flights])
            for name in flights[0].tracks
        ]
        one = [_rms(_fused(_fly(_only(scenario, name)))) for name in flights[0].tracks]
        of_raw.append(_rms(fused_m) / min(map(_rms, raw)))
        of_hits.append(_rms(fused_m) / min(_rms(each[np.abs(each) < WILD_M]) for each in raw))
        of_one.append(_rms(fused_m) / min(one))
        good.append(fused_m)
        gaps_s += [float(np.diff(flight.fused.time_s).max()) for flight in flights]
        for kind, errors in faulty.items():
            errors.append(_fused(_fly(_with_fault(scenario, kind))))
    rms_m = _rms(np.concatenate(good))
    dead, stuck = (_rms(np.concatenate(errors)) / rms_m for errors in faulty.values())
    return [
        figure("fused_error_rms", 100 * rms_m, "cm, five kinds of ground"),
        figure("fused_over_best_raw", max(of_raw), "worst ground", at_most(0.5)),
        figure("fused_over_best_raw_hits", max(of_hits), "worst ground, outliers left out"),
        figure("fused_over_best_single", max(of_one), "worst ground, same filter", at_most(0.75)),
        figure("fused_with_a_dead_sensor", dead, "times the error", at_most(1.2)),
        figure("fused_with_a_stuck_sensor", stuck, "times the error", at_most(1.2)),
        figure("fused_longest_silence", max(gaps_s), "s"),
    ]


def drops() -> Figures:
    """Time from a drop below the vehicle's middle until the distance is right, by 20 cm or 5 %, and stays so."""
    settled_s = []
    with TemporaryDirectory() as folder:
        path = Path(folder) / "drop.yaml"
        for (seed, at_m), deep_m in product(enumerate(EDGES_M), DROPS_M):
            path.write_text(DROP.format(airframe=CONFIGS / "quad_pallet.yaml", at_m=at_m, deep_m=deep_m))
            simulation = Simulation(load_scenario(path), VirtualClock(), seed)
            crossed_s = math.inf
            for _ in simulation.fly():
                if simulation.vehicle.pose(simulation.now_s()).position_ned_m[0] >= at_m:
                    crossed_s = min(crossed_s, simulation.now_s())
            fused = simulation.flight.fused
            true_m = simulation.height_m()
            is_off = [value is None or abs(value - true_m) > max(0.2, 0.05 * true_m) for value in fused.filtered_m]
            settled_s.append(fused.time_s[len(is_off) - is_off[::-1].index(True)] - crossed_s)
    return [
        figure("fused_settles_after_a_drop", float(np.median(settled_s)), "s, 0.83 of it geometry", at_most(1.0)),
        figure("fused_settles_after_a_drop_worst", max(settled_s), f"s, of {len(settled_s)} drops", at_most(1.25)),
    ]


def objects() -> Figures:
    """Objects of 30 cm and more under one corner, and none over flat ground."""
    draw = default_rng(21)
    found = sum(_is_found(draw) for _ in range(OBJECTS)) / OBJECTS
    false = 0
    for _ in range(FLAT_S // 200):
        hover = Hover(draw.uniform(1.0, 4.5), draw)
        before: dict[str, float | None] = {}
        for _ in range(2000):
            name, _, seen_m = hover.step()
            false += seen_m is not None and before.get(name) is None
            before[name] = seen_m
    per_1000_s = 1000 * false / FLAT_S
    return [
        figure("objects_found_in_1200_ms", 100 * found, "%", at_least(95)),
        figure("false_objects_in_1000_s", per_1000_s, f"over {FLAT_S} s of hover", NONE),
    ]


def _is_found(draw: Generator) -> bool:
    height_m = draw.uniform(1.0, 4.0)
    object_m, comes_s = draw.uniform(0.3, min(1.2, height_m - 0.4)), draw.uniform(4.0, 5.0)
    hover, corner = Hover(height_m, draw), NAMES[draw.integers(4)]
    while hover.slot * SLOT_S < comes_s + 1.3:
        is_there = hover.slot * SLOT_S >= comes_s
        name, time_s, seen_m = hover.step(corner if is_there else None, object_m)
        if is_there and name == corner and seen_m is not None:
            return time_s - comes_s <= 1.2
    return False


def _fly(scenario: Scenario) -> list[FlightResult]:
    flights = []
    for seed in SEEDS:
        simulation = Simulation(scenario, VirtualClock(), seed)
        for _ in simulation.fly():
            pass
        flights.append(simulation.flight)
    return flights


def _only(scenario: Scenario, sensor: str) -> Scenario:
    airframe: Airframe = scenario.airframe
    return scenario.model_copy(
        update={"airframe": airframe.model_copy(update={"send": Send(fused=FusedSettings(sensors=[sensor]))})}
    )


def _with_fault(scenario: Scenario, kind: str) -> Scenario:
    fault = PlannedFault(sensor="front_left", kind=kind, from_s=FAULT_FROM_S, to_s=scenario.duration_s)
    return scenario.model_copy(update={"faults": (fault,)})


def _fused(flights: list[FlightResult]) -> np.ndarray:
    return np.concatenate([_errors_m(flight.fused, flight.fused.filtered_m) for flight in flights])


def _errors_m(track: SensorTrack, values_m: list[float | None]) -> np.ndarray:
    """Where there is a truth, and the sensors are not at their minimum."""
    pairs = zip(values_m, track.below_m, strict=True)
    return np.array(
        [value - truth for value, truth in pairs if value is not None and truth is not None and truth > NEAREST_M]
    )


def _rms(errors_m: np.ndarray) -> float:
    return math.sqrt(float((errors_m**2).mean()))
