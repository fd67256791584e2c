"""Telemetry logs and ROS bags of a flight of 30 s, written by pymavlink and rosbags."""

from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from msp_range.mavlink.dialect import dialect

START_S = 1_790_000_000
START_US = START_S * 1_000_000
Messages = list[tuple[float, int, Any]]


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


def write_telemetry(path: Path, messages: Messages) -> Path:
    link = dialect.MAVLink(None, 1, 1)
    with path.open("wb") as file:
        for time_s, component, message in messages:
            link.srcComponent = component
            file.write(round(START_US + 1e6 * time_s).to_bytes(8, "big") + message.pack(link))
    return path


class Types:
    """Messages of one version of ROS."""

    def __init__(self, store: Stores) -> None:
        self.store = get_typestore(store)
        self.is_1 = store is Stores.ROS1_NOETIC

    def make(self, kind: str, **fields: Any) -> Any:
        return self.store.types[kind](**fields)

    def header(self, time_s: float) -> Any:
        stamp = self.make("builtin_interfaces/msg/Time", sec=START_S + int(time_s), nanosec=round(time_s % 1.0 * 1e9))
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


def write_bag(path: Path, form: str, others: int = 0) -> Path:
    """A bag of this form, with this many messages of another topic after each; what is to be opened."""
    types = Types(Stores.ROS1_NOETIC if form == "ros1" else Stores.ROS2_HUMBLE)
    writer: Any
    if form == "ros1":
        writer = Writer1(path / "flight.bag")
        written_to = path / "flight.bag"
    else:
        plugin = StoragePlugin.MCAP if form == "mcap" else StoragePlugin.SQLITE3
        writer = Writer2(path / "flight", version=9, storage_plugin=plugin)
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
            writer.write(connections[topic], round((START_S + time_s) * 1e9), serialize(message, kind))
    return written_to
