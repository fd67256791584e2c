"""A ROS 1 or 2 bag (.bag, .db3, .mcap, or a folder with metadata.yaml) as a `VehicleLog`.

Range finders are topics of sensor_msgs/Range; what else is used is known by its type, and where one type serves several
purposes by the topic's name. Times are those of the header, where it has one. Axes: x forward, y left, z up (REP 103);
ranges that are infinite are out of range (REP 117).
"""

import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from msp_lab.logs.bag_messages import Topic, decoder, files_of, read_messages
from msp_lab.logs.log import (
    CLIMB,
    THROTTLE,
    TILT,
    MessageColumns,
    Ranger,
    Series,
    TruthSource,
    VehicleLog,
    longest_m,
    make_continuous,
    make_log,
    make_ranger,
    readings_cm,
    rounded_cm,
    tilt_of_quaternion_deg,
)
from msp_range.recording.error import RecordingError

_EXTERNAL = re.compile(r"vicon|vrpn|mocap|motion_capture|optitrack|qualisys|ground_?truth|gazebo", re.IGNORECASE)
"""Poses of such topics are from outside the vehicle."""
_OWN = re.compile(r"local_position/(pose|odom)$")
"""MAVROS: the autopilot's own estimate."""
_BOARD = re.compile(r"imu|baro|fcu", re.IGNORECASE)
"""Thermometers of such topics are on a board."""
_GBAS = 2
"""NavSatStatus.STATUS_GBAS_FIX: with a ground station, which drivers use for RTK."""
_RTK_STD_M = 0.1
"""A height with a larger standard deviation is no fixed RTK solution [m]: those have 0.02."""
_FIELDS: Mapping[str, tuple[str, ...]] = {
    "sensor_msgs/msg/Range": ("range", "min_range", "max_range"),
    "sensor_msgs/msg/Imu": ("orientation.x", "orientation.y", "orientation_covariance.0"),
    "sensor_msgs/msg/NavSatFix": ("altitude", "status.status", "position_covariance.8"),
    "sensor_msgs/msg/Temperature": ("temperature",),
    "sensor_msgs/msg/RelativeHumidity": ("relative_humidity",),
    "geometry_msgs/msg/TwistStamped": ("twist.linear.z",),
    "geometry_msgs/msg/PoseStamped": ("pose.position.z",),
    "geometry_msgs/msg/PoseWithCovarianceStamped": ("pose.pose.position.z",),
    "geometry_msgs/msg/TransformStamped": ("transform.translation.z",),
    "nav_msgs/msg/Odometry": ("pose.pose.position.z",),
    "mavros_msgs/msg/VfrHud": ("throttle",),
    "mavros_msgs/msg/VFR_HUD": ("throttle",),
}
"""Type of a message -> the fields that are read."""
_POSES = ("PoseStamped", "PoseWithCovarianceStamped", "TransformStamped", "Odometry")


class _Topic(MessageColumns):
    """Values of some fields of a topic's messages; `kind` is their type without its package."""

    def __init__(self, name: str, message_type: str, fields: tuple[str, ...]) -> None:
        super().__init__(name, fields)
        self.kind = message_type.rsplit("/", 1)[-1]


def read_bag(path: Path, progress: Callable[[float], None], named_field: str = "") -> VehicleLog:
    """Read a bag, as `msp_lab.logs.opening.open_log`; its fields are named ``/topic.field.of.field``."""
    topic, _, field = named_field.partition(".")
    topics: dict[str, _Topic] = {}
    columns: dict[str, _Topic] = {}
    notes = ["A bag does not say which way range finders look: all count as looking down."]
    names = [topic] if field else []
    for place, (time_s, arrived_s, found, message) in enumerate(_messages(path, names, progress, notes)):
        name, kind = found.name, found.kind
        try:
            if kind in _FIELDS:
                topics.setdefault(name, _Topic(name, kind, _FIELDS[kind])).add(time_s, message, place, arrived_s)
            if name in names:
                columns.setdefault(name, _Topic(name, kind, (field,))).add(time_s, message, place, arrived_s)
        except (AttributeError, IndexError, TypeError, ValueError) as error:
            raise RecordingError(f"{path}: {name}, a {kind}, has no such number: {error}") from None
    clock = make_continuous([*topics.values(), *columns.values()])
    references = _references(topics)
    references += [TruthSource("column", found.series(field)) for found in columns.values()]
    return make_log(path, "ROS bag", _rangers(topics), _context(topics), references, notes, clock)


def _messages(
    path: Path, names: list[str], progress: Callable[[float], None], notes: list[str]
) -> Iterator[tuple[float, float, Topic, Any]]:
    """Time by the header and of arrival since the first message arrived [s], topic and message, of these topics and of
    those with `_FIELDS`.

    Where a file is cut or damaged, the messages before that, and a note.
    """

    def is_wanted(topic: Topic) -> bool:
        return topic.kind in _FIELDS or topic.name in names

    count = read_bytes = 0
    start_ns: int | None = None
    lost = []
    files, unpack = files_of(path)
    size = sum(each.stat().st_size for each in files if each.is_file())
    for file in files:
        try:
            for topic, arrived_ns, packed in read_messages(file, is_wanted):
                message: Any = decoder(topic.kind, topic.definition, topic.is_ros1)(unpack(packed))
                stamp = getattr(getattr(message, "header", None), "stamp", None)
                sent_ns = 0 if stamp is None else int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
                start_ns = arrived_ns if start_ns is None else start_ns
                count += 1
                read_bytes += len(packed)
                if count % 1000 == 0:
                    progress(min(1.0, read_bytes / size))
                yield ((sent_ns or arrived_ns) - start_ns) / 1e9, (arrived_ns - start_ns) / 1e9, topic, message
        except Exception as error:  # whatever storages, decoders, or types that damaged definitions make raise
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            lost.append(f"{file.name} is cut or damaged after {count} messages ({reason}); those before are here.")
    if lost and not count:
        raise RecordingError(f"{path}: cannot be read as a ROS bag: {lost[0].partition('(')[2].rpartition(')')[0]}")
    notes += lost


def _rangers(topics: Mapping[str, _Topic]) -> list[Ranger]:
    rangers = []
    for each in topics.values():
        if each.kind == "Range" and each["range"].size:
            maximum_m = longest_m(each["max_range"])
            range_m = each["range"]
            reading_cm = readings_cm(range_m, maximum_m)
            reading_cm[np.isposinf(reading_cm)] = np.nan
            name = each.source.strip("/").replace("/", "_")
            is_too_near = rounded_cm(range_m) < rounded_cm(each["min_range"])  # minus infinity too (REP 117)
            rangers.append(make_ranger(name, each.unsorted("range", reading_cm), True, maximum_m, is_too_near))
    return rangers


def _context(topics: Mapping[str, _Topic]) -> dict[str, Series]:
    found: dict[str, Series] = {}
    for each in topics.values():
        if each.kind == "Imu" and (known := each["orientation_covariance.0"] != -1.0).any():
            # -1 says that there is no orientation.
            tilt = tilt_of_quaternion_deg(each["orientation.x"], each["orientation.y"])
            found.setdefault(TILT, each.series("orientation", np.where(known, tilt, np.nan)))
        elif each.kind == "TwistStamped" and each.source.endswith("velocity_local"):
            found[CLIMB] = each.series("twist.linear.z")
        elif each.kind == "Temperature":
            found.setdefault(
                "board_temperature_c" if _BOARD.search(each.source) else "air_temperature_c", each.series("temperature")
            )
        elif each.kind == "RelativeHumidity":
            found["humidity_pct"] = each.series("relative_humidity", 100.0 * each["relative_humidity"])
        elif each.kind in ("VfrHud", "VFR_HUD"):
            found[THROTTLE] = each.series("throttle")
    return found


def _references(topics: Mapping[str, _Topic]) -> list[TruthSource]:
    references = []
    for each in topics.values():
        if each.kind == "NavSatFix":
            std_m = np.sqrt(np.maximum(each["position_covariance.8"], 0.0))
            fixed = (each["status.status"] == _GBAS) & (std_m > 0.0) & (std_m < _RTK_STD_M)
            if fixed.any():
                altitude = each.series("altitude", np.where(fixed, each["altitude"], np.nan))
                references.append(TruthSource("rtk", altitude, std=each.series("position_covariance", std_m)))
        elif each.kind in _POSES and each[each.fields[0]].size:
            if _EXTERNAL.search(each.source):
                references.append(TruthSource("mocap", each.series(each.fields[0])))
            elif _OWN.search(each.source):
                refused = "the bag does not say whether the range is fused into it"
                references.append(TruthSource("ekf", each.series(each.fields[0]), refused=refused))
    return references
