"""The one intake of readings, for everything that compares them with a truth.

It makes one table of files: CSV in the one form, recordings, datasets of imported logs, or with a column map other
people's tables; with what the files are and what was noticed. Rows stay in the order of the files and readings in the
resolution of their file.
"""

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, TypedDict, Unpack

import numpy as np

from msp_lab.readings.checks import WRONG_UNIT_SHARE, check_comparable
from msp_lab.readings.clock_runs import with_clock_runs
from msp_lab.readings.column_map import ColumnMap, read_table
from msp_lab.readings.dataset import ORIGIN, is_dataset, read_dataset, sensors_by_run
from msp_lab.readings.no_echo import NO_ECHO, as_no_answer, in_code_of, without_negative
from msp_lab.readings.others import Referenced
from msp_lab.readings.runs import runs_of
from msp_lab.readings.vehicle import others_as_reference
from msp_range.arrays import Column, Indices, numbered
from msp_range.reading_model.sensor_model import SensorModel
from msp_range.recording.csv_form import MeasuredData, join_tables
from msp_range.recording.error import RecordingError
from msp_range.recording.export import measured_data
from msp_range.recording.reader import Recording, is_recording
from msp_sim.effects.base import OTHERS, REFERENCE, REFERENCE_STD, TRUE_RANGE
from msp_sim.model.context_limits import check_contexts
from msp_sim.model.derived import DERIVED, PREVIOUS, derived_columns
from msp_sim.model.model import Model

CLOCK_FAULT_CM = 32768.0
"""Readings from here on are a fault of the sensor's clock line and no distance: the highest bit of the answer is set.
They are left out where a unit is judged by distances."""
OVERLAP_SHARE = 0.95
"""Two files of which this share of the smaller one's rows is in both are the same readings twice, and are refused. Any
value from 0.5 on finds a table and the recording that it was made from; accidental repeats stay far below."""
FLOWN_SHARE = 0.5
"""Angles of which there are more different ones than this share of the readings were flown: those that are set up have
at least ten readings each. Any value from 0.1 to 0.9 decides alike."""
EQUAL_RELATIVE = 1e-9
"""A column whose values differ by a smaller share than this is constant: 100.00000000000142 is 100. It is far above the
rounding of arithmetic (1e-15) and far below any resolution."""


FLIGHT_LOGS = (".bin", ".ulg", ".tlog", ".bag", ".db3")
"""Endings of files that ``msp-lab import`` reads."""

Truth = Literal["recorded", "others"]
"""Where the true range comes from: the files, or each sensor's neighbours."""


@dataclass(frozen=True)
class SourceFile:
    """A file of readings: its name, the SHA-256 of its content in hexadecimal, and its number of rows."""

    name: str
    sha256: str
    rows: int


@dataclass(frozen=True)
class LoadedReadings:
    """Readings of all files together."""

    data: MeasuredData
    """All rows in the order of the files, with `run` and `previous_reading_cm`."""
    sources: tuple[SourceFile, ...]
    """The files."""
    messages: tuple[str, ...] = ()
    """What was left out or noticed, a sentence each."""
    sensors: tuple[str, ...] = ()
    """The sensors that the user selected; none: all."""


class Which(TypedDict, total=False):
    """Which readings of the files are used, and how; all of it may be left out."""

    run_column: str | None
    """The column that distinguishes runs; None: `run`, and where there is none each file is one."""
    sensors: Sequence[str]
    """Those whose readings are used, as the column `sensor` names them; none: all."""
    runs: Sequence[str]
    """Of a dataset, those that are read; none: all."""
    truth: Truth
    """The true range as it was recorded, or for each sensor what the other ones say."""
    without: Sequence[str]
    """Sensors that are then no reference for the others."""


def load_readings(
    paths: Sequence[Path], sensor: SensorModel, column_map: ColumnMap | None = None, **which: Unpack[Which]
) -> LoadedReadings:
    """Read and check CSV files, recordings, datasets of ``msp-lab import``, or with a map other people's tables.

    The sensor's limits and its code of no echo show whether units are right. RecordingError if a file cannot be read,
    its readings are given twice, or they cannot be compared with a truth; in a line, with what to do. ConfigError if
    there is no such column.
    """
    messages = [column_map.note] if column_map is not None and column_map.note else []
    tables: list[MeasuredData] = []
    sources: list[SourceFile] = []
    referenced: list[Referenced] = []
    run_column, runs, is_of_others = which.get("run_column"), which.get("runs", ()), which.get("truth") == "others"
    for path in paths:
        table, recording, notes = read_file(path, column_map, sensor.maximum_cm, run_column or "run", runs)
        if is_of_others and not len(table):
            raise RecordingError(f"{path}: no readings, only a header")
        table, changed = in_code_of(sensor, table)
        table = table.without(NO_ECHO)
        messages += [*(f"{path}: {note}" for note in notes), *changed]
        if is_of_others:
            table, of_runs = others_as_reference(path, table, recording, Model.of(sensor), which.get("without", ()))
            referenced += of_runs
        # Of some runs of a large dataset the others are not read: their logs' SHA-256 are in this file.
        source = SourceFile(path.name, sha256(path / ORIGIN if runs else path), len(table))
        for other, earlier, its in zip(paths, tables, sources, strict=False):
            if its.sha256 == source.sha256:
                raise RecordingError(f"{path}: has the same content as {other}; each reading may count once")
            if column_map is None:
                _check_overlap(path, table, other, earlier)
        tables.append(table)
        sources.append(source)
    of_rows, renamed = runs_of(tables, paths, run_column)
    columns = {**join_tables(tables).columns, "run": np.concatenate(of_rows)}
    # Time since power-up says more than time in the run.
    asked = DERIVED.keys() - ({"time_in_run_s"} if "uptime_s" in columns else set())
    if "time_in_run_s" in columns and np.isnan(columns["time_in_run_s"]).all():
        # A table without times has numbers of rows in their place, from which no rate follows.
        asked = {name for name in asked if "time_s" not in DERIVED[name][0]}
    derived, words = derived_columns(asked, columns)
    columns |= derived
    messages += [f"{name} is computed from {words[name]}." for name in derived if name != "time_in_run_s"]
    # Many readings are held once, and not twice.
    tables.clear()
    name = ", ".join(str(path) for path in paths)
    sensors = tuple(which.get("sensors", ()))
    if sensors:
        columns = dict(_selected(name, MeasuredData(columns), sensors).columns)
    reading_cm = columns["reading_cm"]
    sound = MeasuredData({**columns, "reading_cm": np.where(reading_cm >= CLOCK_FAULT_CM, math.nan, reading_cm)})
    check_contexts(name, sound)
    check_comparable(name, sound, sensor)
    _round_constants(columns)
    repeated = _add_previous(columns)
    messages += [*renamed, *repeated, *_about_others(columns), *_about_offsets(referenced)]
    return LoadedReadings(MeasuredData(columns), tuple(sources), tuple(messages), sensors)


def sensors_in(
    paths: Sequence[Path], sensor: SensorModel, column_map: ColumnMap | None, **which: Unpack[Which]
) -> list[str]:
    """Names of the sensors in some files, in order; the parameters and errors are those of `load_readings`."""
    if all(map(is_dataset, paths)):
        return sorted({name for path in paths for names in sensors_by_run(path).values() for name in names})
    return sorted(set(load_readings(paths, sensor, column_map, **which).data["sensor"].tolist()))


def without_impossible(loaded: LoadedReadings, sensor: SensorModel) -> LoadedReadings:
    """Return the readings with those outside of the sensor's limits as no answer, and without angles that were flown
    and not set up; with a message about both."""
    angles = loaded.data.columns.get("incidence_deg", np.zeros(0))
    if np.unique(angles[~np.isnan(angles)]).size > FLOWN_SHARE * angles.size:
        text = "incidence_deg is another one in most readings, as in flight: no angle was set up, so it is not used."
        loaded = replace(loaded, data=loaded.data.without("incidence_deg"), messages=(*loaded.messages, text))
    reading_cm = loaded.data["reading_cm"]
    outside = (reading_cm < sensor.minimum_cm) | (reading_cm > sensor.maximum_cm)
    if outside.sum() > WRONG_UNIT_SHARE * (~np.isnan(reading_cm)).sum():
        return loaded
    what = f"readings are outside of the sensor's {sensor.minimum_cm} to {sensor.maximum_cm} cm"
    data, notes = as_no_answer(loaded.data, outside, what)
    return replace(loaded, data=data, messages=(*loaded.messages, *notes))


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file, or of the names and contents of a folder's files, in hexadecimal."""
    if path.is_dir():
        files = sorted(member for member in path.rglob("*") if member.is_file())
        lines = [f"{member.relative_to(path).as_posix()} {sha256(member)}\n" for member in files]
        return hashlib.sha256("".join(lines).encode()).hexdigest()
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def read_file(
    path: Path, column_map: ColumnMap | None, maximum_cm: float, run_column: str = "run", runs: Sequence[str] = ()
) -> tuple[MeasuredData, Recording | None, list[str]]:
    """Read one file, with a run from each step of its clock on and without readings that are codes.

    Returns
    -------
    tuple
        Its rows, the recording that it is, and what was noticed, a sentence each.
    """
    recording = None
    notes = []
    if is_dataset(path):
        table = read_dataset(path, runs=runs)
    elif column_map is None and is_recording(path):
        recording = Recording(path)
        table = measured_data(recording)
        if recording.losses:
            notes.append(f"The file is damaged; lost: {recording.losses}.")
    elif path.suffix.lower() in FLIGHT_LOGS:
        raise RecordingError(f"{path}: a flight log; 'msp-lab import {path.name} --out DATASET' makes readings of it")
    else:
        table = read_table(path, column_map, maximum_cm)
    table, steps = with_clock_runs(path, table, run_column)
    table, codes = without_negative(table)
    return table, recording, [*notes, *steps, *codes]


def _about_others(columns: Mapping[str, Column]) -> list[str]:
    """What a comparison with the other sensors cannot show, where it is one."""
    of_others = columns.get(REFERENCE, np.zeros(0)) == OTHERS
    if not of_others.any():
        return []
    unknown = np.isnan(columns[TRUE_RANGE][of_others])
    typical_cm = float(np.nanmedian(columns[REFERENCE_STD][of_others])) if not unknown.all() else math.nan
    lost = f" In {unknown.sum()} rows they do not know it, or the vehicle stands or is as low." if unknown.any() else ""
    return [
        f"The true range is what the other sensors say, to {typical_cm:.2g} cm.{lost} What all of them have in common "
        "cannot be seen: the air's temperature, a common latency, scale or offset."
    ]


def _about_offsets(referenced: Sequence[Referenced]) -> list[str]:
    """By how much sensors read more than the others, over their readings of all runs."""
    found = []
    for sensor in sorted({name for run in referenced for name in run.rows}):
        of_runs = [(run.offsets_cm[sensor], run.rows[sensor]) for run in referenced if sensor in run.rows]
        if len(of_runs) > 1:
            offset_cm, rows = np.array(of_runs).T
            half_cm = 2.0 * float(offset_cm.std(ddof=1)) / math.sqrt(offset_cm.size)
            found.append(f"{sensor} {np.average(offset_cm, weights=rows):+.1f} cm ({half_cm:.1f} either way)")
    if not found:
        return []
    return [
        f"Readings less the others', on average over all runs: {', '.join(found)}. It is taken off, since a "
        "sloping ground or a mounting that is a little off looks the same."
    ]


def _check_overlap(path: Path, table: MeasuredData, other: Path, earlier: MeasuredData) -> None:
    """Refuse readings that are in an earlier file, as those of a recording are in the table made of it."""
    keys = ("time_s", "sensor", "reading_cm", "true_range_cm")
    names = [name for name in keys if name in table and name in earlier]
    rows, others = _rows(table, names), _rows(earlier, names)
    both = len(rows & others)
    if both > OVERLAP_SHARE * min(len(rows), len(others)):
        raise RecordingError(
            f"{path}: {both} of its readings are in {other} too; each may count once, so leave one of them out"
        )


def _rows(table: MeasuredData, names: Sequence[str]) -> set[tuple[object, ...]]:
    # Times to a millisecond: a recording has more digits than a table. Unknown numbers are equal here.
    columns = [
        np.nan_to_num(np.round(table[name], 3), nan=-1.0) if table[name].dtype.kind == "f" else table[name]
        for name in names
    ]
    return set(zip(*(column.tolist() for column in columns), strict=True))


def _selected(name: str, data: MeasuredData, sensors: Sequence[str]) -> MeasuredData:
    there = sorted(set(data["sensor"].tolist()))
    unknown = [sensor for sensor in sensors if sensor not in there]
    if unknown:
        raise RecordingError(f"{name}: no readings of the sensor {unknown[0]!r}; there are some of {', '.join(there)}")
    return data.select(np.flatnonzero(np.isin(data["sensor"], sensors)))


def _round_constants(columns: dict[str, Column]) -> None:
    """Make columns constant that differ only by what arithmetic adds."""
    for name, column in columns.items():
        if column.dtype.kind == "f" and np.isfinite(column).any():
            low, high = float(np.nanmin(column)), float(np.nanmax(column))
            if low < high <= low + EQUAL_RELATIVE * max(abs(low), abs(high)):
                columns[name] = np.where(np.isnan(column), math.nan, float(f"{low:.9g}"))


def _add_previous(columns: dict[str, Column]) -> list[str]:
    """Drop duplicate rows, and add to each reading the one before it of the same sensor and run."""
    order = time_order(columns)
    series = [np.diff(numbered(columns[name])[order], prepend=-1) for name in ("run", "sensor")]
    is_first = np.any(series, axis=0)
    same_time = ~is_first & (np.diff(columns["time_s"][order], prepend=math.nan) == 0.0)
    if same_time.any():
        # Unknown numbers are equal here.
        as_before = [np.diff(numbered(column)[order], prepend=-1) == 0 for column in columns.values()]
        duplicate = np.all([same_time, *as_before], axis=0)
        if duplicate.any():
            kept = np.ones(order.size, dtype=bool)
            kept[order[duplicate]] = False
            columns |= {name: column[kept] for name, column in columns.items()}
            return [f"{duplicate.sum()} duplicate rows are dropped.", *_add_previous(columns)]
    previous = np.full(order.size, math.nan)
    previous[order[1:]] = np.where(is_first[1:], math.nan, columns["reading_cm"][order[:-1]])
    if "time_in_run_s" in columns:
        # Without times the order of the rows need not be that of the readings: beams of a scanner, or a sorted table.
        previous[np.isnan(columns["time_in_run_s"])] = math.nan
    columns[PREVIOUS] = previous
    if not same_time.any():
        return []
    return [
        f"{same_time.sum()} readings of one sensor have the time of the one before: their order is that of the file."
    ]


def time_order(columns: Mapping[str, Column]) -> Indices:
    """Return row numbers by run, sensor and time; rows of one time stay in the order of the file."""
    run, sensor = (numbered(columns[name]) for name in ("run", "sensor"))
    return np.lexsort((columns["time_s"], sensor, run))
