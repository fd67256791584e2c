"""Logs of a flight of 30 s, written by pymavlink and rosbags, and logs of any kind whose clock is set on the way."""

import re
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink.DFReader import DFReader_binary
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from msp_range.clock import VirtualClock
from msp_range.mavlink.dialect import dialect
from msp_range.recording.csv_form import MeasuredData, write_csv
from msp_range.recording.writer import Recorder

START_S = 1_790_000_000
START_US = START_S * 1_000_000
Messages = list[tuple[float, int, Any]]
Clock = Callable[[float], float]
"""What a log's clock shows at a time [s]."""
LOGS = Path(__file__).parents[1] / "data" / "logs"
FORMS = ("bin", "ulg", "tlog", "ros1", "sqlite3", "mcap", "csv", "recording")
"""Every kind of log that is read."""


def right(time_s: float) -> float:
    return time_s


def set_by(step_s: float, at_s: float = 15.0) -> Clock:
    """A clock that is set forward by this at some time of the log, or back."""
    return lambda time_s: time_s + (step_s if time_s >= at_s else 0.0)


def height_m(time_s: float) -> float:
    return float(3.0 + 2.0 * np.sin(time_s / 3.0))


def telemetry(posz: float = 1.0) -> Messages:
    """What an autopilot (component 1) and the bridge (191) send in 30 s, with the component of each message."""
    found: Messages = [
        (0.0, 1, dialect.MAVLink_param_value_message(name.encode(), value, 9, 2, number))
        for number, (name, value) in enumerate({"EK3_SRC1_POSZ": posz, "EK3_RNG_USE_HGT": -1.0}.items())
    ]
    for step in range(600):
        time_s = 0.05 * step
        range_cm = round(100.0 * height_m(time_s - 0.1)) if step % 50 else 800
        distance = dialect.MAVLink_distance_sensor_message
        found.append((time_s, 191, distance(step * 50, 20, 765, range_cm, 0, 10, 25, 4, signal_quality=100)))
        if step % 2:  # every other one has an invalid signal
            found.append((time_s, 1, distance(step * 50, 20, 765, 300, 0, 0, 0, 0, signal_quality=step % 4 == 1)))
        found.append((time_s, 1, dialect.MAVLink_attitude_message(step * 50, 0.1, -0.2, 1.0, 0.0, 0.0, 0.0)))
        rate_cm_s = round(100.0 * 2.0 / 3.0 * np.cos(time_s / 3.0))
        place = (step * 50, 0, 0, 0, round(1e3 * height_m(time_s)), 0, 0, -rate_cm_s, 0)
        found.append((time_s, 1, dialect.MAVLink_global_position_int_message(*place)))
        found.append((time_s, 1, dialect.MAVLink_vfr_hud_message(0.0, 0.0, 0, 42, 0.0, 0.0)))
    return found


def write_telemetry(path: Path, messages: Messages, clock: Clock = right) -> Path:
    link = dialect.MAVLink(None, 1, 1)
    with path.open("wb") as file:
        for time_s, component, message in messages:
            link.srcComponent = component
            file.write(round(START_US + 1e6 * clock(time_s)).to_bytes(8, "big") + message.pack(link))
    return path


class Types:
    """Messages of one version of ROS."""

    def __init__(self, store: Stores, clock: Clock = right) -> None:
        self.clock = clock
        self.store = get_typestore(store)
        self.is_1 = store is Stores.ROS1_NOETIC

    def make(self, kind: str, **fields: Any) -> Any:
        return self.store.types[kind](**fields)

    def header(self, time_s: float) -> Any:
        time_s = self.clock(time_s)
        stamp = self.make(
            "builtin_interfaces/msg/Time", sec=START_S + int(time_s // 1.0), nanosec=round(time_s % 1.0 * 1e9)
        )
        number = {"seq": 0} if self.is_1 else {}
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id="map", **number)

    def messages(self) -> list[tuple[float, str, Any]]:
        """What a flight of 30 s has: when it was recorded, the topic, and the message."""
        found: list[tuple[float, str, Any]] = []
        sines = {"x": np.sin(0.05), "y": 0.0, "z": 0.0, "w": np.cos(0.05)}
        for step in range(600):
            time_s = 0.05 * step
            range_m = height_m(time_s - 0.1) if step % 50 else np.inf
            limits = {"radiation_type": 0, "field_of_view": 0.5, "min_range": 0.2, "max_range": 7.65}
            header = self.header(time_s)
            ranged = self.make("sensor_msgs/msg/Range", header=header, range=range_m, **limits)
            # The recorder writes it later than it was made.
            found.append((time_s + 0.02, "/sonar/down", ranged))
            place = self.make("geometry_msgs/msg/Point", x=0.0, y=0.0, z=height_m(time_s))
            turn = self.make("geometry_msgs/msg/Quaternion", **sines)
            pose = self.make("geometry_msgs/msg/Pose", position=place, orientation=turn)
            for topic in ("/vrpn/drone/pose", "/mavros/local_position/pose"):
                found.append((time_s, topic, self.make("geometry_msgs/msg/PoseStamped", header=header, pose=pose)))
            zero = self.make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
            unknown = {
                f"{name}_covariance": np.zeros(9) for name in ("orientation", "angular_velocity", "linear_acceleration")
            }
            imu = {"orientation": turn, "angular_velocity": zero, "linear_acceleration": zero}
            found.append((time_s, "/imu", self.make("sensor_msgs/msg/Imu", header=header, **imu, **unknown)))
            air = self.make("sensor_msgs/msg/Temperature", header=header, temperature=11.5, variance=0.0)
            found.append((time_s, "/weather/temperature", air))
        return found


def write_bag(
    path: Path,
    form: str,
    others: int = 0,
    clock: Clock = right,
    arrived: Clock | None = None,
    packed: CompressionMode = CompressionMode.NONE,
) -> Path:
    """A bag of this form, with this many messages of another topic after each; what is to be opened."""
    types = Types(Stores.ROS1_NOETIC if form == "ros1" else Stores.ROS2_HUMBLE, clock)
    writer: Any
    if form == "ros1":
        writer = Writer1(path / "flight.bag")
        written_to = path / "flight.bag"
    else:
        plugin = StoragePlugin.MCAP if form == "mcap" else StoragePlugin.SQLITE3
        writer = Writer2(path / "flight", version=9, storage_plugin=plugin)
        if packed is not CompressionMode.NONE:
            writer.set_compression(packed, CompressionFormat.ZSTD)
        written_to = path / "flight"
    other = types.make("std_msgs/msg/UInt8", data=0)
    connections: dict[str, Any] = {}
    with writer:
        messages = (
            (time_s, each) for time_s, *flown in types.messages() for each in (flown, *[("/other", other)] * others)
        )
        for time_s, (topic, message) in messages:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=types.store)
            serialize = types.store.serialize_ros1 if types.is_1 else types.store.serialize_cdr
            writer.write(
                connections[topic], round((START_S + (arrived or clock)(time_s)) * 1e9), serialize(message, kind)
            )
    return written_to


def write_log(folder: Path, form: str, clock: Clock = right) -> Path:
    """A log of any of `FORMS` with this clock."""
    if form in ("ros1", "sqlite3", "mcap"):
        return write_bag(folder, form, clock=clock)
    if form == "tlog":
        return write_telemetry(folder / "flight.tlog", telemetry(), clock)
    if form in ("bin", "ulg"):
        source, change = (LOGS / "arducopter.BIN", _dataflash) if form == "bin" else (LOGS / "px4.ulg", _ulog)
        (folder / f"flight.{form}").write_bytes(change(source, clock))
        return folder / f"flight.{form}"
    return _write_table(folder, clock) if form == "csv" else _write_recording(folder, clock)


def _dataflash(source: Path, clock: Clock) -> bytes:
    """The log with other times in all messages that begin with one."""
    content = bytearray(source.read_bytes())
    log = DFReader_binary(str(source))
    timed = [kind for kind, form in log.formats.items() if form.columns[:1] == ["TimeUS"]]
    places = sorted(at + 3 for kind in timed for at in log.offsets[kind])
    log.close()
    return _set(content, [(at,) for at in places], clock)


def _ulog(source: Path, clock: Clock) -> bytes:
    """The log with other times of messages, and of their samples."""
    content = bytearray(source.read_bytes())
    sampled, topics, places, at = set[bytes](), dict[int, bytes](), list[tuple[int, ...]](), 16
    while at < len(content):
        size, kind = struct.unpack_from("<HB", content, at)
        body = bytes(content[at + 3 : at + 3 + size])
        if kind == ord("F") and (found := re.match(rb"(\w+):uint64_t timestamp;uint64_t timestamp_sample;", body)):
            sampled.add(found[1])
        elif kind == ord("A"):
            topics[int.from_bytes(body[1:3], "little")] = body[3:]
        elif kind == ord("D"):
            name = topics[int.from_bytes(body[:2], "little")]
            places.append((at + 5, at + 13) if name in sampled else (at + 5,))
        at += 3 + size
    return _set(content, places, clock)


def _set(content: bytearray, places: list[tuple[int, ...]], clock: Clock) -> bytes:
    """Bytes with other microseconds at these places, those of one message in one tuple, counted from the earliest."""
    stamps = [struct.unpack_from("<Q", content, at)[0] for at, *_ in places]
    start = min(stamps)
    for message, stamp in zip(places, stamps, strict=True):
        later = round(1e6 * (clock((stamp - start) / 1e6) - (stamp - start) / 1e6))
        for at in message:
            struct.pack_into("<Q", content, at, struct.unpack_from("<Q", content, at)[0] + later)
    return bytes(content)


def _write_table(folder: Path, clock: Clock) -> Path:
    time_s = 0.05 * np.arange(600.0)
    height_cm = np.array([100.0 * height_m(each) for each in time_s])
    columns = {
        "time_s": np.array([clock(each) for each in time_s]),
        "sensor": np.full(600, "down"),
        "reading_cm": np.round(height_cm),
        "true_range_cm": height_cm,
        "uptime_s": time_s,
    }
    write_csv(folder / "flight.csv", MeasuredData(columns))
    return folder / "flight.csv"


def _write_recording(folder: Path, clock: Clock) -> Path:
    recorder = Recorder(folder / "flight.mcap", VirtualClock())
    for step in range(600):
        at_s = 0.05 * step
        range_cm = 100.0 * height_m(at_s)
        recorder.write("/truth/down", at_s, {"true_range_cm": range_cm})
        stamps = dict.fromkeys(("time_s", "ping_s", "read_s"), clock(at_s))
        recorder.write("/range/down", at_s, stamps | {"status": "ok", "raw": round(range_cm)})
    recorder.close()
    return folder / "flight.mcap"
