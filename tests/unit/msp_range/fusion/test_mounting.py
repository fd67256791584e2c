"""What a sensor reads over a plane: against geometry by numpy, and its derivatives against differences."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from msp_range.fusion.mounting import LEVEL, DownwardSensor, Oblique, spans_plane
from msp_range.geometry import boresight, rotation_matrix

ANGLES_DEG = [(0.0, 0.0, 0.0), (5.0, -8.0, 70.0), (-12.0, 3.0, 200.0)]


def reads(sensor: DownwardSensor, angles_rad: Any, height_m: float, rise: tuple[float, float]) -> tuple[float, float]:
    """(slant, nearest) [m] by vectors: a plane through the point ``height_m`` below the origin, NED."""
    turned = Rotation.from_euler("ZYX", angles_rad[::-1]).as_matrix()
    at, looks = turned @ np.array(sensor.position_m), turned @ np.array(sensor.boresight)
    normal = np.array([rise[0], rise[1], 1.0])
    over_m = normal @ (np.array([0.0, 0.0, height_m]) - at)
    return float(over_m / (normal @ looks)), float(over_m / np.linalg.norm(normal))


@pytest.mark.parametrize("angles_deg", ANGLES_DEG)
@pytest.mark.parametrize("rise", [(0.0, 0.0), (0.1, -0.2)])
@pytest.mark.parametrize("oblique", ["slant", "nearest", "unknown"])
def test_a_reading_is_where_the_beam_or_the_perpendicular_meets_the_plane(
    angles_deg: tuple[float, float, float], rise: tuple[float, float], oblique: Oblique
) -> None:
    angles_rad = tuple(math.radians(each) for each in angles_deg)
    sensor = DownwardSensor((0.3, -0.2, 0.05), boresight(0.0, math.radians(-78), math.radians(30)), oblique)
    view = sensor.turned(rotation_matrix(*angles_rad)).view(2.5, *rise)
    assert view is not None
    slant_m, nearest_m = reads(sensor, angles_rad, 2.5, rise)
    if oblique == "unknown":
        # Midway in the information that a reading has on the height: 1 / r of a height is the mean of the two.
        assert 1 / view.expected_m == pytest.approx((1 / slant_m + 1 / nearest_m) / 2, rel=1e-12)
        assert math.sqrt(view.shared_variance_m2) == pytest.approx(abs(slant_m - nearest_m) / 2, rel=0.1)
    else:
        assert view.expected_m == pytest.approx(slant_m if oblique == "slant" else nearest_m, rel=1e-12)
        assert view.shared_variance_m2 == 0.0


@pytest.mark.parametrize("angles_deg", ANGLES_DEG)
@pytest.mark.parametrize("oblique", ["slant", "nearest", "unknown"])
def test_the_derivatives_are_those_of_the_reading_over_level_ground(
    angles_deg: tuple[float, float, float], oblique: Oblique
) -> None:
    rotation = rotation_matrix(*(math.radians(each) for each in angles_deg))
    sensor = DownwardSensor((0.25, 0.2, 0.05), boresight(0.0, math.radians(-80), math.radians(90)), oblique)
    state, small = np.array([3.0, 0.0, 0.0]), 1e-6

    def at(*state: float) -> float:
        view = sensor.turned(rotation).view(*state)
        assert view is not None
        return view.expected_m

    view = sensor.turned(rotation).view(*state)
    assert view is not None
    differences = [(at(*(state + step)) - at(*(state - step))) / (2 * small) for step in small * np.eye(3)]
    np.testing.assert_allclose([view.by_height, view.by_north, view.by_east], differences, rtol=1e-7, atol=1e-8)
    sloping = sensor.turned(rotation).view(3.0, 0.12, -0.07)
    assert sloping is not None
    assert (sloping.by_north, sloping.by_east) == (view.by_north, view.by_east), "a slope is not learnt from itself"


@pytest.mark.parametrize(
    ("feet_m", "spans"),
    [
        ([(0.25, -0.2), (0.25, 0.2), (-0.25, -0.2)], True),
        ([(0.25, -0.2), (0.25, 0.2), (-0.25, -0.2), (-0.25, 0.2)], True),
        ([(0.25, -0.2), (-0.25, 0.2)], False),
        ([(0.5, 0.02), (0.2, 0.0), (-0.1, 0.03), (-0.4, 0.0), (-0.6, 0.02)], False),
        ([(0.0, 0.0)] * 8, False),
        ([], False),
    ],
)
def test_three_sensors_that_are_not_on_one_line_span_a_plane(feet_m: list[tuple[float, float]], spans: bool) -> None:
    assert spans_plane(feet_m) is spans
    turned = [(0.6 * x - 0.8 * y + 3.0, 0.8 * x + 0.6 * y - 1.0) for x, y in feet_m]
    assert spans_plane(turned) is spans


def test_canted_sensors_at_one_place_span_a_plane_where_their_beams_are_known_to_meet_the_ground() -> None:
    looks = [boresight(0.0, math.radians(-70), math.radians(yaw)) for yaw in (45, 135, -45, -135)]
    slant = [DownwardSensor((0.0, 0.0, 0.0), look, "slant") for look in looks]
    nearest = [DownwardSensor((0.0, 0.0, 0.0), look, "nearest") for look in looks]
    assert spans_plane([sensor.foot_m(2.0) for sensor in slant])
    assert not spans_plane([sensor.foot_m(2.0) for sensor in nearest])
    assert not spans_plane([sensor.foot_m(0.1) for sensor in slant])


def test_a_beam_along_the_ground_sees_none() -> None:
    forward = DownwardSensor((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), "slant")
    assert forward.turned(LEVEL).view(2.0, 0.0, 0.0) is None
