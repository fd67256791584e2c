"""Which format a log has, by its first bytes and its name, and the reader for it."""

import pkgutil
from collections.abc import Iterator
from pathlib import Path

from msp_lab.logs.log import LogFormat, LogRequest, VehicleLog
from msp_lab.readings.dataset import is_dataset
from msp_range.extras import require
from msp_range.input_file import open_input
from msp_range.plugins import installed, load_entry
from msp_range.recording.error import RecordingError
from msp_range.recording.reader import LARGEST_FILE_BYTES
from msp_range.yaml_file import ConfigError

GROUP = "msp_lab.logs"
"""Entry points of formats of other packages, each a `LogFormat`."""
ROS_2 = LogFormat("ROS 2 bag", ".db3", "msp_lab.logs.ros:read_bag")
RECORDING = LogFormat(
    "recording of msp-range, or ROS 2 bag",
    ".mcap",
    "msp_lab.logs.recorded:read_rows",
    b"\x89MCAP0\r\n",
    is_flight=False,
)
TABLE = LogFormat("CSV table", ".csv", "msp_lab.logs.recorded:read_rows", is_flight=False)
FORMATS = (
    LogFormat("ArduPilot dataflash log", ".bin", "msp_lab.logs.ardupilot:read_ardupilot", b"\xa3\x95"),
    LogFormat("PX4 ULog", ".ulg", "msp_lab.logs.px4:read_px4", b"ULog\x01\x12\x35"),
    LogFormat("telemetry log of a ground station", ".tlog", "msp_lab.logs.telemetry:read_telemetry"),
    LogFormat("ROS 1 bag", ".bag", "msp_lab.logs.ros:read_bag", b"#ROSBAG V"),
    ROS_2,
    RECORDING,
    TABLE,
)
"""Formats that need no other package; a folder with a metadata.yaml is a ROS 2 bag too."""
_ROS_PROFILES = (b"\4\0\0\0ros2", b"\4\0\0\0ros1")
"""How the header of an MCAP file goes on after 8 bytes of magic, the record's kind and its length (mcap.dev/spec)."""


def open_log(path: Path, asked: LogRequest | None = None) -> VehicleLog:
    """Read a log of any format, a file or the folder of a ROS 2 bag, with what is asked of its reader.

    Raises
    ------
    RecordingError
        It cannot be read, or is of no format that is known.
    """
    asked = asked or LogRequest()
    found = format_of(path)
    if asked.column_map is not None and found is not TABLE:
        raise RecordingError(f"{path}: --map is for CSV tables, and this is a {found.what}")
    if found.is_flight:
        require("logs", f"Reading a {found.what}")
    try:
        log: VehicleLog = pkgutil.resolve_name(found.reader)(path, asked)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from None
    return log


def is_flight_log(path: Path) -> bool:
    """True for a log that has to be imported before its readings can be compared; False also where nothing is there."""
    try:
        return not is_dataset(path) and format_of(path).is_flight
    except RecordingError:
        return False


def format_of(path: Path) -> LogFormat:
    """The format of a log.

    Raises
    ------
    RecordingError
        It is not known, or the file cannot be read.
    """
    if (path / "metadata.yaml").is_file():
        return ROS_2
    try:
        with open_input(path, LARGEST_FILE_BYTES) as file:
            begins = file.read(64)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from None
    ending = ".csv" if path.name.lower().endswith(".csv.gz") else path.suffix.lower()
    known: list[LogFormat] = []
    unusable: list[str] = []
    for form in _formats(unusable):
        known.append(form)
        if form.begins and begins.startswith(form.begins):
            return ROS_2 if form is RECORDING and begins[17:].startswith(_ROS_PROFILES) else form
    found = next((form for form in known if form.ending == ending), None)
    if found is None:
        listed = ", ".join(f"{form.ending} ({form.what})" for form in known)
        words = f"no log that is known: it begins with {begins[:8]!r}; known are {listed}"
        raise RecordingError("; ".join([f"{path}: {words}", *unusable]))
    if not begins:
        raise RecordingError(f"{path}: the file is empty")
    return found


def _formats(unusable: list[str]) -> Iterator[LogFormat]:
    """All formats, those of other packages last; what is wrong with one that cannot be used is added to the list."""
    yield from FORMATS
    for entry in installed(GROUP).values():
        try:
            yield load_entry(entry, "log format", LogFormat)
        except ConfigError as error:
            unusable.append(str(error))
