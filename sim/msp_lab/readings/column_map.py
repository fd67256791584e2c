"""Other people's tables in the names and units of the CSV form.

By a map (a YAML file, or NAME=COLUMN*FACTOR on the command line) a CSV file is read as measured data. Columns are named
by their header or, where that is empty or not unique, by their number from 1. Tables side by side in one file are parts
of the map.
"""

import difflib
import json
import math
import re
from collections.abc import Container, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from msp_range.input_file import CONTROL
from msp_range.recording.columns import BASE_COLUMNS, BRIDGE_COLUMNS, CONTEXT_COLUMNS, WORD_COLUMNS
from msp_range.recording.csv_form import (
    Column,
    MeasuredData,
    csv_header,
    is_number,
    join_tables,
    picked_cells,
    read_columns,
    read_csv,
    short_list,
    with_point,
)
from msp_range.recording.error import RecordingError
from msp_range.yaml_file import ConfigError, Section, load, suggest

Unit = Literal["m", "cm", "mm", "in", "ft", "deg", "rad", "cos", "C", "F", "K", "s", "ms", "us", "%", "1"]

_LENGTHS_CM = {"m": 100.0, "cm": 1.0, "mm": 0.1, "in": 2.54, "ft": 30.48}
_TIMES_S = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
_KINDS: dict[str, dict[str, tuple[float, float]]] = {
    "_cm": {unit: (factor, 0.0) for unit, factor in _LENGTHS_CM.items()},
    "_cm_s": {unit: (factor, 0.0) for unit, factor in _LENGTHS_CM.items()},
    "_deg": {"deg": (1.0, 0.0), "rad": (180.0 / math.pi, 0.0), "cos": (180.0 / math.pi, 0.0)},
    "_c": {"C": (1.0, 0.0), "F": (5.0 / 9.0, -160.0 / 9.0), "K": (1.0, -273.15)},
    "_s": {unit: (factor, 0.0) for unit, factor in _TIMES_S.items()},
    "_ms": {unit: (1e3 * factor, 0.0) for unit, factor in _TIMES_S.items()},
    "_pct": {"%": (1.0, 0.0), "1": (100.0, 0.0)},
}
"""Ending of a column's name -> units that can be converted to it: (factor, offset)."""

KNOWN = {**BASE_COLUMNS, **CONTEXT_COLUMNS}
MISSPELT = 0.75
"""Refuse a name that is no column of the CSV form but so similar to one (share of equal letters): it is a misspelling
and no column of one's own. `reading` for `reading_cm` has 0.82; lower: `range_m` is refused too; higher: misspellings
become columns that nothing uses."""
_OPTION = re.compile(r"\s*(?P<name>[^=]*?)\s*=\s*(?P<column>.+?)\s*(?:\*\s*(?P<factor>[-+0-9.eE]+))?\s*")


class MappedColumn(Section):
    """Where a column of the CSV form is found in a table; a name or a number alone is that of the column."""

    column: str | int | None = None
    """Its header, or its number from 1."""

    value: str | float | None = None
    """One value for all rows, instead of a column."""

    unit: Unit | None = None
    """Unit of the numbers; left out: that of the CSV form. cos: they are the cosine of an angle."""

    factor: float = Field(1.0)
    """Factor of the numbers, applied after the unit: -1 changes the sign."""

    offset: float = Field(0.0)
    """Offset that is added after the factor, in the CSV form's unit."""

    @model_validator(mode="before")
    @classmethod
    def _alone(cls, given: Any) -> Any:
        return {"column": given} if isinstance(given, str | int) else given


class Codes(Section):
    """Values in the file that are no distance."""

    no_echo: tuple[float, ...] = ()
    """Readings of no echo, which become the sensor's maximum."""

    no_answer: tuple[float, ...] = ()
    """Readings of no measurement, which become empty."""


class Part(Section):
    """One table of a file."""

    columns: dict[str, MappedColumn] = Field(min_length=1)
    """Column of the CSV form, or of one's own -> its place; a name or a number alone needs no other unit."""

    @field_validator("columns")
    @classmethod
    def _are_known(cls, columns: dict[str, MappedColumn]) -> dict[str, MappedColumn]:
        for name, place in columns.items():
            check(name, place)
        return columns


class ColumnMap(Part):
    """A map file."""

    columns: dict[str, MappedColumn] = Field(default_factory=dict)
    """Column of the CSV form -> its place in every part."""

    parts: tuple[Part, ...] = ()
    """Tables side by side in one file, joined one after the other; left out: one table."""

    codes: Codes = Codes()
    """Codes for readings that are no distance."""

    leave_out: dict[str, tuple[float, ...]] = Field(default_factory=dict)
    """Column of the CSV form -> values of rows that are left out."""

    note: str = ""
    """A warning about the use of numbers from these data."""

    delimiter: str = Field(",", min_length=1, max_length=1)
    """Between the cells."""

    decimal: Literal[".", ","] = "."
    """Before the decimals of a number."""

    @model_validator(mode="after")
    def _is_readable(self) -> "ColumnMap":
        if self.decimal == self.delimiter:
            raise ValueError(f"found decimal and delimiter {self.decimal!r}, expected two different ones")
        return self


def check(name: str, place: MappedColumn) -> None:
    """Check that a column's name is none of the CSV form's misspelt, and that the unit is of its kind.

    Raises
    ------
    ValueError
        It is, or it is not; in one line.
    """
    if name not in KNOWN:
        near = difflib.get_close_matches(name, KNOWN, n=1, cutoff=MISSPELT)
        if near:
            raise ValueError(
                f"found the column name {name!r}, which the CSV form does not have. Did you mean {near[0]!r}? "
                "A column of your own needs a name that is less like it"
            )
        if not name.strip() or CONTROL.search(name):
            raise ValueError(f"found the column name {name!r}, expected letters")
    if (place.column is None) == (place.value is None):
        raise ValueError(f"{name}: expected either a column or a value")
    if place.unit is not None and place.unit not in (units := _units(name)):
        known = ", ".join(units) or "none: leave it out"
        raise ValueError(f"{name}: found the unit {place.unit!r}, expected one of {known}")


def load_map(options: Sequence[str]) -> ColumnMap:
    """Return the map of ``--map``: one file, or any number of NAME=COLUMN*FACTOR.

    Raises
    ------
    ConfigError
        A file that cannot be used, an option that is neither, or both kinds.

    Examples
    --------
    >>> load_map(["reading_cm=dist*100", "true_range_cm=actual"]).columns["reading_cm"].factor
    100.0
    """
    if len(options) == 1 and Path(options[0]).suffix in (".yaml", ".yml"):
        return load(options[0], ColumnMap)
    columns: dict[str, MappedColumn] = {}
    for option in options:
        found = _OPTION.fullmatch(option)
        if found is None:
            raise ConfigError(f"--map {option}: expected one YAML file, or NAME=COLUMN*FACTOR as often as needed")
        try:
            mapped = MappedColumn(column=found["column"], factor=float(found["factor"] or 1.0))
            check(found["name"], mapped)
        except ValueError as error:
            raise ConfigError(f"--map {option}: {error}") from None
        columns[found["name"]] = mapped
    return ColumnMap(columns=columns)


def load_maps(options: Sequence[str] | None) -> ColumnMap | None:
    """The map of the options as `load_map` makes it; None if no option is given."""
    return load_map(options) if options else None


def read_table(path: Path, column_map: ColumnMap | None, maximum_cm: float) -> MeasuredData:
    """Read a CSV file in the project's form, in which time and sensor may be missing, or with a map anybody's.

    Parameters, what is returned and what is raised are those of `read_mapped`.
    """
    if column_map is not None:
        return read_mapped(path, column_map, maximum_cm)
    hint = "; --map NAME=COLUMN reads columns with other names"
    return _with_times(path, read_csv(path, ("reading_cm",), ("time_s", "sensor"), hint)).without(*BRIDGE_COLUMNS)


def read_mapped(path: Path, column_map: ColumnMap, maximum_cm: float) -> MeasuredData:
    """Read a table with other column names.

    Parameters
    ----------
    path
        A CSV file with a header, also compressed (.gz).
    column_map
        Places of its columns.
    maximum_cm
        Reading that means no echo.

    Returns
    -------
    MeasuredData
        If the map does not name them, ``time_s`` is the row's number, ``time_in_run_s`` unknown and ``sensor`` the
        file's name.

    Raises
    ------
    RecordingError
        The file cannot be read, lacks a column, or a cell is no number; with file, line and column.
    """
    header = csv_header(path, column_map.delimiter)
    if not header:
        raise RecordingError(f"{path}: empty, expected a header")
    # What already has a name of the CSV form keeps it.
    known = [name for name in header if name in KNOWN and header.count(name) == 1]
    shared = {name: MappedColumn(column=name) for name in known} | column_map.columns
    own = [part.columns for part in column_map.parts] or [{}]
    parts = [shared | column for column in own]
    tables = [_read_part(path, header, places, column_map, maximum_cm) for places in parts]
    # What is words in one part is words in all.
    words = {name for table in tables for name, column in table.columns.items() if column.dtype.kind == "U"}
    if any(table[name].dtype.kind != "U" for table in tables for name in words & table.columns.keys()):
        tables = [_read_part(path, header, places, column_map, maximum_cm, words) for places in parts]
    data = _with_times(path, join_tables(tables))
    for name, values in column_map.leave_out.items():
        if name not in data:
            raise RecordingError(f"{path}: the map leaves out rows by {name}, but has no column for it")
        data = data.select(~np.isin(data[name], values))
    return data


def _with_times(path: Path, table: MeasuredData) -> MeasuredData:
    """A table with a time and a sensor, where it has none of its own."""
    size, columns = len(table), dict(table.columns)
    if "time_s" not in columns:
        # Numbers of rows keep their order, and are no time that anything could drift over.
        columns |= {"time_s": np.arange(float(size)), "time_in_run_s": np.full(size, math.nan)}
    columns.setdefault("sensor", np.full(size, path.name.split(".")[0]))
    return MeasuredData(columns)


def _read_part(
    path: Path,
    header: list[str],
    places: Mapping[str, MappedColumn],
    column_map: ColumnMap,
    maximum_cm: float,
    words: Container[str] = WORD_COLUMNS,
) -> MeasuredData:
    """One of the tables side by side in a file; ``words`` are columns of words."""
    if "reading_cm" not in places:
        raise RecordingError(f"{path}: the map has no column for reading_cm. Columns: {short_list(header)}")
    where = {
        name: _index(path, header, name, place.column) for name, place in places.items() if place.column is not None
    }
    values = {name: str(place.value) for name, place in places.items() if name not in where}

    def rows() -> Iterator[tuple[int, list[str]]]:
        for line, cells in picked_cells(path, where.values(), column_map.delimiter):
            # A table next to a longer one ends where all its cells are empty.
            if any(cells):
                yield line, [pointed(name, cell) for name, cell in zip(where, cells, strict=True)]

    def pointed(name: str, cell: str) -> str:
        has_comma = column_map.decimal == "," and name not in WORD_COLUMNS and is_number(with_point(cell))
        return with_point(cell) if has_comma else cell

    headings = {name: header[at] or f"number {at + 1}" for name, at in where.items()}
    found = read_columns(path, rows, headings, words=words)
    constant = read_columns(path, lambda: iter([(2, [*values.values()])]), {name: name for name in values}, words=words)
    columns = {}
    for name, place in places.items():
        numbers = found[name] if name in found else np.repeat(constant[name], len(found))
        columns[name] = numbers
        if numbers.dtype.kind == "f":
            columns[name] = _converted(name, place, numbers)
            if name == "reading_cm":
                columns[name][np.isin(numbers, column_map.codes.no_echo)] = maximum_cm
                columns[name][np.isin(numbers, column_map.codes.no_answer)] = math.nan
    return MeasuredData(columns)


def _index(path: Path, header: list[str], name: str, column: str | int) -> int:
    if isinstance(column, int):
        if not 1 <= column <= len(header):
            raise RecordingError(f"{path}: found {len(header)} columns, expected a number {column} for {name}")
        return column - 1
    count = header.count(column)
    if count == 1:
        return header.index(column)
    if count:
        raise RecordingError(f"{path}: the column {column!r} occurs {count} times; give its number from 1")
    hint = suggest(column, [heading[:64] for heading in header])
    if len(header) == 1 and (other := next((each for each in ";\t|" if each in header[0]), "")):
        hint = f" Are the columns separated by {other!r}? Give a map file with delimiter: {json.dumps(other)}."
    there = short_list([heading or "(no name)" for heading in header])
    raise RecordingError(f"{path}: there is no column {column!r} for {name}.{hint} Columns: {there}")


def _converted(name: str, place: MappedColumn, numbers: Column) -> Column:
    factor, offset = (1.0, 0.0) if place.unit is None else _units(name)[place.unit]
    if place.unit == "cos":
        numbers = np.arccos(np.clip(numbers, -1.0, 1.0))
    found: Column = (numbers * factor + offset) * place.factor + place.offset
    # 18.350 m is 1835 cm and not 1835.0000000000002.
    return np.round(found, 9)


def _units(name: str) -> dict[str, tuple[float, float]]:
    endings = sorted((ending for ending in _KINDS if name.endswith(ending)), key=len)
    return _KINDS[endings[-1]] if endings else {}
