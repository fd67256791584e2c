"""Runs the product on a case: characterise on the bench table, then gap on the runs, in this process.

The only module here that knows of the product, and only by its commands and the files that they leave.
"""

import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from evaluation.product import command
from evaluation.second_hand.generator import Case

SENSOR = Path(__file__).parent / "sensor.yaml"
DATE = "2026-01-01"
"""Date in the model files: a case gives the same files on every day."""

NAMED = ("named", "indistinguishable")
"""Verdicts that an effect is there; any other is a suggestion."""
NOTHING: dict[str, Any] = {
    "verdict": "",
    "effects": [],
    "unknown": [],
    "calibration": [],
    "sentence": "",
    "seconds": 0.0,
}
"""What is reported where a command crashed."""


def characterise(bench: Path, model: Path) -> str:
    """Make the sensor's model of a bench table; what ended the command, empty where it succeeded."""
    return command("msp-lab", "characterise", bench, "--sensor", SENSOR, "--out", model, "--date", DATE)


def run_case(case: Case, splits: int | None = None) -> dict[str, Any]:
    """Run both commands on a case.

    Parameters
    ----------
    case
        Its tables.
    splits
        Random seed of `gap`, by which runs are split; None: its default.

    Returns
    -------
    dict
        ``verdict``, ``effects`` (name, alternatives, parameters), ``curves`` (channel, variables, formula),
        ``calibration`` (names of base numbers that changed), ``sentence``, ``seconds``, and ``crash``: empty, or what
        ended the command.
    """
    # Here, so that the generator can be used without the product.
    from msp_range.recording.csv_form import write_csv

    seed = () if splits is None else ("--seed", splits)
    with TemporaryDirectory() as folder:
        bench, runs, model, out = (Path(folder) / name for name in ("bench.csv", "runs.csv", "model.yaml", "gap"))
        write_csv(bench, case.bench)
        write_csv(runs, case.runs)
        crash = characterise(bench, model) or command(
            "msp-lab", "gap", runs, "--model", model, "--out", out, "--until", "add", *seed
        )
        reported = NOTHING if crash else json.loads((out / "gap.json").read_text())
    return {
        "verdict": reported["verdict"],
        "effects": [
            {
                "name": each["name"],
                "alternatives": [other["name"] for other in each["alternatives"]],
                "parameters": each["parameters"],
            }
            for each in reported["effects"]
            if each["verdict"] in NAMED
        ],
        "curves": [{name: each[name] for name in ("channel", "variables", "formula")} for each in reported["unknown"]],
        "calibration": [each["name"] for each in reported["calibration"]],
        "sentence": reported["sentence"],
        "seconds": reported["seconds"],
        "crash": crash,
    }
