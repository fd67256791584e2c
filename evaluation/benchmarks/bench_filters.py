"""The changepoint filter: cost of an update early and late in a flight; and the time of the whole filter study."""

import statistics
import time

import numpy as np

from evaluation import CONFIGS
from evaluation.benchmarks.figure import Figures, Goal, at_most, figure, under
from msp_lab.filter_study.explain import explain_rows
from msp_lab.filter_study.goals import check_goals
from msp_lab.filter_study.study import run_study
from msp_lab.filter_study.table import report_table
from msp_range.filters.base import Estimate
from msp_range.filters.changepoint import ChangepointParameters
from msp_range.reading_model.sensor_model import load_sensor_model

SENSOR = CONFIGS / "sensors" / "mb1242.yaml"
UPDATES = 20_000
COUNTED = 2_000
SEEDS = 200


def run() -> Figures:
    """All figures of this file."""
    early_us, late_us = _update_us()
    started_s = time.perf_counter()
    results = run_study(SEEDS, 1)
    study_s = time.perf_counter() - started_s
    started_s = time.perf_counter()
    explain_rows(report_table())
    explain_s = time.perf_counter() - started_s
    wanted = [goal for goal in check_goals(results) if goal.met is not None]
    reached = sum(goal.met is True for goal in wanted)
    return [
        figure("changepoint_update", late_us, "us", at_most(300)),
        figure("changepoint_update_late_over_early", late_us / early_us, "times", at_most(1.2)),
        figure("filter_study", study_s, f"s, {SEEDS} seeds of all scenarios and filters", under(60)),
        figure("filter_table_explained", explain_s, "s, tables 5.4-5.6"),
        figure("filter_goals_reached", reached, f"of {len(wanted)}", Goal("all", lambda value: value == len(wanted))),
    ]


def _update_us() -> tuple[float, float]:
    """Median CPU time of an update in the first and the last readings of a long flight with outliers."""
    one = ChangepointParameters(filter="changepoint").make(load_sensor_model(SENSOR))
    rng = np.random.default_rng(1)
    height_m = 3.0 + 1.5 * np.sin(np.arange(UPDATES) / 80.0)
    outliers = rng.random(UPDATES) < 0.05
    readings = np.where(outliers, rng.uniform(0.2, 7.6, UPDATES), height_m + rng.normal(0.0, 0.02, UPDATES)).round(2)
    spent_ns = []
    for number, range_m in enumerate(readings.tolist()):
        started_ns = time.thread_time_ns()
        one.update(0.1 * number, Estimate(range_m, 4e-4))
        spent_ns.append(time.thread_time_ns() - started_ns)
    return statistics.median(spent_ns[:COUNTED]) / 1e3, statistics.median(spent_ns[-COUNTED:]) / 1e3
