"""Which format a log has, by its first bytes and its name, and the reader for it."""

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from msp_lab.readings.dataset import is_dataset
from msp_range.extras import require
from msp_range.input_file import open_input
from msp_range.recording.error import RecordingError
from msp_range.recording.reader import LARGEST_FILE_BYTES

if TYPE_CHECKING:
    from msp_lab.logs.log import VehicleLog
    from msp_lab.readings.column_map import ColumnMap

FORMATS = {
    ".bin": "ArduPilot dataflash log",
    ".ulg": "PX4 ULog",
    ".tlog": "telemetry log of a ground station",
    ".bag": "ROS 1 bag",
    ".db3": "ROS 2 bag",
    ".mcap": "recording of msp-range, or ROS 2 bag",
    ".csv": "CSV table",
}
"""Ending -> what such a file is; a folder with a metadata.yaml is a ROS 2 bag too."""
_READERS = {
    ".bin": ("ardupilot", "read_ardupilot"),
    ".ulg": ("px4", "read_px4"),
    ".tlog": ("telemetry", "read_telemetry"),
    ".bag": ("ros", "read_bag"),
    ".db3": ("ros", "read_bag"),
}
"""Ending -> module of this package, and its function of path, progress and field."""
_ROS_PROFILES = (b"\4\0\0\0ros2", b"\4\0\0\0ros1")
"""How the header of an MCAP file goes on after 8 bytes of magic, the record's kind and its length (mcap.dev/spec)."""
_MAGIC = {b"\xa3\x95": ".bin", b"ULog\x01\x12\x35": ".ulg", b"#ROSBAG V": ".bag", b"\x89MCAP0\r\n": ".mcap"}


def open_log(
    path: Path,
    progress: Callable[[float], None],
    *,
    field: str = "",
    column_map: "ColumnMap | None" = None,
    maximum_cm: float = float("inf"),
) -> "VehicleLog":
    """Read a log of any format.

    Parameters
    ----------
    path
        The file, or the folder of a ROS 2 bag.
    progress
        Called with the share that is read.
    field
        The field that is to be read as a reference, as ``--truth column:`` names it; empty: none.
    column_map
        Columns of a CSV file.
    maximum_cm
        Reading of no echo, for recordings and CSV files; the other formats state it.

    Raises
    ------
    RecordingError
        It cannot be read, or is of no format that is known.
    """
    from msp_lab.logs.recorded import read_recording, read_table

    kind = kind_of(path)
    if kind == ".csv":
        return read_table(path, column_map, maximum_cm)
    if column_map is not None:
        raise RecordingError(f"{path}: --map is for CSV tables, and this is a {FORMATS[kind]}")
    if kind == ".mcap":
        return read_recording(path, maximum_cm)
    require("logs", f"Reading a {FORMATS[kind]}")
    module, function = _READERS[kind]
    log: VehicleLog = getattr(importlib.import_module(f"msp_lab.logs.{module}"), function)(path, progress, field)
    return log


def is_flight_log(path: Path) -> bool:
    """True for a log that has to be imported before its readings can be compared; False also where nothing is there."""
    try:
        return not is_dataset(path) and kind_of(path) not in (".csv", ".mcap")
    except RecordingError:
        return False


def kind_of(path: Path) -> str:
    """The ending that a file of this format has.

    Raises
    ------
    RecordingError
        The format is not known, or the file cannot be read.
    """
    if (path / "metadata.yaml").is_file():
        return ".db3"
    try:
        with open_input(path, LARGEST_FILE_BYTES) as file:
            begins = file.read(64)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from None
    by_content = next((kind for magic, kind in _MAGIC.items() if begins.startswith(magic)), None)
    if by_content == ".mcap" and begins[17:].startswith(_ROS_PROFILES):
        return ".db3"
    suffix = ".csv" if path.name.lower().endswith(".csv.gz") else path.suffix.lower()
    kind = by_content or (suffix if suffix in FORMATS else None)
    if kind is None:
        known = ", ".join(f"{ending} ({what})" for ending, what in FORMATS.items())
        raise RecordingError(f"{path}: no log that is known: it begins with {begins[:8]!r}; known are {known}")
    if not begins:
        raise RecordingError(f"{path}: the file is empty")
    return kind
