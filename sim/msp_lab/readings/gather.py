"""The readings to characterise from: files of measured data or recordings, one after the other, and what they are.

Paths enter, one `MeasuredData` and the files' names, hashes and rows leave. What makes an analysis impossible is told
here, before any: no true range, hardly any readings, another unit.
"""

import hashlib
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from msp_lab.readings.column_map import ColumnMap, read_mapped
from msp_range.reading_model.sensor_model import SensorModel
from msp_range.recording.columns import WORD_COLUMNS
from msp_range.recording.csv_form import Column, MeasuredData, read_csv
from msp_range.recording.error import RecordingError
from msp_range.recording.export import measured_data
from msp_range.recording.reader import Recording, is_recording

LEAST_READINGS = 30
"""Fewer readings with a true range than this say nothing that would be worth a file."""
WRONG_UNIT = 0.5
LEAST_NEAR = 0.1
"""Where more than this share of the readings is outside of the sensor's limits, or less than this within a factor of 2
of the truth, they are in another unit or of something else."""


AGAIN = 0.95
"""Of two files of which this share of the smaller one's rows is in both, one was made of the other."""
TEMPERATURES_C = {"air_temperature_c": (-50.0, 65.0), "target_temperature_c": (-50.0, 85.0)}
"""Air that people and sensors stand, and what asphalt in the sun comes to [deg C]."""
CONTEXTS = {
    "humidity_pct": (0.0, 100.0, "per cent of saturation, 0 to 100"),
    "incidence_deg": (-90.0, 90.0, "degrees between beam and normal, -90 to 90"),
    "throttle": (0.0, 1.0, "a share, 0 to 1"),
    "external_duty": (0.0, 1.0, "a share, 0 to 1"),
}
"""Smallest and largest value of a column, and what is expected."""
STUCK_SHARE, STUCK_CM = 0.98, 30.0
"""Of the readings that are one number, while the true range goes over so much: they do not follow it."""


@dataclass(frozen=True)
class Source:
    """A file of readings."""

    name: str
    sha256: str
    rows: int


class Gathered(NamedTuple):
    """Measured data of all files together, the files, and what to know of them."""

    data: MeasuredData
    sources: tuple[Source, ...]
    warnings: tuple[str, ...]
    sensors: tuple[str, ...] = ()


def gather(
    paths: Sequence[Path], sensor: SensorModel, column_map: ColumnMap | None = None, sensors: Sequence[str] = ()
) -> Gathered:
    """Read all files.

    Parameters
    ----------
    paths
        CSV files in the one form, recordings, or with `column_map` other people's tables.
    sensor
        Its limits: readings outside of them are no readings.
    column_map
        Names and units of the columns.
    sensors
        Those whose readings are used, as the column `sensor` names them; none: all.

    Raises
    ------
    RecordingError
        A file cannot be read, is named twice, or the data cannot be characterised from; in a line, with what to do.
    """
    tables: list[MeasuredData] = []
    sources: list[Source] = []
    warnings: list[str] = []
    for path in paths:
        table = read_table(path, sensor, column_map, warnings)
        source = Source(path.name, sha256(path), len(table))
        same = next((p for p, each in zip(paths, sources, strict=False) if each.sha256 == source.sha256), None)
        if same is not None:
            raise RecordingError(f"{path}: has the same content as {same}; each reading may count once")
        if column_map is None:
            _check_not_again(path, table, zip(paths, tables, strict=False))
        tables.append(table)
        sources.append(source)
    data = joined(tables)
    name = ", ".join(str(path) for path in paths)
    if sensors:
        data = _of(name, data, sensors)
    data, more = _within_limits(data, sensor)
    warnings += more
    check_comparable(name, data, sensor)
    if column_map is not None and column_map.note:
        warnings.insert(0, column_map.note)
    return Gathered(data, tuple(sources), tuple(warnings), tuple(sensors))


def _check_not_again(path: Path, table: MeasuredData, before: Iterable[tuple[Path, MeasuredData]]) -> None:
    """Refuse readings that are in an earlier file, as those of a recording are in the table made of it."""
    names = ("time_s", "sensor", "reading_cm", "true_range_cm")
    rows = _rows(table, names)
    for other, earlier in before:
        others = _rows(earlier, names)
        again = len(rows & others)
        if again > AGAIN * min(len(rows), len(others)):
            raise RecordingError(
                f"{path}: {again} of its readings are in {other} too; each may count once, so leave one of them out"
            )


def _rows(table: MeasuredData, names: Sequence[str]) -> set[tuple[object, ...]]:
    # Times to a millisecond: a recording has more digits than a table. Unknown numbers are equal here.
    columns = [
        np.nan_to_num(np.round(table[name], 3), nan=-1.0) if table[name].dtype.kind == "f" else table[name]
        for name in names
        if name in table
    ]
    return set(zip(*(column.tolist() for column in columns), strict=True))


def sha256(path: Path) -> str:
    """Of a file, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def read_table(path: Path, sensor: SensorModel, column_map: ColumnMap | None, warnings: list[str]) -> MeasuredData:
    """Read one file: CSV in the one form, a recording, or with a map someone else's table.

    What of a damaged recording is left out is added to ``warnings``.
    """
    if column_map is not None:
        return read_mapped(path, column_map, sensor.maximum_cm)
    if is_recording(path):
        recording = Recording(path)
        data = measured_data(recording)
        if recording.losses:
            warnings.append(f"{path} is damaged; lost: {recording.losses}")
        return data
    try:
        return read_csv(path)
    except RecordingError as error:
        if "is missing" not in str(error):
            raise
        raise RecordingError(f"{error}; --map NAME=COLUMN tells of columns with other names") from None


def joined(tables: Sequence[MeasuredData]) -> MeasuredData:
    """Tables one after the other; a column that one lacks is unknown there."""
    names = dict.fromkeys(name for table in tables for name in table.columns)
    columns: dict[str, Column] = {}
    for name in names:
        is_word = name in WORD_COLUMNS or any(name in table and table[name].dtype.kind == "U" for table in tables)
        missing = "" if is_word else math.nan
        pieces = [table[name] if name in table else np.full(len(table), missing) for table in tables]
        pieces = [piece.astype(str, copy=False) if is_word else piece for piece in pieces]
        columns[name] = pieces[0] if len(pieces) == 1 else np.concatenate(pieces)
    return MeasuredData(columns)


def _of(name: str, data: MeasuredData, sensors: Sequence[str]) -> MeasuredData:
    there = sorted(set(data["sensor"].tolist()))
    unknown = [each for each in sensors if each not in there]
    if unknown:
        raise RecordingError(f"{name}: no readings of the sensor {unknown[0]!r}; there are some of {', '.join(there)}")
    return data.select(np.flatnonzero(np.isin(data["sensor"], sensors)))


def _within_limits(data: MeasuredData, sensor: SensorModel) -> tuple[MeasuredData, list[str]]:
    """Readings that the sensor cannot make are no answer."""
    reading_cm = data["reading_cm"]
    outside = (reading_cm < sensor.minimum_cm) | (reading_cm > sensor.maximum_cm)
    if not outside.any() or outside.sum() > WRONG_UNIT * (~np.isnan(reading_cm)).sum():
        return data, []
    values = np.unique(reading_cm[outside])
    shown = ", ".join(f"{value:g}" for value in values[:5]) + (" ..." if values.size > 5 else "")
    warning = (
        f"{outside.sum()} readings are outside of the sensor's {sensor.minimum_cm} to {sensor.maximum_cm} cm "
        f"and count as no answer: {shown}"
    )
    columns = dict(data.columns) | {"reading_cm": np.where(outside, math.nan, reading_cm)}
    return MeasuredData(columns), [warning]


def check_comparable(name: str, data: MeasuredData, sensor: SensorModel) -> None:
    """Refuse readings that cannot be compared with a truth: none, hardly any, or in another unit.

    Raises
    ------
    RecordingError
        In a line, with what to do.
    """
    if not len(data):
        raise RecordingError(f"{name}: no readings, only a header")
    if "true_range_cm" not in data or np.isnan(data["true_range_cm"]).all():
        raise RecordingError(
            f"{name}: no true_range_cm, so there is nothing to compare readings with; add the reference's range as a "
            "column, or name the column that it is in with --map true_range_cm=COLUMN"
        )
    for column, (low_c, high_c) in TEMPERATURES_C.items():
        if column in data and ((data[column] < low_c) | (data[column] > high_c)).any():
            raise RecordingError(
                f"{name}: found {column} of {_span(data[column][~np.isnan(data[column])])}, expected deg C from "
                f"{low_c:g} to {high_c:g}. In deg F or K? --map takes a file that says so (unit: F or K)"
            )
    for column, (low, high, expected) in CONTEXTS.items():
        known = data[column][~np.isnan(data[column])] if column in data else np.zeros(0)
        if known.size and (known.min() < low or known.max() > high):
            raise RecordingError(
                f"{name}: found {column} of {_span(known)}, expected {expected}. In another unit? "
                f"--map {column}=COLUMN*FACTOR"
            )
        if known.size and column == "humidity_pct" and 0.0 < known.max() <= 1.0:
            raise RecordingError(
                f"{name}: found {column} of {_span(known)}, expected {expected}. A share? --map {column}=COLUMN*100"
            )
    answered = ~np.isnan(data["reading_cm"])
    usable = answered & ~np.isnan(data["true_range_cm"])
    if usable.sum() < LEAST_READINGS:
        raise RecordingError(
            f"{name}: found {int(usable.sum())} readings with a true range, expected at least {LEAST_READINGS}; "
            "the report took 100 to 20000 a point"
        )
    reading_cm, true_cm = data["reading_cm"][usable], data["true_range_cm"][usable]
    outside = (reading_cm < sensor.minimum_cm) | (reading_cm > sensor.maximum_cm)
    heard = reading_cm != sensor.maximum_cm
    ratios = reading_cm[heard] / np.maximum(true_cm[heard], 1e-9)
    ratio = float(np.median(ratios)) if heard.any() else 1.0
    values, counts = np.unique(reading_cm[heard], return_counts=True)
    if values.size and counts.max() > STUCK_SHARE * counts.sum() and np.ptp(true_cm[heard]) > STUCK_CM:
        raise RecordingError(
            f"{name}: nearly all readings are {values[counts.argmax()]:g} cm while the true range is {_span(true_cm)} "
            "cm: they do not follow it. A sensor or a recording that is stuck?"
        )
    near = ((ratios > 0.5) & (ratios < 2.0)).mean() if heard.any() else 1.0
    if outside.mean() > WRONG_UNIT or near < LEAST_NEAR:
        raise RecordingError(
            f"{name}: readings of {_span(reading_cm)} against true ranges of {_span(true_cm)} (median ratio "
            f"{ratio:.3g}; the sensor reads {sensor.minimum_cm} to {sensor.maximum_cm} cm)."
            + _unit_hint(reading_cm, true_cm, ratio)
        )


def _span(values: Column) -> str:
    return f"{values.min():g} to {values.max():g}"


def _unit_hint(reading_cm: Column, true_cm: Column, ratio: float) -> str:
    for column, is_small in (("reading_cm", ratio), ("true_range_cm", 1.0 / ratio)):
        for unit, factor in (("metres", 0.01), ("inches", 1 / 2.54), ("millimetres", 10.0), ("feet", 1 / 30.48)):
            if 0.8 * factor < is_small < 1.25 * factor:
                return f" Is {column} in {unit}? Then: --map {column}=COLUMN*{1 / factor:g}"
    if float(np.median(true_cm)) < 12.0 and 0.5 < ratio < 2.0:
        return " Are both in metres? Then: --map reading_cm=COLUMN*100 --map true_range_cm=COLUMN*100"
    return (
        " Both have to be centimetres of the same thing, and the sensor model that of the sensor that read; "
        "--map converts."
    )
