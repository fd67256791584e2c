"""A ground station's log of MAVLink messages (.tlog) as a `VehicleLog`.

Its times are those at which frames arrived, since senders have different clocks. Messages:
https://mavlink.io/en/messages/common.html.
"""

import struct
from collections.abc import Mapping
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
from msp_lab.logs.telemetry_frames import TelemetryFrames
from msp_range.arrays import Column
from msp_range.correction.humidity import HYGROMETER, relative_humidity_percent
from msp_range.mavlink.dialect import dialect
from msp_range.mavlink.frames import text_of
from msp_range.recording.error import RecordingError
from msp_sim.model.derived import tilt_deg

MOST_BAD_SHARE = 0.5
"""A file of which a larger share is not in frames is no log. A damaged one has a few per cent."""
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
    if field and (message not in kinds or field not in _numbers(kinds[message])):
        raise RecordingError(f"{path}: MAVLink's common messages have no number {asked.field}")
    distances: dict[tuple[int, int], MessageColumns] = {}
    flight = LoggedFlight()
    senders: dict[str, int] = {}
    parameters: dict[str, float] = {}
    frames = TelemetryFrames({*ids, dialect.MAVLINK_MSG_ID_DISTANCE_SENSOR, dialect.MAVLINK_MSG_ID_PARAM_VALUE})
    for message_id, rows in frames.of(path, asked.progress):
        values = rows["values"]
        if message_id == dialect.MAVLINK_MSG_ID_DISTANCE_SENSOR:
            for key in dict.fromkeys(zip(rows["sender"].tolist(), values["id"].tolist(), strict=True)):
                own = rows[(rows["sender"] == key[0]) & (values["id"] == key[1])]
                _add(distances.setdefault(key, MessageColumns.collecting("DISTANCE_SENSOR", _DISTANCE)), own)
        elif message_id == dialect.MAVLINK_MSG_ID_PARAM_VALUE:
            for text, kind, value in values[["param_id", "param_type", "param_value"]].tolist():
                parameters[text_of(text)] = _parameter(text_of(text), kind, value)
        else:
            name = ids[message_id]
            own = rows[rows["sender"] == senders.setdefault(name, rows["sender"][0])]
            _add(flight.setdefault(name, MessageColumns.collecting(name, fields[name])), own)
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


def _add(columns: MessageColumns, rows: Column) -> None:
    """Add messages of one sender, as `TelemetryFrames` has them."""
    values = rows["values"]
    boot_ms = values["time_boot_ms"] if "time_boot_ms" in (values.dtype.names or ()) else np.zeros(rows.size)
    # Zero is a sender without a clock.
    columns.extend(rows["time_s"], values, rows["place"], np.where(boot_ms != 0, 1e-3 * boot_ms, np.nan))


def _numbers(kind: Any) -> list[str]:
    """The fields of a message that are neither texts nor other arrays."""
    return [name for name, length in zip(kind.ordered_fieldnames, kind.array_lengths, strict=True) if not length]


def _parameter(name: str, kind: int, value: float) -> float:
    """A parameter's value: PX4 sends the bytes of an integer in the place of a float, ArduPilot its value."""
    if name.startswith("EKF2_") and kind in _INTEGER_TYPES:
        number: int = struct.unpack("<i", struct.pack("<f", value))[0]
        return float(number)
    return value


def _rangers(distances: Mapping[tuple[int, int], MessageColumns]) -> list[Ranger]:
    rangers = []
    numbers = [number for _, number in distances]
    for (sender, number), found in distances.items():
        whose = f"_of_{sender // 256}_{sender % 256}" if numbers.count(number) > 1 else ""
        name = f"distance_sensor_{number}{whose}"
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
