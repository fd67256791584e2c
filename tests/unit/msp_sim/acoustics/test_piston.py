"""Directivity of a piston against textbook values."""

import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.integrate import quad

from msp_sim.acoustics.piston import (
    FIRST_NULL_X,
    directivity_db,
    level_db,
    main_lobe_x,
)

HALF_POWER_X = 1.6163399561
"""Where (2 J1(x) / x)^2 = 1/2."""
FIRST_SIDE_LOBE_X = 5.1356223018
"""First zero of J2 above 0 (Abramowitz and Stegun, table 9.5), where 2 J1(x) / x has its next extreme."""


@pytest.mark.parametrize(
    # Table of 2 J1(x) / x: Kinsler and others, Fundamentals of Acoustics, appendix A6 (four digits).
    ("x", "published"),
    [(0.2, 0.9950), (1.0, 0.8801), (1.6, 0.7124), (2.0, 0.5767), (3.0, 0.2260), (4.0, -0.0330), (5.0, -0.1310)],
)
def test_directivity_is_the_textbooks(x: float, published: float) -> None:
    # A piston of 4 wavelengths: x = 4 pi sin(theta).
    angle_rad = math.asin(x / (4 * math.pi))
    assert 10 ** (directivity_db(angle_rad, 4.0, 1.0) / 20) == pytest.approx(abs(published), abs=0.5e-4)


@pytest.mark.parametrize(("diameter", "half_power_deg", "null_deg"), [(2.0, 14.90, 37.58), (4.0, 7.39, 17.75)])
def test_half_power_and_null(diameter: float, half_power_deg: float, null_deg: float) -> None:
    # asin(0.5145 lambda / D) and asin(1.2197 lambda / D); the null is zero to nine digits.
    half_rad, null_rad = (math.asin(x / (math.pi * diameter)) for x in (HALF_POWER_X, FIRST_NULL_X))
    assert math.degrees(half_rad) == pytest.approx(half_power_deg, abs=0.01)
    assert math.degrees(null_rad) == pytest.approx(null_deg, abs=0.01)
    assert directivity_db(half_rad, diameter, 1.0) == pytest.approx(10 * math.log10(0.5), abs=1e-6)
    assert directivity_db(null_rad, diameter, 1.0) < -180


def test_first_side_lobe_is_17_6_db_down() -> None:
    assert level_db(FIRST_SIDE_LOBE_X) == pytest.approx(-17.57, abs=0.005)
    beyond_null = [directivity_db(math.radians(deg), 4.0, 1.0) for deg in range(18, 36)]
    assert max(beyond_null) == pytest.approx(-17.57, abs=0.05)


@given(st.floats(0.0, math.pi / 2), st.floats(0.1, 6.0))
@example(2.0**-24, 0.1015625)
def test_directivity_is_the_interference_of_the_pistons_points(angle_rad: float, diameter: float) -> None:
    """The Huygens integral over a disk, strip by strip at sin(u) of its radius, by numerical quadrature."""
    k = math.pi * diameter * math.sin(angle_rad)
    strip = quad(lambda u: math.cos(u) ** 2 * math.cos(k * math.sin(u)), 0, math.pi / 2, epsabs=1e-11, limit=200)[0]
    pressure = 4 / math.pi * strip
    assert 10 ** (directivity_db(angle_rad, diameter, 1.0) / 20) == pytest.approx(abs(pressure), abs=1e-8)
    assert directivity_db(-angle_rad, diameter, 1.0) == directivity_db(angle_rad, diameter, 1.0) <= 0.0


def test_behind_the_piston_is_refused() -> None:
    with pytest.raises(ValueError, match="found 91 deg off the axis"):
        directivity_db(math.radians(91), 2.0, 1.0)


@given(st.floats(1e-5, 100.0))
def test_the_main_lobe_is_as_far_down_as_asked(down_db: float) -> None:
    x = main_lobe_x(down_db)
    assert 0.0 < x < FIRST_NULL_X
    assert level_db(x) == pytest.approx(-down_db, rel=1e-7, abs=1e-11)


def test_the_main_lobe_from_the_axis_to_the_null() -> None:
    assert main_lobe_x(0.0) == 0.0
    assert main_lobe_x(0.999999e-6) == pytest.approx(main_lobe_x(1.000001e-6), rel=2e-6)
    assert main_lobe_x(1e4) == pytest.approx(FIRST_NULL_X)
    assert main_lobe_x(10 * math.log10(2)) == pytest.approx(HALF_POWER_X, rel=1e-8)
