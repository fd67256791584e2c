"""The folder of a Monte Carlo run: a row per flight in flights.csv, and what was flown in settings.json.

A row is on disk as soon as its flight is done, so that an interrupted run is resumed; the same seed gives the same
file.
"""

import csv
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from msp_range.yaml_file import ConfigError
from msp_sim.terminal import make_folder

FLIGHTS, SETTINGS, SUMMARY, PICTURE = "flights.csv", "settings.json", "summary.json", "flights.png"
"""Names of the files in the folder."""
NUMBER = "flight"
"""Column with the number of the flight."""
WORDS = ("faults", "sha256")
"""Columns that hold text."""
Row = Mapping[str, Any]


class FlightStore:
    """The flights in a folder.

    Parameters
    ----------
    folder
        Made if it is not there.
    columns
        Columns of the table, after the flight's number.
    settings
        What the flights depend on; those of another run in the folder are refused.

    Raises
    ------
    ConfigError
        The folder has flights of other settings, or cannot be used.
    """

    def __init__(self, folder: Path, columns: Sequence[str], settings: Mapping[str, Any]) -> None:
        self._path = folder / FLIGHTS
        self._columns = [NUMBER, *columns]
        make_folder(folder)
        text = json.dumps(settings, indent=2) + "\n"
        known = folder / SETTINGS
        if known.exists() and known.read_text(encoding="utf-8") != text:
            earlier = json.loads(known.read_text(encoding="utf-8"))
            other = [key for key in settings if earlier.get(key) != settings[key]]
            raise ConfigError(
                f"{folder}: holds flights with another {', '.join(other)}; name another --out, or delete {folder}"
            )
        known.write_text(text, encoding="utf-8")
        self._rows: dict[int, Row] = {row[NUMBER]: row for row in self._read()}
        self._write(self.rows)
        self._file = self._path.open("a", encoding="utf-8", newline="")

    @property
    def rows(self) -> list[Row]:
        """All flights in the order of their numbers."""
        return [self._rows[number] for number in sorted(self._rows)]

    def add(self, number: int, numbers: Mapping[str, Any]) -> None:
        """Add a flight."""
        row = {NUMBER: number} | {name: numbers[name] for name in self._columns[1:]}
        self._rows[number] = row
        csv.DictWriter(self._file, self._columns).writerow(row)
        self._file.flush()

    def close(self) -> None:
        """Close the table; its rows are in the order of their numbers."""
        self._file.close()
        if list(self._rows) != sorted(self._rows):
            self._write(self.rows)

    def _write(self, rows: Iterable[Row]) -> None:
        """Replace the table."""
        new = self._path.with_suffix(".new")
        with new.open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, self._columns)
            writer.writeheader()
            writer.writerows(rows)
        new.replace(self._path)

    def _read(self) -> list[Row]:
        """The flights of an earlier run; a row that was cut off with its program is left out."""
        if not self._path.exists():
            return []
        lines = [line for line in self._path.read_text(encoding="utf-8").splitlines(keepends=True) if "\n" in line]
        return [{key: _value(key, text) for key, text in row.items()} for row in csv.DictReader(lines)]


def _value(column: str, text: str) -> Any:
    """A value as it was written."""
    if column in WORDS:
        return text
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    return {"": None, "True": True, "False": False}.get(text, text)
