"""Accuracy with nothing varied, and the longest range with missed echoes masked."""

import math
from collections.abc import Sequence

import numpy as np
from scipy.signal import find_peaks, peak_widths

from msp_lab.characterise.calibration import pooled_spread
from msp_lab.characterise.field_of_view import RELIABLE_SHARE
from msp_lab.characterise.findings import Baseline, MaximumRange, Peak
from msp_lab.characterise.points import PointReadings
from msp_lab.estimates import IntervalEstimate, Z, fit_line, mean_of_points, share
from msp_lab.readings.resolution import to_step
from msp_range.arrays import Array
from msp_range.reading_model.sensor_model import SensorModel

PEAK_HALF_CM = 3
"""Readings this near to each other belong to one peak [cm]."""
MIN_PEAK_SHARE = 0.001
MIN_READINGS = 10
PEAK_DEVIATIONS = 6.0
"""A peak has at least this share of all readings, this number of readings, and this many standard deviations more than
if readings were spread evenly over the sensor's range."""
PEAK_FOOT = 0.0999
"""A peak reaches as far as a tenth of its top, and two with more than that between them are one. Higher: shoulders
become peaks of their own."""


def baseline(points: Sequence[PointReadings], reference_std_cm: float | None = None) -> Baseline | None:
    """Accuracy at the points with nothing varied; ``reference_std_cm`` as for `calibration.calibrate`."""
    found = sorted((point.found for point in points), key=lambda result: result.true_range_cm)
    known = [(point.true_range_cm, point.error.value, point.error.standard_error**2) for point in found if point.error]
    if not known:
        return None
    echoes = [point for point in points if point.found.error is not None]
    hits = np.concatenate([point.error_cm[point.is_hit] for point in echoes])
    range_cm, mean_cm, variance_cm2 = np.array(known).T
    between = None
    if np.unique(range_cm).size >= 3:
        line = fit_line(range_cm, mean_cm, variance_cm2)
        between = IntervalEstimate(math.sqrt(line.between), unit="cm", n=len(known), of="points")
    readings = sum(result.readings for result in found)
    return Baseline(
        points=tuple(found),
        bias=mean_of_points(mean_cm, variance_cm2, reference_std_cm or 0.0),
        spread=pooled_spread(echoes),
        between_points=between,
        missed=share(sum(result.missed for result in found), readings),
        outliers=share(sum(result.outliers for result in found), readings),
        largest_error_cm=max((result.worst_error_cm or 0.0 for result in found), key=abs),
        largest_hit_error_cm=float(max(hits, key=abs)),
    )


def maximum_range(points: Sequence[PointReadings], sensor: SensorModel) -> MaximumRange | None:
    """Histogram and peaks at the longest of these points' ranges, before and after missed echoes are masked."""
    range_cm = max((point.range_cm for point in points if point.hits), default=None)
    if range_cm is None:
        return None
    here = [point for point in points if point.hits and point.range_cm == range_cm]
    readings = to_step(np.concatenate([point.reading_cm[~np.isnan(point.reading_cm)] for point in here]), 1.0)
    kept = to_step(np.concatenate([point.reading_cm[point.is_echo] for point in here]), 1.0)
    values, counts = np.unique(readings, return_counts=True)
    span_cm = float(sensor.maximum_cm - sensor.minimum_cm)
    return MaximumRange(
        true_range_cm=range_cm,
        readings=readings.size,
        histogram=tuple(zip(values.astype(int).tolist(), counts.tolist(), strict=True)),
        no_echo=sum(point.found.no_echo for point in here),
        saturated=sum(point.found.saturated for point in here),
        peaks_before=peaks(readings, span_cm),
        peaks_after=peaks(kept, span_cm),
        peak=_mode(kept),
    )


def peaks(reading_cm: Array, span_cm: float) -> tuple[Peak, ...]:
    """Peaks of whole-centimetre readings of a sensor that reads over this span, the largest first.

    A peak is where most readings are within `PEAK_HALF_CM`, of at least `MIN_PEAK_SHARE`, `MIN_READINGS` and
    `PEAK_DEVIATIONS`; it ends at `PEAK_FOOT`.

    Examples
    --------
    >>> readings = np.repeat([502.0, 503.0, 504.0, 765.0], [30, 50, 30, 10])
    >>> [(peak.reading_cm, round(peak.share, 2)) for peak in peaks(readings, 745.0)]
    [(503.0, 0.92), (765.0, 0.08)]
    """
    if not reading_cm.size:
        return ()
    first = int(reading_cm.min()) - 2 * PEAK_HALF_CM
    counts = np.bincount(reading_cm.astype(int) - first, minlength=int(np.ptp(reading_cm)) + 4 * PEAK_HALF_CM + 1)
    near = np.convolve(counts, np.ones(2 * PEAK_HALF_CM + 1), "same")
    # The background; most of the range has no readings if there are no outliers.
    evenly = float(np.median(np.concatenate([near, np.zeros(max(int(span_cm) - near.size, 0))])))
    least = max(MIN_PEAK_SHARE * reading_cm.size, MIN_READINGS, evenly + PEAK_DEVIATIONS * math.sqrt(evenly))
    # Of tops that are equally high only the last is one.
    tops, found = find_peaks(near + 1e-9 * np.arange(near.size), height=least, prominence=0.0)
    foot = near[tops], found["left_bases"], found["right_bases"]
    _, _, low, high = peak_widths(near, tops, 1.0 - PEAK_FOOT, foot)
    found_peaks = []
    for start, stop, prominence, top in zip(
        np.ceil(low).astype(int), high, found["prominences"], near[tops], strict=True
    ):
        # Others are the tail of a higher one.
        if prominence > (1.0 - PEAK_FOOT) * top:
            inside = counts[start : int(stop) + 1]
            found_peaks.append(Peak(float(first + start + inside.argmax()), float(inside.sum()) / reading_cm.size))
    return tuple(sorted(found_peaks, key=lambda peak: -peak.share))


def _mode(reading_cm: Array) -> IntervalEstimate:
    """Most frequent reading, and those with counts that are not significantly lower."""
    values, counts = np.unique(reading_cm, return_counts=True)
    top = int(counts.max())
    as_likely = values[counts >= top - Z * np.sqrt(top + counts)]
    middle = float(values[counts.argmax()])
    near = as_likely[np.abs(as_likely - middle) <= 2 * PEAK_HALF_CM]
    return IntervalEstimate(middle, float(near.min()), float(near.max()), "cm", reading_cm.size)


def longest_reliable_cm(points: Sequence[PointReadings], maximum_cm: float) -> float | None:
    """Longest range on the axis, to a millimetre and up to a maximum, at which readings are reliably of the surface."""
    ranges = [p.range_cm for p in points if p.hits / p.reading_cm.size >= RELIABLE_SHARE]
    return min(round(max(ranges), 1), float(maximum_cm)) if ranges else None
