"""Readings and contexts from the project's CSV form, for the measures of this package."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

NO_CONTEXT = ("reading_cm", "previous_reading_cm", "time_s", "run")
"""Not a context of a reading: itself, its predecessor, when it was taken, and the run, by which rows are left out."""

STEPS_CM = (10.0, 5.0, 2.54, 2.0, 1.0, 0.5, 0.2, 0.1, 0.05)
"""Steps of readings that are looked for, the coarsest first; finer ones count as none."""


@dataclass(frozen=True)
class Table:
    """Readings with their contexts."""

    reading_cm: FloatArray
    """One a row."""
    contexts: dict[str, FloatArray]
    """Columns of numbers; words are numbered in order."""
    run: NDArray[np.str_]
    """Name of each row's run."""

    @property
    def residual_cm(self) -> FloatArray:
        """Reading less true range."""
        return self.reading_cm - self.contexts["true_range_cm"]

    def of_step(self, step_cm: float) -> "Table":
        """The same, readings rounded to a step."""
        rounded = np.round(self.reading_cm / step_cm) * step_cm if step_cm > 0.0 else self.reading_cm
        return Table(rounded, self.contexts, self.run)


def comparable(cells: dict[str, list[str]], run: str) -> dict[str, list[str]]:
    """Rows with a reading and a true range, each with its run and the reading before it of the same sensor.

    Parameters
    ----------
    cells
        A table.
    run
        Name of its run, where it has no column `run`.
    """
    count = len(cells["reading_cm"])
    cells = {"run": [run] * count, "sensor": ["sensor"] * count} | cells
    last: dict[tuple[str, str], str] = {}
    previous = []
    for key, reading in zip(zip(cells["run"], cells["sensor"], strict=True), cells["reading_cm"], strict=True):
        previous.append(last.get(key, ""))
        last[key] = reading
    cells["previous_reading_cm"] = previous
    kept = [bool(reading and truth) for reading, truth in zip(cells["reading_cm"], cells["true_range_cm"], strict=True)]
    return {name: [cell for cell, keep in zip(column, kept, strict=True) if keep] for name, column in cells.items()}


def table_of(cells: dict[str, list[str]]) -> Table:
    """Numbers of a table."""
    contexts = {}
    for name, column in cells.items():
        if name in NO_CONTEXT:
            continue
        try:
            numbers = np.array([float(cell) if cell else np.nan for cell in column])
        except ValueError:
            numbers = np.unique(column, return_inverse=True)[1].astype(float)
        if np.unique(numbers[~np.isnan(numbers)]).size > 1 or name == "true_range_cm":
            contexts[name] = numbers
    return Table(np.array(cells["reading_cm"], dtype=float), contexts, np.array(cells["run"]))


def step_of(reading_cm: FloatArray) -> float:
    """Step of the readings [cm]; 0 where there is none."""
    for step in STEPS_CM:
        if np.mean(np.abs(reading_cm / step - np.round(reading_cm / step)) < 1e-6) > 0.99:
            return step
    return 0.0
