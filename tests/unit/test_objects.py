"""Objects and holes below one sensor: how many readings make one, keep it, and end it."""

import pytest

from msp_range.fusion.objects import Below

MEMORY_S = 1.5


def below(*readings: float | str, ground_is_seen: bool = True) -> Below:
    """Readings 0.4 s apart: 'ground', 'nothing', or how much farther than the ground [m]."""
    made = Below()
    for i, reading in enumerate(readings):
        if reading == "ground":
            made.ground(0.4 * i)
        elif reading == "nothing":
            made.nothing(0.4 * i, MEMORY_S)
        else:
            made.off(0.4 * i, float(reading), ground_is_seen)
    return made


@pytest.mark.parametrize(
    ("readings", "object_m"),
    [
        ([-0.5, -0.52, -0.54], 0.52),
        ([0.5, 0.5, 0.5], -0.5),
        ([-0.5, -0.5], None),
        # Three of the last four, whatever the fourth was.
        ([-0.5, "ground", -0.5, -0.5], 0.5),
        ([-0.5, "nothing", -0.5, -0.5], 0.5),
        ([-0.5, -2.0, -0.5, -0.5], 0.5),
        (["ground", -0.5, "ground", -0.5, "ground", -0.5], None),
        ([-0.5, -0.5, "ground", "ground", -0.5], None),
        # Each within 8 cm of the newest one.
        ([-0.5, -0.57, -0.5], pytest.approx(0.523, abs=1e-3)),
        ([-0.5, -0.59, -0.5], None),
        # Kerbs and grass.
        ([-0.13, -0.13, -0.13], 0.13),
        ([-0.11, -0.11, -0.11], None),
        ([0.11, 0.11, 0.11], None),
    ],
)
def test_three_of_the_last_four_readings_that_agree_are_an_object(
    readings: list[float | str], object_m: float | None
) -> None:
    assert below(*readings).object_m == (None if object_m is None else pytest.approx(object_m))


def test_against_a_ground_that_nobody_sees_nothing_is_an_object() -> None:
    assert below(-0.5, -0.5, -0.5, -0.5, ground_is_seen=False).object_m is None
    # Readings from before count, once it is seen.
    made = below(-0.5, -0.5, ground_is_seen=False)
    made.off(0.8, -0.5, True)
    assert made.object_m == pytest.approx(0.5)


def test_a_known_object_follows_its_readings_by_half_and_not_those_of_something_else() -> None:
    made = below(-0.5, -0.5, -0.5, -0.6)
    assert made.object_m == pytest.approx(0.55)
    assert made.is_object(-0.66)
    assert made.is_object(-0.44)
    assert not made.is_object(-0.68)
    assert not made.is_object(-0.42)
    assert not made.is_object(0.55)
    made.off(1.6, -1.5, True)
    assert made.object_m == pytest.approx(0.55)
    assert not Below().is_object(0.0)


def test_two_readings_of_the_ground_in_a_row_end_an_object() -> None:
    seen = [-0.5, -0.5, -0.5]
    assert below(*seen, "ground").object_m == pytest.approx(0.5)
    assert below(*seen, "ground", "ground").object_m is None
    assert below(*seen, "ground", -0.5, "ground").object_m == pytest.approx(0.5)
    assert below(*seen, "ground", "nothing", "ground").object_m is None


def test_an_object_is_kept_over_readings_without_a_range_until_it_is_forgotten() -> None:
    """It was seen last at 0.8 s."""
    assert below(-0.5, -0.5, -0.5, "nothing", "nothing", "nothing").object_m == pytest.approx(0.5)
    assert below(-0.5, -0.5, -0.5, "nothing", "nothing", "nothing", "nothing").object_m is None


def test_a_step_of_the_ground_moves_a_known_object_and_begins_the_count_anew() -> None:
    made = below(-0.5, -0.5, -0.5)
    made.move(0.3)
    assert made.object_m == pytest.approx(0.8)
    made.move(-0.66)
    assert made.object_m == pytest.approx(0.14)
    made.move(-0.05)
    assert made.object_m is None, "less than 12 cm"
    counting = below(-0.5, -0.5)
    counting.move(0.0)
    counting.off(0.8, -0.5, True)
    assert counting.object_m is None


def test_clear_forgets_the_object_and_what_was_counted() -> None:
    made = below(-0.5, -0.5, -0.5)
    made.clear()
    assert made.object_m is None
    made.off(1.2, -0.5, True)
    assert made.object_m is None
