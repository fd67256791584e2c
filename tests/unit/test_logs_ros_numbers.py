"""Numbers of serialized ROS messages, compared with the messages that rosbags makes of them."""

from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from msp_lab.logs.log import number_at
from msp_lab.logs.ros import _FIELDS
from msp_lab.logs.ros_numbers import numbers_of

RNG = np.random.default_rng(1)
STORES = {"ros1": get_typestore(Stores.ROS1_NOETIC), "ros2": get_typestore(Stores.ROS2_HUMBLE)}
for store in STORES.values():
    store.register(get_types_from_msg("std_msgs/Header header\nfloat32 throttle\n", "mavros_msgs/msg/VfrHud"))
    store.register(get_types_from_msg("std_msgs/Header header\nfloat32 throttle\n", "mavros_msgs/msg/VFR_HUD"))
    mixed = "string a\nbool b\nint64 c\nstring d\nuint8 e\nint16[3] f\nfloat64 g\n"
    store.register(get_types_from_msg(mixed, "made_msgs/msg/Mixed"))
    store.register(get_types_from_msg("float32[] many\nfloat32 one\n", "made_msgs/msg/Many"))


def made(store: Any, kind: str, text: str) -> Any:
    """A message of random numbers, whose texts are all the same."""
    numbers = {"bool": True, "string": text}
    fields = {}
    for name, (node, about) in store.fielddefs[kind][1]:
        if node == 2:
            fields[name] = made(store, about, text)
        elif node == 1:
            value = float(np.float32(RNG.normal())) if about[0].startswith("float") else int(RNG.integers(0, 100))
            fields[name] = numbers.get(about[0], value)
        else:
            (_, (base, _)), length = about
            fields[name] = RNG.integers(0, 100, length or 2).astype(base)
    return store.types[kind](**fields)


@pytest.mark.parametrize("version", ["ros1", "ros2"])
@pytest.mark.parametrize(
    ("kind", "paths"),
    [
        ("made_msgs/msg/Mixed", ("g", "b", "c", "f.1", "e")),
        *((kind, ("header.stamp.sec", "header.stamp.nanosec", *paths)) for kind, paths in _FIELDS.items()),
    ],
)
def test_numbers_are_those_of_the_message(version: str, kind: str, paths: tuple[str, ...]) -> None:
    store, is_ros1 = STORES[version], version == "ros1"
    numbers = numbers_of(store, kind, is_ros1, paths)
    assert numbers is not None
    for length in range(12):
        message = made(store, kind, "m" * length)
        pack = store.serialize_ros1 if is_ros1 else store.serialize_cdr
        content = bytes(pack(message, kind))
        assert numbers(content) == [number_at(path)(message) for path in paths]
        # What is not whole, goes on, or has a text that may be damaged, is for rosbags.
        assert numbers(content[:-1]) is numbers(content + b"\0") is numbers(b"") is None
        if length:
            assert numbers(content.replace(b"m", b"\xff", 1)) is None


def test_big_endian_messages_and_those_with_sequences_are_left_to_rosbags() -> None:
    store = STORES["ros2"]
    kind = "sensor_msgs/msg/Temperature"
    numbers = numbers_of(store, kind, False, ("temperature",))
    message = made(store, kind, "map")
    assert numbers is not None
    assert numbers(bytes(store.serialize_cdr(message, kind))) == [message.temperature]
    assert numbers(bytes(store.serialize_cdr(message, kind, little_endian=False))) is None
    assert numbers_of(store, "made_msgs/msg/Many", False, ("one",)) is None
    assert numbers_of(store, kind, False, ("heat",)) is numbers_of(store, "made_msgs/msg/None", False, ("one",)) is None
