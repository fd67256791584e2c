"""What a point's readings look like while they come in: counts, outliers, and what does not fit the reference.

Readings enter one by one; what is noticed leaves as words, early enough to look at the bench. Nothing is judged here
that a fit would judge better: every reading is recorded, whatever this says of it.
"""

import math
from collections import Counter, defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from msp_range.reading import Reading, Status

CORE_LEAST_CM = 4.0
"""A reading this near the median is no outlier, however quiet the others are [cm]."""
CORE_SPREADS = 6.0
"""Nor is one within so many standard deviations, which are estimated from the median deviation."""
FIRST_LOOK = 8
"""Readings before the first one can be called an outlier."""
NOTED_MOST = 1000

ACCOUNTED_CM, ACCOUNTED_SHARE = 3.0, 0.05
"""What air temperature, placement and calibration can add up to between a median and the reference."""


@dataclass(frozen=True, slots=True)
class Outlier:
    """A reading far from the others: which one of the point's, how many centimetres, and what may be behind it."""

    number: int
    sensor: str
    reading_cm: int
    why: str


class Watch:
    """Readings of one sensor at one point.

    Parameters
    ----------
    sensor
        Its name.
    expected_cm
        Readings that the reference and the angle let expect: to the nearest point and along the beam.

    Examples
    --------
    >>> from msp_range.reading import Reading, Status
    >>> watch = Watch("a", (120.0, 120.0))
    >>> for reading_cm in [120, 121, 120, 119, 120, 120, 121, 120, 187]:
    ...     noticed = watch.take(Reading(0.0, "a", Status.OK, reading_cm / 100, raw=reading_cm))
    >>> noticed
    Outlier(number=9, sensor='a', reading_cm=187, why='67 cm longer than the others')
    """

    def __init__(self, sensor: str, expected_cm: tuple[float, float]) -> None:
        self.sensor = sensor
        self.expected_cm = expected_cm
        self.counts: Counter[int] = Counter()
        self.no_echo = 0
        self.failed: Counter[Status] = Counter()
        self.outliers: list[Outlier] = []
        self.read = 0
        self._core = (-math.inf, math.inf)
        self._look_at = FIRST_LOOK

    def take(self, reading: Reading) -> Outlier | None:
        """Count a reading; returns what is worth a look."""
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
            self._core = self._find_core()
        low_cm, high_cm = self._core
        if low_cm <= reading.raw <= high_cm:
            return None
        outlier = Outlier(self.read, self.sensor, reading.raw, self._why(reading))
        if len(self.outliers) < NOTED_MOST:
            self.outliers.append(outlier)
        return outlier

    @property
    def median_cm(self) -> float | None:
        """Median of the readings with an echo [cm]."""
        return _median(self.counts)

    def doubts(self) -> list[str]:
        """What a person should look at before the set-up is changed."""
        said = []
        median_cm = self.median_cm
        if median_cm is not None and self.no_echo * 2 < self.read:
            nearest_cm, slant_cm = self.expected_cm
            allowed_cm = ACCOUNTED_CM + ACCOUNTED_SHARE * slant_cm
            if not nearest_cm - allowed_cm <= median_cm <= slant_cm + allowed_cm:
                said.append(
                    f"{self.sensor} reads {median_cm:g} cm, and the reference says {nearest_cm:g} cm: is the target "
                    "where it should be, and is nothing else in the beam?"
                )
        if self.outliers:
            shown = ", ".join(f"{each.reading_cm}" for each in self.outliers[:6])
            more = ", ..." if len(self.outliers) > 6 else ""
            said.append(f"{self.sensor}: {len(self.outliers)} outliers among {self.read} readings ({shown}{more})")
        if self.no_echo:
            said.append(f"{self.sensor}: no echo in {self.no_echo} of {self.read} readings")
        for status, count in self.failed.items():
            said.append(f"{self.sensor}: {count} pings without a usable answer ({status.value}), asked again")
        return said

    def _find_core(self) -> tuple[float, float]:
        median_cm = _median(self.counts)
        if median_cm is None:
            return -math.inf, math.inf
        deviations: dict[float, int] = defaultdict(int)
        for reading_cm, count in self.counts.items():
            deviations[abs(reading_cm - median_cm)] += count
        spread_cm = 1.4826 * (_median(deviations) or 0.0)
        reach_cm = max(CORE_LEAST_CM, CORE_SPREADS * spread_cm)
        return median_cm - reach_cm, median_cm + reach_cm

    def _why(self, reading: Reading) -> str:
        if reading.suspect:
            return "a missed echo that came as 255, or something there"
        median_cm = self.median_cm or 0.0
        away_cm = (reading.raw or 0) - median_cm
        return f"{abs(away_cm):g} cm {'longer' if away_cm > 0 else 'shorter'} than the others"


def _median(counts: Mapping[Any, int]) -> float | None:
    """Median of values that are there so many times."""
    total = sum(counts.values())
    if total == 0:
        return None
    passed = 0
    middle: list[float] = []
    for value in sorted(counts):
        passed += counts[value]
        if 2 * passed >= total:
            middle.append(float(value))
        if 2 * passed > total:
            break
    return sum(middle) / len(middle)
