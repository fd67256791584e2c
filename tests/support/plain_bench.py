"""Points of a bench by the plainest sampling: a mean, a normal spread, rounding, and shares of codes and of strays.

Shares no code with the simulator, the reading model or the analyses.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msp_range.recording.csv_form import MeasuredData

WORDS = ("sensor", "run", "condition", "target")


def point(
    rng: np.random.Generator,
    true_cm: float,
    *,
    n: int = 100,
    error_cm: float = 0.0,
    sigma_cm: float = 0.6,
    missed: float = 0.0,
    saturated: float = 0.0,
    stray: float = 0.0,
    **context: Any,
) -> dict[str, NDArray[Any]]:
    """Columns of one point: whole centimetres from 20 to 765, 765 and 255 for missed echoes, strays anywhere."""
    reading = np.clip(np.rint(true_cm + error_cm + sigma_cm * rng.standard_normal(n)), 20, 765)
    kind = rng.random(n)
    reading[kind < missed + saturated + stray] = np.rint(
        rng.uniform(20, 764, (kind < missed + saturated + stray).sum())
    )
    reading[kind < missed + saturated] = 255.0
    reading[kind < missed] = 765.0
    columns = {"reading_cm": reading, "true_range_cm": np.full(n, float(true_cm))}
    given = {"sensor": "one", "run": "day", "condition": "baseline", **context}
    for name, value in given.items():
        columns[name] = np.full(n, value) if name in WORDS else np.full(n, float(value))
    return columns


def table(*points: dict[str, NDArray[Any]]) -> MeasuredData:
    """Points as one table; a column that one of them lacks is empty there."""
    names = dict.fromkeys(name for each in points for name in each)
    columns = {
        name: np.concatenate(
            [each.get(name, np.full(each["reading_cm"].size, "" if name in WORDS else np.nan)) for each in points]
        )
        for name in names
    }
    columns["time_s"] = np.arange(float(columns["reading_cm"].size))
    return MeasuredData(columns)
