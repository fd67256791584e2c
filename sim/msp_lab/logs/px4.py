"""A PX4 ULog (.ulg) as a `VehicleLog`.

What topics hold: https://docs.px4.io/main/en/msg_docs/. Whether EKF2 fuses the range into its height is in its flags
(estimator_status_flags.cs_rng_hgt, in old versions a bit of estimator_status.control_mode_flags); where they are
missing its parameters say whether it may. Its height above the terrain (dist_bottom) is not used: it is the range
finder's wherever there is one.
"""

import contextlib
import functools
import struct
from array import array
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from pyulog import ULog
from pyulog.core import ULogException

from msp_lab.logs.fused import by_px4, is_estimate
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
    make_continuous,
    make_log,
    make_ranger,
    rounded_cm,
    tilt_of_quaternion_deg,
    truth_source,
)
from msp_range.arrays import Array, Column
from msp_range.input_file import open_input
from msp_range.mavlink.orientation import DOWN
from msp_range.recording.error import RecordingError

_RANGE_HEIGHT_BIT = 10
"""Bit of estimator_status.control_mode_flags: the range is fused as height (EstimatorStatus.msg, CS_RNG_HGT)."""
_THRUST = "control[3]"
"""Field of actuator_controls_0, before there was vehicle_thrust_setpoint: the collective thrust, 0 to 1."""
_DEFAULT_TEMPERATURE = 0
"""vehicle_air_data.temperature_source: no thermometer, 15 deg C are assumed."""
LARGEST_BYTES = 4 * 2**30
"""A larger log is refused: pyulog reads it message by message, 15 MB a second."""

_TOPICS = [
    "distance_sensor",
    "vehicle_attitude",
    "vehicle_local_position",
    "vehicle_local_position_groundtruth",
    "estimator_status_flags",
    "estimator_status",
    "vehicle_gps_position",
    "vehicle_visual_odometry",
    "vehicle_mocap_odometry",
    "vehicle_air_data",
    "vehicle_thrust_setpoint",
    "actuator_controls_0",
    "vehicle_imu_status",
]
MOST_AFTER = 0.5
"""A height is refused if more of it than this share is after the range was first fused. Higher: a reference that
ends after the take-off; lower: logs in which only a landing is fused are refused as a whole. Chosen by judgement."""
MOST_READ = 20
"""A file is given up after this many times its size was read: where its definitions are cut, pyulog goes back without
end. A damaged file is searched a few times over."""
_EVERY_BYTES = 2**20


def read_px4(path: Path, asked: LogRequest) -> VehicleLog:
    """Read a log; its fields are named ``topic.field``."""
    topic, dot, _ = asked.field.partition(".")
    try:
        # pyulog prints what it leaves out; what is lost is in its attributes too.
        with open_input(path, LARGEST_BYTES) as file, contextlib.redirect_stdout(None):
            log = _InOrder(_Watched(file, asked.progress), [*_TOPICS, *([topic] if dot else [])])
    except (TypeError, ValueError, KeyError, IndexError, struct.error, ULogException, _ReadWithoutEnd) as error:
        raise RecordingError(f"{path}: no ULog, or damaged at its beginning: {error}") from None
    asked.progress(1.0)
    try:
        return _log(path, log, asked.field)
    except KeyError as error:
        raise RecordingError(f"{path}: damaged at its beginning: a topic has no field {error}") from None


def _log(path: Path, log: ULog, named_field: str) -> VehicleLog:
    """What was read, as a `VehicleLog`; raises KeyError where a topic lacks a field that every version has."""
    topic, _, field = named_field.partition(".")
    topics = []
    for each in log.data_list:
        name = each.name if each.multi_id == 0 else f"{each.name}[{each.multi_id}]"
        # A topic that is added again has lost its messages before.
        place = np.array(log.places[each.msg_id])[-each.data["timestamp"].size :]
        topics.append(messages_of(name, each.data, place))
    clock = make_continuous(topics)
    flight = LoggedFlight({columns.source: columns for columns in topics})
    parameters = log.initial_parameters | {name: value for _, name, value in log.changed_parameters}
    context = {
        TILT: flight.combined("vehicle_attitude", ("q[1]", "q[2]"), tilt_of_quaternion_deg, "q"),
        CLIMB: flight.series("vehicle_local_position", "vz", -1.0),
        THROTTLE: _throttle(flight),
        "air_temperature_c": _air_temperature(flight),
        "vibration_m_s2": flight.series("vehicle_imu_status", "accel_vibration_metric"),
    }
    column, refused = flight.series(topic, field), ""
    if is_estimate(named_field):
        column, refused = _without_fused(column, flight, parameters)
    references = [*_references(flight, parameters), truth_source("column", column, refused=refused)]
    notes = []
    if log.file_corruption:
        notes.append("The file is damaged; what could be read is here.")
    if log.dropouts:
        lost_s = sum(dropout.duration for dropout in log.dropouts) / 1e3
        notes.append(f"The logger dropped messages {len(log.dropouts)} times, for {lost_s:.3g} s in all.")
    return make_log(path, f"PX4 ULog, {_version(log)}", _rangers(flight), context, references, notes, clock)


def messages_of(name: str, data: Mapping[str, Column], place: Column) -> MessageColumns:
    """A topic's messages, with the times of the satellites, which are next to the log's own, as the other clock."""
    stamp_s = data["timestamp"] / 1e6
    utc_us = data.get("time_utc_usec", np.zeros(place.size))
    # When it was measured, where all messages of the topic have that next to when they were published.
    sampled_us = data.get("timestamp_sample", np.zeros(1))
    before_s = stamp_s - sampled_us / 1e6 if (sampled_us > 0).all() else 0.0
    return MessageColumns(name, data, stamp_s, place, np.where(utc_us > 0, utc_us / 1e6, np.nan), before_s)


class _InOrder(ULog):  # type: ignore[misc]
    """A log that knows in which order the messages of its topics were written."""

    @functools.cached_property
    def places(self) -> "dict[int, array[int]]":
        """Places of the messages by the topic's number."""
        return defaultdict(lambda: array("q"))

    class _MessageData(ULog._MessageData):  # type: ignore[misc]
        _count = 0

        def initialize(self, data: bytes, header: Any, subscriptions: Any, log: Any) -> bool:
            """Keep a message, as of pyulog, and its place."""
            is_corrupt: bool = super().initialize(data, header, subscriptions, log)
            self._count += 1
            number = int.from_bytes(data[:2], "little")
            if not is_corrupt and number in subscriptions:
                log.places[number].append(self._count)
            return is_corrupt


class _ReadWithoutEnd(Exception):
    """pyulog goes back in the file again and again."""


class _Watched:
    """A file that reports how far it is read, and raises where it is read without end."""

    def __init__(self, file: BinaryIO, progress: Callable[[float], None]) -> None:
        self._file = file
        self._progress = progress
        self._size = file.seek(0, 2)
        file.seek(0)
        self._read = self._next = 0
        self.seek, self.tell, self.close = file.seek, file.tell, file.close

    def read(self, size: int = -1) -> bytes:
        """Read, as of the file."""
        content = self._file.read(size)
        # Reading at the end counts too.
        self._read += len(content) + 1
        if self._read > self._next:
            self._next = self._read + _EVERY_BYTES
            self._progress(min(1.0, self._read / max(self._size, 1)))
            if self._read > MOST_READ * (self._size + _EVERY_BYTES):
                raise _ReadWithoutEnd("its definitions are read again and again")
        return content


def _rangers(flight: LoggedFlight) -> list[Ranger]:
    rangers = []
    for name, data in flight.items():
        if name.startswith("distance_sensor"):
            is_down = looks_down(data.get("orientation", DOWN))
            ranges = data.unsorted("current_distance", data["current_distance"])
            is_too_near = rounded_cm(ranges.values) < rounded_cm(data.get("min_distance", 0.0))
            # Zero is an invalid signal, -1 an unknown one (DistanceSensor.msg).
            no_answer = data.get("signal_quality", -1.0) == 0
            plain_name = name.replace("[", "_").rstrip("]")
            rangers.append(make_ranger(plain_name, ranges, is_down, data["max_distance"], is_too_near, no_answer))
    return rangers


def _references(flight: LoggedFlight, parameters: Mapping[str, Any]) -> list[TruthSource | None]:
    height, refused = _without_fused(flight.series("vehicle_local_position", "z", -1.0), flight, parameters)
    return [
        truth_source("simulator", flight.series("vehicle_local_position_groundtruth", "z", -1.0)),
        # Millimetres before 1.14.
        truth_source(
            "rtk",
            flight.fixed("vehicle_gps_position", "fix_type", "altitude_msl_m")
            or flight.fixed("vehicle_gps_position", "fix_type", "alt", 1e-3),
            std=flight.series("vehicle_gps_position", "epv"),
        ),
        *(
            truth_source("mocap", flight.series(topic, "position[2]", -1.0) or flight.series(topic, "z", -1.0))
            for topic in ("vehicle_mocap_odometry", "vehicle_visual_odometry")
        ),
        truth_source("ekf", height, refused=refused),
        truth_source("barometer", flight.series("vehicle_air_data", "baro_alt_meter")),
    ]


def _without_fused(
    height: Series | None, flight: LoggedFlight, parameters: Mapping[str, Any]
) -> tuple[Series | None, str]:
    """EKF2's height until the range is first fused into it, and why it is refused where that is most of the log."""
    if height is None:
        return None, ""
    flags = flight.series("estimator_status_flags", "cs_rng_hgt") or _range_height_bit(flight)
    if flags is None or not len(flags):
        return height, by_px4(parameters)
    # Flags are logged when they change, and once a second.
    before = np.clip(np.searchsorted(flags.time_s, height.time_s, side="right") - 1, 0, None)
    fused = flags.values[before] != 0
    # What was fused once stays in the height, and a bias of the barometer learnt from it too.
    after = np.maximum.accumulate(fused)
    if after.mean() > MOST_AFTER:
        share, first_s = 100.0 * float(fused.mean()), float(height.time_s[after.argmax()] - height.time_s[0])
        name = flags.source.removeprefix("estimator_status_flags.")
        return (
            height,
            f"{name} is set for {share:.0f} % of the time, so the range is fused into it from {first_s:.0f} s on",
        )
    return replace(height, values=np.where(after, np.nan, height.values)), ""


def _range_height_bit(flight: LoggedFlight) -> Series | None:
    """The flag of versions whose logs have all flags in one number."""
    flags = flight.series("estimator_status", "control_mode_flags")
    if flags is None:
        return None
    is_set = np.floor(flags.values / 2.0**_RANGE_HEIGHT_BIT) % 2.0
    return Series(f"bit {_RANGE_HEIGHT_BIT} of {flags.source}", flags.time_s, is_set)


def _throttle(flight: LoggedFlight) -> Series | None:
    thrust = flight.series("vehicle_thrust_setpoint", "xyz[2]", -1.0) or flight.series("actuator_controls_0", _THRUST)
    return None if thrust is None else replace(thrust, values=np.clip(thrust.values, 0.0, 1.0))


def _air_temperature(flight: LoggedFlight) -> Series | None:
    """Temperature of a thermometer in the air: an external barometer or an airspeed sensor, since 1.15."""

    def in_air(source: Array, found_c: Array) -> Array:
        return np.where(source != _DEFAULT_TEMPERATURE, found_c, np.nan)

    fields = ("temperature_source", "ambient_temperature")
    found = flight.combined("vehicle_air_data", fields, in_air, "ambient_temperature")
    return found if found is not None and np.isfinite(found.values).any() else None


def _version(log: Any) -> str:
    release = log.msg_info_dict.get("ver_sw_release")
    if release is None:
        return "unknown version"
    return "PX4 " + ".".join(str(release >> shift & 0xFF) for shift in (24, 16, 8))
