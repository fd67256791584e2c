"""When and where readings are taken: times, true ranges and contexts, before any reading is drawn."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Rows:
    """One table without its readings; all arrays have one entry per reading."""

    run: NDArray[np.int64]
    sensor: NDArray[np.int64]
    """Numbers of the run and of the sensor."""
    block: NDArray[np.int64]
    """The noise is independent between blocks: a run of one sensor, or one range at the bench."""
    time_s: Floats
    """Time since the start of the run."""
    true_cm: Floats
    """Perpendicular distance to the surface."""
    range_before: Callable[[float], Floats]
    """True range a delay [s] before each reading."""
    contexts: dict[str, NDArray[Any]] = field(default_factory=dict)
    """Further columns, numbers or words."""
    spacing_s: float = 0.1
    """Mean time between readings of one sensor."""
    placed_cm: Floats | float = 0.0
    """Error of the true range that the table says."""

    def __len__(self) -> int:
        return len(self.time_s)

    def columns(self, reading_cm: Floats, run: str, sensors: Sequence[str] = ("down",)) -> dict[str, NDArray[Any]]:
        """The table in the CSV form; a run is the words of ``run`` with its number, from 1 on."""
        return {
            "time_s": np.round(self.time_s, 4),
            "sensor": np.array(sensors)[self.sensor],
            "run": np.array([run.format(number + 1) for number in self.run]),
            "reading_cm": reading_cm,
            "true_range_cm": np.round(self.true_cm + self.placed_cm, 2),
            **self.contexts,
        }

    def previous(self) -> NDArray[np.int64]:
        """Index of the row before in the same block; -1 where it is the first."""
        last: dict[int, int] = {}
        before = np.full(len(self), -1)
        for index, block in enumerate(self.block.tolist()):
            before[index] = last.get(block, -1)
            last[block] = index
        return before
