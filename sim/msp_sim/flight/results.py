"""The folder with the results of a flight: numbers, picture, recording, link log. None is replaced unless asked."""

import json
from pathlib import Path
from typing import Any

from msp_range.extras import missing
from msp_range.yaml_file import ConfigError
from msp_sim.flight.flight_log import FlightResult
from msp_sim.terminal import make_folder

RECORDING, TLOG, NUMBERS, PICTURE, SCENARIO = "flight.mcap", "link.tlog", "summary.json", "flight.png", "scenario.yaml"
"""Names of the files in the folder of a flight."""


def make_ready(folder: Path, force: bool) -> None:
    """Make the folder of a flight, and delete the files of an earlier flight.

    Raises
    ------
    ConfigError
        The folder holds a flight and ``force`` is not given, or it cannot be made.
    """
    make_folder(folder)
    existing = [folder / name for name in (RECORDING, TLOG, NUMBERS, PICTURE, SCENARIO) if (folder / name).exists()]
    if existing and not force:
        raise ConfigError(
            f"{existing[0]}: a flight is in this folder already; name another one, or replace it: --force"
        )
    for path in existing:
        path.unlink()
    if (absent := missing("sim")) is not None:
        print(f"no picture will be drawn without {absent}")


def write_results(folder: Path, summary: dict[str, Any], flight: FlightResult, title: str) -> None:
    """Write the numbers and, if matplotlib is installed, the picture of a flight, and print their paths."""
    (folder / NUMBERS).write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    print(f"  numbers: {folder / NUMBERS}")
    if missing("sim") is None:
        from msp_sim.flight.flight_picture import draw

        draw(flight, folder / PICTURE, title)
        print(f"  picture: {folder / PICTURE}")
