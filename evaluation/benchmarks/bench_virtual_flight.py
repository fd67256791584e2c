"""How much faster than real time a virtual flight is: four sensors, emulated bus, loopback autopilot, recording."""

import statistics
import tempfile
import time
from pathlib import Path

from evaluation import CONFIGS
from evaluation.benchmarks.figure import Figures, at_least, figure
from msp_range.clock import VirtualClock
from msp_range.recording.writer import Recorder
from msp_sim.flight.flight import Simulation
from msp_sim.flight.scenario import load_scenario

SCENARIO = CONFIGS / "scenarios" / "demo.yaml"
FLIGHTS = 5


def run() -> Figures:
    """Flown seconds a second of wall time, median of several flights."""
    scenario = load_scenario(SCENARIO)
    speeds = []
    for number in range(FLIGHTS):
        with tempfile.TemporaryDirectory() as folder:
            clock = VirtualClock()
            recorder = Recorder(Path(folder) / "flight.mcap", clock)
            started_s = time.perf_counter()
            simulation = Simulation(scenario, clock, number, recorder=recorder)
            for _ in simulation.fly():
                pass
            recorder.close()
            speeds.append(simulation.flight.duration_s / (time.perf_counter() - started_s))
    return [figure("virtual_flight_over_real_time", statistics.median(speeds), "times real time", at_least(180))]
