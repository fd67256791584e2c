"""A session: what a person sets up or a pilot flies, the contexts of its readings, and how long it takes."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

import numpy as np

from msp_lab.gap.runs import taken
from msp_range.arrays import Column

Columns: TypeAlias = Mapping[str, Column]
Kind: TypeAlias = Literal["bench", "flight"]


def chosen(levels: tuple[float, ...], ends_only: bool) -> tuple[float, ...]:
    """All levels of what is varied, or the first and the last."""
    return (levels[0], levels[-1]) if ends_only else levels


@dataclass(frozen=True)
class PlannedSession:
    """A session of a kind, as long as it is."""

    kind: Kind
    """At the bench, or in flight."""
    varied: Mapping[str, str]
    """Context columns that it varies, with their values in words."""
    contexts: Columns
    """Context columns of its readings, (n,), `run` among them."""
    per_point: int
    """Readings of a sensor at a point, or in a flight."""
    visits: int
    """How often each point is set up anew, or each group of flights flown."""
    minutes: float
    """Time for setting up and for reading or flying."""
    campaign: Mapping[str, Any]
    """Content of the campaign file."""
    scenarios: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """Content of the scenario files of its flights, by name."""
    offset_cm: float = 0.0
    """Standard deviation of the true range's error of each run: the reference's."""

    @property
    def readings(self) -> int:
        """How many."""
        return int(np.size(self.contexts["true_range_cm"]))

    @property
    def runs(self) -> int:
        """In how many runs."""
        return np.unique(self.contexts["run"]).size

    def sampled(self, rows: int) -> Columns:
        """The contexts of so many of its readings, evenly over the session; of a short session several times."""
        place = (np.arange(rows) + 0.5) * self.readings / rows
        # Steps that are no whole number, so that of sensors that ping in turn all are taken.
        return taken(self.contexts, place.astype(np.intp))
