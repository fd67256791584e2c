"""DISTANCE_SENSOR: every field against MAVLink's definition, packed and taken apart by hand."""

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from msp_range.mavlink.dialect import dialect
from msp_range.mavlink.distance_sensor import Autopilot, Stream, distance_sensor
from msp_range.mavlink.orientation import CUSTOM, DOWN, PITCH_90, Orientation
from tests.support.mavlink_ends import read_distance_sensor

NO_QUATERNION = (0.0, 0.0, 0.0, 0.0)
DOWNWARD = Stream(10, Orientation(DOWN, NO_QUATERNION), 20, 765, "ardupilot")


def fields(message: Any) -> dict[str, Any]:
    """What the message's frame holds, read without pymavlink."""
    read = read_distance_sensor(message.pack(dialect.MAVLink(None, srcSystem=1, srcComponent=191)))
    assert read is not None
    return read


def current_cm(range_m: float, stream: Stream = DOWNWARD) -> int:
    return int(fields(distance_sensor(stream, 0, range_m, 0.0004, 0.4, 80))["current_distance"])


def covariance(variance_m2: float) -> int:
    return int(fields(distance_sensor(DOWNWARD, 0, 3.0, variance_m2, 0.4, 80))["covariance"])


def quality(asked: int) -> int:
    return int(fields(distance_sensor(DOWNWARD, 0, 3.0, 0.0004, 0.4, asked))["signal_quality"])


def test_every_field_of_a_distance() -> None:
    stream = Stream(7, Orientation(CUSTOM, (0.5, -0.5, 0.5, -0.5)), 20, 765, "ardupilot")
    message = distance_sensor(stream, 123456, 3.0149, 0.00035, 0.25, 83)
    assert fields(message) == {
        "time_boot_ms": 123456,
        "min_distance": 19,
        "max_distance": 765,
        "current_distance": 301,
        "type": 1,  # ultrasound
        "id": 7,
        "orientation": 100,
        "covariance": 4,  # 3.5 cm^2, rounded up
        "horizontal_fov": 0.25,
        "vertical_fov": 0.25,
        "quaternion": [0.5, -0.5, 0.5, -0.5],
        "signal_quality": 83,
    }


def test_pymavlink_reads_the_same_fields() -> None:
    frame = distance_sensor(DOWNWARD, 99, 2.5, 0.0009, 0.5, 100).pack(dialect.MAVLink(None, 1, 191))
    (read,) = dialect.MAVLink(None).parse_buffer(frame)
    assert (read.get_srcSystem(), read.get_srcComponent(), read.get_type()) == (1, 191, "DISTANCE_SENSOR")
    assert (read.current_distance, read.covariance, read.signal_quality, read.orientation) == (250, 9, 100, 25)
    assert read.quaternion == list(NO_QUATERNION)


@pytest.mark.parametrize(
    ("range_m", "expected_cm"),
    [(2.004, 200), (2.006, 201), (0.0, 20), (-1.0, 20), (0.196, 20), (7.65, 765), (7.7, 765), (1e300, 765)],
)
def test_a_distance_is_whole_centimetres_within_what_the_sensor_reports(range_m: float, expected_cm: int) -> None:
    assert current_cm(range_m) == expected_cm


def test_the_shortest_report_lies_above_the_minimum() -> None:
    message = fields(distance_sensor(DOWNWARD, 0, 0.20, 0.0004, 0.8, 80))
    assert message["min_distance"] < message["current_distance"] == 20


@pytest.mark.parametrize(
    ("variance_m2", "expected_cm2"),
    [
        (0.0, 1),
        (0.0001, 1),
        (0.00010001, 2),
        (0.0253, 253),
        (0.0254, 254),
        (0.5, 254),
        (1e308, 254),
        (math.inf, 255),
        (math.nan, 255),
    ],
)
def test_the_variance_is_never_called_smaller_than_it_is_and_255_only_where_unknown(
    variance_m2: float, expected_cm2: int
) -> None:
    assert covariance(variance_m2) == expected_cm2


def test_the_quality_of_a_distance_is_never_unknown_and_never_invalid() -> None:
    assert [quality(asked) for asked in (-1, 0, 1, 2, 50, 100, 101)] == [2, 2, 2, 2, 50, 100, 100]


@pytest.mark.parametrize("range_m", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_is_refused(range_m: float) -> None:
    with pytest.raises(ValueError, match="cannot be sent"):
        distance_sensor(DOWNWARD, 0, range_m, 0.0004, 0.4, 80)


@pytest.mark.parametrize(
    ("autopilot", "orientation", "expected_cm"),
    [
        ("ardupilot", DOWN, 766),
        ("ardupilot", 0, 766),
        ("px4", DOWN, 766),
        ("px4", PITCH_90, 766),
        ("px4", 0, 765),
        ("px4", CUSTOM, 765),
    ],
)
def test_no_echo_is_what_the_autopilot_takes_for_far_away(
    autopilot: Autopilot, orientation: int, expected_cm: int
) -> None:
    stream = Stream(3, Orientation(orientation, NO_QUATERNION), 20, 765, autopilot)
    message = fields(distance_sensor(stream, 5, None, math.inf, 0.44, 80))
    assert message["current_distance"] == expected_cm
    assert (message["min_distance"], message["max_distance"]) == (19, 765)
    assert (message["covariance"], message["signal_quality"]) == (255, 1)
    assert (message["time_boot_ms"], message["id"], message["orientation"]) == (5, 3, orientation)
    assert message["horizontal_fov"] == message["vertical_fov"] == pytest.approx(0.44)


def test_time_wraps_after_49_7_days_as_the_autopilots_own_does() -> None:
    assert fields(distance_sensor(DOWNWARD, 2**32 - 1, 2.0, 0.0, 0.4, 80))["time_boot_ms"] == 2**32 - 1
    assert fields(distance_sensor(DOWNWARD, 2**32 + 5, 2.0, 0.0, 0.4, 80))["time_boot_ms"] == 5


@given(
    time_boot_ms=st.integers(0, 2**63),
    range_m=st.floats(allow_nan=False, allow_infinity=False),
    variance_m2=st.floats(),
    field_of_view_rad=st.floats(0.0, math.tau),
    quality=st.integers(),
    id=st.integers(1, 254),
    orientation=st.sampled_from([*range(41), CUSTOM]),
    autopilot=st.sampled_from(["ardupilot", "px4"]),
)
def test_whatever_is_sent_packs_and_means_something(
    time_boot_ms: int,
    range_m: float,
    variance_m2: float,
    field_of_view_rad: float,
    quality: int,
    id: int,
    orientation: int,
    autopilot: Autopilot,
) -> None:
    stream = Stream(id, Orientation(orientation, NO_QUATERNION), 20, 765, autopilot)
    message = fields(distance_sensor(stream, time_boot_ms, range_m, variance_m2, field_of_view_rad, quality))
    assert message["min_distance"] < message["current_distance"] <= message["max_distance"]
    assert 1 <= message["covariance"] <= 255
    assert 2 <= message["signal_quality"] <= 100
    # Single precision on the wire: half a unit of its last of 24 bits.
    assert message["horizontal_fov"] == pytest.approx(field_of_view_rad, rel=2**-24, abs=1e-44)
    no_echo = fields(distance_sensor(stream, time_boot_ms, None, variance_m2, field_of_view_rad, quality))
    assert no_echo["current_distance"] >= message["current_distance"]
