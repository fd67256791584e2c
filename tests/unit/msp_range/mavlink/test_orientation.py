"""Mountings against scipy's rotations of the angles that MAVLink's own descriptions of the enum give."""

import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from msp_range.mavlink.dialect import dialect
from msp_range.mavlink.orientation import CUSTOM, DOWN, NAMES, Orientation, orientation_of

Vector = NDArray[np.float64]

BREAKAWAY_RAD = math.radians(12.6)
"""Of the MB1242 at 200 cm."""


def described_angles_deg() -> dict[int, tuple[float, float, float]]:
    """Roll, pitch and yaw of every value but CUSTOM, read from its description; what it leaves out is 0."""
    angles_deg = {}
    for value, entry in dialect.enums["MAV_SENSOR_ORIENTATION"].items():
        named = {name: float(angle) for name, angle in re.findall(r"(Roll|Pitch|Yaw): (\d+)", entry.description)}
        if named:
            angles_deg[value] = (named.get("Roll", 0.0), named.get("Pitch", 0.0), named.get("Yaw", 0.0))
    return angles_deg


def rotation(roll_deg: float, pitch_deg: float, yaw_deg: float) -> Rotation:
    return Rotation.from_euler("ZYX", [yaw_deg, pitch_deg, roll_deg], degrees=True)


def looks_along(roll_deg: float, pitch_deg: float, yaw_deg: float) -> Vector:
    return np.asarray(rotation(roll_deg, pitch_deg, yaw_deg).apply([1.0, 0.0, 0.0]))


def angle_rad(a: Vector, b: Vector) -> float:
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


ANGLES_DEG = described_angles_deg()
AXES = {value: looks_along(*angles) for value, angles in ANGLES_DEG.items()}
FIRST_OF_AXIS = {
    value: min(other for other, other_axis in AXES.items() if np.allclose(axis, other_axis, atol=1e-9))
    for value, axis in AXES.items()
}


def orientation_of_deg(
    roll_deg: float, pitch_deg: float, yaw_deg: float, breakaway_rad: float = BREAKAWAY_RAD
) -> Orientation:
    return orientation_of(math.radians(roll_deg), math.radians(pitch_deg), math.radians(yaw_deg), breakaway_rad)


def test_the_enum_has_41_described_rotations_along_12_axes() -> None:
    assert sorted(ANGLES_DEG) == list(range(41))
    assert set(FIRST_OF_AXIS.values()) | {CUSTOM} == set(NAMES)


@pytest.mark.parametrize("value", sorted(ANGLES_DEG))
def test_every_mounting_of_the_enum_gets_the_first_value_of_its_axis(value: int) -> None:
    orientation = orientation_of_deg(*ANGLES_DEG[value])
    assert orientation.value == FIRST_OF_AXIS[value]
    assert orientation.quaternion == (0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("word", "axis"),
    [
        ("forward", (1, 0, 0)),
        ("right", (0, 1, 0)),
        ("rear", (-1, 0, 0)),
        ("left", (0, -1, 0)),
        ("down", (0, 0, 1)),
        ("up", (0, 0, -1)),
        ("forward right", (math.sqrt(0.5), math.sqrt(0.5), 0)),
        ("forward and down", (math.sqrt(0.5), 0, math.sqrt(0.5))),
    ],
)
def test_words_say_where_the_axis_points_in_the_body_frame(word: str, axis: tuple[float, float, float]) -> None:
    (value,) = [value for value, name in NAMES.items() if name == word]
    assert AXES[value] == pytest.approx(np.array(axis), abs=1e-9)


def test_straight_down_is_25_however_it_is_written() -> None:
    for pitch_deg in (-90.0, 270.0):
        for roll_deg, yaw_deg in ((0.0, 0.0), (90.0, 0.0), (0.0, 135.0), (-30.0, 200.0)):
            assert orientation_of_deg(roll_deg, pitch_deg, yaw_deg).value == DOWN == 25


@pytest.mark.parametrize("value", sorted(set(FIRST_OF_AXIS.values())))
@pytest.mark.parametrize("off_axis_deg", [9.99, 10.01])
def test_an_axis_is_claimed_as_far_as_the_sensor_hears_and_no_farther(value: int, off_axis_deg: float) -> None:
    _, pitch_deg, yaw_deg = ANGLES_DEG[value]
    for pitch_change_deg in (off_axis_deg, -off_axis_deg):
        orientation = orientation_of_deg(0.0, pitch_deg + pitch_change_deg, yaw_deg, math.radians(10.0))
        assert orientation.value == (value if off_axis_deg < 10.0 else CUSTOM)


def test_halfway_between_two_axes_the_lower_value_is_taken() -> None:
    wide_rad = math.radians(23.4)
    for step in range(8):
        neighbours = {step, (step + 1) % 8}
        assert orientation_of_deg(0.0, 0.0, 45.0 * step + 22.5, wide_rad).value == min(neighbours)


any_angle_deg = st.floats(-360.0, 360.0)


@given(roll_deg=any_angle_deg, pitch_deg=any_angle_deg, yaw_deg=any_angle_deg, breakaway_deg=st.floats(6.0, 60.0))
def test_any_mounting_gets_the_nearest_axis_or_its_own_quaternion(
    roll_deg: float, pitch_deg: float, yaw_deg: float, breakaway_deg: float
) -> None:
    boresight = looks_along(roll_deg, pitch_deg, yaw_deg)
    nearest_rad = min(angle_rad(boresight, axis) for axis in AXES.values())
    orientation = orientation_of_deg(roll_deg, pitch_deg, yaw_deg, math.radians(breakaway_deg))
    rounding_rad = 1e-7
    if orientation.value == CUSTOM:
        assert nearest_rad > math.radians(breakaway_deg) - rounding_rad
        w, x, y, z = orientation.quaternion
        sent = Rotation.from_quat([x, y, z, w])
        # Radians of any rotation between the two: the roll counts too.
        assert (sent * rotation(roll_deg, pitch_deg, yaw_deg).inv()).magnitude() == pytest.approx(0.0, abs=rounding_rad)
        assert w >= 0.0
        assert math.hypot(w, x, y, z) == pytest.approx(1.0, abs=1e-12)
    else:
        assert orientation.quaternion == (0.0, 0.0, 0.0, 0.0)
        off_axis_rad = angle_rad(boresight, AXES[orientation.value])
        assert off_axis_rad == pytest.approx(nearest_rad, abs=rounding_rad)
        assert off_axis_rad <= math.radians(breakaway_deg) + rounding_rad
