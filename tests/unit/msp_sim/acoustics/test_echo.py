"""Spreading, reflection, slant ranges and the level of an echo."""

import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from msp_sim.acoustics.absorption import absorption_db_per_m
from msp_sim.acoustics.atmosphere import Atmosphere
from msp_sim.acoustics.echo import WALL, Target, echo_level_db
from msp_sim.acoustics.materials import MATERIALS, porous_impedance_rayl, reflection_coefficient
from msp_sim.acoustics.piston import directivity_db
from msp_sim.acoustics.slant import nearest_range_in_beam, slant_range
from msp_sim.acoustics.spreading import (
    plate_cross_section_m2,
    plate_spreading,
    small_target_spreading,
    wall_spreading,
)

AIR = Atmosphere()
ranges_m = st.floats(0.2, 8.0)


@given(ranges_m)
def test_a_wall_fades_by_20_log_and_a_small_target_by_40_log(range_m: float) -> None:
    assert wall_spreading(2 * range_m) == pytest.approx(wall_spreading(range_m) / 4)
    assert small_target_spreading(2 * range_m, 0.01) == pytest.approx(small_target_spreading(range_m, 0.01) / 16)


def test_spreading_at_one_metre() -> None:
    assert wall_spreading(1.0) == pytest.approx(1 / (16 * math.pi))
    # 16 pi^2 and not the report's 16 pi: out over a sphere, and back over another.
    assert small_target_spreading(1.0, 1.0) == pytest.approx(1 / (4 * math.pi) ** 2)


def test_a_rigid_sphere_sends_back_its_shadow() -> None:
    """Geometric limit: pi a^2, target strength 20 log10(a / 2) (Urick, Principles of Underwater Sound, table 9.1)."""
    target = Target(cross_section_m2=math.pi * 0.5**2)
    assert target.spreading_db(1.0) == pytest.approx(20 * math.log10(0.5 / 2))


def test_a_plate_is_a_wall_up_to_2_a_over_lambda() -> None:
    area_m2, wavelength_m = 0.2032**2, AIR.wavelength_m(42e3)
    meet_m = 2 * area_m2 / wavelength_m
    assert plate_spreading(0.9 * meet_m, area_m2, wavelength_m) == wall_spreading(0.9 * meet_m)
    far = small_target_spreading(1.1 * meet_m, plate_cross_section_m2(area_m2, wavelength_m))
    assert plate_spreading(1.1 * meet_m, area_m2, wavelength_m) == far
    # Target strength of a plate, 20 log10(A / lambda) (Urick, table 9.1).
    strength_db = 10 * math.log10(plate_cross_section_m2(area_m2, wavelength_m) / (4 * math.pi))
    assert strength_db == pytest.approx(20 * math.log10(area_m2 / wavelength_m))


@pytest.mark.parametrize(
    ("medium_rayl", "target_rayl", "published", "rel"),
    [
        # Kinsler and others, 6.2: air to water 99.9 %; water to ice (2.95e6) 11 %; nothing from the same.
        (415.0, 1.48e6, 0.9989, 1e-4),
        (1.48e6, 2.95e6, 0.110, 0.005),
        (415.0, 415.0, 0.0, 0.0),
    ],
)
def test_reflection_is_the_textbooks(medium_rayl: float, target_rayl: float, published: float, rel: float) -> None:
    assert reflection_coefficient(medium_rayl, target_rayl) == pytest.approx(published, rel=rel)
    assert reflection_coefficient(target_rayl, medium_rayl) == pytest.approx(published, rel=rel)


def test_hard_surfaces_reflect_alike_and_soft_ones_less() -> None:
    """The report could not separate plywood, asphalt and concrete (figures 4.13 to 4.15)."""
    levels_db = {name: Target(material.impedance_rayl).reflection_db(AIR) for name, material in MATERIALS.items()}
    for hard in ("plywood", "asphalt", "concrete", "water"):
        assert -0.02 < levels_db[hard] < 0
        # Wrong by a factor of 3: still nothing that a sensor would notice.
        assert Target(MATERIALS[hard].impedance_rayl / 3).reflection_db(AIR) > -0.05
    assert levels_db["foam"] < levels_db["snow"] < levels_db["grass"] < levels_db["dirt"] < -5
    assert all(each.source and each.doubt and each.roughness_source for each in MATERIALS.values())


def test_a_porous_ground_lies_between_air_and_rock() -> None:
    assert porous_impedance_rayl(413.0, 1.0) == 413.0
    # Tortuosity 1 / sqrt(0.25) = 2: sqrt(2) / 0.25.
    assert porous_impedance_rayl(1.0, 0.25) == pytest.approx(math.sqrt(2) / 0.25)
    with pytest.raises(ValueError, match="found a porosity of 0"):
        porous_impedance_rayl(413.0, 0.0)


@given(ranges_m, st.floats(-0.5, 0.5))
@example(1.0, 5e-324)
def test_the_echo_is_what_its_intensity_says(range_m: float, angle_rad: float) -> None:
    """Report eq 5, corrected, multiplied out as intensities."""
    water = Target(1.48e6)
    share = reflection_coefficient(AIR.impedance_rayl, 1.48e6)
    one_way = 10 ** (directivity_db(angle_rad, 0.0136, AIR.wavelength_m(42e3)) / 10)
    intensity_per_m = absorption_db_per_m(42e3, AIR) / (10 * math.log10(math.e))
    power = 4 * math.pi  # 1 W/m^2 at 1 m: 0 dB
    intensity = share * power * one_way**2 * wall_spreading(range_m) * math.exp(-2 * intensity_per_m * range_m)
    level_db = echo_level_db(0.0, range_m, angle_rad, water, AIR, 0.0136, 42e3)
    assert level_db == pytest.approx(10 * math.log10(intensity), abs=1e-9)


def test_a_louder_source_is_as_much_louder_an_echo() -> None:
    quiet, loud = (echo_level_db(level_db, 2.0, 0.1, WALL, AIR, 0.0136, 42e3) for level_db in (0.0, 13.0))
    assert loud - quiet == pytest.approx(13.0)


@pytest.mark.parametrize(("incidence_deg", "factor"), [(0.0, 1.0), (12.6, 1.02468), (18.0, 1.05146), (60.0, 2.0)])
def test_slant_range_is_the_reports_eq_8(incidence_deg: float, factor: float) -> None:
    assert slant_range(2.0, math.radians(incidence_deg)) == pytest.approx(2.0 * factor, rel=1e-5)


@given(st.floats(0.2, 8.0), st.floats(-1.2, 1.2), st.floats(0.0, 0.4))
def test_the_nearest_point_in_the_beam_is_found_by_search(
    perpendicular_m: float, incidence_rad: float, half_rad: float
) -> None:
    # Rays in the plane of incidence, where the nearest lies.
    rays_rad = [incidence_rad + half_rad * share / 200 for share in range(-200, 201)]
    searched_m = min(perpendicular_m / math.cos(ray) for ray in rays_rad if abs(ray) < math.pi / 2)
    nearest_m = nearest_range_in_beam(perpendicular_m, incidence_rad, half_rad)
    assert nearest_m <= searched_m * (1 + 1e-12)
    assert nearest_m == pytest.approx(searched_m, rel=1e-5)
    assert perpendicular_m <= nearest_m <= slant_range(perpendicular_m, incidence_rad) * (1 + 1e-12)


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(ValueError, match="found a range of 0 m"):
        wall_spreading(0.0)
    with pytest.raises(ValueError, match=r"found a cross section of -1 m\^2"):
        small_target_spreading(1.0, -1.0)
    with pytest.raises(ValueError, match="found an impedance of 0 rayl"):
        reflection_coefficient(413.0, 0.0)
    for refuses in (slant_range, lambda r, angle: nearest_range_in_beam(r, angle, 0.2)):
        with pytest.raises(ValueError, match="found an incidence of 90 deg"):
            refuses(1.0, math.pi / 2)
