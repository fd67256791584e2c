"""The ROS 2 node of docs/examples: its messages as ROS encodes them, and its main path on a real bridge's socket."""

import importlib.util
import math
import sys
import time
from pathlib import Path
from threading import Thread
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
from rosbags.typesys import Stores, get_typestore

from msp_range.log import Log
from msp_range.watch.place import Outputs
from msp_range.watch.watch import Watch
from tests.support.bench import Bench, airframe
from tests.support.shipped import CONFIGS
from tests.support.waiting import LIMIT_S

STORE = get_typestore(Stores.ROS2_JAZZY)
SENSOR = {
    "name": "a",
    "in_fused": True,
    "minimum_m": 0.2,
    "maximum_m": 7.65,
    "half_angle_deg": [[0.5, 23.4], [2.0, 12.6], [7.0, 11.0]],
}
NANO = 10**9


@pytest.fixture
def node() -> Any:
    spec = importlib.util.spec_from_file_location("ros2_node", CONFIGS.parent / "docs" / "examples" / "ros2_node.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def message(kind: str, content: dict[str, Any]) -> Any:
    """The dict as a message of rosbags, encoded and decoded again as CDR."""

    def made(name: str, values: dict[str, Any]) -> Any:
        return STORE.types[name](**values)

    def header(values: dict[str, Any]) -> Any:
        stamp = made("builtin_interfaces/msg/Time", values["stamp"])
        return made("std_msgs/msg/Header", {"stamp": stamp, "frame_id": values["frame_id"]})

    content = content | {"header": header(content["header"])}
    if "status" in content:
        content["status"] = [
            made(
                "diagnostic_msgs/msg/DiagnosticStatus",
                entry | {"values": [made("diagnostic_msgs/msg/KeyValue", pair) for pair in entry["values"]]},
            )
            for entry in content["status"]
        ]
    return STORE.deserialize_cdr(STORE.serialize_cdr(made(kind, content), kind), kind)


@pytest.mark.parametrize(
    ("reading", "range_m"),
    [
        ({"status": "ok", "corrected_m": 2.5, "std_m": 0.02}, 2.5),
        ({"status": "at_minimum", "corrected_m": 0.2, "std_m": 0.02}, -math.inf),
        ({"status": "no_echo"}, math.inf),
        ({"status": "no_answer"}, math.nan),
        ({"status": "impossible"}, math.nan),
    ],
)
def test_a_range_follows_rep_117(node: Any, reading: dict[str, Any], range_m: float) -> None:
    content = node.sensor_range("a", SENSOR, {"time_s": 10.25, **reading}, 1.7e9)
    found = message("sensor_msgs/msg/Range", content)
    assert found.range == pytest.approx(range_m, nan_ok=True)
    assert (found.header.stamp.sec, found.header.stamp.nanosec) == (1_700_000_010, NANO // 4)
    assert (found.header.frame_id, found.radiation_type) == ("msp_range_a", found.ULTRASOUND)
    assert (found.min_range, found.max_range) == pytest.approx((0.2, 7.65))
    # The whole beam, at the distance; without one at the longest.
    half_deg = 12.6 if range_m == 2.5 else 11.0
    assert found.field_of_view == pytest.approx(math.radians(2 * half_deg))
    assert found.variance == pytest.approx(0.0004 if "std_m" in reading else 0.0)


def test_the_fused_distance_has_the_limits_of_its_sensors(node: Any) -> None:
    other = SENSOR | {"name": "b", "minimum_m": 0.3, "maximum_m": 5.0}
    aside = SENSOR | {"name": "c", "in_fused": False, "maximum_m": 40.0}
    content = node.fused_range([SENSOR, other, aside], {"time_s": 1.0, "range_m": 3.0, "variance_m2": 0.01}, 0.0)
    found = message("sensor_msgs/msg/Range", content)
    assert found.header.frame_id == "msp_range_fused"
    assert (found.range, found.min_range, found.max_range) == pytest.approx((3.0, 0.2, 7.65))


def test_a_fault_is_an_error_of_its_sensor(node: Any) -> None:
    sensors = {
        "a": {"fault": None, "readings": 9, "rejected": {}},
        "b": {"fault": "no answer", "readings": 8, "rejected": {"no_answer": 3}},
    }
    status = {"state": "critical", "uptime_s": 2.0, "sensors": sensors, "faults": [{"text": "Range b: no answer"}]}
    found = message("diagnostic_msgs/msg/DiagnosticArray", node.diagnostics(status, 5.0))
    assert [(entry.name, entry.level, entry.message) for entry in found.status] == [
        ("msp_range: a", 0, "good"),
        ("msp_range: b", 2, "no answer"),
        ("msp_range: bridge", 1, "Range b: no answer"),
    ]
    assert [(pair.key, pair.value) for pair in found.status[1].values] == [("readings", "8"), ("no_answer", "3")]


class Range:
    """As in Humble: without a variance."""

    def __init__(self) -> None:
        self.header = SimpleNamespace(stamp=SimpleNamespace(sec=0, nanosec=0), frame_id="")
        self.radiation_type, self.range = 0, 0.0
        self.field_of_view = self.min_range = self.max_range = 0.0


class DiagnosticStatus:
    def __init__(self) -> None:
        self.level, self.name, self.message, self.hardware_id, self.values = b"\x00", "", "", "", list[Any]()


class KeyValue:
    def __init__(self) -> None:
        self.key = self.value = ""


class DiagnosticArray:
    def __init__(self) -> None:
        self.header = Range().header
        self.status: list[Any] = []


def stand_in(published: list[tuple[str, Any]]) -> dict[str, ModuleType | SimpleNamespace]:
    """The modules that the node imports."""

    def create_publisher(kind: type, topic: str, depth: int) -> SimpleNamespace:
        return SimpleNamespace(publish=lambda content: published.append((topic, content)))

    made = SimpleNamespace(create_publisher=create_publisher, destroy_node=lambda: None)
    rclpy = SimpleNamespace(init=lambda: None, shutdown=lambda: None, create_node=lambda name: made)
    diagnostic = SimpleNamespace(DiagnosticArray=DiagnosticArray, DiagnosticStatus=DiagnosticStatus, KeyValue=KeyValue)
    return {
        "rclpy": rclpy,
        "diagnostic_msgs": SimpleNamespace(msg=diagnostic),
        "diagnostic_msgs.msg": diagnostic,
        "sensor_msgs": SimpleNamespace(msg=SimpleNamespace(Range=Range)),
        "sensor_msgs.msg": SimpleNamespace(Range=Range),
    }


def test_its_main_path_publishes_a_bridge_until_that_ends(
    node: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    published: list[tuple[str, Any]] = []
    for name, module in stand_in(published).items():
        monkeypatch.setitem(sys.modules, name, module)
    path = tmp_path / "new" / "status.sock"
    monkeypatch.setattr(node, "SOCKETS", (str(path),))
    bench = Bench(airframe(), 300)
    watch = Watch(bench.bridge, bench.wire, Outputs(None, path, None), bench.clock.now(), Log("json"))
    thread = Thread(target=node.main, daemon=True)
    thread.start()
    end_s = time.monotonic() + LIMIT_S
    while not {"~/range/d", "~/fused", "/diagnostics"} <= {topic for topic, _ in published[:]}:
        assert time.monotonic() < end_s
        bench.steps += bench.bridge.step()
        watch.service(bench.clock.now())
    watch.close()
    thread.join(LIMIT_S)
    assert not thread.is_alive()
    by_topic = dict(published)
    assert by_topic["~/range/d"].range == pytest.approx(3.0, abs=0.01)
    assert by_topic["~/range/d"].header.frame_id == "msp_range_d"
    assert by_topic["~/fused"].range == pytest.approx(3.0, abs=0.01)
    assert [entry.level for entry in by_topic["/diagnostics"].status[:4]] == [b"\x00"] * 4


def test_without_a_bridge_it_says_so(node: Any, tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="no bridge runs"):
        node.connect([str(tmp_path / "none.sock")])
