"""A log format: lines of time [s], range [m] and height above the ground by a laser [m]."""

from pathlib import Path

import numpy as np

from msp_lab.logs.log import LogFormat, LogRequest, MessageColumns, VehicleLog, make_log, make_ranger, truth_source
from msp_range.recording.error import RecordingError

PILOT_LOG = LogFormat("log of the pilot's box", ".pilot", "sonar_extras.pilot_log:read_pilot_log", b"PILOT 1\n")


def read_pilot_log(path: Path, asked: LogRequest) -> VehicleLog:
    """Read a log, all at once."""
    if not path.read_bytes().startswith(b"PILOT 1\n"):
        raise RecordingError(f"{path}: no log of the pilot's box: its first line is not PILOT 1")
    try:
        time_s, range_m, height_m = np.loadtxt(path, skiprows=1, ndmin=2).T
    except (OSError, ValueError) as error:
        raise RecordingError(f"{path}: no log of the pilot's box: {error}") from None
    asked.progress(1.0)
    box = MessageColumns("box", {"range": range_m, "height": height_m}, time_s)
    nothing = np.zeros(time_s.size, dtype=bool)
    ranger = make_ranger("down", box.unsorted("range", range_m), True, np.array([7.65]), range_m < 0.2, nothing)
    references = [truth_source("mocap", box.series("height"))]
    if asked.field == "box.height":
        references.append(truth_source("column", box.series("height")))
    return make_log(path, "log of the pilot's box", [ranger], {}, references)
