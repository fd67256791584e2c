"""The study as files: figures, its numbers as JSON, and its own statistics in the form that ``--table`` reads."""

import csv
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from msp_lab.filter_study.bands import find_bands
from msp_lab.filter_study.draw import draw_figures
from msp_lab.filter_study.explain import FilterResult
from msp_lab.filter_study.goals import check_goals
from msp_lab.filter_study.nine import AS_REPORTED
from msp_lab.filter_study.scenarios import NAMES
from msp_lab.filter_study.statistics import STATISTICS
from msp_lab.filter_study.study import Study
from msp_lab.filter_study.table import COLUMNS


def publish_study(
    folder: Path, results: Study, reverse: bool, verdicts: Sequence[FilterResult], seed: int
) -> list[Path]:
    """Write all files of a study and return their paths."""
    table, figures = folder / "table.csv", folder / "filters.json"
    with table.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        for scenario in NAMES:
            for name, variant in AS_REPORTED.items():
                middle = find_bands(variant)[scenario].middle
                writer.writerow([scenario, name, *(f"{value:.3f}" for value in middle)])
    figures.write_text(json.dumps(_figures(results, reverse, verdicts), indent=2) + "\n", encoding="utf-8")
    return [table, figures, *draw_figures(folder, seed)]


def _figures(results: Study, reverse: bool, verdicts: Sequence[FilterResult]) -> dict[str, Any]:
    noises = {"report_noise": results.report_noise, "outlier_readings": results.outliers}
    return {
        "rms_cm": {
            noise: {
                scenario: {name: round(float(np.mean(rms_cm)), 4) for name, rms_cm in compared.rms_cm.items()}
                for scenario, compared in of_noise.items()
            }
            for noise, of_noise in noises.items()
        },
        "delay_samples": {
            scenario: {name: None if np.isnan(delay) else round(delay, 2) for name, delay in compared.delay.items()}
            for scenario, compared in results.report_noise.items()
        },
        "goals": [
            {"figure": goal.name, "value": goal.shown, "goal": goal.wanted, "met": goal.met}
            for goal in check_goals(results)
        ],
        "errors_are_truth_less_estimate": reverse,
        "explanations": [_explanation(verdict) for verdict in verdicts],
    }


def _explanation(verdict: FilterResult) -> dict[str, Any]:
    return {
        "filter": verdict.filter,
        "explained": verdict.changes is not None,
        "changes": [
            {"what": change.kind, "value": change.value, "text": change.text}
            for change in (verdict.nearest or () if verdict.changes is None else verdict.changes)
        ],
        "tried": verdict.tried,
        "rows": {
            scenario: {
                "table": dict(zip(STATISTICS, row.values, strict=True)),
                "predicted": dict(zip(STATISTICS, verdict.after[scenario].middle.round(4).tolist(), strict=True)),
                "gap_before": round(float(np.abs(verdict.before[scenario].distance(row)).max()), 2),
                "gap_after": round(float(np.abs(verdict.after[scenario].distance(row)).max()), 2),
                "columns_swapped": row.swapped,
            }
            for scenario, row in verdict.rows.items()
        },
    }
