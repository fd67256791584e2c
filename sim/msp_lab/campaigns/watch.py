"""Watch the readings of a point while they come in: counts, outliers, and disagreement with the reference.

It is updated with each reading, and warns early enough to check the bench. They only advise: every reading is recorded,
and the fit decides what it is.
"""

import math
from collections import Counter
from dataclasses import dataclass

import numpy as np

from msp_range.arrays import Array
from msp_range.reading import Reading, Status

CORE_LEAST_CM = 4.0
"""A reading this near the median is not called an outlier, however little the others scatter [cm]: a target that is
not rigid moves by this much."""
CORE_SPREADS = 6.0
"""Nor is a reading within this many standard deviations of the median, estimated from the median deviation: about one
in a billion normal readings is farther. A smaller number reports ordinary noise."""
FIRST_LOOK = 8
"""Readings before the first one can be called an outlier: with fewer the spread is not known within a factor of 2."""
MAX_OUTLIERS = 1000
"""Outliers that are kept for display; more are only counted among the readings."""

ACCOUNTED_CM, ACCOUNTED_SHARE = 3.0, 0.05
"""Difference between median and reference that air temperature, placement and calibration can explain [cm, share of
the range]; more is reported as a wrong placement."""


@dataclass(frozen=True)
class Outlier:
    """A reading far from the others: its number within the point, its value, and a possible reason."""

    number: int
    sensor: str
    reading_cm: float
    why: str


class PointWatch:
    """Readings of one sensor at one point.

    Parameters
    ----------
    sensor
        Name of the sensor.
    expected_cm
        Readings expected from the reference and the angle: to the nearest point and along the beam [cm].

    Examples
    --------
    >>> from msp_range.reading import Reading, Status
    >>> watch = PointWatch("a", (120.0, 120.0))
    >>> for reading_cm in [120, 121, 120, 119, 120, 120, 121, 120, 187]:
    ...     noticed = watch.update(Reading(0.0, "a", Status.OK, reading_cm / 100, raw=reading_cm))
    >>> noticed
    Outlier(number=9, sensor='a', reading_cm=187, why='67 cm longer than the others')
    """

    def __init__(self, sensor: str, expected_cm: tuple[float, float]) -> None:
        self.sensor = sensor
        self.expected_cm = expected_cm
        self.counts: Counter[float] = Counter()
        self.no_echo = 0
        self.failed: Counter[Status] = Counter()
        self.outliers: list[Outlier] = []
        self.read = 0
        self._core_cm = (-math.inf, math.inf)
        self._look_at = FIRST_LOOK

    def update(self, reading: Reading) -> Outlier | None:
        """Count a reading, and return it if it is an outlier."""
        if reading.status.is_fault or reading.raw is None:
            self.failed[reading.status] += 1
            return None
        self.read += 1
        if reading.status is Status.NO_ECHO:
            self.no_echo += 1
            return None
        self.counts[reading.raw] += 1
        if self.read >= self._look_at:
            self._look_at *= 2
            self._core_cm = self._find_core()
        low_cm, high_cm = self._core_cm
        if low_cm <= reading.raw <= high_cm:
            return None
        outlier = Outlier(self.read, self.sensor, reading.raw, self._why(reading))
        if len(self.outliers) < MAX_OUTLIERS:
            self.outliers.append(outlier)
        return outlier

    @property
    def median_cm(self) -> float | None:
        """Median of the readings with an echo [cm]."""
        return float(np.median(self._echoes_cm())) if self.counts else None

    def warnings(self) -> list[str]:
        """Return what to check before the set-up is changed."""
        found = []
        median_cm = self.median_cm
        if median_cm is not None and self.no_echo * 2 < self.read:
            nearest_cm, slant_cm = self.expected_cm
            allowed_cm = ACCOUNTED_CM + ACCOUNTED_SHARE * slant_cm
            if not nearest_cm - allowed_cm <= median_cm <= slant_cm + allowed_cm:
                found.append(
                    f"{self.sensor} reads {median_cm:g} cm, and the reference is {nearest_cm:g} cm: is the target "
                    "in its place, and is nothing else in the beam?"
                )
        if self.outliers:
            shown = ", ".join(f"{outlier.reading_cm:g}" for outlier in self.outliers[:6])
            more = ", ..." if len(self.outliers) > 6 else ""
            found.append(f"{self.sensor}: {len(self.outliers)} outliers among {self.read} readings ({shown}{more})")
        if self.no_echo:
            found.append(f"{self.sensor}: no echo in {self.no_echo} of {self.read} readings")
        for status, count in self.failed.items():
            found.append(f"{self.sensor}: {count} pings without a usable answer ({status.value}), asked again")
        return found

    def _echoes_cm(self) -> Array:
        """The readings with an echo, in the order of their values' first ones [cm]."""
        return np.repeat(np.array([*self.counts], dtype=float), [*self.counts.values()])

    def _find_core(self) -> tuple[float, float]:
        median_cm = self.median_cm
        if median_cm is None:
            return -math.inf, math.inf
        deviations_cm = np.abs(self._echoes_cm() - median_cm)
        reach_cm = max(CORE_LEAST_CM, CORE_SPREADS * 1.4826 * float(np.median(deviations_cm)))
        return median_cm - reach_cm, median_cm + reach_cm

    def _why(self, reading: Reading) -> str:
        if reading.suspect:
            return "a missed echo reported as 255, or an object there"
        median_cm = self.median_cm or 0.0
        away_cm = (reading.raw or 0) - median_cm
        return f"{abs(away_cm):g} cm {'longer' if away_cm > 0 else 'shorter'} than the others"
