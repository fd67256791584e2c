"""A ROS 1 or 2 bag (.bag, .db3, .mcap, or a folder with metadata.yaml) as a `VehicleLog`.

Range finders are topics of sensor_msgs/Range; what else is used is known by its type, and where one type serves several
purposes by the topic's name. Times are those of the header, where it has one. Axes: x forward, y left, z up (REP 103);
ranges that are infinite are out of range (REP 117).

A bag that was cut has no index, and in the order of its times a clock that was set cannot be seen. So the three kinds
of storage are read here from their beginning, and rosbags decodes the messages. Formats:
https://wiki.ros.org/Bags/Format/2.0, https://mcap.dev/spec, and rosbag2's tables topics, messages and
message_definitions.
"""

import contextlib
import os
import re
import shutil
import sqlite3
import struct
import tempfile
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
import zstandard
from mcap.records import Channel, Schema
from rosbags.rosbag1.reader import decompressors
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.msg import normalize_msgtype

from msp_lab.logs.log import (
    CLIMB,
    THROTTLE,
    TILT,
    LogRequest,
    MessageColumns,
    Ranger,
    Series,
    TruthSource,
    VehicleLog,
    make_continuous,
    make_log,
    make_ranger,
    number_at,
    rounded_cm,
    tilt_of_quaternion_deg,
)
from msp_lab.logs.ros_numbers import numbers_of
from msp_range.input_file import open_input, read_text
from msp_range.recording.error import RecordingError
from msp_range.recording.mcap_records import Losses, RawMessage, read_records
from msp_range.recording.reader import LARGEST_FILE_BYTES

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
_STAMP = ("header.stamp.sec", "header.stamp.nanosec")
_POSES = ("PoseStamped", "PoseWithCovarianceStamped", "TransformStamped", "Odometry")


_MOST_METADATA_BYTES = 64 * 2**20
_IDL = "=" * 80 + "\n"
"""Before each part of a definition in IDL."""
_MESSAGE, _CHUNK, _CONNECTION = b"\x02", b"\x05", b"\x07"
"""Records of a bag of ROS 1 that hold messages or topics; the others are indexes."""
_LENGTH, _TIME = struct.Struct("<I"), struct.Struct("<II")


class Topic(NamedTuple):
    """A topic: its name, the type of its messages, its definition (empty: the type is known), and how it is written."""

    name: str
    kind: str
    definition: str = ""
    is_ros1: bool = False


_UNKNOWN = Topic("", "")
"""In place of a topic that was not described yet."""
Wanted = Callable[[Topic], bool]
Messages = Iterator[tuple[Topic, int, bytes]]
"""Topic, when the message arrived [ns], and its bytes."""


class CutError(Exception):
    """The file ends or is damaged here; the messages before were whole."""


class _NoNumberError(Exception):
    """A message has no number of the name that is asked for."""


class _Topic(MessageColumns):
    """Values of some fields of a topic's messages; `kind` is their type without its package."""

    def __init__(self, name: str, message_type: str, fields: tuple[str, ...]) -> None:
        super().__init__(name, {field: array("d") for field in fields})
        self.message_type = message_type
        self.kind = message_type.rsplit("/", 1)[-1]


def read_bag(path: Path, asked: LogRequest) -> VehicleLog:
    """Read a bag; its fields are named ``/topic.field.of.field``."""
    topic, _, field = asked.field.partition(".")
    topics: dict[str, _Topic] = {}
    notes = ["A bag does not say which way range finders look: all count as looking down."]
    fields = {topic: (field,)} if field else {}
    for place, (time_s, arrived_s, found, numbers) in enumerate(_messages(path, fields, asked.progress, notes)):
        if found.name not in topics:
            topics[found.name] = _Topic(found.name, found.kind, _fields_of(found, fields))
        topics[found.name].add(time_s, numbers, place, arrived_s)
    clock = make_continuous(topics.values())
    known = [connection for connection in topics.values() if connection.message_type in _FIELDS]
    references = _references(known)
    references += [TruthSource("column", topics[name].series(field)) for name in fields if name in topics]
    return make_log(path, "ROS bag", _rangers(known), _context(known), references, notes, clock)


def _fields_of(topic: Topic, asked: Mapping[str, tuple[str, ...]]) -> tuple[str, ...]:
    """The fields of a topic that are read, those that are asked for by its name last."""
    return tuple(dict.fromkeys((*_FIELDS.get(topic.kind, ()), *asked.get(topic.name, ()))))


def _messages(
    path: Path, asked: Mapping[str, tuple[str, ...]], progress: Callable[[float], None], notes: list[str]
) -> Iterator[tuple[float, float, Topic, Sequence[float]]]:
    """Time by the header and of arrival since the first message arrived [s], topic and its fields, of topics that are
    asked for and of those with `_FIELDS`.

    Where a file is cut or damaged, the messages before that, and a note.
    """

    def is_wanted(topic: Topic) -> bool:
        return topic.kind in _FIELDS or topic.name in asked

    readers: dict[Topic, Callable[[bytes], tuple[int, Sequence[float]]]] = {}
    count = read_bytes = 0
    start_ns: int | None = None
    lost = []
    files, unpack = files_of(path)
    size = sum(file.stat().st_size for file in files if file.is_file())
    for file in files:
        try:
            for topic, arrived_ns, packed in read_messages(file, is_wanted):
                if topic not in readers:
                    readers[topic] = _reader(topic, _fields_of(topic, asked))
                sent_ns, numbers = readers[topic](unpack(packed))
                start_ns = arrived_ns if start_ns is None else start_ns
                count += 1
                read_bytes += len(packed)
                if count % 1000 == 0:
                    progress(min(1.0, read_bytes / size))
                yield ((sent_ns or arrived_ns) - start_ns) / 1e9, (arrived_ns - start_ns) / 1e9, topic, numbers
        except _NoNumberError as error:
            raise RecordingError(f"{path}: {error}") from None
        except Exception as error:  # whatever storages, decoders, or types that damaged definitions make raise
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            lost.append(f"{file.name} is cut or damaged after {count} messages ({reason}); those before are here.")
    if lost and not count:
        raise RecordingError(f"{path}: cannot be read as a ROS bag: {lost[0].partition('(')[2].rpartition(')')[0]}")
    notes += lost


def _rangers(topics: Sequence[_Topic]) -> list[Ranger]:
    rangers = []
    for topic in topics:
        if topic.kind == "Range":
            name = topic.source.strip("/").replace("/", "_")
            ranges = topic.unsorted("range", topic["range"])
            is_too_near = rounded_cm(topic["range"]) < rounded_cm(topic["min_range"])  # minus infinity too (REP 117)
            rangers.append(make_ranger(name, ranges, True, topic["max_range"], is_too_near, np.isnan(topic["range"])))
    return rangers


def _context(topics: Sequence[_Topic]) -> dict[str, Series]:
    found: dict[str, Series] = {}
    for topic in topics:
        if topic.kind == "Imu" and (known := topic["orientation_covariance.0"] != -1.0).any():
            # -1 says that there is no orientation.
            tilt = tilt_of_quaternion_deg(topic["orientation.x"], topic["orientation.y"])
            found.setdefault(TILT, topic.series("orientation", np.where(known, tilt, np.nan)))
        elif topic.kind == "TwistStamped" and topic.source.endswith("velocity_local"):
            found[CLIMB] = topic.series("twist.linear.z")
        elif topic.kind == "Temperature":
            found.setdefault(
                "board_temperature_c" if _BOARD.search(topic.source) else "air_temperature_c",
                topic.series("temperature"),
            )
        elif topic.kind == "RelativeHumidity":
            found["humidity_pct"] = topic.series("relative_humidity", 100.0 * topic["relative_humidity"])
        elif topic.kind in ("VfrHud", "VFR_HUD"):
            found[THROTTLE] = topic.series("throttle")
    return found


def _references(topics: Sequence[_Topic]) -> list[TruthSource]:
    references = []
    for topic in topics:
        if topic.kind == "NavSatFix":
            std_m = np.sqrt(np.maximum(topic["position_covariance.8"], 0.0))
            fixed = (topic["status.status"] == _GBAS) & (std_m > 0.0) & (std_m < _RTK_STD_M)
            if fixed.any():
                altitude = topic.series("altitude", np.where(fixed, topic["altitude"], np.nan))
                references.append(TruthSource("rtk", altitude, std=topic.series("position_covariance", std_m)))
        elif topic.kind in _POSES:
            height = topic.series(next(iter(topic.values)))
            if _EXTERNAL.search(topic.source):
                references.append(TruthSource("mocap", height))
            elif _OWN.search(topic.source):
                refused = "the bag does not say whether the range is fused into it"
                references.append(TruthSource("ekf", height, refused=refused))
    return references


def read_messages(path: Path, is_wanted: Wanted) -> Messages:
    """Messages of one file; raises `CutError`, or what damaged bytes make raise, after those that are whole."""
    if path.suffix == ".zstd":
        with tempfile.TemporaryDirectory() as folder:
            whole = Path(folder, path.stem)
            with path.open("rb") as packed, whole.open("wb") as out, contextlib.suppress(zstandard.ZstdError):
                shutil.copyfileobj(zstandard.ZstdDecompressor().stream_reader(packed), out)
            yield from read_messages(whole, is_wanted)
        return
    with open_input(path, LARGEST_FILE_BYTES) as file:
        begins = file.read(13)
        if begins.startswith(b"#ROSBAG V2.0\n"):
            yield from _of_ros1(file, is_wanted)
        elif begins.startswith(b"\x89MCAP"):
            yield from _of_mcap(file, is_wanted)
        else:
            begins += file.read(19)
            yield from _of_sqlite_file(path, begins, file.seek(0, 2), is_wanted)


def files_of(path: Path) -> tuple[list[Path], Callable[[bytes], bytes]]:
    """The files of a bag, and what unpacks a message's bytes; all of its folder where metadata.yaml is damaged."""
    if not path.is_dir():
        return [path], bytes
    try:
        about = yaml.safe_load(read_text(path / "metadata.yaml", _MOST_METADATA_BYTES))["rosbag2_bagfile_information"]
        files = [path / Path(name).name for name in about["relative_file_paths"]]
        is_packed = str(about.get("compression_mode")).lower() == "message"
    except (OSError, KeyError, TypeError, AttributeError, yaml.YAMLError):
        files, is_packed = sorted(file for file in path.iterdir() if file.suffix != ".yaml"), False
    return files, zstandard.ZstdDecompressor().decompress if is_packed else bytes


def _reader(topic: Topic, fields: Sequence[str]) -> Callable[[bytes], tuple[int, Sequence[float]]]:
    """What makes the time of a message's header [ns], 0 without one, and its fields of the message's bytes."""
    kind, definition, is_ros1 = topic.kind, topic.definition, topic.is_ros1
    store = get_typestore(Stores.EMPTY if definition else Stores.ROS2_HUMBLE)
    if definition.startswith(f"{_IDL}IDL: "):
        for part in definition.split(_IDL)[1:]:
            store.register(get_types_from_idl(part.partition("\n")[2]))
    elif definition:
        store.register(get_types_from_msg(definition, kind))
    decode = store.deserialize_ros1 if is_ros1 else store.deserialize_cdr
    quick = numbers_of(store, kind, is_ros1, (*_STAMP, *fields))

    def read(content: bytes) -> tuple[int, Sequence[float]]:
        found = quick(content) if quick is not None else None
        if found is not None:
            sec, nanosec, *numbers = found
            return int(sec) * 1_000_000_000 + int(nanosec), numbers
        message: Any = decode(content, kind)
        stamp = getattr(getattr(message, "header", None), "stamp", None)
        try:
            numbers = [float(number_at(field)(message)) for field in fields]
        except (AttributeError, IndexError, TypeError, ValueError) as error:
            raise _NoNumberError(f"{topic.name}, a {kind}, has no such number: {error}") from None
        return 0 if stamp is None else int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec), numbers

    return read


def _of_ros1(file: Any, is_wanted: Wanted) -> Messages:
    topics: dict[bytes, Topic | None] = {}
    size = file.seek(0, 2)
    file.seek(13)
    while (begin := file.tell()) < size:
        header_bytes = int.from_bytes(file.read(4), "little")
        header = _fields(file.read(min(header_bytes, size - begin)))
        length_bytes = file.read(4)
        length, left = int.from_bytes(length_bytes, "little"), size - file.tell()
        if len(length_bytes) < 4 or b"op" not in header:
            raise CutError(f"no record in its last {size - begin} bytes")
        kind = header[b"op"]
        if kind == _CHUNK:
            content = file.read(min(length, left))
            packing = header[b"compression"].decode()
            if length <= left or packing == "none":
                yield from _in_chunk(decompressors[packing](content), topics, is_wanted)
        elif kind in (_MESSAGE, _CONNECTION):
            yield from _of_record(header, file.read(min(length, left)), topics, is_wanted)
        else:
            file.seek(length, 1)
        if length > left:
            raise CutError(f"{length - left} bytes are missing at its end")


def _in_chunk(content: bytes, topics: dict[bytes, Topic | None], is_wanted: Wanted) -> Messages:
    at, end = 0, len(content)
    length_at = _LENGTH.unpack_from
    while at + 4 <= end:
        begin = at + 4 + length_at(content, at)[0]
        if begin + 4 > end:
            return
        stop = begin + 4 + length_at(content, begin)[0]
        if stop > end:
            return
        conn = content.find(b"conn=", at, begin) + 5
        # Most messages of most bags are of other topics: those are stepped over without a look at their other fields.
        topic = topics.get(content[conn : conn + 4], _UNKNOWN)
        if topic is not None:
            time = content.find(b"time=", at, begin) + 5
            if topic is not _UNKNOWN and content.find(b"op=" + _MESSAGE, at, begin) > 0 and time >= 5:
                yield topic, _nanoseconds(content, time), content[begin + 4 : stop]
            else:
                yield from _of_record(_fields(content[at + 4 : begin]), content[begin + 4 : stop], topics, is_wanted)
        at = stop


def _nanoseconds(content: bytes, at: int) -> int:
    seconds, rest_ns = _TIME.unpack_from(content, at)
    return int(seconds) * 1_000_000_000 + int(rest_ns)


def _of_record(
    header: Mapping[bytes, bytes], content: bytes, topics: dict[bytes, Topic | None], is_wanted: Wanted
) -> Messages:
    """The message of a record, if it is one that is wanted; a topic is kept."""
    if header[b"op"] == _CONNECTION:
        about = {name: value.decode() for name, value in _fields(content).items()}
        name = "/" + "/".join(filter(None, header[b"topic"].decode().split("/")))
        topic = Topic(name, normalize_msgtype(about[b"type"]), about[b"message_definition"], True)
        topics[header[b"conn"]] = topic if is_wanted(topic) else None
    elif header[b"op"] == _MESSAGE and (wanted := topics[header[b"conn"]]) is not None:
        yield wanted, _nanoseconds(header[b"time"], 0), content


def _fields(header: bytes) -> dict[bytes, bytes]:
    found, at = {}, 0
    while at + 4 < len(header):
        end = at + 4 + int.from_bytes(header[at : at + 4], "little")
        name, _, value = header[at + 4 : end].partition(b"=")
        found[name] = value
        at = end
    return found


def _of_mcap(file: Any, is_wanted: Wanted) -> Messages:
    losses = Losses()
    schemas: dict[int, Schema] = {}
    topics: dict[int, Topic] = {}
    for record in read_records(file, losses):
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel) and record.schema_id in schemas:
            schema, is_ros1 = schemas[record.schema_id], record.message_encoding == "ros1"
            kind = normalize_msgtype(schema.name) if is_ros1 else schema.name
            topics[record.id] = Topic(record.topic, kind, schema.data.decode(), is_ros1)
        elif isinstance(record, RawMessage) and record.channel_id in topics and is_wanted(topics[record.channel_id]):
            yield topics[record.channel_id], record.log_time_ns, record.data
    if losses:
        raise CutError(f"lost: {losses}")


def _of_sqlite_file(path: Path, begins: bytes, size: int, is_wanted: Wanted) -> Messages:
    """Messages of the whole pages of a file; ``begins`` has the size of a page and how many there are, 1 is 65,536
    (sqlite.org/fileformat.html)."""
    page_bytes = int.from_bytes(begins[16:18], "big")
    page_bytes = page_bytes if page_bytes > 1 else 65_536
    cut_bytes, missing = size % page_bytes, int.from_bytes(begins[28:], "big") * page_bytes - size
    with tempfile.TemporaryDirectory() as folder:
        if cut_bytes:
            # SQLite fills a page that ends early with zeros, and takes those for the bytes of messages.
            path = Path(shutil.copyfile(path, Path(folder, path.name)))
            os.truncate(path, size - cut_bytes)
        try:
            yield from _of_sqlite(path, is_wanted)
        except sqlite3.DatabaseError:
            if missing <= 0:
                raise
    if missing > 0:
        raise CutError(f"{missing} bytes are missing at its end")


def _of_sqlite(path: Path, is_wanted: Wanted) -> Messages:
    with contextlib.closing(sqlite3.connect(f"{path.resolve().as_uri()}?immutable=1", uri=True)) as database:
        # Without this a file that is shorter than its first page says is not opened.
        database.execute("PRAGMA writable_schema=ON")
        definitions: dict[str, str] = {}
        with contextlib.suppress(sqlite3.OperationalError):  # bags before version 4 have none
            query = "SELECT topic_type, encoded_message_definition FROM message_definitions"
            definitions = dict(database.execute(query).fetchall())
        topics = {
            number: topic
            for number, name, kind in database.execute("SELECT id, name, type FROM topics")
            if is_wanted(topic := Topic(name, kind, definitions.get(kind, "")))
        }
        wanted = ", ".join(str(int(number)) for number in topics)
        # By id is the order in which they were written; by time needs an index, whose pages may be lost.
        query = f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({wanted}) ORDER BY id"
        for number, arrived_ns, content in database.execute(query):
            yield topics[number], arrived_ns, content
