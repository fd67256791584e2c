"""Measured readings as CSV, in the one form that the whole project uses, and as columns of numpy arrays.

One row is one ping. ``time_s`` is the time of the echo, or of the ping where there was none; an empty cell is
unknown, and an empty ``reading_cm`` is no answer. Columns that are not named here are further context: numbers where
every cell is a number or empty, words otherwise.
"""

import csv
import difflib
import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from msp_range.recording.error import RecordingError

BASE_COLUMNS = {
    "time_s": "time of the echo, or of the ping where there was none [s]",
    "sensor": "name of the sensor",
    "run": "name of the session; times of different runs do not compare",
    "reading_cm": "distance as the sensor reported it [cm]; empty: no answer",
    "true_range_cm": "perpendicular distance to the surface [cm]",
}
CONTEXT_COLUMNS = {
    "condition": "which experiment of a campaign the reading belongs to, a word",
    "air_temperature_c": "air temperature [deg C]",
    "target_temperature_c": "air temperature at the far end, next to the target [deg C]",
    "humidity_pct": "relative humidity [%]",
    "incidence_deg": "angle between the beam and the surface's normal, signed [deg]",
    "range_rate_cm_s": "rate of change of the range [cm/s]",
    "throttle": "throttle, 0 to 1",
    "vibration_hz": "frequency of vibration [Hz]",
    "uptime_s": "time since the sensor was powered [s]",
    "target": "what the beam meets, a word",
    "target_size_cm": "shorter side of the target [cm]",
    "neighbour_lag_ms": "time since the last ping of another sensor [ms]; empty: none",
    "neighbour_range_cm": "range of that other sensor [cm]",
    "external_level_db": "sound level of an external ultrasonic source at 30 cm from it [dB re 20 uPa]; empty: none",
    "external_duty": "share of the time that it sounds, 0 to 1",
    "external_distance_cm": "distance from that source to the sensor [cm]",
    "external_frequency_khz": "frequency of that source [kHz]",
}
WORD_COLUMNS = frozenset({"sensor", "run", "condition", "target"})
"""Known columns that hold words; the other known ones hold numbers."""
REQUIRED_COLUMNS = ("time_s", "sensor", "reading_cm")
NEVER_EMPTY = frozenset({"time_s", "sensor"})
BLOCK = 1 << 10
"""Rows that are held as text at a time: so many stay in a processor's cache."""

Column: TypeAlias = NDArray[Any]
"""float64 with NaN where unknown, or str with "" where unknown."""


@dataclass(frozen=True)
class MeasuredData:
    """Columns of equal length by name, in the order of the file.

    Examples
    --------
    >>> data = MeasuredData({"sensor": np.array(["a", "b"]), "reading_cm": np.array([120.0, np.nan])})
    >>> len(data), "throttle" in data, data.select(data["sensor"] == "a")["reading_cm"].tolist()
    (2, False, [120.0])
    """

    columns: Mapping[str, Column]

    def __post_init__(self) -> None:
        lengths = {name: len(column) for name, column in self.columns.items()}
        if len(set(lengths.values())) > 1:
            raise ValueError(f"columns of different lengths: {lengths}")

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()), ()))

    def __getitem__(self, name: str) -> Column:
        return self.columns[name]

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    def select(self, rows: NDArray[Any]) -> "MeasuredData":
        """Return the rows of a boolean mask or of an index array."""
        return MeasuredData({name: column[rows] for name, column in self.columns.items()})


def read_csv(path: Path | str, required: Sequence[str] = REQUIRED_COLUMNS) -> MeasuredData:
    """Read measured data.

    Parameters
    ----------
    path
        A CSV file with a header, separated by commas, in UTF-8.
    required
        Columns that have to be there.

    Returns
    -------
    MeasuredData
        ``sensor``, ``run``, ``condition`` and ``target`` as words, the other known columns as numbers.

    Raises
    ------
    RecordingError
        It names the file, line, column, what was found and what was expected.
    """
    path = Path(path)
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = csv.reader(file, strict=True)
            header = [name.strip() for name in next(rows, [])]
            _check_header(path, header, required)
            parts: list[list[Column]] = [[] for _ in header]
            first = 0
            for block in _blocks(_whole_rows(path, rows, len(header))):
                for name, cells, column in zip(header, zip(*block, strict=True), parts, strict=True):
                    column.append(_column(path, name, cells, first))
                first += len(block)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise RecordingError(f"{path}: not UTF-8 text: {error}") from None
    except csv.Error as error:
        raise RecordingError(f"{path}:{rows.line_num}: not CSV: {error}") from None
    columns = {}
    for name, blocks in zip(header, parts, strict=True):
        columns[name] = _joined(path, header, name, blocks)
        # Many readings are there once, and not twice.
        blocks.clear()
    return MeasuredData(columns)


def write_csv(path: Path | str, columns: Mapping[str, Column] | MeasuredData) -> None:
    """Write measured data, the known columns first and in their usual order; `read_csv` backwards.

    Raises
    ------
    RecordingError
        The file cannot be written.
    ValueError
        Columns of different lengths, an infinite number, or a carriage return in a word.
    """
    data = columns if isinstance(columns, MeasuredData) else MeasuredData(columns)
    known = [name for name in (*BASE_COLUMNS, *CONTEXT_COLUMNS) if name in data]
    names = known + [name for name in data.columns if name not in known]
    cells = [_cells(name, data[name]) for name in names]
    try:
        with Path(path).open("x", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(names)
            writer.writerows(zip(*cells, strict=True))
    except FileExistsError:
        raise RecordingError(f"{path}: there is a file already, and none is overwritten") from None
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written: {error.strerror}") from None


def _check_header(path: Path, header: list[str], required: Sequence[str]) -> None:
    if not header:
        raise RecordingError(f"{path}: empty, expected a header with the columns {', '.join(required)}")
    for number, name in enumerate(header, start=1):
        if not name:
            raise RecordingError(f"{path}:1: column {number} has no name")
        if name in header[: number - 1]:
            raise RecordingError(f"{path}:1: the column {name!r} is there twice")
    for name in required:
        if name not in header:
            near = difflib.get_close_matches(name, [each for each in header if each not in required], n=1)
            hint = f" Is it {near[0]!r}?" if near else " Columns are told apart by commas." if len(header) == 1 else ""
            raise RecordingError(f"{path}:1: the column {name!r} is missing.{hint} Found: {', '.join(header)}")


def _whole_rows(path: Path, rows: Any, width: int) -> Iterator[list[str]]:
    for row in rows:
        if len(row) == width:
            yield row
        elif row:  # an empty line is no row
            raise RecordingError(f"{path}:{rows.line_num}: found {len(row)} cells, expected {width} as in the header")


def _blocks(rows: Iterator[list[str]]) -> Iterator[list[list[str]]]:
    """Rows by the `BLOCK`: as text they need many times the memory that they need as numbers."""
    while block := list(itertools.islice(rows, BLOCK)):
        yield block


def _joined(path: Path, header: list[str], name: str, parts: list[Column]) -> Column:
    if not parts:
        return np.array([], dtype=str if name in WORD_COLUMNS else float)
    if len({part.dtype.kind for part in parts}) > 1:
        # Numbers at first, and words further on: it was words all along.
        index = header.index(name)
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = csv.reader(file, strict=True)
            next(rows)
            return np.array([row[index] for row in rows if row], dtype=str)
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def _column(path: Path, name: str, cells: Sequence[str], first: int) -> Column:
    """The cells of a block, the first of which is in this row of the table."""
    is_known = name in BASE_COLUMNS or name in CONTEXT_COLUMNS
    if name in NEVER_EMPTY and "" in cells:
        expected = "a number" if name == "time_s" else "a name"
        raise _cell_error(path, name, first + cells.index(""), "nothing", expected)
    if name not in WORD_COLUMNS:
        try:
            numbers = np.array([float(cell) if cell else math.nan for cell in cells], dtype=float)
            if not np.isinf(numbers).any():
                return numbers
        except ValueError:
            pass
        if is_known:
            row = next(row for row, cell in enumerate(cells) if not _is_number(cell))
            expected = "a number, or nothing where it is unknown"
            raise _cell_error(path, name, first + row, repr(cells[row]), expected)
    return np.array(cells, dtype=str)


def _is_number(cell: str) -> bool:
    try:
        return not cell or not math.isinf(float(cell))
    except ValueError:
        return False


def _cell_error(path: Path, name: str, row: int, found: str, expected: str) -> RecordingError:
    """Say where a cell is; its line is looked up again, because a quoted cell may span several."""
    with path.open(encoding="utf-8-sig", newline="") as file:
        rows = csv.reader(file, strict=True)
        next(rows)
        filled = (rows.line_num for each in rows if each)
        line = next(line for count, line in enumerate(filled) if count == row)
    return RecordingError(f"{path}:{line}: column {name!r}: found {found}, expected {expected}")


def _cells(name: str, column: Column) -> Iterable[str]:
    if column.dtype.kind not in "fiub":
        words = [str(each) for each in column.tolist()]
        if any("\r" in each for each in words):  # which Python 3.11's csv would not quote
            raise ValueError(f"column {name!r}: found a carriage return in a word")
        return words
    numbers = column.astype(float)
    if np.isinf(numbers).any():
        raise ValueError(
            f"column {name!r}: found an infinite number at row {int(np.flatnonzero(np.isinf(numbers))[0])}"
        )
    known = numbers[~np.isnan(numbers)]
    # Whole centimetres stay whole: 123, not 123.0.
    show = "{:.0f}".format if (known == np.rint(known)).all() and (np.abs(known) < 2**53).all() else repr
    return ["" if each != each else show(each) for each in numbers.tolist()]
