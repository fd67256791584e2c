"""Breakaway angles with their intervals, what a tilted sensor reads, and the sonar equation through the angles."""

import math
from collections.abc import Sequence

import numpy as np
import pytest

from msp_lab.characterise.field_of_view import breakaway_rows, find_field_of_view, sonar_through
from msp_lab.characterise.findings import FieldOfView
from msp_lab.characterise.points import sort_into_points
from msp_range.correction.calibration import IDENTITY, Calibration
from tests.support.known import known
from tests.support.plain_bench import point, table
from tests.support.shipped import SENSOR

REPORT = {50: 23.4, 100: 18.0, 150: 14.4, 200: 12.6}
ANGLES_DEG = [round(1.8 * k, 1) for k in range(-15, 16)]


def test_a_wall_that_is_seen_edge_on_is_left_out() -> None:
    rng = np.random.default_rng(1)
    parts = [
        point(rng, 100, condition="field_of_view", incidence_deg=each, missed=0.99 if each else 0.0)
        for each in (0.0, 45.0, 90.0)
    ]
    found = known(find_field_of_view(sort_into_points(table(*parts), SENSOR), IDENTITY))
    assert [each.incidence_deg for each in found.points] == [0.0, 45.0]


def swept(
    seed: int,
    edges: dict[int, tuple[float, float]],
    *,
    grows: float = 1.0,
    n: int = 50,
    angles: Sequence[float] = ANGLES_DEG,
    offset: float = 0.0,
) -> FieldOfView:
    """Sweeps: up to each side's edge 97 % of the readings are of the wall, and 3 % behind."""
    rng = np.random.default_rng(seed)
    parts = []
    for z, (left, right) in edges.items():
        for theta in angles:
            inside = -left <= theta <= right
            slant_cm = z / math.cos(math.radians(theta)) - z
            parts.append(
                point(
                    rng,
                    z,
                    n=n,
                    error_cm=offset + grows * slant_cm,
                    missed=0.03 if inside else 0.97,
                    condition="field_of_view",
                    incidence_deg=theta,
                )
            )
    found = find_field_of_view(
        sort_into_points(table(*parts), SENSOR), Calibration((0.0, 100.0), (offset, 100.0 + offset))
    )
    assert found is not None
    return found


def test_the_reports_angles_come_back_between_two_steps() -> None:
    found = swept(1, {z: (angle, angle) for z, angle in REPORT.items()})
    for angle in found.angles:
        half = angle.half_angle
        assert half.value == REPORT[int(angle.range_cm)]
        assert (half.low, half.high) == pytest.approx((half.value, half.value + 1.8))


def test_the_smaller_side_counts() -> None:
    angle = swept(2, {100: (10.8, 18.0)}).angles[0]
    assert angle.negative is not None
    assert angle.positive is not None
    assert (angle.negative.value, angle.positive.value, angle.half_angle.value) == (10.8, 18.0, 10.8)


def test_an_edge_beyond_the_sweep_has_no_upper_end() -> None:
    half = swept(3, {50: (30.0, 30.0)}).angles[0].half_angle
    assert (half.value, half.low, half.high) == (27.0, 27.0, None)


def test_few_readings_leave_the_edge_open() -> None:
    rng = np.random.default_rng(4)
    wide = 0
    for seed in rng.integers(0, 1000, 20):
        half = swept(int(seed), {100: (18.0, 18.0)}, n=3).angles[0].half_angle
        assert known(half.low) <= 18.0 <= (half.high or 90.0)
        wide += (half.high or 90.0) - known(half.low) > 1.9
    assert wide > 2


def test_a_wide_angle_behind_a_silent_one_is_no_field_of_view() -> None:
    rng = np.random.default_rng(5)
    parts = [
        point(rng, 100, n=50, missed=0.95 if theta == 5.4 else 0.02, condition="field_of_view", incidence_deg=theta)
        for theta in (0.0, 1.8, 3.6, 5.4, 7.2, 9.0)
    ]
    found = find_field_of_view(sort_into_points(table(*parts), SENSOR), IDENTITY)
    assert found is not None
    assert found.angles[0].half_angle.value == 3.6


@pytest.mark.parametrize(("grows", "verdict"), [(1.0, "slant"), (0.0, "nearest"), (0.5, "unknown")])
def test_slant_and_nearest_are_distinguished_under_a_calibration(grows: float, verdict: str) -> None:
    found = swept(6, {z: (angle, angle) for z, angle in REPORT.items()}, grows=grows, offset=2.0)
    assert found.oblique.verdict == verdict
    assert found.oblique.share_of_slant is not None
    assert found.oblique.share_of_slant.value == pytest.approx(grows, abs=0.1)


def test_small_angles_do_not_separate_slant_from_nearest() -> None:
    found = swept(7, {50: (27.0, 27.0)}, angles=[-5.4, -3.6, -1.8, 0.0, 1.8, 3.6, 5.4])
    assert found.oblique.verdict == "unknown"
    assert found.oblique.share_of_slant is None


def test_no_angles_no_field_of_view() -> None:
    rng = np.random.default_rng(8)
    parts = table(point(rng, 100, condition="field_of_view", incidence_deg=0.0))
    assert find_field_of_view(sort_into_points(parts, SENSOR), IDENTITY) is None


def test_an_edge_that_eight_readings_leave_open_is_reported_as_open() -> None:
    """4 of 8 at 9 deg: not reliable, though at random it may be: its likelihood is 1.8 in the logarithm lower."""
    rng = np.random.default_rng(10)
    parts = []
    for angle_deg, of_wall in ((-9.0, 4), (-4.5, 8), (0.0, 8), (4.5, 8), (9.0, 4), (13.5, 0), (-13.5, 0)):
        part = point(rng, 100, n=8, condition="field_of_view", incidence_deg=angle_deg)
        part["reading_cm"][of_wall:] = 765.0
        parts.append(part)
    found = find_field_of_view(sort_into_points(table(*parts), SENSOR), IDENTITY)
    assert found is not None
    half = found.angles[0].half_angle
    assert (half.low, half.value, half.high) == (4.5, 4.5, 13.5)


def test_the_rows_for_the_file_never_grow_and_leave_out_silence() -> None:
    found = swept(9, {50: (12.6, 12.6), 100: (18.0, 18.0), 150: (-1.0, -1.0), 200: (9.0, 9.0)})
    assert breakaway_rows(found.angles) == [(50.0, 12.6), (100.0, 12.6), (200.0, 9.0)]


def test_the_sonar_equation_goes_through_the_reports_angles() -> None:
    found = sonar_through([(float(z), angle) for z, angle in REPORT.items()], SENSOR, 500.0)
    assert found is not None
    assert found.within_a_step
    for row in found.rows:
        assert row.fitted_deg == pytest.approx(row.measured_deg, abs=0.2)
        assert row.left_out_deg == pytest.approx(row.measured_deg, abs=1.8)
    assert [r for r, _ in found.beyond] == [250.0, 300.0, 400.0, 500.0, 600.0, 765.0]
    assert "3 parameters for 4 angles" in found.note
    assert sonar_through([(50.0, 20.0), (100.0, 15.0)], SENSOR, None) is None


def test_angles_that_no_piston_has_are_reported_as_missed() -> None:
    found = sonar_through([(50.0, 40.0), (100.0, 39.0), (150.0, 10.0), (200.0, 9.0)], SENSOR, 500.0)
    assert found is not None
    assert not found.within_a_step
