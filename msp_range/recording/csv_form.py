"""Measured readings as CSV, in the one form that the whole project uses, and as columns of numpy arrays.

One row is one ping. ``time_s`` is the time of the echo, or of the ping where there was none; an empty cell is
unknown, and an empty ``reading_cm`` is no answer. Columns that are not named here are further context: numbers where
every cell is a number or empty, words otherwise. Files are text in UTF-8, compressed ones (.gz) are unpacked; whatever
is no table, or is too large, is refused in a line that names the place.
"""

import csv
import difflib
import gzip
import io
import itertools
import math
import os
import zlib
from collections.abc import Callable, Collection, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from msp_range.arrays import Column
from msp_range.input_file import CONTROL, open_input, text_fault
from msp_range.recording.columns import KNOWN_COLUMNS, LARGEST_NUMBER, WORD_COLUMNS
from msp_range.recording.error import RecordingError, new_file

BLOCK = 1 << 10
"""Rows that are held as text at a time, which need many times the memory that they need as numbers: this many stay in a
processor's cache."""
MOST_WORD_BYTES = 256 * 2**20
"""Memory that a column of words may take: it is as many rows long as its longest word is wide."""
LARGEST_BYTES = 512 * 2**20
"""A larger file is refused: ten million readings with their contexts fit, and take 60 s and 1 GB to read."""
MOST_EXPANSION = 50
"""Bytes that a compressed file may have unpacked for each of its own. Tables have 5 to 20; a bomb has 1000."""
FREE_EXPANSION_BYTES = 2**20
"""Bytes that the smallest compressed file may have unpacked."""
LONGEST_LINE = 2**18
"""Characters of a line: a row of `MOST_COLUMNS` of the longest cells is shorter."""
MOST_COLUMNS = 1000
"""Columns of a table. Tables of readings have 4 to 40; each column costs 8 bytes of memory for each row."""
LONGEST_CELL = 200
"""Characters of a cell that is kept as a word: names of runs, targets and conditions have 10 to 40."""


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

    def column(self, name: str) -> Column:
        """Return a column; if the table lacks it, its values are unknown."""
        if name in self.columns:
            return self.columns[name]
        return np.full(len(self), "" if name in WORD_COLUMNS else math.nan)

    def select(self, rows: Column) -> "MeasuredData":
        """Return the rows of a boolean mask or of an index array."""
        return MeasuredData({name: column[rows] for name, column in self.columns.items()})

    def without(self, *names: str) -> "MeasuredData":
        """Return the table without columns."""
        return MeasuredData({name: column for name, column in self.columns.items() if name not in names})


def join_tables(tables: Sequence[MeasuredData]) -> MeasuredData:
    """The rows of several tables in one; a column that one of them lacks is unknown there.

    Examples
    --------
    >>> first, second = ({"time_s": np.array([each])} for each in (1.0, 2.0))
    >>> joined = join_tables([MeasuredData(first | {"target": np.array(["wood"])}), MeasuredData(second)])
    >>> joined["time_s"].tolist(), joined["target"].tolist()
    ([1.0, 2.0], ['wood', ''])
    """
    columns: dict[str, Column] = {}
    for name in dict.fromkeys(name for table in tables for name in table.columns):
        is_word = name in WORD_COLUMNS or any(name in table and table[name].dtype.kind == "U" for table in tables)
        missing = "" if is_word else math.nan
        pieces = [table[name] if name in table else np.full(len(table), missing) for table in tables]
        pieces = [piece.astype(str, copy=False) if is_word else piece for piece in pieces]
        columns[name] = pieces[0] if len(pieces) == 1 else np.concatenate(pieces)
    return MeasuredData(columns)


def read_csv(
    path: Path | str,
    required: Sequence[str] = ("time_s", "sensor", "reading_cm"),
    optional: Sequence[str] = (),
    hint: str = "",
) -> MeasuredData:
    """Read measured data.

    Parameters
    ----------
    path
        A CSV file with a header, separated by commas, in UTF-8.
    required
        Columns that have to be there.
    optional
        Columns that may be missing; where a name is like one of them, it is taken for that one, misspelt.
    hint
        What the message of a missing column ends with.

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
    header = csv_header(path)
    _check_header(path, header, required, optional, hint)

    def rows() -> Iterator[tuple[int, Sequence[str]]]:
        for line, row in itertools.islice(csv_rows(path), 1, None):
            if len(row) != len(header):
                raise RecordingError(f"{path}:{line}: found {len(row)} cells, expected {len(header)} as in the header")
            yield line, row

    return read_columns(path, rows, dict(zip(header, header, strict=True)), {"time_s", "sensor"})


def read_columns(
    path: Path,
    rows: Callable[[], Iterator[tuple[int, Sequence[str]]]],
    headings: Mapping[str, str],
    never_empty: Container[str] = (),
    words: Container[str] = WORD_COLUMNS,
) -> MeasuredData:
    """Columns of a table, block by block.

    Parameters
    ----------
    path
        The file, for messages.
    rows
        Each row with its line, without the header; called again where a column turns out to hold words.
    headings
        Name of each column -> what the file calls it.
    never_empty
        Columns of which every cell has to hold something.
    words
        Columns that hold words, whatever they look like.

    Raises
    ------
    RecordingError
        A cell of a known column is no number; as `rows`.
    """
    parts: dict[str, list[Column]] = {name: [] for name in headings}
    read = rows()
    while block := list(itertools.islice(read, BLOCK)):
        lines, cells = zip(*block, strict=True)
        for name, column in zip(headings, zip(*cells, strict=True), strict=True):
            if name in never_empty and "" in column:
                place = f"{path}:{lines[column.index('')]}: column {headings[name]!r}"
                raise RecordingError(f"{place}: found nothing, expected a {'number' if name == 'time_s' else 'name'}")
            found = None if name in words else _numbers(path, name, headings[name], column, lines, name in never_empty)
            parts[name].append(word_column(str(path), name, column) if found is None else found)
    columns = {}
    for index, (name, blocks) in enumerate(parts.items()):
        if len({part.dtype.kind for part in blocks}) > 1:
            # Numbers at first, and words further on: it was words all along.
            columns[name] = word_column(str(path), name, [cells[index] for _, cells in rows()])
        elif blocks:
            if blocks[0].dtype.kind == "U":
                longest = max(part.dtype.itemsize // 4 for part in blocks)
                _check_words(str(path), name, sum(map(len, blocks)), longest)
            columns[name] = np.concatenate(blocks)
        else:
            columns[name] = np.array([], dtype=str if name in WORD_COLUMNS else float)
        # Many readings are there once, and not twice.
        blocks.clear()
    return MeasuredData(columns)


def write_csv(path: Path | str, columns: Mapping[str, Column] | MeasuredData, *, replacing: bool = False) -> None:
    """Write measured data, the known columns first and in their usual order; `read_csv` backwards.

    The file is there only when it is complete; an existing one is refused, or replaced with ``replacing``.

    Raises
    ------
    RecordingError
        The file cannot be written.
    ValueError
        Columns of different lengths, a number that is infinite or too large, or a control character in a word.
    """
    data = columns if isinstance(columns, MeasuredData) else MeasuredData(columns)
    known = [name for name in KNOWN_COLUMNS if name in data]
    names = known + [name for name in data.columns if name not in known]
    cells = [_cells(name, data[name]) for name in names]
    with new_file(path, replacing=replacing) as unfinished, unfinished.open("x", encoding="utf-8", newline="") as out:
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(names)
        writer.writerows(zip(*cells, strict=True))


def csv_header(path: Path, delimiter: str = ",") -> list[str]:
    """The headings of a table, none of an empty one; raises as `csv_rows`."""
    return [name.strip() for name in next(csv_rows(path, delimiter), (0, []))[1]]


def csv_rows(path: Path, delimiter: str = ",") -> Iterator[tuple[int, list[str]]]:
    """Each row of a table with the number of the line on which it ends; empty lines are left out.

    Raises
    ------
    RecordingError
        The file cannot be read, is too large, not text, or not CSV.
    """
    try:
        with open_input(path, LARGEST_BYTES) as file:
            rows = csv.reader(_lines(path, file), delimiter=delimiter, strict=True)
            for row in rows:
                if len(row) > MOST_COLUMNS:
                    raise RecordingError(
                        f"{path}:{rows.line_num}: found {len(row)} columns, expected at most {MOST_COLUMNS}"
                    )
                if row:
                    yield rows.line_num, row
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise RecordingError(f"{path}: cannot be unpacked: {error}") from None
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from None
    except csv.Error as error:
        raise RecordingError(f"{path}:{rows.line_num}: not CSV: {error}") from None


def _lines(path: Path, file: io.BufferedReader) -> Iterator[str]:
    is_packed = path.suffix == ".gz"
    with gzip.GzipFile(fileobj=file) if is_packed else file as stream:
        most = FREE_EXPANSION_BYTES + MOST_EXPANSION * os.fstat(file.fileno()).st_size if is_packed else LARGEST_BYTES
        text = io.TextIOWrapper(stream, "utf-8-sig", "surrogateescape")
        number, rest = 1, ""
        while block := text.read(2**16):
            if stream.tell() > most:
                raise RecordingError(f"{path}: found more than {most / 1e6:.0f} MB of unpacked text, expected less")
            if (fault := text_fault(block)) is not None:
                raise RecordingError(f"{path}:{number + fault[0]}: {fault[2]}")
            rest += block
            end = rest.rfind("\n") + 1
            number += rest.count("\n", 0, end)
            yield from io.StringIO(rest[:end])
            rest = rest[end:]
            if len(rest) > LONGEST_LINE:
                raise RecordingError(f"{path}:{number}: found a line of more than {LONGEST_LINE} characters")
        yield from io.StringIO(rest)


def picked_cells(path: Path, places: Collection[int | None], delimiter: str = ",") -> Iterator[tuple[int, list[str]]]:
    """The cells at these places of each row below the header, without blanks around them, with its line.

    Empty where there is no place, or the row is shorter.
    """
    for line, row in itertools.islice(csv_rows(path, delimiter), 1, None):
        yield line, [row[at].strip() if at is not None and at < len(row) else "" for at in places]


def short_list(names: Sequence[str]) -> str:
    """Names of columns for a message: the first ones, each cut where it is long."""
    shown = [name if len(name) <= 40 else f"{name[:40]}..." for name in names[:20]]
    return ", ".join(shown) + (f" and {len(names) - 20} more" if len(names) > 20 else "")


def _check_header(path: Path, header: list[str], required: Sequence[str], optional: Sequence[str], hint: str) -> None:
    if not header:
        raise RecordingError(f"{path}: empty, expected a header with the columns {', '.join(required)}")
    for number, name in enumerate(header, start=1):
        if not name:
            raise RecordingError(f"{path}:1: column {number} has no name")
        if name in header[: number - 1]:
            raise RecordingError(f"{path}:1: the column {name[:LONGEST_CELL]!r} is there twice")
    names = *required, *optional
    for name in names:
        near = difflib.get_close_matches(name, [heading[:64] for heading in header if heading not in names], n=1)
        if name not in header and (near or name in required):
            why = f" Is it {near[0]!r}?" if near else " Columns are separated by commas." if len(header) == 1 else ""
            raise RecordingError(f"{path}:1: the column {name!r} is missing.{why} Found: {short_list(header)}{hint}")


def word_column(source: str, name: str, words: Sequence[str]) -> Column:
    """Words as a column.

    Raises
    ------
    RecordingError
        One is so long, or they are so many, that the column would take too much memory.
    """
    _check_words(source, name, len(words), max(map(len, words), default=0))
    return np.array(words, dtype=str)


def table_of(source: str, rows: Sequence[Mapping[str, Any]], names: Iterable[str]) -> MeasuredData:
    """Records as columns of words or numbers, in which what is None or not there is an empty word or NaN."""
    columns: dict[str, Column] = {}
    for name in names:
        values = [row.get(name) for row in rows]
        if name in WORD_COLUMNS or any(isinstance(value, str) for value in values):
            columns[name] = word_column(source, name, ["" if value is None else str(value) for value in values])
        else:
            columns[name] = np.array(values, dtype=float)
    return MeasuredData(columns)


def _check_words(source: str, name: str, count: int, longest: int) -> None:
    found = f"{source}: column {name[:LONGEST_CELL]!r}: found a word of {longest} characters"
    if longest > LONGEST_CELL:
        raise RecordingError(f"{found}, expected at most {LONGEST_CELL}")
    if 4 * longest * count > MOST_WORD_BYTES:
        raise RecordingError(f"{found} in a table of {count} rows, expected {MOST_WORD_BYTES // (4 * count)} at most")


def _numbers(
    path: Path, name: str, heading: str, cells: Sequence[str], lines: Sequence[int], never_empty: bool
) -> Column | None:
    """The cells of a block as numbers, with the line of each; None where a column of one's own holds words."""
    parse = to_time_s if name == "time_s" else to_number
    try:
        numbers = np.array([parse(cell) if cell else math.nan for cell in cells], dtype=float)
        if not (np.abs(numbers) > LARGEST_NUMBER).any() and not (never_empty and np.isnan(numbers).any()):
            return numbers
    except ValueError:
        pass
    if name not in KNOWN_COLUMNS:
        return None
    row = next(row for row, cell in enumerate(cells) if not is_number(cell, parse))
    or_else = "a time of ISO 8601" if name == "time_s" else "nothing where it is unknown"
    commas = '. With decimal commas: a map file with decimal: ","' * is_number(with_point(cells[row]))
    raise RecordingError(
        f"{path}:{lines[row]}: column {heading[:LONGEST_CELL]!r}: found {cells[row][:LONGEST_CELL]!r}, expected a "
        f"number, or {or_else}{commas}"
    )


def with_point(cell: str) -> str:
    """A cell with a decimal point in place of a comma."""
    return cell.replace(",", ".")


def to_number(cell: str) -> float:
    """A number as tables have it; what only Python takes for one (``1_0``, digits of other scripts) is none.

    Raises
    ------
    ValueError
        It is none.
    """
    if "_" in cell or not cell.isascii():
        raise ValueError(f"could not convert string to float: {cell!r}")
    return float(cell)


def to_time_s(cell: str) -> float:
    """A time [s]: a number, or a time of ISO 8601 as seconds since 1970; without a zone it is UTC.

    Raises
    ------
    ValueError
        It is neither.

    Examples
    --------
    >>> to_time_s("12.5"), to_time_s("2026-05-01T12:00:00.25Z"), to_time_s("2026-05-01 14:00:00.25+02:00")
    (12.5, 1777636800.25, 1777636800.25)
    """
    try:
        return to_number(cell)
    except ValueError:
        found = datetime.fromisoformat(cell.strip())
        return (found if found.tzinfo else found.replace(tzinfo=UTC)).timestamp()


def is_number(cell: str, parse: Callable[[str], float] = to_number) -> bool:
    """Whether a cell of a column of numbers, or of times, can be one: a number, or nothing; NaN is no time."""
    try:
        return not cell or abs(number := parse(cell)) <= LARGEST_NUMBER or (parse is to_number and math.isnan(number))
    except ValueError:
        return False


def _cells(name: str, column: Column) -> Iterable[str]:
    if column.dtype.kind not in "fiub":
        words = [str(word) for word in column.tolist()]
        wrong = next((word for word in words if CONTROL.search(word)), None)
        if wrong is not None:
            raise ValueError(f"column {name!r}: found a control character in {wrong!r}")
        return words
    numbers = column.astype(float)
    too_large = np.abs(numbers) > LARGEST_NUMBER
    if too_large.any():
        row = int(np.flatnonzero(too_large)[0])
        raise ValueError(f"column {name!r}: found {numbers[row]:g} at row {row}, expected at most {LARGEST_NUMBER:g}")
    known = numbers[~np.isnan(numbers)]
    # Whole centimetres stay whole: 123, not 123.0.
    show = "{:.0f}".format if (known == np.rint(known)).all() and (np.abs(known) < 2**53).all() else repr
    return ["" if value != value else show(value) for value in numbers.tolist()]
