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
    RTK_FIXED,
    THROTTLE,
    TILT,
    Ranger,
    Series,
    TruthSource,
    VehicleLog,
    longest_m,
    make_log,
    make_ranger,
    readings_cm,
    rounded_cm,
    series,
    tilt_of_quaternion_deg,
    truth_source,
)
from msp_lab.readings.clock_runs import ClockRun, Stamps, continuous
from msp_range.arrays import Array, Column
from msp_range.input_file import open_input
from msp_range.mavlink.orientation import DOWN
from msp_range.recording.error import RecordingError

_RANGE_HEIGHT_BIT = 10
"""Of estimator_status.control_mode_flags: the range is fused as height (EstimatorStatus.msg, CS_RNG_HGT)."""
_THRUST = "control[3]"
"""Of actuator_controls_0, before there was vehicle_thrust_setpoint: the collective thrust, 0 to 1."""
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
"""A file is given up after so many times its size was read: where its definitions are cut, pyulog goes back without
end. A damaged file is searched a few times over."""
_EVERY_BYTES = 2**20
_Topics = Mapping[str, Mapping[str, Column]]


def read_px4(path: Path, progress: Callable[[float], None], named_field: str = "") -> VehicleLog:
    """Read a log, as `msp_lab.logs.opening.open_log`; its fields are named ``topic.field``."""
    topic, dot, _ = named_field.partition(".")
    try:
        # pyulog prints what it leaves out; what is lost is in its attributes too.
        with open_input(path, LARGEST_BYTES) as file, contextlib.redirect_stdout(None):
            log = _InOrder(_Watched(file, progress), [*_TOPICS, *([topic] if dot else [])])
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from None
    except (TypeError, ValueError, KeyError, IndexError, struct.error, ULogException, _ReadWithoutEnd) as error:
        raise RecordingError(f"{path}: no ULog, or damaged at its beginning: {error}") from None
    progress(1.0)
    try:
        return _log(path, log, named_field)
    except KeyError as error:
        raise RecordingError(f"{path}: damaged at its beginning: a topic has no field {error}") from None


def _log(path: Path, log: ULog, named_field: str) -> VehicleLog:
    """What was read, as a `VehicleLog`; raises KeyError where a topic lacks a field that every version has."""
    topic, _, field = named_field.partition(".")
    found: dict[str, dict[str, Column]] = {}
    for each in log.data_list:
        found[each.name if each.multi_id == 0 else f"{each.name}[{each.multi_id}]"] = dict(each.data)
    clock = _make_continuous(found, [_places(log, each) for each in log.data_list])
    parameters = log.initial_parameters | {name: value for _, name, value in log.changed_parameters}
    context = {
        TILT: _tilt(found),
        CLIMB: _field(found, "vehicle_local_position", "vz", -1.0),
        THROTTLE: _throttle(found),
        "air_temperature_c": _air_temperature(found),
        "vibration_m_s2": _field(found, "vehicle_imu_status", "accel_vibration_metric"),
    }
    column, refused = _field(found, topic, field), ""
    if is_estimate(named_field):
        column, refused = _without_fused(column, found, parameters)
    references = [*_references(found, parameters), truth_source("column", column, refused=refused)]
    notes = []
    if log.file_corruption:
        notes.append("The file is damaged; what could be read is here.")
    if log.dropouts:
        lost_s = sum(each.duration for each in log.dropouts) / 1e3
        notes.append(f"The logger dropped messages {len(log.dropouts)} times, for {lost_s:.3g} s in all.")
    return make_log(path, f"PX4 ULog, {_version(log)}", _rangers(found), context, references, notes, clock)


def _make_continuous(found: dict[str, dict[str, Column]], places: list[Column]) -> tuple[ClockRun, ...]:
    """Put the times of all topics on a clock that never steps; the runs between the steps.

    The times of the satellites, which are next to the log's own, are the other clock.
    """
    stamps = []
    for data, place in zip(found.values(), places, strict=True):
        utc_us = data.get("time_utc_usec", np.zeros(place.size))
        stamps.append(Stamps(place, data["timestamp"] / 1e6, np.where(utc_us > 0, utc_us / 1e6, np.nan)))
    times_s, runs = continuous(stamps)
    for data, sender, time_s in zip(found.values(), stamps, times_s, strict=True) if runs else ():
        for name in {"timestamp", "timestamp_sample"} & data.keys():
            # A sample that was not stamped stays so.
            data[name] = np.where(data[name] > 0, data[name] + 1e6 * (time_s - sender.time_s), 0.0)
    return runs


def _places(log: "_InOrder", topic: Any) -> Column:
    """Where in the log a topic's messages are; a topic that is added again has lost those before."""
    return np.array(log.places[topic.msg_id])[-topic.data["timestamp"].size :]


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


def _rangers(found: _Topics) -> list[Ranger]:
    rangers = []
    for name, data in found.items():
        if not name.startswith("distance_sensor"):
            continue
        maximum_m = longest_m(data["max_distance"])
        reading_cm = readings_cm(data["current_distance"], maximum_m)
        # Zero is an invalid signal, -1 an unknown one (DistanceSensor.msg).
        reading_cm[data.get("signal_quality", np.full(reading_cm.size, -1)) == 0] = np.nan
        facing = int(np.median(data["orientation"])) if "orientation" in data else DOWN
        is_too_near = rounded_cm(data["current_distance"]) < rounded_cm(data.get("min_distance", np.zeros(1)))
        found_cm = Series(f"{name}.current_distance", _time_s(data), reading_cm)
        plain_name = name.replace("[", "_").rstrip("]")
        rangers.append(make_ranger(plain_name, found_cm, facing == DOWN, maximum_m, is_too_near))
    return rangers


def _references(found: _Topics, parameters: Mapping[str, Any]) -> list[TruthSource | None]:
    height, refused = _without_fused(_field(found, "vehicle_local_position", "z", -1.0), found, parameters)
    return [
        truth_source("simulator", _field(found, "vehicle_local_position_groundtruth", "z", -1.0)),
        truth_source("rtk", _rtk(found), std=_field(found, "vehicle_gps_position", "epv")),
        *(
            truth_source("mocap", _field(found, topic, "position[2]", -1.0) or _field(found, topic, "z", -1.0))
            for topic in ("vehicle_mocap_odometry", "vehicle_visual_odometry")
        ),
        truth_source("ekf", height, refused=refused),
        truth_source("barometer", _field(found, "vehicle_air_data", "baro_alt_meter")),
    ]


def _without_fused(height: Series | None, found: _Topics, parameters: Mapping[str, Any]) -> tuple[Series | None, str]:
    """EKF2's height until the range is first fused into it, and why it is refused where that is most of the log."""
    if height is None:
        return None, ""
    flags = _field(found, "estimator_status_flags", "cs_rng_hgt") or _range_height_bit(found)
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


def _range_height_bit(found: _Topics) -> Series | None:
    """The flag of versions whose logs have all flags in one number."""
    flags = _field(found, "estimator_status", "control_mode_flags")
    if flags is None:
        return None
    is_set = np.floor(flags.values / 2.0**_RANGE_HEIGHT_BIT) % 2.0
    return Series(f"bit {_RANGE_HEIGHT_BIT} of {flags.source}", flags.time_s, is_set)


def _rtk(found: _Topics) -> Series | None:
    gps = found.get("vehicle_gps_position", {})
    fixed = gps.get("fix_type", np.zeros(0)) == RTK_FIXED
    if not fixed.any():
        return None
    # Millimetres before 1.14.
    name, factor = ("altitude_msl_m", 1.0) if "altitude_msl_m" in gps else ("alt", 1e-3)
    return series(f"vehicle_gps_position.{name}", _time_s(gps), np.where(fixed, factor * gps[name], np.nan))


def _tilt(found: _Topics) -> Series | None:
    data = found.get("vehicle_attitude", {})
    if "q[3]" not in data:
        return None
    tilt_deg = tilt_of_quaternion_deg(data["q[1]"].astype(float), data["q[2]"].astype(float))
    return series("vehicle_attitude.q", _time_s(data), tilt_deg)


def _throttle(found: _Topics) -> Series | None:
    thrust = _field(found, "vehicle_thrust_setpoint", "xyz[2]", -1.0) or _field(found, "actuator_controls_0", _THRUST)
    return None if thrust is None else replace(thrust, values=np.clip(thrust.values, 0.0, 1.0))


def _air_temperature(found: _Topics) -> Series | None:
    """Of a thermometer in the air: an external barometer or an airspeed sensor, since 1.15."""
    source = _field(found, "vehicle_air_data", "temperature_source")
    if source is None or not (source.values != _DEFAULT_TEMPERATURE).any():
        return None
    found_c = _field(found, "vehicle_air_data", "ambient_temperature")
    if found_c is None:
        return None
    return replace(found_c, values=np.where(source.values != _DEFAULT_TEMPERATURE, found_c.values, np.nan))


def _field(found: _Topics, topic: str, field: str, factor: float = 1.0) -> Series | None:
    data = found.get(topic, {})
    if field not in data or not data[field].size:
        return None
    return series(f"{topic}.{field}", _time_s(data), factor * data[field].astype(float))


def _time_s(data: Mapping[str, Column]) -> Array:
    """When it was measured, where the topic has that next to when it was published."""
    sampled = data.get("timestamp_sample")
    stamps = sampled if sampled is not None and (sampled > 0).all() else data["timestamp"]
    return np.asarray(stamps / 1e6)


def _version(log: Any) -> str:
    release = log.msg_info_dict.get("ver_sw_release")
    return (
        "unknown version"
        if release is None
        else "PX4 " + ".".join(str(release >> shift & 0xFF) for shift in (24, 16, 8))
    )
