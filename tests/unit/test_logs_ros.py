"""Bags of ROS 1 and 2, written by rosbags, as logs; cut, damaged, and with topics that are not known."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from msp_lab.logs.log import Log
from msp_lab.logs.opening import open_log
from msp_range.recording.error import RecordingError

START_S = 1_790_000_000


def nothing(share: float) -> None:
    pass


def height_m(time_s: float) -> float:
    return float(3.0 + 2.0 * np.sin(time_s / 3.0))


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


def written(path: Path, form: str) -> Path:
    """A bag of this form; what is to be opened."""
    types = Types(Stores.ROS1_NOETIC if form == "ros1" else Stores.ROS2_HUMBLE)
    writer: Any
    if form == "ros1":
        writer = Writer1(path / "flight.bag")
        written_to = path / "flight.bag"
    else:
        plugin = StoragePlugin.MCAP if form == "mcap" else StoragePlugin.SQLITE3
        writer = Writer2(path / "flight", version=9, storage_plugin=plugin)
        written_to = path / "flight"
    connections: dict[str, Any] = {}
    with writer:
        for time_s, topic, message in types.messages():
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=types.store)
            serialize = types.store.serialize_ros1 if types.is_1 else types.store.serialize_cdr
            writer.write(connections[topic], round((START_S + time_s) * 1e9), serialize(message, kind))
    return written_to


def check(log: Log) -> None:
    (ranger,) = log.rangers
    assert ranger.name == "sonar_down"
    assert ranger.maximum_cm == pytest.approx(765.0, abs=1e-3)
    # Infinite is out of range; the stamp of the header counts, not when it was recorded.
    assert ranger.series.values[0] == pytest.approx(765.0, abs=1e-3)
    assert ranger.series.values[1] == pytest.approx(100.0 * height_m(-0.05), abs=1e-3)
    assert ranger.series.time_s[1] - ranger.series.time_s[0] == pytest.approx(0.05, abs=1e-6)
    mocap, own = log.references
    assert (mocap.kind, mocap.refused, own.kind) == ("mocap", "", "ekf")
    assert "does not say" in own.refused
    assert mocap.series.at(ranger.series.time_s[[40]])[0] == pytest.approx(height_m(2.0), abs=1e-6)
    # Half the angle is in the quaternion.
    assert log.context["tilt_deg"].values[3] == pytest.approx(np.degrees(0.1), 1e-6)
    assert log.context["air_temperature_c"].values[3] == 11.5


@pytest.mark.parametrize("form", ["ros1", "sqlite3", "mcap"])
def test_each_form_gives_the_same(tmp_path: Path, form: str) -> None:
    check(open_log(written(tmp_path, form), nothing))


@pytest.mark.parametrize("form", ["sqlite3", "mcap"])
def test_a_single_file_of_a_bag_is_enough(tmp_path: Path, form: str) -> None:
    folder = written(tmp_path, form)
    (file,) = [each for each in folder.iterdir() if each.suffix != ".yaml"]
    check(open_log(file, nothing))


def test_any_field_of_a_topic(tmp_path: Path) -> None:
    path = written(tmp_path, "ros1")
    reference = open_log(path, nothing, field="/vrpn/drone/pose.pose.orientation.w").references[-1]
    assert (reference.kind, reference.series.values[0]) == ("column", pytest.approx(np.cos(0.05)))
    with pytest.raises(RecordingError, match="orientation"):
        open_log(path, nothing, field="/vrpn/drone/pose.orientation.w")


@pytest.mark.parametrize("form", ["ros1", "sqlite3", "mcap"])
@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.95])
def test_a_cut_bag_is_a_line_or_what_is_whole(tmp_path: Path, form: str, share: float) -> None:
    path = written(tmp_path, form)
    (file,) = [each for each in (path.iterdir() if path.is_dir() else [path]) if each.suffix != ".yaml"]
    file.write_bytes(file.read_bytes()[: int(share * file.stat().st_size)])
    try:
        lines = [each.name for each in open_log(path, nothing).rangers]
    except RecordingError as error:
        lines = str(error).splitlines()
    assert len(lines) == 1
