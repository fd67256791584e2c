"""Tables in the project's CSV form, written and read without the product."""

import csv
import gzip
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray


def cells_of(column: NDArray[Any], digits: int) -> list[Any]:
    """Cells of a column: numbers with so many digits, and an empty one for what is unknown."""
    values: list[Any] = column.tolist()
    return ["" if np.isnan(each) else f"{each:.{digits}g}" for each in values] if column.dtype.kind == "f" else values


def write_form(path: Path, cells: Mapping[str, Sequence[Any]]) -> Path:
    """Write cells by column; the file is there when it is complete."""
    path.parent.mkdir(parents=True, exist_ok=True)
    begun = path.with_suffix(".part")
    with begun.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(cells)
        writer.writerows(zip(*cells.values(), strict=True))
    return begun.replace(path)


def read_form(path: Path) -> dict[str, list[str]]:
    """Cells by column, of a packed file too."""
    with gzip.open(path, "rt") if path.suffix == ".gz" else path.open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    return {name: [row[k] for row in rows] for k, name in enumerate(header)}
