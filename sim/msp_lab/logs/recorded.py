"""Our own recordings (MCAP) and CSV tables as a `VehicleLog`: their readings have their context with them already."""

import os
from pathlib import Path

import numpy as np

from msp_lab.logs.log import TILT, LogRequest, Ranger, Series, VehicleLog, make_log, series
from msp_lab.readings.intake import read_file
from msp_range.recording.csv_form import MeasuredData
from msp_range.recording.error import RecordingError
from msp_range.recording.pings import recorded_attitudes
from msp_range.recording.reader import is_recording
from msp_sim.model.derived import tilt_deg

LARGEST_RECORDING_BYTES = 200 * 2**20
"""A larger recording of our own is refused: its messages are held as Python objects, some ten times the file. A flight
of an hour with four sensors has 20 MB."""


def read_rows(path: Path, asked: LogRequest) -> VehicleLog:
    """Read a recording of the bridge, of a simulator or of a bench, or a CSV file.

    Raises
    ------
    RecordingError
        It cannot be read, or is too large.
    """
    largest_mb, found_mb = LARGEST_RECORDING_BYTES / 1e6, os.path.getsize(path) / 1e6
    if found_mb > largest_mb and is_recording(path):
        raise RecordingError(
            f"{path}: found {found_mb:.0f} MB, expected at most {largest_mb:.0f} MB for a recording of the bridge; cut "
            "it with 'mcap filter --start ... --end ...' and import the parts"
        )
    data, recording, notes = read_file(path, asked.column_map, asked.maximum_cm)
    rangers = rangers_of(path, data, asked.maximum_cm)
    if recording is None:
        about = [asked.column_map.note] if asked.column_map is not None and asked.column_map.note else []
        return make_log(path, "CSV table", rangers, {}, (), [*about, *notes], ())
    context = {}
    angles = recorded_attitudes(recording)
    # Where a step of the clock began runs, attitudes are on none of their clocks.
    if angles and all(np.unique(ranger.columns["run"]).size == 1 for ranger in rangers):
        rows = np.array([(each.time_s, each.roll_rad, each.pitch_rad) for _, each in angles])
        context[TILT] = series("/attitude", rows[:, 0], tilt_deg(rows[:, 1], rows[:, 2]))
    return make_log(path, "recording of msp-range", rangers, context, (), notes, ())


def rangers_of(path: Path, data: MeasuredData, code_cm: float) -> list[Ranger]:
    """The range finders of a table, each with its rows in the order of time, and their code of no echo."""
    if not len(data):
        raise RecordingError(f"{path}: no readings")
    rangers = []
    for name in dict.fromkeys(data["sensor"].tolist()):
        rows = np.flatnonzero(data["sensor"] == name)
        own = data.select(rows[np.argsort(data["time_s"][rows], kind="stable")])
        readings = Series(path.name, own["time_s"], own["reading_cm"])
        columns = own.without("time_s", "sensor", "reading_cm").columns
        rangers.append(Ranger(name, readings, columns=columns, code_cm=code_cm))
    return rangers
