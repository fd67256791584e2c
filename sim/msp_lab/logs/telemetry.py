"""A ground station's log of MAVLink messages (.tlog) as a `VehicleLog`.

Before each frame are the microseconds since 1970 at which it arrived, in eight bytes; those are the times here, since
senders have different clocks. Frames of other messages are stepped over by their length; those that matter are decoded
by the bridge's own link. Messages: https://mavlink.io/en/messages/common.html.
"""

import struct
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from msp_lab.logs.fused import by_any, is_estimate
from msp_lab.logs.log import (
    CLIMB,
    RTK_FIXED,
    THROTTLE,
    TILT,
    LoggedFlight,
    LogRequest,
    MessageColumns,
    Ranger,
    Series,
    TruthSource,
    VehicleLog,
    magnitude,
    make_continuous,
    make_log,
    make_ranger,
    truth_source,
)
from msp_range.correction.humidity import HYGROMETER, relative_humidity_percent
from msp_range.input_file import open_input
from msp_range.mavlink.dialect import dialect
from msp_range.mavlink.frames import Frame, FrameReader
from msp_range.mavlink.orientation import DOWN
from msp_range.recording.error import RecordingError
from msp_range.recording.reader import LARGEST_FILE_BYTES
from msp_sim.model.derived import tilt_deg

LATEST_US = 4_000_000_000_000_000
"""Times after the year 2096 are none [us]: the log is damaged there."""
MOST_BAD_BYTES = 2**20
"""After so many bytes in no frame nothing more is read: the log was overwritten there. Each costs a microsecond."""
MOST_BAD_SHARE = 0.5
"""A file of which a larger share is not in frames is no log. A damaged one has a few per cent."""
_BLOCK_BYTES = 2**20
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
    bad, size = 0, 0
    for place, (time_s, frame, read, skipped, size) in enumerate(_frames(path, wanted)):
        asked.progress(read / size)
        bad += skipped
        if frame is None:
            continue
        start_s = time_s if start_s is None else start_s
        decoded = frame.decode()
        sender = (frame.system, frame.component)
        # Zero is a sender without a clock.
        stamp = (time_s - start_s, decoded, place, 1e-3 * getattr(decoded, "time_boot_ms", 0) or np.nan)
        if frame.message_id == dialect.MAVLINK_MSG_ID_DISTANCE_SENSOR:
            key = (*sender, decoded.id)
            distances.setdefault(key, MessageColumns.collecting("DISTANCE_SENSOR", _DISTANCE)).add(*stamp)
        elif frame.message_id == dialect.MAVLINK_MSG_ID_PARAM_VALUE:
            parameters[decoded.param_id] = _parameter(decoded)
        else:
            name = ids[frame.message_id]
            if senders.setdefault(name, sender) == sender:
                flight.setdefault(name, MessageColumns.collecting(name, fields[name])).add(*stamp)
    clock = make_continuous([*distances.values(), *flight.values()])
    if bad > MOST_BAD_SHARE * size:
        raise RecordingError(f"{path}: no telemetry log: {bad} of {size} bytes are in no frame")
    notes = ["Times are those of arrival at the ground station, so lags contain the radio link's."]
    if bad:
        notes.append(f"{bad} bytes that belong to no message are left out.")
    refused = by_any(parameters) if is_estimate(asked.field) else ""
    column = truth_source("column", flight.series(message, field), refused=refused)
    references = [*_references(flight, parameters), column]
    form, rangers = "telemetry log (MAVLink)", _rangers(distances)
    return make_log(path, form, rangers, _context(flight), references, notes, clock)


def _frames(path: Path, wanted: set[int]) -> Iterator[tuple[float, Frame | None, int, int, int]]:
    """Wanted frames with their time [s], the bytes read, the bytes skipped since the last one, and the file's size."""
    try:
        with open_input(path, LARGEST_FILE_BYTES) as file:
            size = file.seek(0, 2)
            file.seek(0)
            rest, skipped = b"", 0
            while block := file.read(_BLOCK_BYTES):
                data = rest + block
                at, end = 0, len(data)
                is_last = file.tell() >= size
                while end - at > _STAMP_BYTES + _LONGEST_FRAME or (is_last and end - at > _STAMP_BYTES + 3):
                    begin = at + _STAMP_BYTES
                    length, message_id = _header(data, begin)
                    stop = begin + length
                    if not length or stop > end or not (stop == end or _is_frame(data, stop, end)):
                        at += 1
                        skipped += 1
                        continue
                    if message_id in wanted:
                        for frame in FrameReader().read(data[begin:stop]):
                            stamp_us = int.from_bytes(data[at:begin], "big")
                            yield stamp_us / 1e6, frame, file.tell(), skipped, size
                            skipped = 0
                    at = stop
                rest = data[at:]
                if skipped > MOST_BAD_BYTES:
                    break
            yield 0.0, None, size, skipped + len(rest) + size - file.tell(), size
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from None


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


def _parameter(message: Any) -> float:
    """A parameter's value: PX4 sends the bytes of an integer in the place of a float, ArduPilot its value."""
    if message.param_id.startswith("EKF2_") and message.param_type in _INTEGER_TYPES:
        number: int = struct.unpack("<i", struct.pack("<f", message.param_value))[0]
        return float(number)
    return float(message.param_value)


def _rangers(distances: Mapping[tuple[int, int, int], MessageColumns]) -> list[Ranger]:
    rangers = []
    numbers = [number for _, _, number in distances]
    for (system, component, number), found in distances.items():
        name = f"distance_sensor_{number}" + (f"_of_{system}_{component}" if numbers.count(number) > 1 else "")
        ranges = found.unsorted("current_distance", found["current_distance"] / 100.0)
        is_down = int(np.median(found["orientation"])) == DOWN
        is_too_near = found["current_distance"] < found["min_distance"]
        # 1 is an invalid signal, 0 an unknown one (common.xml).
        no_answer = found["signal_quality"] == 1
        rangers.append(make_ranger(name, ranges, is_down, found["max_distance"] / 100.0, is_too_near, no_answer))
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
    gps, fixed, std = flight.get("GPS_RAW_INT"), None, None
    if gps is not None and (is_fixed := gps["fix_type"] == RTK_FIXED).any():
        fixed = gps.series("alt", np.where(is_fixed, 0.001 * gps["alt"], np.nan))
        std = flight.series("GPS_RAW_INT", "v_acc", 0.001) if (gps["v_acc"] > 0.0).any() else None
    return [
        truth_source("simulator", flight.series("SIM_STATE", "alt")),
        truth_source("simulator", flight.series("HIL_STATE_QUATERNION", "alt", 0.001)),
        truth_source("rtk", fixed, std=std),
        truth_source("mocap", flight.series("ATT_POS_MOCAP", "z", -1.0)),
        truth_source("mocap", flight.series("VISION_POSITION_ESTIMATE", "z", -1.0)),
        truth_source("ekf", flight.series("GLOBAL_POSITION_INT", "relative_alt", 0.001), refused=by_any(parameters)),
    ]
