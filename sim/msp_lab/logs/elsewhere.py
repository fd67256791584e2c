"""A reference that is in another file than the readings, on a clock of its own: motion capture, a total station, a
ground truth as CSV.

The file and the log of the readings enter; the reference on the log's clock leaves.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from msp_lab.logs.clocks import clock_difference_s
from msp_lab.logs.log import Series, TruthSource, VehicleLog, series
from msp_lab.logs.opening import kind_of, open_log
from msp_lab.logs.truth import Truth, choose
from msp_range.recording.csv_form import csv_rows, short_list, to_number, to_time_s
from msp_range.recording.error import RecordingError

TIME_NAMES = ("time_s", "time", "timestamp", "stamp", "t")
"""Headers of a CSV file's time; without any of them it is the first column."""
_UNITS_S = ((1e17, 1e-9), (1e14, 1e-6), (1e11, 1e-3))
"""Times larger than this are since 1970 in a smaller unit than seconds; 1e11 s would be the year 5138."""


def reference_of(path: Path, truth: Truth, log: VehicleLog, maximum_cm: float) -> tuple[TruthSource, float]:
    """The reference of a log in another file, and by how much its clock differs [s]; the maximum as for `open_log`.

    Raises
    ------
    RecordingError
        There is none, or the two do not show the same flight.
    """
    if kind_of(path) == ".csv":
        if truth.kind != "column":
            raise RecordingError(f"{path}: of a CSV file --truth needs the column: column:NAME*FACTOR@{path.name}")
        reference = TruthSource("column", _column(path, truth))
    else:
        found = choose(open_log(path, lambda share: None, field=truth.field, maximum_cm=maximum_cm), truth)
        if found is None:
            raise RecordingError(f"{path}: no reference in this file")
        reference = found
    ranger = next((each for each in log.rangers if each.is_down), None)
    if ranger is None:
        raise RecordingError(f"{log.path}: no range finder that looks down, to compare with {path.name}")
    try:
        echoes = Series(ranger.name, ranger.series.time_s, ranger.echoes_cm)
        difference_s = clock_difference_s(echoes, reference.series)
    except RecordingError as error:
        raise RecordingError(f"{log.path} and {path}: {error}") from None
    std = None if reference.std is None else _later(reference.std, difference_s)
    return replace(reference, series=_later(reference.series, difference_s), std=std, ranger=""), difference_s


def _later(found: Series, by_s: float) -> Series:
    return Series(found.source, found.time_s + by_s, found.values)


def _column(path: Path, truth: Truth) -> Series:
    """A column of a CSV file over its time [m]."""
    rows = csv_rows(path)
    header = [name.strip() for name in next(rows, (0, []))[1]]
    if truth.name not in header:
        raise RecordingError(f"{path}: there is no column {truth.name!r}. Columns: {short_list(header)}")
    at = header.index(truth.name)
    named = [header.index(name) for name in TIME_NAMES if name in header]
    time_at = named[0] if named else 0
    time_s, values = [], []
    for line, row in rows:
        try:
            cell = row[at].strip()
            time_s.append(to_time_s(row[time_at].strip()))
            values.append(to_number(cell) if cell else np.nan)
        except (ValueError, IndexError):
            raise RecordingError(
                f"{path}:{line}: expected numbers in the columns {header[time_at]!r}, {truth.name!r}"
            ) from None
    stamps = np.array(time_s)
    factor_s = next((unit_s for least, unit_s in _UNITS_S if stamps.size and np.median(stamps) > least), 1.0)
    return series(truth.name, factor_s * stamps, truth.factor * np.array(values))
