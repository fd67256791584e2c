"""The sonar equation: the report's four angles, each from the other three, and the beam beyond the table."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from msp_range.acoustics.beam import BreakawayTable
from msp_sim.acoustics.sonar import STEP_DEG, Sonar, extended_beam, fit_sonar, leave_one_out

FREQUENCY_HZ = 42e3
ON_AXIS_M = 5.0
MAXIMUM_M = 7.65
REPORT = BreakawayTable(ranges_m=(0.5, 1.0, 1.5, 2.0), half_angles_deg=(23.4, 18.0, 14.4, 12.6))
FITTED = fit_sonar(REPORT, FREQUENCY_HZ, ON_AXIS_M)


def half_angle_deg(sonar: Sonar, range_m: float) -> float:
    angle_deg = sonar.half_angle_deg(range_m)
    assert angle_deg is not None
    return angle_deg


def test_the_plate_at_500_cm_is_heard_on_the_axis() -> None:
    assert FITTED.excess_db(5.0) > 0


def test_the_fit_is_a_piston_of_the_sensors_size() -> None:
    # Transducers for 40 kHz come in cans of 10 to 16 mm.
    assert 0.010 < FITTED.piston_diameter_m < 0.016
    assert FITTED.gain_db_per_m > 0


def test_each_angle_follows_from_the_other_three_within_a_step() -> None:
    predicted_deg = leave_one_out(REPORT, FREQUENCY_HZ, ON_AXIS_M)
    assert predicted_deg == pytest.approx(list(REPORT.half_angles_deg), abs=STEP_DEG)
    # Not a copy of the table, and not the fit to all four.
    for range_m, each_deg in zip(REPORT.ranges_m, predicted_deg, strict=True):
        assert each_deg is not None
        assert abs(each_deg - half_angle_deg(FITTED, range_m)) > 0.05


@settings(max_examples=25)
@given(st.floats(6.0, 20.0), st.floats(0.010, 0.020), st.floats(3.5, 6.0))
def test_a_sensor_that_is_a_piston_is_recovered(
    source_level_db: float, piston_diameter_m: float, gain_db_per_m: float
) -> None:
    true = Sonar(source_level_db, piston_diameter_m, gain_db_per_m, FREQUENCY_HZ)
    ranges_m = (0.5, 1.0, 1.5, 2.0, 2.5)
    angles_deg = [true.half_angle_deg(range_m) for range_m in ranges_m]
    usable_deg = [angle for angle in angles_deg if angle is not None and angle >= 3.0]
    if len(usable_deg) < len(ranges_m) or not all(np.diff(usable_deg) < 0):
        return
    table = BreakawayTable(ranges_m, tuple(usable_deg))
    fitted = fit_sonar(table, FREQUENCY_HZ)
    assert fitted.piston_diameter_m == pytest.approx(piston_diameter_m, rel=1e-3)
    assert fitted.gain_db_per_m == pytest.approx(gain_db_per_m, abs=0.02)
    assert fitted.source_level_db == pytest.approx(source_level_db, abs=0.05)


def test_the_fit_keeps_to_the_range_on_the_axis() -> None:
    """A table that by itself says that nothing is heard at 4 m."""
    table = BreakawayTable((0.5, 1.0, 1.5, 2.0), (20.0, 16.0, 13.0, 10.0))
    assert fit_sonar(table, FREQUENCY_HZ).excess_db(4.0) < -0.5
    assert fit_sonar(table, FREQUENCY_HZ, on_axis_m=4.0).excess_db(4.0) >= -1e-9


def test_too_few_rows_are_refused() -> None:
    with pytest.raises(ValueError, match="found 2 breakaway angles, expected at least 3"):
        fit_sonar(BreakawayTable((0.5, 1.0), (20.0, 15.0)), FREQUENCY_HZ)
    with pytest.raises(ValueError, match="found 2 breakaway angles"):
        leave_one_out(BreakawayTable((0.5, 1.0, 1.5), (20.0, 15.0, 12.0)), FREQUENCY_HZ)


def test_beyond_the_table_the_beam_is_the_equations_and_never_grows() -> None:
    beam = extended_beam(REPORT, FITTED, MAXIMUM_M)
    assert beam.ranges_m[:4] == REPORT.ranges_m
    assert beam.half_angles_deg[:4] == REPORT.half_angles_deg
    assert beam.ranges_m[-1] == MAXIMUM_M
    for range_m in (2.25, 2.5, 2.75, 3.0):
        assert math.degrees(beam.half_angle_rad(range_m)) == pytest.approx(half_angle_deg(FITTED, range_m), abs=0.02)
    assert half_angle_deg(FITTED, 5.0) > 12.6  # what the gain would make of it
    everywhere_rad = beam.half_angle_rad(np.linspace(0.2, 9.0, 1000))
    assert (np.diff(everywhere_rad) <= 1e-12).all()
    assert math.degrees(beam.half_angle_rad(MAXIMUM_M)) == pytest.approx(11.3, abs=0.1)


def test_where_no_echo_is_predicted_the_last_angle_is_held() -> None:
    table = BreakawayTable((0.5, 1.0, 1.5, 2.0), (20.0, 16.0, 13.0, 10.0))
    sonar = fit_sonar(table, FREQUENCY_HZ)
    beam = extended_beam(table, sonar, MAXIMUM_M)
    last_m = beam.ranges_m[-1]
    assert sonar.half_angle_deg(last_m) is not None
    assert sonar.half_angle_deg(last_m + 0.25) is None
    assert 2.0 <= last_m < MAXIMUM_M
    assert half_angle_deg(sonar, last_m) < 6.0 <= min(beam.half_angles_deg)
    assert beam.half_angle_rad(7.0) == beam.half_angle_rad(last_m) >= math.radians(6.0) - 1e-12


def test_a_table_that_the_equation_cannot_describe_is_held() -> None:
    no_piston = BreakawayTable((0.5, 1.0, 1.5, 2.0), (25.0, 24.9, 24.8, 12.0))
    assert extended_beam(no_piston, fit_sonar(no_piston, FREQUENCY_HZ), MAXIMUM_M) == no_piston
