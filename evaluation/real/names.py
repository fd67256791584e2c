"""Names that are required, allowed and forbidden in each measured set.

A line of `names.csv` holds one thing or several that stand for each other (`|`): a name of the catalogue, ``unknown
CHANNEL of VARIABLE``, or ``calibration NAME``. A name of the catalogue that no line of a set holds is forbidden there.
"""

import argparse
import csv
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

FILE = Path(__file__).parent / "names.csv"


@dataclass(frozen=True)
class Line:
    """A line of the table."""

    status: str
    """required, allowed or forbidden."""
    what: tuple[str, ...]
    """One of these."""
    values: str
    """``PARAMETER LOW HIGH`` of a required name, or empty: a right name with another number is not what is there."""
    why: str
    """The numbers of the analysis."""

    def holds(self, parameters: Mapping[str, float]) -> bool:
        """Whether an effect's parameters are what is there; what is no effect of the catalogue has none."""
        if not self.values or not parameters:
            return True
        name, low, high = self.values.split()
        return float(low) <= parameters.get(name, float("nan")) <= float(high)


def expected_names() -> dict[str, list[Line]]:
    """Lines by set."""
    lines: dict[str, list[Line]] = {}
    with FILE.open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            lines.setdefault(row["set"], []).append(
                Line(row["status"], tuple(row["what"].split("|")), row["values"], row["why"])
            )
    return lines


def markdown_table() -> str:
    """The table of `docs/real_data.md`."""
    rows = ["| set | | name | why |", "|---|---|---|---|"]
    for name, lines in expected_names().items():
        for k, line in enumerate(lines):
            what = " or ".join(f"`{each}`" for each in line.what)
            if line.status != "required":
                what = what.replace(" or ", ", ")
            if line.values:
                what += " ({} {} to {})".format(*line.values.split())
            rows.append(f"| {name if k == 0 else ''} | {line.status} | {what} | {line.why} |")
    return "\n".join(rows)


def options(parser: argparse.ArgumentParser) -> None:
    """It has none."""


def main(given: argparse.Namespace) -> None:
    """Print the table of the document."""
    print(markdown_table())
