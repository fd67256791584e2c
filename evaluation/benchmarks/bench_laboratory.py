"""The report's whole campaign on the simulator: collected, fitted and reported, by the commands that a person types."""

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from evaluation import CONFIGS
from evaluation.benchmarks.figure import Figures, at_most, figure, under

CAMPAIGN = CONFIGS / "campaigns" / "table_4_1.yaml"
BIN = Path(sys.executable).parent


def run() -> Figures:
    """Wall time of both commands, and how far the sonar equation misses the angles that were measured."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        report = folder / "report"
        started_s = time.perf_counter()
        _call("msp-lab", "collect", CAMPAIGN, "--simulate", "--out", folder / "collected")
        collected_s = time.perf_counter()
        readings = folder / "collected" / "readings.csv"
        _call("msp-lab", "characterise", readings, "--out", folder / "model.yaml", "--report", report)
        done_s = time.perf_counter()
        rows = json.loads((report / "findings.json").read_text(encoding="utf-8"))["sonar"]["rows"]
    misses_deg = [abs(row["fitted_deg"] - row["measured_deg"]) for row in rows]
    return [
        figure("campaign_collected", collected_s - started_s, "s, Table 4.1 complete"),
        figure("campaign_to_report", done_s - started_s, "s, collected, fitted and reported", under(120)),
        figure(
            "sonar_equation_misses",
            max(misses_deg),
            f"deg, largest of {len(misses_deg)} breakaway angles",
            at_most(1.8),
        ),
    ]


def _call(command: str, *arguments: object) -> None:
    subprocess.run([str(BIN / command), *map(str, arguments)], check=True, stdout=subprocess.DEVNULL)
