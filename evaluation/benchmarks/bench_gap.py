"""The gap workflow on many readings: the whole of `msp-lab gap`, its screen alone, and how its cost grows.

Contexts are those of the flights of the blind tables (`evaluation/blind`) and every further column that an effect can
ask for, so that the complete catalogue is tested; no two readings are alike. Two effects are hidden, to be named and
refitted. `python -m evaluation gap_cost --rows 5000000` prints seconds and the largest memory of one process
for that many.
"""

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from numpy.random import default_rng

from evaluation import CONFIGS
from evaluation.benchmarks.figure import Figures, at_most, figure, under
from evaluation.blind.flight import Columns, contexts
from msp_lab.gap.problem import Problem, first_state, screened
from msp_range.arrays import numbered
from msp_range.recording.columns import CONTEXT_COLUMNS
from msp_sim.model.derived import time_in_run_s
from msp_sim.model.model import load_model

READINGS = 100_000
FEWER = 10_000
GROWTH = 11.0
"""Times the time for ten times the readings: linear, and a tenth for what was not measured."""
SENSOR = CONFIGS / "sensors" / "mb1242.yaml"
MSP_LAB = Path(sys.executable).parent / "msp-lab"
AT_ONCE = 250_000
"""Rows that are drawn and written at a time."""


def run() -> Figures:
    """Measure the workflow, its screen, and the growth of its time."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        wall_s, _, _ = workflow(folder, READINGS)
        fewer_s, _, _ = workflow(folder, FEWER)
    seconds = screen_s(READINGS)
    return [
        figure("gap_1e5", wall_s, "s for 100,000 readings, complete catalogue: msp-lab gap with its report", under(14)),
        figure(
            "gap_screen_1e5", seconds, "s for 100,000 readings: every effect's score, and the null by runs", under(1)
        ),
        figure(
            "gap_cost_growth",
            wall_s / fewer_s,
            "times the time for ten times the readings (10,000 to 100,000)",
            at_most(GROWTH),
        ),
    ]


def flights(rows: int, seed: int) -> Columns:
    """Context columns of flights of 500 readings, all that the form knows."""
    rng = default_rng([seed, rows])
    columns = contexts(rng, rows // 500, 500)
    n = columns["time_s"].size
    columns |= {
        "condition": np.full(n, "flight"),
        "target_size_cm": rng.uniform(5.0, 200.0, n),
        "external_level_db": rng.uniform(80.0, 120.0, n),
        "external_duty": rng.uniform(0.0, 0.5, n),
        "external_distance_cm": rng.uniform(50.0, 500.0, n),
        "external_frequency_khz": rng.uniform(38.0, 46.0, n),
    }
    columns["time_in_run_s"] = time_in_run_s(columns)
    # There is no reference where the truth is known, and the time of day follows from time_s.
    assert columns.keys() >= CONTEXT_COLUMNS.keys() - {"reference", "time_of_day_h"}
    return columns


def measured(rows: int, seed: int) -> Columns:
    """The same with readings of a sensor whose range is off and which its rotors disturb."""
    columns = flights(rows, seed)
    model = load_model(SENSOR).adding("range_scale", scale_pct=0.3).adding("rotor_noise", growth=0.4)
    columns["reading_cm"] = model.sample(columns, default_rng([seed, rows, 1]))
    return columns


def workflow(folder: Path, rows: int) -> tuple[float, float, float]:
    """Seconds, processor seconds and the largest memory [GB] of `msp-lab gap` on a file of so many readings."""
    path = folder / f"{rows}.csv"
    write_readings(path, rows)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    started_s = time.perf_counter()
    command = [MSP_LAB, "gap", path, "--model", SENSOR, "--out", folder / f"{rows}"]
    subprocess.run([str(each) for each in command], check=True, capture_output=True)
    wall_s = time.perf_counter() - started_s
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    path.unlink()
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return wall_s, cpu_s, after.ru_maxrss / 1e6


def screen_s(rows: int) -> float:
    """Seconds for one screen of so many readings at the fitted base."""
    columns = measured(rows, 1)
    reading_cm = np.asarray(columns.pop("reading_cm"), dtype=float)
    unit = numbered(np.asarray(columns["run"]))
    problem = Problem.of(load_model(SENSOR), columns, reading_cm, unit, default_rng(1))
    state = first_state(problem)
    started_s = time.perf_counter()
    screened(problem, state)
    return time.perf_counter() - started_s


def write_readings(path: Path, rows: int) -> None:
    """Write a CSV file of so many readings."""
    with path.open("w", encoding="utf-8") as file:
        for start in range(0, rows, AT_ONCE):
            columns = measured(min(AT_ONCE, rows - start), start)
            if start:
                columns["run"] = np.char.add(f"{start}/", np.asarray(columns["run"], dtype=str))
            else:
                file.write(",".join(columns) + "\n")
            texts = [
                each.tolist() if each.dtype.kind == "U" else [f"{value:.6g}" for value in each.tolist()]
                for each in columns.values()
            ]
            file.writelines(",".join(row) + "\n" for row in zip(*texts, strict=True))


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--rows", type=int, default=READINGS, help="readings (default: %(default)s)")


def main(given: argparse.Namespace) -> None:
    """Measure the workflow once on so many readings, and nothing else."""
    with tempfile.TemporaryDirectory() as name:
        wall_s, cpu_s, largest_gb = workflow(Path(name), given.rows)
    print(f"{given.rows} readings: {wall_s:.1f} s, {cpu_s:.1f} s of the processor, {largest_gb:.2f} GB")
