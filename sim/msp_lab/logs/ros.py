"""A ROS 1 or 2 bag (.bag, .db3, .mcap, or a folder with metadata.yaml) as a `VehicleLog`.

Range finders are topics of sensor_msgs/Range; what else is used is known by its type, and where one type serves several
purposes by the topic's name. Times are those of the header, where it has one. Axes: x forward, y left, z up (REP 103);
ranges that are infinite are out of range (REP 117).
"""

import re
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Reader
from rosbags.typesys import Stores, get_typestore

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
    make_ranger,
    readings_cm,
    rounded_cm,
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


class _Bag1(Reader):
    """A bag of ROS 1. Its reader keeps 170 bytes for each message; here for those of wanted topics only."""

    def __init__(self, path: Path, is_wanted: Callable[[Any], bool]) -> None:
        super().__init__(path)
        self._is_wanted = is_wanted

    def read_index_data(self, pos: int, indexes: dict[int, list[Any]]) -> None:
        found: dict[int, list[Any]] = defaultdict(list)
        super().read_index_data(pos, found)
        for connection in filter(self._is_wanted, self.connections):
            indexes[connection.id] += found[connection.id]


def read_bag(path: Path, progress: Callable[[float], None], named_field: str = "") -> VehicleLog:
    """Read a bag, as `msp_lab.logs.opening.open_log`; its fields are named ``/topic.field.of.field``."""
    topic, _, field = named_field.partition(".")
    topics: dict[str, _Topic] = {}
    columns: dict[str, _Topic] = {}
    notes = ["A bag does not say which way range finders look: all count as looking down."]
    names = [topic] if field else []
    for time_s, name, kind, message in _messages(path, names, progress, notes):
        try:
            if kind in _FIELDS:
                topics.setdefault(name, _Topic(name, kind, _FIELDS[kind])).add(time_s, message)
            if name in names:
                columns.setdefault(name, _Topic(name, kind, (field,))).add(time_s, message)
        except (AttributeError, IndexError, TypeError, ValueError) as error:
            raise RecordingError(f"{path}: {name}, a {kind}, has no such number: {error}") from None
    references = _references(topics)
    references += [TruthSource("column", found.series(field)) for found in columns.values()]
    return VehicleLog(path, "ROS bag", tuple(_rangers(topics)), _context(topics), tuple(references), tuple(notes))


def _messages(
    path: Path, names: list[str], progress: Callable[[float], None], notes: list[str]
) -> Iterator[tuple[float, str, str, Any]]:
    """Time since the bag's beginning [s], topic, type and message, of these topics and of those with `_FIELDS`.

    Where the bag is damaged, the messages before that, and a note.
    """

    def is_wanted(connection: Any) -> bool:
        return connection.msgtype in _FIELDS or connection.topic in names

    count = 0
    try:
        bags = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
        if not bags.is2:
            bags.readers = [_Bag1(path, is_wanted)]
        with bags as reader:
            wanted = list(filter(is_wanted, reader.connections))
            if not wanted:
                return
            start_ns, length_ns = reader.start_time, max(reader.duration, 1)
            for connection, arrived_ns, content in reader.messages(connections=wanted):
                message: Any = reader.deserialize(content, connection.msgtype)
                stamp = getattr(getattr(message, "header", None), "stamp", None)
                sent_ns = 0 if stamp is None else int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
                count += 1
                if count % 1000 == 0:
                    progress(min(1.0, (arrived_ns - start_ns) / length_ns))
                yield ((sent_ns or arrived_ns) - start_ns) / 1e9, connection.topic, connection.msgtype, message
    except Exception as error:  # whatever rosbags, its storage, or types that damaged definitions make raise
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        if not count:
            raise RecordingError(f"{path}: cannot be read as a ROS bag: {reason}") from None
        notes.append(f"The bag is damaged after {count} messages ({reason}); those before are here.")


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
            # The cosine of the tilt is the last element of the rotation matrix; -1 says that there is no orientation.
            cosine = 1.0 - 2.0 * (each["orientation.x"] ** 2 + each["orientation.y"] ** 2)
            tilt = np.where(known, np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))), np.nan)
            found.setdefault(TILT, each.series("orientation", tilt))
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
    return {name: each for name, each in found.items() if len(each)}


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
