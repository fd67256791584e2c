"""A reference that is in another file than the readings, on a clock of its own: motion capture, a total station, a
ground truth as CSV.

The reference is put on the clock of the log of the readings, or it is said why the difference of the clocks cannot be
known.
"""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy.signal import correlate, correlation_lags

from msp_lab.logs.log import LogRequest, Series, TruthSource, VehicleLog, series
from msp_lab.logs.opening import TABLE, format_of, open_log
from msp_lab.logs.truth import Truth, choose
from msp_range.arrays import Array
from msp_range.recording.csv_form import csv_header, picked_cells, read_columns, short_list
from msp_range.recording.error import RecordingError

TIME_NAMES = ("time_s", "time", "timestamp", "stamp", "t")
"""Headers of a CSV file's time; without any of them it is the first column."""
_UNITS_S = ((1e17, 1e-9), (1e14, 1e-6), (1e11, 1e-3))
"""Times larger than this are since 1970 in a smaller unit than seconds; 1e11 s would be the year 5138."""
STEP_S = 0.1
"""Both are compared on a grid of such steps [s], which is finer than what `align` searches through."""
LEAST_OVERLAP_S = 20.0
"""Readings and reference have to overlap for this long [s]: over less, any two climbs look alike."""
LEAST_CORRELATION = 0.8
"""Refuse a best difference with a smaller correlation: the two do not show the same flight. A sensor that misses half
of its echoes still has 0.9."""
APART_S = 3.0
"""A second difference counts as another one where it is farther from the best than this [s]: a climb is as long."""
CERTAIN_NATS = 10.0
"""The best difference has to be more likely than any other by this [nat], one to 20,000, for as many independent
samples as there are seconds. Lower: flights that repeat themselves are taken for each other."""
LONGEST_S = 86_400.0
"""Longer logs are refused [s]: a day takes 100 MB. Flights have an hour."""
SMOOTHED = 5
"""Each reading is replaced by the median of this many around it, which removes single outliers."""


def reference_of(path: Path, truth: Truth, log: VehicleLog, maximum_cm: float) -> tuple[TruthSource, float]:
    """The reference of a log in another file, and by how much its clock differs [s]; the maximum as of `LogRequest`.

    Raises
    ------
    RecordingError
        There is none, or the two do not show the same flight.
    """
    if format_of(path) is TABLE:
        if truth.kind != "column":
            raise RecordingError(f"{path}: of a CSV file --truth needs the column: column:NAME*FACTOR@{path.name}")
        reference = TruthSource("column", _column(path, truth))
    else:
        found = choose(open_log(path, LogRequest(field=truth.field, maximum_cm=maximum_cm)), truth)
        if found is None:
            raise RecordingError(f"{path}: no reference in this file")
        reference = found
    ranger = next((candidate for candidate in log.rangers if candidate.is_down), None)
    if ranger is None:
        raise RecordingError(f"{log.path}: no range finder that looks down, to compare with {path.name}")
    try:
        echoes = Series(ranger.name, ranger.series.time_s, ranger.echoes_cm)
        difference_s = clock_difference_s(echoes, reference.series)
    except RecordingError as error:
        raise RecordingError(f"{log.path} and {path}: {error}") from None
    std = reference.std and _later(reference.std, difference_s)
    return replace(reference, series=_later(reference.series, difference_s), std=std, ranger=""), difference_s


def _later(found: Series, by_s: float) -> Series:
    return replace(found, time_s=found.time_s + by_s)


def _column(path: Path, truth: Truth) -> Series:
    """A column of a CSV file over its time [m]."""
    header = csv_header(path)
    if truth.name not in header:
        raise RecordingError(f"{path}: there is no column {truth.name!r}. Columns: {short_list(header)}")
    time_at = next((header.index(name) for name in TIME_NAMES if name in header), 0)
    places = {"time_s": time_at, "true_range_cm": header.index(truth.name)}
    headings = {name: header[at] for name, at in places.items()}
    read = read_columns(path, lambda: picked_cells(path, places.values()), headings, ("time_s",))
    stamps = read["time_s"]
    factor_s = next((unit_s for least, unit_s in _UNITS_S if stamps.size and np.median(stamps) > least), 1.0)
    return series(truth.name, factor_s * stamps, truth.factor * read["true_range_cm"])


def clock_difference_s(readings: Series, height: Series) -> float:
    """What is to be added to the times of the height, to have them on the clock of the readings [s], to half a second.

    All differences at which the two overlap are tried at once, by Fourier transforms. The finer step, with its
    interval, is `msp_lab.logs.alignment`.

    Parameters
    ----------
    readings
        Of a range finder, in any unit; no-echo readings are not a number.
    height
        Of the same flight, at least in part.

    Raises
    ------
    RecordingError
        They do not show the same flight, fit each other in several ways, or are longer than a day; the text follows a
        file's name.
    """
    known = readings.known()
    if len(known) < 2 * SMOOTHED or len(height.known()) < 2 * SMOOTHED:
        raise RecordingError("hardly any readings or heights to compare the clocks by")
    windows = np.lib.stride_tricks.sliding_window_view(known.values, SMOOTHED)
    middle = SMOOTHED // 2
    smooth = Series(known.source, known.time_s[middle : middle + len(windows)], np.median(windows, axis=1))
    (r, r_known), (h, h_known) = _grid(smooth), _grid(height)
    # At lag k, reading i + k meets height i.
    lags = correlation_lags(r.size, h.size)
    sums = partial(correlate, method="fft")
    n = np.rint(sums(r_known, h_known))
    enough = n * STEP_S >= LEAST_OVERLAP_S
    if not enough.any():
        raise RecordingError(f"both overlap by less than {LEAST_OVERLAP_S:.0f} s at any difference of the clocks")
    n = np.where(enough, n, 1.0)
    mean_r, mean_h = sums(r, h_known) / n, sums(r_known, h) / n
    spread_r = sums(r * r, h_known) / n - mean_r**2
    spread_h = sums(r_known, h * h) / n - mean_h**2
    # Where one of them hardly moves, nothing can be seen.
    moves = enough & (spread_r > 1e-3 * spread_r[enough].max()) & (spread_h > 1e-3 * spread_h[enough].max())
    both = np.where(moves, spread_r * spread_h, 1.0)
    correlation = np.where(moves, (sums(r, h) / n - mean_r * mean_h) / np.sqrt(both), 0.0)
    correlation = np.clip(correlation, 0.0, 0.9999)
    nats = -0.5 * n * STEP_S * np.log1p(-(correlation**2))
    best = int(np.argmax(nats))
    if correlation[best] < LEAST_CORRELATION:
        raise RecordingError(
            f"the two do not show the same flight: at best their correlation is {correlation[best]:.2f}, expected "
            f"{LEAST_CORRELATION:g}"
        )
    elsewhere = np.abs(lags - lags[best]) * STEP_S > APART_S
    other = int(np.argmax(np.where(elsewhere, nats, -np.inf)))
    if nats[best] - nats[other] < CERTAIN_NATS:
        away_s = abs(lags[best] - lags[other]) * STEP_S
        raise RecordingError(
            f"the two fit each other about as well {away_s:.0f} s away from the best fit: "
            "fly something that does not repeat itself, such as three quick climbs at the start"
        )
    return float(smooth.time_s[0] - height.known().time_s[0] + lags[best] * STEP_S)


def _grid(series: Series) -> tuple[Array, Array]:
    """Values on the grid about their mean, 0 where they are not known, and where they are."""
    known = series.known()
    length_s = float(known.time_s[-1] - known.time_s[0])
    if length_s > LONGEST_S:
        raise RecordingError(
            f"{known.source} spans {length_s / 3600.0:.0f} h, expected at most {LONGEST_S / 3600.0:.0f}"
        )
    time_s = np.arange(known.time_s[0], known.time_s[-1], STEP_S)
    values = known.at(time_s)
    good = np.isfinite(values)
    return np.where(good, values - np.nanmean(values), 0.0), good.astype(float)
