"""A ground station's log of MAVLink messages (.tlog) as a `VehicleLog`.

Before each frame are the microseconds since 1970 at which it arrived, in eight bytes; those are the times here, since
senders have different clocks. Frames of other messages are stepped over by their length; those that matter are decoded
by the bridge's own link. Messages: https://mavlink.io/en/messages/common.html.
"""

import struct
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from msp_lab.logs.fused import by_any, is_estimate
from msp_lab.logs.log import (
    CLIMB,
    THROTTLE,
    TILT,
    LoggedFlight,
    LogRequest,
    MessageColumns,
    Ranger,
    Series,
    TruthSource,
    VehicleLog,
    looks_down,
    magnitude,
    make_continuous,
    make_log,
    make_ranger,
    truth_source,
)
from msp_range.correction.humidity import HYGROMETER, relative_humidity_percent
from msp_range.input_file import open_input
from msp_range.mavlink.dialect import dialect
from msp_range.mavlink.frames import Frame, FrameReader, text_of
from msp_range.recording.error import RecordingError
from msp_range.recording.reader import LARGEST_FILE_BYTES
from msp_sim.model.derived import tilt_deg

LATEST_US = 4_000_000_000_000_000
"""Later times are not believed [us], this is in the year 2096: the log is damaged there."""
MOST_BAD_BYTES = 2**20
"""After this many bytes in no frame nothing more is read: the log was overwritten there. Each costs a microsecond."""
MOST_BAD_SHARE = 0.5
"""A file of which a larger share is not in frames is no log. A damaged one has a few per cent."""
_STAMP_BYTES, _LONGEST_FRAME = 8, 280
_VERSION_1, _VERSION_2, _SIGNED = 0xFE, 0xFD, 0x01
_INTEGER_TYPES = range(dialect.MAV_PARAM_TYPE_UINT8, dialect.MAV_PARAM_TYPE_REAL32)

FIELDS: Mapping[str, tuple[str, ...]] = {
    "ATTITUDE": ("roll", "pitch"),
    "GLOBAL_POSITION_INT": ("relative_alt", "vz"),
    "VFR_HUD": ("throttle",),
    "GPS_RAW_INT": ("fix_type", "alt", "v_acc"),
    "SCALED_PRESSURE": ("temperature",),
    "VIBRATION": ("vibration_x", "vibration_y", "vibration_z"),
    HYGROMETER: ("temperature", "humidity"),
    "SIM_STATE": ("alt",),
    "HIL_STATE_QUATERNION": ("alt",),
    "ATT_POS_MOCAP": ("z",),
    "VISION_POSITION_ESTIMATE": ("z",),
}
"""Messages and fields of the flight; those of several components are taken from the first one that sends them."""
_DISTANCE = ("current_distance", "min_distance", "max_distance", "orientation", "signal_quality")


def read_telemetry(path: Path, asked: LogRequest) -> VehicleLog:
    """Read a log; its fields are named ``MESSAGE.field``."""
    message, _, field = asked.field.partition(".")
    fields = dict(FIELDS) | ({message: (*FIELDS.get(message, ()), field)} if field else {})
    kinds = {kind.msgname: kind for kind in dialect.mavlink_map.values() if kind.msgname in fields}
    ids = {kind.id: name for name, kind in kinds.items()}
    if field and (message not in kinds or field not in kinds[message].fieldnames):
        raise RecordingError(f"{path}: MAVLink's common messages have no {asked.field}")
    distances: dict[tuple[int, int, int], MessageColumns] = {}
    flight = LoggedFlight()
    senders: dict[str, tuple[int, int]] = {}
    parameters: dict[str, float] = {}
    wanted = {*ids, dialect.MAVLINK_MSG_ID_DISTANCE_SENSOR, dialect.MAVLINK_MSG_ID_PARAM_VALUE}
    start_s: float | None = None
    frames = _Frames(wanted)
    for place, (time_s, frame) in enumerate(frames.of(path, asked.progress)):
        start_s = time_s if start_s is None else start_s
        decoded = frame.decode()
        sender = (frame.system, frame.component)
        # Zero is a sender without a clock.
        stamp = (time_s - start_s, decoded, place, 1e-3 * getattr(decoded, "time_boot_ms", 0) or np.nan)
        if frame.message_id == dialect.MAVLINK_MSG_ID_DISTANCE_SENSOR:
            key = (*sender, decoded.id)
            distances.setdefault(key, MessageColumns.collecting("DISTANCE_SENSOR", _DISTANCE)).add(*stamp)
        elif frame.message_id == dialect.MAVLINK_MSG_ID_PARAM_VALUE:
            name = text_of(decoded.param_id)
            parameters[name] = _parameter(name, decoded)
        else:
            kind = ids[frame.message_id]
            if senders.setdefault(kind, sender) == sender:
                flight.setdefault(kind, MessageColumns.collecting(kind, fields[kind])).add(*stamp)
    clock = make_continuous([*distances.values(), *flight.values()])
    if frames.bad_bytes > MOST_BAD_SHARE * frames.size:
        raise RecordingError(f"{path}: no telemetry log: {frames.bad_bytes} of {frames.size} bytes are in no frame")
    notes = ["Times are those of arrival at the ground station, so lags contain the radio link's."]
    if frames.bad_bytes:
        notes.append(f"{frames.bad_bytes} bytes that belong to no message are left out.")
    refused = by_any(parameters) if is_estimate(asked.field) else ""
    column = truth_source("column", flight.series(message, field), refused=refused)
    references = [*_references(flight, parameters), column]
    form, rangers = "telemetry log (MAVLink)", _rangers(distances)
    return make_log(path, form, rangers, _context(flight), references, notes, clock)


class _Frames:
    """The frames of a log with one of these messages, and how many bytes of how many are in no frame."""

    def __init__(self, wanted: set[int]) -> None:
        self._wanted = wanted
        self.bad_bytes = self.size = 0

    def of(self, path: Path, progress: Callable[[float], None]) -> Iterator[tuple[float, Frame]]:
        """Wanted frames with their time [s]."""
        with open_input(path, LARGEST_FILE_BYTES) as file:
            self.size = file.seek(0, 2)
            file.seek(0)
            rest, skipped = b"", 0
            while skipped <= MOST_BAD_BYTES and (block := file.read(2**20)):
                data = rest + block
                at, end = 0, len(data)
                is_last = file.tell() >= self.size
                while end - at > _STAMP_BYTES + _LONGEST_FRAME or (is_last and end - at > _STAMP_BYTES + 3):
                    begin = at + _STAMP_BYTES
                    length, message_id = _header(data, begin)
                    stop = begin + length
                    if not length or stop > end or not (stop == end or _is_frame(data, stop, end)):
                        at += 1
                        skipped += 1
                        self.bad_bytes += 1
                        continue
                    if message_id in self._wanted:
                        for frame in FrameReader().read(data[begin:stop]):
                            yield int.from_bytes(data[at:begin], "big") / 1e6, frame
                            skipped = 0
                    at = stop
                rest = data[at:]
                progress(file.tell() / self.size)
            self.bad_bytes += len(rest) + self.size - file.tell()


def _header(data: bytes, begin: int) -> tuple[int, int]:
    """Length of the frame that begins here and its message; length 0: none does."""
    if data[begin] == _VERSION_2 and begin + 10 <= len(data):
        signature = 13 * (data[begin + 2] & _SIGNED)
        return 12 + data[begin + 1] + signature, int.from_bytes(data[begin + 7 : begin + 10], "little")
    if data[begin] == _VERSION_1 and begin + 6 <= len(data):
        return 8 + data[begin + 1], data[begin + 5]
    return 0, -1


def _is_frame(data: bytes, at: int, end: int) -> bool:
    """Whether a time and the first byte of a frame follow, as far as they are here."""
    begin = at + _STAMP_BYTES
    if begin >= end:
        return True
    return data[begin] in (_VERSION_1, _VERSION_2) and int.from_bytes(data[at:begin], "big") < LATEST_US


def _parameter(name: str, message: Any) -> float:
    """A parameter's value: PX4 sends the bytes of an integer in the place of a float, ArduPilot its value."""
    if name.startswith("EKF2_") and message.param_type in _INTEGER_TYPES:
        number: int = struct.unpack("<i", struct.pack("<f", message.param_value))[0]
        return float(number)
    return float(message.param_value)


def _rangers(distances: Mapping[tuple[int, int, int], MessageColumns]) -> list[Ranger]:
    rangers = []
    numbers = [number for _, _, number in distances]
    for (system, component, number), found in distances.items():
        name = f"distance_sensor_{number}" + (f"_of_{system}_{component}" if numbers.count(number) > 1 else "")
        ranges = found.unsorted("current_distance", found["current_distance"] / 100.0)
        is_too_near = found["current_distance"] < found["min_distance"]
        # 1 is an invalid signal, 0 an unknown one (common.xml).
        no_answer = found["signal_quality"] == 1
        is_down, maximum_m = looks_down(found["orientation"]), found["max_distance"] / 100.0
        rangers.append(make_ranger(name, ranges, is_down, maximum_m, is_too_near, no_answer))
    return rangers


def _context(flight: LoggedFlight) -> dict[str, Series | None]:
    return {
        TILT: flight.combined("ATTITUDE", ("roll", "pitch"), tilt_deg),
        "vibration_m_s2": flight.combined("VIBRATION", FIELDS["VIBRATION"], magnitude),
        CLIMB: flight.series("GLOBAL_POSITION_INT", "vz", -0.01),
        THROTTLE: flight.series("VFR_HUD", "throttle", 0.01),
        "air_temperature_c": flight.series(HYGROMETER, "temperature", 0.01),
        "board_temperature_c": flight.series("SCALED_PRESSURE", "temperature", 0.01),
        "humidity_pct": flight.combined(HYGROMETER, ("humidity",), relative_humidity_percent, "humidity"),
    }


def _references(flight: LoggedFlight, parameters: Mapping[str, float]) -> list[TruthSource | None]:
    std = flight.series("GPS_RAW_INT", "v_acc", 0.001)
    if std is not None and not (std.values > 0.0).any():
        std = None  # zero is not known
    return [
        truth_source("simulator", flight.series("SIM_STATE", "alt")),
        truth_source("simulator", flight.series("HIL_STATE_QUATERNION", "alt", 0.001)),
        truth_source("rtk", flight.fixed("GPS_RAW_INT", "fix_type", "alt", 0.001), std=std),
        truth_source("mocap", flight.series("ATT_POS_MOCAP", "z", -1.0)),
        truth_source("mocap", flight.series("VISION_POSITION_ESTIMATE", "z", -1.0)),
        truth_source("ekf", flight.series("GLOBAL_POSITION_INT", "relative_alt", 0.001), refused=by_any(parameters)),
    ]
