"""Raw tables of the measured sets, as they are in the files: centimetres and seconds, and nothing else done to them.

Nothing of the product is imported here, so that an error of its readers or of its column maps is seen.
"""

import csv
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evaluation.csv_form import read_form

FloatArray = NDArray[np.floating[Any]]


def read_table(path: Path) -> dict[str, FloatArray]:
    """Columns of numbers of a CSV file with a header; empty cells are NaN, columns of words are left out."""
    columns: dict[str, FloatArray] = {}
    for name, cells in read_form(path).items():
        try:
            columns[name] = np.array([float(cell or "nan") for cell in cells])
        except ValueError:
            continue
    return columns


def read_words(path: Path, name: str) -> NDArray[np.str_]:
    """One column of words."""
    return np.array(read_form(path)[name])


def read_tilt(path: Path) -> list[tuple[str, float, FloatArray, FloatArray]]:
    """The five tables of the tilted HC-SR04: name, distance of the heading [cm], angles [deg], readings [cm]."""
    with path.open(encoding="utf-8", newline="") as file:
        _, *rows = csv.reader(file)
    tables = []
    for name, column, distance_cm in (
        ("vertical 2", 0, 2.0),
        ("vertical 4", 3, 4.0),
        ("vertical 6", 6, 6.0),
        ("vertical 10", 9, 10.0),
        ("horizontal 5", 12, 5.0),
    ):
        pairs = [row[column : column + 2] for row in rows if len(row) > column + 1 and row[column] and row[column + 1]]
        angle, reading = np.array(pairs, dtype=float).T
        # The row at 0 or 1 deg holds the last reading of the sweep before.
        tables.append((name, distance_cm, angle[angle > 1], reading[angle > 1]))
    return tables
