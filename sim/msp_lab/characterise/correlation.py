"""How alike the errors of neighbouring hits are: the correlation that goes into the sensor model file.

Points and the times of the readings enter, a correlation and the time to which it refers leave. Each point is taken
about the mean of its own hits, so that an error of its placement is no correlation. The fit of the mixture takes
readings as independent; the simulator and the gap workflow draw and score them with this correlation.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from msp_lab.characterise.points import PointReadings
from msp_range.arrays import Array
from msp_range.recording.csv_form import MeasuredData
from msp_sim.model.history import MAX_CORRELATION

SURE_Z = 3.5
"""A correlation goes into the file if it is so many standard errors from none (p = 2e-4, one-sided). Lower: models of
independent readings get correlated noise; higher: weak correlation is found missing later, by the gap workflow."""
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


def hit_correlation(points: Sequence[PointReadings], data: MeasuredData) -> HitCorrelation | None:
    """Correlation of neighbouring hits; None where there is none for sure, or times are not known.

    Parameters
    ----------
    points
        Undisturbed, on the axis.
    data
        The readings from which the points were made, for their times.
    """
    if "time_s" not in data:
        return None
    time_s = np.asarray(data["time_s"], dtype=np.float64)
    steps = [each for point in points for each in _steps(point, time_s)]
    if not steps:
        return None
    spacing_s = float(np.median([step for step, _, _, _ in steps]))
    if not spacing_s > 0.0:
        return None
    near = [each for each in steps if each[0] <= NEIGHBOURS * spacing_s]
    products = np.array([product for _, product, _, _ in near])
    expected = np.array([lost for _, _, lost, _ in near])
    variance = float(np.mean([square for _, _, _, square in near]))
    if variance <= 0.0:
        return None
    # About its own mean a point of n independent hits has a correlation of -1 / n.
    correlation = float(products.mean() / variance + expected.mean())
    z = correlation * float(np.sqrt(len(near)))
    return HitCorrelation(min(correlation, MAX_CORRELATION), spacing_s, z) if z > SURE_Z else None


def _steps(point: PointReadings, time_s: Array) -> list[tuple[float, float, float, float]]:
    """From each hit to the next in time: seconds, product of both errors [cm^2], 1 / hits, square of the first."""
    hit = np.flatnonzero(point.is_hit & np.isfinite(time_s[point.rows]))
    if hit.size < MIN_HITS:
        return []
    hit = hit[np.argsort(time_s[point.rows[hit]], kind="stable")]
    error_cm = point.error_cm[hit] - point.error_cm[hit].mean()
    step_s = np.diff(time_s[point.rows[hit]])
    return [
        (step, one * other, 1.0 / hit.size, one * one)
        for step, one, other in zip(step_s.tolist(), error_cm[:-1].tolist(), error_cm[1:].tolist(), strict=True)
    ]
