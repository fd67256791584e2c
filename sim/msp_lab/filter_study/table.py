"""A table of error statistics, such as the report's tables 5.4-5.6: one row per scenario and filter.

Rows of a CSV file are checked; the report's own table is `REPORT`. Two of the report's columns are swapped in places
(erratum 7), which shows without any simulation: RMS^2 = mean^2 + (N - 1) / N variance.
"""

import csv
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from io import StringIO
from pathlib import Path

from msp_lab.filter_study.nine import CAUSAL
from msp_lab.filter_study.scenarios import NAMES, SAMPLES
from msp_lab.filter_study.statistics import STATISTICS
from msp_range.recording.csv_form import csv_rows, short_list
from msp_range.recording.error import RecordingError
from msp_range.yaml_file import ConfigError

COLUMNS = ("scenario", "filter", *STATISTICS)
REPORT = """\
scenario,filter,rms,p90,median,mean,variance
fixed,moving average 5,0.978,1.000,0.000,-0.152,0.938
fixed,moving average 11,0.648,0.636,-0.091,-0.147,0.400
fixed,moving average 15,0.540,0.600,-0.200,-0.144,0.272
fixed,median 3,1.314,1.000,0.000,-0.114,1.722
fixed,median 7,0.912,1.000,0.000,-0.085,0.828
fixed,median 11,0.858,1.000,0.000,-0.010,0.740
fixed,kalman 1,1.939,1.996,0.000,-0.154,3.755
fixed,kalman 2,1.584,1.756,-0.034,-0.155,2.497
fixed,kalman 3,0.618,0.593,-0.180,-0.126,0.351
steps,moving average 5,20.019,1.200,1.074,-0.200,401.606
steps,moving average 11,29.368,0.945,2.587,-0.182,860.070
steps,moving average 15,34.240,19.773,3.554,-0.333,1165.529
steps,median 3,1.353,1.000,-0.090,0.000,1.832
steps,median 7,0.987,1.000,-0.060,0.000,0.976
steps,median 11,1.007,1.000,0.000,0.000,1.020
steps,kalman 1,1.941,1.996,-0.153,0.000,3.762
steps,kalman 2,2.840,1.756,-0.082,-0.034,8.100
steps,kalman 3,15.692,4.304,1.233,-0.329,245.951
random,moving average 5,25.522,11.280,2.742,0.400,647.046
random,moving average 11,45.286,29.855,6.979,1.091,2012.159
random,moving average 15,55.317,40.373,9.824,1.800,2978.318
random,median 3,1.690,2.000,-0.109,0.000,2.858
random,median 7,1.981,2.000,0.015,0.000,3.945
random,median 11,2.650,4.000,0.144,0.000,7.034
random,kalman 1,1.939,2.002,-0.154,0.000,3.755
random,kalman 2,2.014,2.136,-0.165,0.015,4.051
random,kalman 3,16.724,20.031,-0.889,1.296,280.292
"""
"""Tables 5.4, 5.5 and 5.6 as they are printed [cm, variance cm^2]."""


@dataclass(frozen=True)
class Row:
    """Statistics of one filter in one scenario, in the order of `STATISTICS`."""

    scenario: str
    filter: str
    values: tuple[float, ...]
    """RMS, 90th percentile, median, mean [cm] and variance [cm^2], each under its right name."""
    decimals: tuple[int, ...]
    """Digits after the point of each value."""
    swapped: bool
    """True if the columns median and mean were exchanged in the table; the values are in the right order."""


Table = Mapping[tuple[str, str], Row]


def report_table() -> Table:
    """Return the report's tables 5.4-5.6."""
    return _parse(enumerate(csv.reader(StringIO(REPORT)), start=1), "the report's table")


def read_table(path: Path) -> Table:
    """Read a table with the columns of `COLUMNS`.

    Raises
    ------
    ConfigError
        The file cannot be read, or a row or a column is not what is expected.
    """
    try:
        return _parse(csv_rows(path), str(path))
    except RecordingError as error:
        raise ConfigError(str(error)) from None


def _parse(rows: Iterator[tuple[int, list[str]]], source: str) -> Table:
    head = [cell.strip() for cell in next(rows, (0, []))[1]]
    if sorted(head) != sorted(COLUMNS):
        raise ConfigError(f"{source}: found the columns {short_list(head) or 'none'}, expected {', '.join(COLUMNS)}")
    table: dict[tuple[str, str], Row] = {}
    for number, line in rows:
        if not any(cell.strip() for cell in line):
            continue
        place = f"{source}: line {number}"
        if len(line) != len(head):
            raise ConfigError(f"{place}: found {len(line)} cells, expected {len(head)}")
        row = _row(dict(zip(head, (cell.strip() for cell in line), strict=True)), place)
        if (row.scenario, row.filter) in table:
            raise ConfigError(f"{place}: {row.filter} in scenario {row.scenario} occurs twice, expected once")
        table[row.scenario, row.filter] = row
    if not table:
        raise ConfigError(f"{source}: contains no rows, expected one per scenario and filter")
    return _columns_in_order(table)


def _row(cells: Mapping[str, str], place: str) -> Row:
    for key, known in (("scenario", NAMES), ("filter", CAUSAL)):
        if cells[key] not in known:
            raise ConfigError(f"{place}: found the {key} {cells[key][:80]!r}, expected one of {', '.join(known)}")
    numbers, decimals = [], []
    for key in STATISTICS:
        try:
            number = float(cells[key])
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise ConfigError(f"{place}: {key}: found {cells[key][:80]!r}, expected a number")
        numbers.append(number)
        decimals.append(len(cells[key].partition(".")[2]))
    if numbers[0] < 0 or numbers[4] < 0:
        raise ConfigError(f"{place}: found rms {numbers[0]:g} and variance {numbers[4]:g}, expected neither below 0")
    return Row(cells["scenario"], cells["filter"], (*numbers,), tuple(decimals), swapped=False)


def _columns_in_order(table: Mapping[tuple[str, str], Row]) -> Table:
    """The rows with median and mean under their own names.

    A row with too small a mean and median to decide follows the others of its scenario.
    """
    swapped = {}
    for scenario in {row.scenario for row in table.values()}:
        rows = {key: _is_swapped(row) for key, row in table.items() if row.scenario == scenario}
        decided = [row for row in rows.values() if row is not None]
        most = sum(decided) > len(decided) / 2
        swapped.update({key: most if row is None else row for key, row in rows.items()})
    return {key: _exchanged(row) if swapped[key] else row for key, row in table.items()}


def _is_swapped(row: Row) -> bool | None:
    """Whether RMS^2 = mean^2 + (N - 1) / N variance holds with the column headed median only; None: undecided."""
    rms, _, median, mean, variance = row.values
    as_named, exchanged = (
        abs(rms * rms - middle * middle - variance * (SAMPLES - 1) / SAMPLES) for middle in (mean, median)
    )
    # What the rounding of the printed numbers explains.
    rounding = rms * 10.0 ** -row.decimals[0] + 0.5 * 10.0 ** -row.decimals[4]
    if as_named <= rounding and exchanged <= rounding:
        return None
    return exchanged < as_named


def _exchanged(row: Row) -> Row:
    rms, p90, median, mean, variance = row.values
    return replace(row, values=(rms, p90, mean, median, variance), swapped=True)
