"""Readings whose context is unknown: they are left out where an effect needs it.

A mask of readings says where the columns of an effect are known. A blank temperature is neither the one of the row
before nor 22.5 C: what the air did to that reading is unknown, and to count it as nothing hides the effect in the
others.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from msp_lab.gap import rules
from msp_lab.readings.intake import PREVIOUS
from msp_range.arrays import Flags
from msp_sim.effects.base import REFERENCE_STD, Scene
from msp_sim.model.model import Model

BLANK_IS_NONE = frozenset(
    {
        "neighbour_lag_ms",
        "neighbour_range_cm",
        "external_level_db",
        "external_duty",
        "external_distance_cm",
        "external_frequency_khz",
        "condition",
        PREVIOUS,
        REFERENCE_STD,
    }
)
"""Columns in which a blank cell says that there is none: no other sensor, no source, no reading before."""


@dataclass(frozen=True)
class KnownRows:
    """Readings of which the columns that are known in most of them are known."""

    rows: Flags
    """Which readings these are, (n,)."""
    columns: tuple[str, ...] = ()
    """Columns with blank cells that are known in all of them."""
    unasked: tuple[str, ...] = ()
    """Columns with so many blank cells that nothing is asked of them."""

    @classmethod
    def of(cls, model: Model, contexts: Mapping[str, Any]) -> "KnownRows":
        """The readings on which all that can be asked is asked; columns with the fewest blank cells come first."""
        scene = Scene(model.sensor, contexts)
        known = {name: scene.known(name) for name in contexts if name not in BLANK_IS_NONE}
        partly = {name: each for name, each in known.items() if isinstance(each, np.ndarray) and each.any()}
        rows = np.ones(scene.range_cm.size, dtype=bool)
        columns, unasked = [], []
        for name in sorted(partly, key=lambda name: -int(partly[name].sum())):
            if (rows & partly[name]).mean() >= rules.MIN_KNOWN_SHARE:
                rows = rows & partly[name]
                columns.append(name)
            else:
                unasked.append(name)
        return cls(rows, tuple(columns), tuple(unasked))

    def needed(self, model: Model, contexts: Mapping[str, Any]) -> "KnownRows":
        """The readings of which those columns are known that the model's effects need."""
        required = {name for each in model.effects for name in each.effect.requires}
        columns = tuple(name for name in self.columns if name in required)
        scene = Scene(model.sensor, contexts)
        rows = np.ones(scene.range_cm.size, dtype=bool)
        for name in columns:
            rows &= scene.known(name)
        return KnownRows(rows, columns, self.unasked)

    @property
    def message(self) -> str:
        """What is left out, in a sentence; empty where nothing is."""
        if not self.columns:
            return ""
        left_out = int((~self.rows).sum())
        return f"{' and '.join(self.columns)}: {left_out} readings without it are left out, since an effect needs it."
