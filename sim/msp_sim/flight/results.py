"""The folder with the results of a flight: numbers, picture, recording, link log. None is replaced unless asked."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from msp_range.extras import missing
from msp_range.yaml_file import ConfigError
from msp_sim.flight.flight_log import FlightResult
from msp_sim.terminal import make_folder

RECORDING, TLOG, NUMBERS, PICTURE, SCENARIO = "flight.mcap", "link.tlog", "summary.json", "flight.png", "scenario.yaml"
"""Names of the files in the folder of a flight."""


@dataclass(frozen=True)
class Results:
    """Where the results of a flight go."""

    folder: Path
    force: bool
    """Whether those of an earlier flight are replaced."""

    def make_ready(self) -> None:
        """Make the folder, and delete the files of an earlier flight.

        Raises
        ------
        ConfigError
            The folder holds a flight that is not to be replaced, or it cannot be made.
        """
        make_folder(self.folder)
        names = (RECORDING, TLOG, NUMBERS, PICTURE, SCENARIO)
        existing = [path for name in names if (path := self.folder / name).exists()]
        if existing and not self.force:
            raise ConfigError(
                f"{existing[0]}: a flight is in this folder already; name another one, or replace it: --force"
            )
        for path in existing:
            path.unlink()
        if (absent := missing("sim")) is not None:
            print(f"no picture will be drawn without {absent}")

    def write(self, summary: dict[str, Any], flight: FlightResult, title: str) -> None:
        """Write the numbers and, if matplotlib is installed, the picture of a flight, and print their paths."""
        (self.folder / NUMBERS).write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
        print(f"  numbers: {self.folder / NUMBERS}")
        if missing("sim") is None:
            from msp_sim.flight.flight_picture import draw

            draw(flight, self.folder / PICTURE, title)
            print(f"  picture: {self.folder / PICTURE}")
