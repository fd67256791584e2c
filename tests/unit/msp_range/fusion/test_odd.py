"""Which sensor does not fit into one plane with the others."""

import math
import random
from collections.abc import Sequence

import pytest

from msp_range.fusion.odd import LevelHeight, odd_one, plane_of

Places = Sequence[tuple[float, float]]
CORNERS: Places = ((0.25, -0.2), (0.25, 0.2), (-0.25, -0.2), (-0.25, 0.2))


def ring(count: int) -> list[tuple[float, float]]:
    return [(0.3 * math.cos(k), 0.3 * math.sin(k)) for k in (2 * math.pi * i / count for i in range(count))]


def over(
    rise: tuple[float, float], off_m: dict[int, float] | None = None, places: Places = CORNERS
) -> list[LevelHeight]:
    """What sensors at places see of a plane 5 cm lower than thought, some of them off by something."""
    return [
        LevelHeight(0.05 + north * rise[0] + east * rise[1] + (off_m or {}).get(i, 0.0), north, east)
        for i, (north, east) in enumerate(places)
    ]


def test_the_plane_is_the_grounds_and_costs_what_a_slope_does() -> None:
    plane = plane_of(over((0.1, -0.1)))
    assert plane.lower_m == pytest.approx(0.05)
    assert (plane.rise_north, plane.rise_east) == pytest.approx((0.1, -0.1), rel=0.4)
    assert 0.3 < plane.cost < 1.0
    assert plane_of(over((0.0, 0.0))).cost == pytest.approx(0.0)
    ahead = [(north + 1.0, east) for north, east in CORNERS]
    plane = plane_of(over((0.1, -0.1), places=ahead))
    assert plane.lower_m + plane.rise_north == pytest.approx(0.05 + 0.1), "at the sensors"


@pytest.mark.parametrize("off_m", [-0.3, 0.3, 1.5])
@pytest.mark.parametrize("rise", [(0.0, 0.0), (0.1, 0.05)])
@pytest.mark.parametrize("places", [CORNERS, ring(5), ring(8)], ids=["four", "five", "eight"])
def test_the_one_that_is_off_is_odd_and_the_others_show_the_ground(
    places: Places, rise: tuple[float, float], off_m: float
) -> None:
    for i in range(len(places)):
        found = odd_one(over(rise, {i: off_m}, places))
        assert found is not None
        which, plane = found
        assert which == i
        assert plane.lower_m == pytest.approx(0.05, abs=0.02)


@pytest.mark.parametrize(
    ("rise", "off_m"),
    [
        ((0.3, 0.0), {}),
        ((0.2, -0.2), {}),
        ((0.0, 0.0), {1: 0.1}),
        # A saddle: each sensor may be the one.
        ((0.0, 0.0), {0: 0.15, 1: -0.15, 2: -0.15, 3: 0.15}),
        ((0.0, 0.0), {0: -0.5, 1: -0.5}),
        ((0.0, 0.0), {0: -0.5, 3: -0.5}),
    ],
)
def test_a_slope_a_kerb_a_saddle_and_a_box_below_two_show_none(
    rise: tuple[float, float], off_m: dict[int, float]
) -> None:
    draw = random.Random(1)
    for _ in range(200):
        noisy = [each._replace(higher_m=each.higher_m + draw.gauss(0.0, 0.015)) for each in over(rise, off_m)]
        assert odd_one(noisy) is None


def test_three_sensors_show_none() -> None:
    assert odd_one(over((0.0, 0.0), {0: 1.0}, CORNERS[:3])) is None
