"""The changepoint filter: cost of an update early and late in a flight; and the time of the whole filter study."""

import statistics
import time
from typing import Any

import numpy as np

from evaluation import CONFIGS
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


def run() -> list[dict[str, Any]]:
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
        _figure("changepoint_update", late_us, "us", "at most 300", late_us <= 300),
        _figure(
            "changepoint_update_late_over_early", late_us / early_us, "times", "at most 1.2", late_us < 1.2 * early_us
        ),
        _figure("filter_study", study_s, f"s, {SEEDS} seeds of all scenarios and filters", "under 60", study_s < 60),
        _figure("filter_table_explained", explain_s, "s, tables 5.4-5.6", None, None),
        _figure("filter_goals_reached", reached, f"of {len(wanted)}", "all", reached == len(wanted)),
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


def _figure(key: str, value: float, unit: str, goal: str | None, met: bool | None) -> dict[str, Any]:
    return {"key": key, "value": round(value, 2), "unit": unit, "goal": goal, "met": met}
