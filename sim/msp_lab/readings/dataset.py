"""A dataset of readings: a folder of Parquet files, one for each run and sensor, and what is known of their origin.

``DIR/run=NAME/sensor=NAME/readings.parquet`` holds the columns of the CSV form; names of runs and sensors are in the
folders, where pyarrow, pandas, polars, DuckDB and Spark look for them. ``DIR/dataset.json`` says of each run which file
it is from and what was found there. Only the files and columns that are asked for are read.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote

import numpy as np

from msp_range.arrays import Column
from msp_range.extras import require
from msp_range.input_file import read_text
from msp_range.recording.csv_form import MeasuredData, join_tables
from msp_range.recording.error import RecordingError, new_file

ORIGIN = "dataset.json"
READINGS = "readings.parquet"
_MOST_ORIGIN_BYTES = 64 * 2**20


def is_dataset(path: Path) -> bool:
    """True for a folder that `record_runs` has made."""
    return (path / ORIGIN).is_file()


def origin(folder: Path) -> dict[str, Any]:
    """What a dataset says of its runs, by name; empty where there is none yet.

    Raises
    ------
    RecordingError
        The file is damaged.
    """
    if not is_dataset(folder):
        return {}
    try:
        found = json.loads(read_text(folder / ORIGIN, _MOST_ORIGIN_BYTES))
        runs = found["runs"]
        assert isinstance(runs, dict)
    except (OSError, ValueError, KeyError, TypeError, AssertionError):
        raise RecordingError(f"{folder / ORIGIN}: cannot be read; import the logs again into a new folder") from None
    return runs


def write_tables(folder: Path, run: str, tables: Mapping[str, MeasuredData]) -> None:
    """Write the readings of a run, which is part of the dataset when `record_runs` has listed it.

    Parameters
    ----------
    folder
        The dataset.
    run
        Name of the run.
    tables
        Sensor -> its readings; columns ``run`` and ``sensor`` are not needed.

    Raises
    ------
    RecordingError
        A file cannot be written.
    """
    require("logs", "A dataset of readings")
    import pyarrow as pa
    import pyarrow.parquet as pq

    for sensor, table in tables.items():
        place = folder / f"run={quote(run, safe='')}" / f"sensor={quote(sensor, safe='')}"
        columns = {
            name: pa.array(column, from_pandas=column.dtype.kind == "f")
            for name, column in table.without("run", "sensor").columns.items()
        }
        with new_file(place / READINGS, replacing=True) as unfinished:
            place.mkdir(parents=True, exist_ok=True)
            pq.write_table(pa.table(columns), unfinished, compression="zstd")


def check_new(folder: Path, names: Sequence[str]) -> dict[str, Any]:
    """Return what a dataset says of its runs; RecordingError if it has one of these names already."""
    runs = origin(folder)
    for run in names:
        if run in runs:
            raise RecordingError(
                f"{folder}: there is a run {run!r} already, of {runs[run].get('file')}; use another --out"
            )
    return runs


def record_runs(folder: Path, about: Mapping[str, Mapping[str, Any]]) -> None:
    """List runs in a dataset, which is made where there is none; one call after the other, as each rewrites the list.

    Parameters
    ----------
    folder
        The dataset.
    about
        Name of each run -> what ``dataset.json`` is to say of it.

    Raises
    ------
    RecordingError
        There is such a run already, or the file cannot be written.
    """
    runs = check_new(folder, list(about))
    with new_file(folder / ORIGIN, replacing=True) as unfinished:
        unfinished.write_text(json.dumps({"runs": {**runs, **about}}, indent=2), encoding="utf-8")


def read_dataset(folder: Path, runs: Sequence[str] = ()) -> MeasuredData:
    """The readings of a dataset, run by run and sensor by sensor.

    Parameters
    ----------
    folder
        The dataset.
    runs
        Those that are read; none: all.

    Raises
    ------
    RecordingError
        A file is missing or damaged, or there is no reading.
    """
    require("logs", "A dataset of readings")
    import pyarrow as pa
    import pyarrow.parquet as pq

    tables: list[MeasuredData] = []
    for run, sensor, path in _files(folder):
        if runs and run not in runs:
            continue
        try:
            read = pq.read_table(path, partitioning=None)
        except (OSError, pa.ArrowException) as error:
            reason = str(error).splitlines()[0]
            raise RecordingError(f"{path}: cannot be read: {reason}; import the log again") from None
        found: dict[str, Column] = {"run": np.full(len(read), run), "sensor": np.full(len(read), sensor)}
        for name in read.column_names:
            values = read[name].to_numpy()
            found[name] = values.astype(float) if values.dtype.kind in "fiub" else np.array(values.tolist(), dtype=str)
        if not {"time_s", "reading_cm"} <= set(found):
            raise RecordingError(f"{path}: no time_s and reading_cm; import the log again")
        tables.append(MeasuredData(found))
    if not tables:
        raise RecordingError(f"{folder}: no readings")
    return join_tables(tables)


def sensors_by_run(folder: Path) -> dict[str, list[str]]:
    """The sensors of each run."""
    found: dict[str, list[str]] = {}
    for run, sensor, _ in _files(folder):
        found.setdefault(run, []).append(sensor)
    return found


def _files(folder: Path) -> Iterator[tuple[str, str, Path]]:
    """Run, sensor and file of the runs that are whole: an interrupted import leaves files without an entry."""
    runs = {f"run={quote(run, safe='')}": run for run in origin(folder)}
    for path in sorted(path for place in runs for path in (folder / place).glob(f"sensor=*/{READINGS}")):
        yield runs[path.parts[-3]], unquote(path.parts[-2].partition("=")[2]), path
