"""Geometry of the vehicle that made a recording: where its sensors are, and how it was turned at each time.

A recording has a `Mounting`; the sensors of a table, which has none, count as side by side. Each run gets the other
sensors as its reference.
"""

from collections import deque
from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np

from msp_lab.readings.others import Mounting, Referenced, side_by_side, with_others_as_reference
from msp_range.arrays import Array
from msp_range.fusion.attitude import AttitudeTrack
from msp_range.fusion.mounting import DownwardSensor
from msp_range.geometry import Matrix
from msp_range.recording.csv_form import MeasuredData, join_tables
from msp_range.recording.error import RecordingError
from msp_range.recording.pings import recorded_attitudes
from msp_range.recording.reader import Recording
from msp_sim.model.model import Model

AFTER_S = 0.1
"""Attitudes received up to this long after an echo are used for it [s]: at the usual 10 Hz the next one is. A shorter
time extrapolates, a longer one does no harm."""


def mounting_of(recording: Recording) -> Mounting | None:
    """The downward sensors of the airframe that is in a recording, and its attitudes; None without an airframe.

    Ranges are perpendicular to the ground, as ``true_range_cm`` is; what a canted sensor reads is an effect.
    """
    if not recording.files:
        return None
    # Airframes and the protocol that they name take a quarter of a second, which a table does without.
    from msp_range.config import load_airframe_from

    airframe = load_airframe_from(recording.files, recording.path)
    sensors = {
        sensor.name: DownwardSensor(sensor.position_m, sensor.boresight, "nearest") for sensor in airframe.downward
    }
    attitudes, track = deque(recorded_attitudes(recording)), AttitudeTrack()

    def rotations(time_s: Array) -> Sequence[Matrix | None]:
        found = []
        for at_s in time_s.tolist():
            while attitudes and attitudes[0][0] <= at_s + AFTER_S:
                track.update(attitudes.popleft()[1])
            found.append(track.rotation_at(at_s))
        return found

    return Mounting(sensors, rotations)


def others_as_reference(
    path: Path, data: MeasuredData, recording: Recording | None, model: Model, without: Collection[str]
) -> tuple[MeasuredData, list[Referenced]]:
    """A file's readings with the other sensors of each run as reference, and the same run by run.

    Parameters
    ----------
    path
        The file, for messages.
    data
        Its readings.
    recording
        The recording that they are from, with the vehicle's geometry; None: the sensors are side by side.
    model, without
        As for `with_others_as_reference`.

    Raises
    ------
    RecordingError
        Too few sensors look down.
    """
    mounting = None if recording is None else mounting_of(recording)
    if mounting is None:
        mounting = side_by_side(set(data["sensor"].tolist()))
    run = data.column("run")
    try:
        parts = [
            with_others_as_reference(data.select(np.flatnonzero(run == one)), model, mounting, without)
            for one in dict.fromkeys(run.tolist())
        ]
    except RecordingError as error:
        raise RecordingError(f"{path}: {error}") from None
    return join_tables([part.data for part in parts]), parts
