"""Our own recordings (MCAP) and CSV tables as a `VehicleLog`: their readings have their context with them already."""

import os
from pathlib import Path

import numpy as np

from msp_lab.logs.log import TILT, Ranger, Series, VehicleLog, series
from msp_lab.readings.clock_runs import with_clock_runs
from msp_lab.readings.column_map import ColumnMap
from msp_lab.readings.column_map import read_table as read_rows
from msp_lab.readings.no_echo import without_negative
from msp_range.arrays import Array
from msp_range.recording.csv_form import MeasuredData
from msp_range.recording.error import RecordingError
from msp_range.recording.export import measured_data
from msp_range.recording.pings import recorded_attitudes
from msp_range.recording.reader import Recording
from msp_sim.model.derived import tilt_deg

LARGEST_RECORDING_BYTES = 200 * 2**20
"""A larger recording of our own is refused: its messages are held as Python objects, some ten times the file. A flight
of an hour with four sensors has 20 MB."""


def read_recording(path: Path, maximum_cm: float) -> VehicleLog:
    """Read a recording of the bridge, of a simulator or of a bench, whose sensors have this reading of no echo.

    Raises
    ------
    RecordingError
        It cannot be read, or is too large.
    """
    recording = Recording(path)
    if os.path.getsize(path) > LARGEST_RECORDING_BYTES:
        raise RecordingError(
            f"{path}: found {os.path.getsize(path) / 1e6:.0f} MB, expected at most {LARGEST_RECORDING_BYTES / 1e6:.0f} "
            "MB for a recording of the bridge; cut it with 'mcap filter --start ... --end ...' and import the parts"
        )
    data = measured_data(recording)
    lost = (f"The file is damaged; lost: {recording.losses}.",) if recording.losses else ()
    angles = recorded_attitudes(recording)
    context = {}
    if angles:
        rows = np.array([(each.time_s, each.roll_rad, each.pitch_rad) for _, each in angles])
        context[TILT] = series("/attitude", rows[:, 0], tilt_deg(rows[:, 1], rows[:, 2]))
    rangers, notes = rangers_of(path, data, maximum_cm)
    # Where a step of the clock began runs, attitudes are on none of their clocks.
    is_one = all(np.unique(each.columns["run"]).size == 1 for each in rangers)
    return VehicleLog(path, "recording of msp-range", rangers, context if is_one else {}, (), (*lost, *notes))


def read_table(path: Path, column_map: ColumnMap | None, maximum_cm: float) -> VehicleLog:
    """Read a CSV file in the project's form, or with a map anybody's.

    Raises
    ------
    RecordingError
        It cannot be read.
    """
    rangers, notes = rangers_of(path, read_rows(path, column_map, maximum_cm), maximum_cm)
    about = (column_map.note,) if column_map is not None and column_map.note else ()
    return VehicleLog(path, "CSV table", rangers, {}, (), (*about, *notes))


def rangers_of(path: Path, data: MeasuredData, code_cm: float) -> tuple[tuple[Ranger, ...], list[str]]:
    """The range finders of a table, each with its rows in the order of time, and their code of no echo; with notes
    on runs that a step of its clock begins and on readings that are codes."""
    if not len(data):
        raise RecordingError(f"{path}: no readings")
    data, notes = with_clock_runs(path, data)
    data, codes = without_negative(data)
    rangers = []
    for name in dict.fromkeys(data["sensor"].tolist()):
        rows = np.flatnonzero(data["sensor"] == name)
        rows = rows[np.argsort(data["time_s"][rows], kind="stable")]
        left_out = {"time_s", "sensor", "reading_cm"}
        columns = {key: column[rows] for key, column in data.columns.items() if key not in left_out}
        reading_cm: Array = data["reading_cm"][rows]
        readings = Series(path.name, data["time_s"][rows], reading_cm)
        rangers.append(Ranger(name, readings, columns=columns, code_cm=code_cm))
    return tuple(rangers), [*notes, *codes]
