"""The breakaway table: the report's four angles, what lies between and beyond them, and tables that are refused."""

import math

import numpy as np
import pytest

from msp_range.acoustics.beam import BreakawayTable

REPORT = BreakawayTable(ranges_m=(0.5, 1.0, 1.5, 2.0), half_angles_deg=(23.4, 18.0, 14.4, 12.6))


@pytest.mark.parametrize(
    ("range_m", "half_angle_deg"),
    [
        *[(0.5, 23.4), (1.0, 18.0), (1.5, 14.4), (2.0, 12.6)],
        *[(0.75, 20.7), (1.25, 16.2), (1.75, 13.5), (1.1, 17.28)],
        *[(0.2, 23.4), (0.0, 23.4), (2.01, 12.6), (7.65, 12.6)],
    ],
)
def test_half_angle_is_measured_interpolated_or_held(range_m: float, half_angle_deg: float) -> None:
    assert math.degrees(REPORT.half_angle_rad(range_m)) == pytest.approx(half_angle_deg, rel=1e-12)
    assert math.degrees(REPORT.field_of_view_rad(range_m)) == pytest.approx(2.0 * half_angle_deg, rel=1e-12)


def test_arrays_agree_with_numbers() -> None:
    range_m = np.linspace(0.0, 8.0, 161)
    expected = [REPORT.half_angle_rad(r) for r in range_m.tolist()]
    assert REPORT.half_angle_rad(range_m) == pytest.approx(expected, rel=1e-12)
    assert REPORT.field_of_view_rad(range_m) == pytest.approx(2.0 * np.array(expected), rel=1e-12)
    assert math.isnan(REPORT.half_angle_rad(math.nan))


def test_never_wider_with_range_and_never_under_6_degrees() -> None:
    beam = BreakawayTable(ranges_m=(0.5, 1.0, 3.0, 5.0), half_angles_deg=(20.0, 20.0, 8.0, 2.0))
    angles = np.degrees(beam.half_angle_rad(np.linspace(0.0, 8.0, 801)))
    assert (np.diff(angles) <= 1e-12).all()
    assert angles.max() == pytest.approx(20.0)
    assert angles.min() == pytest.approx(6.0)
    assert math.degrees(beam.half_angle_rad(7.0)) == pytest.approx(6.0)


def test_one_row_is_a_cone() -> None:
    cone = BreakawayTable(ranges_m=(1.0,), half_angles_deg=(15.0,))
    assert [math.degrees(cone.half_angle_rad(r)) for r in (0.5, 1.0, 4.0)] == pytest.approx([15.0] * 3)


@pytest.mark.parametrize(
    ("ranges_m", "half_angles_deg", "message"),
    [
        (
            (0.5, 1.0),
            (18.0, 18.1),
            r"found 18\.1 deg at 100 cm after 18 deg at 50 cm, expected angles that do not increase",
        ),
        ((1.0, 1.0), (18.0, 17.0), r"found 100 cm after 100 cm, expected ranges that grow"),
        ((0.5, 1.0), (18.0,), r"found 2 ranges and 1 half angles"),
        ((), (), r"at least one"),
        ((0.5,), (90.0,), r"found a half angle of 90 deg at 50 cm"),
        ((0.0,), (20.0,), r"expected a range above 0 cm"),
        ((0.5,), (math.nan,), r"expected a range above 0 cm and an angle between 0 and 90"),
    ],
)
def test_an_impossible_table_is_refused(
    ranges_m: tuple[float, ...], half_angles_deg: tuple[float, ...], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        BreakawayTable(ranges_m=ranges_m, half_angles_deg=half_angles_deg)
