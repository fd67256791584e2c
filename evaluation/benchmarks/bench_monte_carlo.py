"""Many flights and many gaps on one worker and on two: simulated flights with the bridge, with the model only, and
separate gaps.

In `make bench` with a few of each, where seconds for 1,000 flights are those of the few, times as many, and the start.
`python -m evaluation monte_carlo --flights 1000 --gaps 100 --readings 100000` measures the whole, in half an hour on an
idle machine.
"""

import argparse
import shutil
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from evaluation import CONFIGS
from evaluation.benchmarks.bench_gap import SENSOR, write_readings
from evaluation.benchmarks.figure import Figures, at_least, figure, under
from evaluation.memory import memory_mb
from msp_lab.gap.findings import Settings
from msp_lab.gap.separate import Common, Job, separate_gap
from msp_sim.flight.sampled import Sampled
from msp_sim.flight.scenario import load_scenario
from msp_sim.monte_carlo.outcome import Flights, draw_sample, fly_sample
from msp_sim.workers import Workers, workers

SCENARIO = CONFIGS / "scenarios" / "rough_grass.yaml"
"""60 s, four sensors."""
WANTED = 1000
FEW_FLIGHTS, FEW_DRAWN, FEW_GAPS, FEW_READINGS = 40, 500, 12, 1000
"""In `make bench`: a minute and a half in all. Of fewer, the last item of one worker, for which the other one waits, is
most of what two workers lack of twice the speed."""
LEAST_RATIO = 1.7
WORKERS = 2
FILES = 5
"""Different files of readings; more gaps read the same ones again, each into a folder of its own."""
ALONE = 10
"""Of many gaps one worker computes so many."""
MEMORY_FROM, MOST_GROWTH_MB = 1, 50.0
"""Memory after this many gaps is compared with that after the last [MB]: the first one loads what all need."""


def run(
    flights: int = FEW_FLIGHTS, drawn: int = FEW_DRAWN, gaps: int = FEW_GAPS, readings: int = FEW_READINGS
) -> Figures:
    """Measure so many flights with the bridge and with the model only, and so many gaps of so many readings."""
    common = Flights(Sampled(load_scenario(SCENARIO), str(SCENARIO)), 1)
    started_s = time.perf_counter()
    with tempfile.TemporaryDirectory() as name, workers(WORKERS, None, "the benchmark") as two:
        # The workers import what they need with their first item.
        _seconds(two, fly_sample, common, range(100_000, 100_000 + 2 * WORKERS))
        start_s = time.perf_counter() - started_s
        flown_s, flown_ratio = _speed(two, fly_sample, common, flights)
        drawn_s, drawn_ratio = _speed(two, draw_sample, common, drawn)
        gap_ratio, growth_mb = _gaps(two, Path(name), gaps, readings)
    whole_s, whole_drawn_s = start_s + flown_s * WANTED, start_s + drawn_s * WANTED
    return [
        _thousand("monte_carlo_1000_flights", whole_s, flights, 200.0),
        _ratio("monte_carlo_2_workers", flown_ratio),
        _thousand("monte_carlo_1000_model_only", whole_drawn_s, drawn, 20.0),
        _ratio("monte_carlo_model_only_2_workers", drawn_ratio),
        _ratio("separate_gaps_2_workers", gap_ratio),
        figure(
            "separate_gaps_memory_growth",
            growth_mb,
            f"MB of a process from gap {MEMORY_FROM + 1} to the last of {min(gaps, ALONE)}",
            under(MOST_GROWTH_MB),
        ),
    ]


def _thousand(key: str, seconds: float, measured: int, limit_s: float) -> dict[str, Any]:
    size = f"from {measured}" if measured != WANTED else "measured"
    return figure(key, seconds, f"s, two workers, {size}", under(limit_s))


def _ratio(key: str, value: float) -> dict[str, Any]:
    return figure(key, value, "times as fast as one", at_least(LEAST_RATIO))


def _speed(two: Workers, function: Callable[[Any, int], Any], common: Flights, count: int) -> tuple[float, float]:
    """Seconds per flight on two workers, and how many times as fast that is as this process alone."""
    one_s = _seconds(Workers(), function, common, range(count))
    two_s = _seconds(two, function, common, range(count))
    return two_s / count, one_s / two_s


def _seconds(where: Workers, function: Callable[[Any, Any], Any], common: Any, items: Sequence[Any]) -> float:
    started_s = time.perf_counter()
    failed = [each.error for each in where.map(function, items, common, what="items") if each.error is not None]
    assert not failed, failed
    return time.perf_counter() - started_s


def _gaps(two: Workers, folder: Path, gaps: int, readings: int) -> tuple[float, float]:
    """How many times as fast two workers are, and the growth of this process's memory [MB]."""
    for number in range(min(FILES, gaps)):
        write_readings(folder / f"{number}.csv", readings)
    # Pictures take three quarters of the time of a small gap, and none is looked at here.
    common = Common(Settings(str(SENSOR)), "recorded", "add" if gaps <= FEW_GAPS else "show")

    def jobs(kind: str, count: int) -> list[Job]:
        return [Job(f"{i}", (folder / f"{i % FILES}.csv",), (), folder / kind / f"{i}") for i in range(count)]

    _seconds(two, separate_gap, common, jobs("start", WORKERS))
    used_mb: list[float] = []
    started_s = time.perf_counter()
    alone = jobs("one", min(gaps, ALONE))
    for outcome in Workers().map(separate_gap, alone, common, what="gaps"):
        assert outcome.error is None, outcome.error
        used_mb.append(memory_mb())
    one_s = (time.perf_counter() - started_s) / len(alone)
    two_s = _seconds(two, separate_gap, common, jobs("two", gaps)) / gaps
    shutil.rmtree(folder / "two")
    return one_s / two_s, used_mb[-1] - used_mb[MEMORY_FROM]


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--flights", type=int, default=FEW_FLIGHTS, help="with the bridge, and with the model only")
    parser.add_argument("--gaps", type=int, default=FEW_GAPS, help="separate gaps")
    parser.add_argument("--readings", type=int, default=FEW_READINGS, help="of each gap")


def main(given: argparse.Namespace) -> None:
    """Measure and print."""
    if given.gaps < MEMORY_FROM + 2:
        raise argparse.ArgumentTypeError(
            f"--gaps: at least {MEMORY_FROM + 2}, as memory after gap {MEMORY_FROM + 1} is compared with later"
        )
    for each in run(given.flights, max(given.flights, FEW_DRAWN), given.gaps, given.readings):
        print(each)
