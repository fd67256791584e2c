"""What in a table looks wrong and cannot be refused: another unit, another order of time, a reference that lags.

For each suspicion a sentence says what was found and what to do; the table is used as it is.
"""

import math
from collections.abc import Iterator

import numpy as np

from msp_range.arrays import Array, Indices, numbered
from msp_range.recording.csv_form import MeasuredData

MIN_ROWS = 20
"""Order and rate are checked in runs of at least this many rows. Noise repeats no sign 20 times. Fewer: short runs are
called shuffled by accident."""
BACKWARDS = -0.5
"""A rate of the range that correlates with the true range's change by less is reported as backwards. Right ones
correlate by nearly 1 and unrelated ones by 0. Any value from -0.8 to -0.2 reports the same tables."""
SHUFFLED = 3.0
"""Times are reported as shuffled where the true range moves this many times as far in the order of the times as in that
of the rows. Right ones move as far; of shuffled runs of 20 rows or more the factor is 5 and more. Higher: partly
shuffled ones pass."""
LONGEST_GAP_S = 1.0
"""Rows that are farther apart in time say nothing of a rate. A vehicle turns round in a second."""
LAG_BLOCKS = 8
"""A table of fewer runs is cut into this many parts, whose estimates of the reference's lag are compared."""
LAG_Z = 5.0
"""A reference is reported to lag where the readings are ahead of it by this many standard errors over runs. The error
of eight numbers is itself known to a quarter, so that this is p = 1e-3. Lower: false reports; higher: small lags
pass."""
LAG_S = 0.02
"""A reference is reported to lag only where it does so by at least this long [s]. Twice the time of flight of an echo
from three metres, by which a reading may seem ahead where its time is that of the ping. Lower: that is reported."""
FASTEST_CM = 50.0
"""Residuals beyond this are no hits and say nothing about a lag [cm]; a quarter of a second at 2 m/s."""


def suspicious(data: MeasuredData) -> list[str]:
    """What looks like another unit, another order of time, or a reference that lags; a sentence each."""
    found = []
    if "incidence_deg" in data:
        angle = np.abs(data["incidence_deg"][~np.isnan(data["incidence_deg"])])
        if angle.size and 0.05 < float(angle.max()) <= np.pi / 2.0:
            found.append(
                f"incidence_deg is at most {float(angle.max()):.2f}: if it is in radians, convert it with --map."
            )
    return found + (_shuffled(data) or _backwards(data) or _lagging(data))


def _series(data: MeasuredData) -> Iterator[Indices]:
    """Rows with a true range of each sensor in each run, in the order of the file."""
    known = np.isfinite(data["true_range_cm"]) & np.isfinite(data["time_s"])
    keys = [numbered(data[name]) for name in ("sensor", "run") if name in data]
    order = np.lexsort(keys)
    order = order[known[order]]
    starts = np.any([np.diff(key[order]) for key in keys], axis=0)
    for rows in np.split(order, np.flatnonzero(starts) + 1):
        if rows.size >= MIN_ROWS:
            yield rows


def _shuffled(data: MeasuredData) -> list[str]:
    """Runs in which the true range jumps in the order of time and not in that of the rows."""
    in_time = in_file = 0.0
    for rows in _series(data):
        true_cm = data["true_range_cm"][rows]
        in_file += float(np.abs(np.diff(true_cm)).sum())
        in_time += float(np.abs(np.diff(true_cm[np.argsort(data["time_s"][rows], kind="stable")])).sum())
    if in_time > SHUFFLED * in_file > 0.0:
        return [
            "true_range_cm jumps in the order of time_s and not in that of the rows: time_s is shuffled or of another "
            "clock, and what depends on time is not to be believed."
        ]
    return []


def _rates(data: MeasuredData) -> tuple[Indices, Array]:
    """Rows with others shortly before and after them, and the slope of the true range there [cm/s]."""
    places, slopes = [np.zeros(0, dtype=np.intp)], [np.zeros(0)]
    for rows in _series(data):
        rows = rows[np.argsort(data["time_s"][rows], kind="stable")]
        time_s, true_cm = data["time_s"][rows], data["true_range_cm"][rows]
        apart_s = time_s[2:] - time_s[:-2]
        near = (apart_s > 0.0) & (apart_s < 2.0 * LONGEST_GAP_S)
        places.append(rows[1:-1][near])
        slopes.append(((true_cm[2:] - true_cm[:-2])[near]) / apart_s[near])
    return np.concatenate(places), np.concatenate(slopes)


def _backwards(data: MeasuredData) -> list[str]:
    if "range_rate_cm_s" not in data:
        return []
    rows, slope = _rates(data)
    rate = data["range_rate_cm_s"][rows]
    known = np.isfinite(rate)
    if known.sum() > MIN_ROWS and _correlation(slope[known], rate[known]) < BACKWARDS:
        return ["true_range_cm falls where range_rate_cm_s is positive: time runs backwards or the sign is wrong."]
    return []


def _correlation(one: Array, other: Array) -> float:
    varies = np.std(one) > 0.0 and np.std(other) > 0.0
    return float(np.corrcoef(one, other)[0, 1]) if varies else 0.0


def _lagging(data: MeasuredData) -> list[str]:
    """A reference behind the readings, which no sensor can cause: hits are ahead where the range changes."""
    rows, slope = _rates(data)
    error_cm = data["reading_cm"][rows] - data["true_range_cm"][rows]
    middle_cm = float(np.nanmedian(error_cm)) if np.isfinite(error_cm).any() else 0.0
    hit = np.abs(error_cm - middle_cm) < FASTEST_CM
    rows, slope, error_cm = rows[hit], slope[hit], error_cm[hit] - middle_cm
    part = numbered(data["run"][rows])
    if part.max(initial=0) + 1 < LAG_BLOCKS:
        part = np.arange(rows.size) * LAG_BLOCKS // max(rows.size, 1)
    weight = np.bincount(part, slope**2)
    moving = weight > 0.0
    if moving.sum() < LAG_BLOCKS // 2:
        return []
    lag_s = np.bincount(part, slope * error_cm)[moving] / weight[moving]
    share = weight[moving] / weight[moving].sum()
    mean_s = float(share @ lag_s)
    error_s = math.sqrt(float(share**2 @ (lag_s - mean_s) ** 2) * lag_s.size / (lag_s.size - 1))
    if mean_s < LAG_S or mean_s < LAG_Z * error_s:
        return []
    low_s, high_s = mean_s - 2.0 * error_s, mean_s + 2.0 * error_s
    return [
        f"Readings are {mean_s:.2g} s ahead of true_range_cm ({low_s:.2g} to {high_s:.2g}), "
        "as no sensor is: the reference lags, or the two have different clocks. Shift its time_s before anything else."
    ]
