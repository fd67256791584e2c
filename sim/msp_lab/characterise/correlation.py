"""How alike the errors of neighbouring hits are: the correlation that goes into the sensor model file.

It is estimated from points and the times of the readings, with the time to which it refers. Each point is taken about
the mean of its own hits, so that an error of its placement is no correlation. The fit of the mixture takes readings as
independent; the simulator and the gap workflow draw and score them with this correlation.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from msp_lab.characterise.points import PointReadings
from msp_range.arrays import Array
from msp_range.recording.csv_form import MeasuredData
from msp_sim.model.history import MAX_CORRELATION

SURE_Z = 3.5
"""A correlation goes into the file if it is this many standard errors above zero (p = 2e-4, one-sided). Lower: models
of independent readings get correlated noise; higher: weak correlation is found missing later, by the gap workflow."""
NEIGHBOURS = 1.5
"""Hits farther apart in time than this many usual steps are no neighbours: something between them was no hit, or the
range was come back to."""
MIN_HITS = 10
"""Points with fewer hits are left out: their own mean takes away a tenth of a correlation and more."""


class HitCorrelation(NamedTuple):
    """Correlation of the errors of two hits that are `spacing_s` apart, and its standard errors from none."""

    correlation: float
    spacing_s: float
    z: float

    @property
    def note(self) -> str:
        """What to know of it."""
        return (
            f"errors of hits {self.spacing_s:.3g} s apart have a correlation of {self.correlation:.2f} ({self.z:.0f} "
            "standard errors): the simulator draws them so, and intervals that take readings as independent are too "
            "narrow"
        )


def hit_correlation(points: Sequence[PointReadings], data: MeasuredData) -> HitCorrelation | None:
    """Correlation of neighbouring hits at undisturbed points; None where there is none for sure.

    `data` are the readings from which the points were made, for their times; without these nothing is known.
    """
    if "time_s" not in data:
        return None
    time_s = data["time_s"]
    step_s, one_cm, other_cm, hits = np.concatenate([np.empty((4, 0)), *(_steps(p, time_s) for p in points)], axis=1)
    if not step_s.size or not np.median(step_s) > 0.0:
        return None
    spacing_s = float(np.median(step_s))
    near = step_s <= NEIGHBOURS * spacing_s
    variance = float(np.mean(one_cm[near] ** 2))
    if variance <= 0.0:
        return None
    # About its own mean a point of n independent hits has a correlation of -1 / n.
    correlation = float((one_cm * other_cm)[near].mean() / variance + (1.0 / hits[near]).mean())
    z = correlation * float(np.sqrt(np.count_nonzero(near)))
    return HitCorrelation(min(correlation, MAX_CORRELATION), spacing_s, z) if z > SURE_Z else None


def _steps(point: PointReadings, time_s: Array) -> Array:
    """From each hit to the next in time, shape (4, steps): seconds, both errors [cm], and hits at this point."""
    hit = np.flatnonzero(point.is_hit & np.isfinite(time_s[point.rows]))
    if hit.size < MIN_HITS:
        return np.empty((4, 0))
    hit = hit[np.argsort(time_s[point.rows[hit]], kind="stable")]
    error_cm = point.error_cm[hit] - point.error_cm[hit].mean()
    step_s = np.diff(time_s[point.rows[hit]])
    return np.array([step_s, error_cm[:-1], error_cm[1:], np.full(step_s.size, hit.size)])
