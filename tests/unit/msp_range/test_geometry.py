"""Rotations against scipy's, which counts intrinsic z-y'-x'' as 'ZYX'."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from msp_range.geometry import (
    angle_between,
    boresight,
    dot,
    down_axis,
    quaternion,
    rotate,
    rotate_back,
    rotation_matrix,
)

ANGLES_RAD = [
    *np.random.default_rng(5).uniform(-2 * math.pi, 2 * math.pi, size=(40, 3)),
    *np.radians([(0, 0, 0), (0, -90, 0), (0, 90, 0), (90, -80, 270), (180, 0, 180), (-360, 360, 0)]),
]


@pytest.mark.parametrize("angles_rad", ANGLES_RAD)
def test_a_rotation_is_scipys(angles_rad: np.ndarray) -> None:
    roll, pitch, yaw = angles_rad
    independent = Rotation.from_euler("ZYX", [yaw, pitch, roll])
    np.testing.assert_allclose(rotation_matrix(roll, pitch, yaw), independent.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(boresight(roll, pitch, yaw), independent.apply([1, 0, 0]), atol=1e-12)
    np.testing.assert_allclose(down_axis(roll, pitch), independent.inv().apply([0, 0, 1]), atol=1e-12)
    turned = rotate(rotation_matrix(roll, pitch, yaw), (0.3, -2.0, 5.0))
    np.testing.assert_allclose(turned, independent.apply([0.3, -2.0, 5.0]), atol=1e-12)
    assert rotate_back(rotation_matrix(roll, pitch, yaw), turned) == pytest.approx((0.3, -2.0, 5.0))
    w, *xyz = quaternion(roll, pitch, yaw)
    assert w >= 0
    assert w * w + sum(each * each for each in xyz) == pytest.approx(1.0)
    np.testing.assert_allclose(Rotation.from_quat([*xyz, w]).as_matrix(), independent.as_matrix(), atol=1e-12)


@pytest.mark.parametrize(
    ("pitch_deg", "yaw_deg", "looks"),
    [(0, 0, (1, 0, 0)), (0, 90, (0, 1, 0)), (0, 270, (0, -1, 0)), (-90, 0, (0, 0, 1)), (90, 33, (0, 0, -1))],
)
def test_body_axes_are_forward_right_down(pitch_deg: float, yaw_deg: float, looks: tuple[float, float, float]) -> None:
    assert boresight(0.7, math.radians(pitch_deg), math.radians(yaw_deg)) == pytest.approx(looks, abs=1e-12)


@pytest.mark.parametrize("angle_rad", [0.0, 1e-9, 1e-4, 0.5, math.pi / 2, 3.0, math.pi - 1e-9, math.pi])
def test_angle_between_is_exact_also_near_nothing_and_half_a_turn(angle_rad: float) -> None:
    turned = (math.cos(angle_rad), math.sin(angle_rad), 0.0)
    assert angle_between((1.0, 0.0, 0.0), turned) == pytest.approx(angle_rad, abs=1e-15, rel=1e-9)
    assert dot((1.0, 0.0, 0.0), turned) == pytest.approx(math.cos(angle_rad))
