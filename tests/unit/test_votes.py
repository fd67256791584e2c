"""A sensor's last readings as its vote: how votes are counted, and when they make a step of the ground."""

from typing import Any

import pytest

from msp_range.fusion.votes import Seen, Sight, Tally, step_m, tally, working
from msp_range.fusion.windows import Windows

near_to: Any = pytest.approx
"""A number that one of another type is compared with."""

WINDOWS = Windows()
"""Four sensors 0.1 s apart: a reading is current for 0.64 s, a vote holds for 1.24 s."""
NOW_S = 10.0


def sight(*readings: float | str, newest_s: float = NOW_S, repeated: bool = False, works: bool = True) -> Sight:
    """A sensor's readings 0.4 s apart, oldest first: 'ground', 'nothing', or how far off the ground [m]."""
    made = Sight()
    made.repeated, made.works, made.read_s = repeated, works, newest_s
    for i, reading in enumerate(readings):
        time_s = newest_s - 0.4 * (len(readings) - 1 - i)
        if reading == "ground":
            made.ground(time_s)
        elif reading == "nothing":
            made.nothing(time_s)
        else:
            made.off(time_s, float(reading))
    return made


# One sensor's vote.


@pytest.mark.parametrize(
    ("readings", "votes"),
    [
        (["ground"], True),
        (["ground", "ground"], True),
        (["ground", "nothing", "ground"], True),
        (["ground", 2.0, "ground"], True),
        ([2.0, "ground", "ground"], True),
        # The only reading with a range.
        (["nothing", "ground", "nothing"], True),
        (["ground", 2.0], False),
        ([2.0, "ground"], False),
        (["ground", "nothing", 2.0], False),
        (["nothing", "nothing"], False),
        ([], False),
        # A fourth reading is no part of the vote.
        (["ground", "ground", 2.0, 0.5], False),
        (["ground", 2.0, "nothing", "nothing"], False),
    ],
)
def test_a_sensor_votes_for_the_ground_by_two_of_its_last_three_readings(readings: list[str], votes: bool) -> None:
    assert sight(*readings).votes_ground(0.0) is votes


@pytest.mark.parametrize(
    ("readings", "vote_m"),
    [
        ([0.5, 0.6], 0.55),
        ([0.5, "nothing", 0.61], 0.555),
        ([0.5, "ground", 0.5], 0.5),
        ([3.0, 0.5, 0.5], 0.5),
        ([0.5, 3.0, 0.5], 0.5),
        ([-1.0, -1.04, 0.5], -1.02),
        # 13 cm apart are two heights.
        ([0.5, 0.63], None),
        ([0.5, -0.5], None),
        ([0.5], None),
        # Ground that was close to it is no vote for another height.
        ([0.05, "ground", "nothing"], None),
        (["ground", "ground"], None),
        ([0.5, 0.5, "ground", "ground"], None),
    ],
)
def test_a_sensor_votes_for_another_height_by_two_of_its_last_three_readings(
    readings: list[str], vote_m: float | None
) -> None:
    assert sight(*readings).votes_off_m(0.0) == (None if vote_m is None else pytest.approx(vote_m))


def test_readings_before_a_time_are_no_part_of_a_vote() -> None:
    ground, off = sight("ground", "ground", 2.0), sight(0.5, 0.5, "ground")
    # The oldest of the three is of 9.2 s.
    assert ground.votes_ground(9.15)
    assert not ground.votes_ground(9.25)
    assert off.votes_off_m(9.15) == pytest.approx(0.5)
    assert off.votes_off_m(9.25) is None
    # With its older readings out of the window, the one that is left speaks alone.
    assert sight(2.0, "nothing", "ground").votes_ground(9.25)


def test_the_newest_reading_is_the_last_one_with_a_range_and_not_too_old() -> None:
    seen = sight("ground", 0.5, "nothing")
    assert seen.newest(9.55) == Seen(near_to(9.6), 0.5, False)
    assert seen.newest(9.65) is None
    assert sight("nothing").newest(0.0) is None
    assert sight("ground", "nothing").newest(0.0) == Seen(near_to(9.6), 0.0, True)


def test_the_reading_before_the_newest_may_be_one_without_a_range() -> None:
    assert sight(0.5, "nothing", 0.6).before() == Seen(near_to(9.6), None, False)
    assert sight(0.5, 0.6).before() == Seen(near_to(9.6), 0.5, False)
    assert sight(0.5).before() is None


def test_ground_that_is_lower_makes_what_was_off_by_as_much_ground_and_the_other_way_round() -> None:
    moved = sight(0.5, "ground", "nothing")
    moved.move(0.42)
    assert not moved.votes_ground(0.0)
    assert moved.newest(0.0) == Seen(near_to(9.6), near_to(-0.42), False)
    near, far = sight(0.5), sight(0.5)
    near.move(0.39)
    far.move(0.37)
    assert near.votes_ground(0.0), "11 cm off"
    assert not far.votes_ground(0.0), "13 cm off"
    empty = sight("nothing")
    empty.move(0.4)
    assert empty.newest(0.0) is None
    near.clear()
    assert not near.votes_ground(0.0)


# All votes.


def test_votes_for_the_ground_and_for_the_height_that_has_most_are_counted() -> None:
    sights = [sight("ground", "ground"), sight(0.5, 0.5), sight(0.6, 0.6), sight(-1.0, -1.0)]
    assert tally(sights, NOW_S, WINDOWS) == Tally(1, 1, 2, 4, False)
    assert tally([sight("ground", "ground") for _ in "abc"], NOW_S, WINDOWS) == Tally(3, 3, 0, 3, False)
    # Within 12 cm of the one in the middle, and 24 cm apart.
    assert tally([sight(each, each) for each in (0.5, 0.61, 0.72)], NOW_S, WINDOWS) == Tally(0, 0, 3, 3, True)
    assert tally([sight(each, each) for each in (0.5, 0.63)], NOW_S, WINDOWS) == Tally(0, 0, 1, 2, True)
    assert tally([], NOW_S, WINDOWS) == Tally(0, 0, 0, 0, False)


def test_sensors_are_leaving_where_most_newest_readings_are_off_to_one_side() -> None:
    """Of a take-off no two readings agree, and each sensor has seen the ground twice just before."""

    def are_leaving(*newest: float | str) -> bool:
        return tally([sight("ground", "ground", each) for each in newest], NOW_S, WINDOWS).are_leaving

    assert are_leaving(0.5, 0.7, 0.9, "ground")
    assert are_leaving(-0.5, -0.7, -0.9, "ground")
    assert not are_leaving(0.5, 0.7, -0.9, "ground")
    assert not are_leaving(0.5, 0.7, "ground", "ground")
    assert not are_leaving(0.5)
    assert not tally([sight(each, newest_s=8.0) for each in (0.5, 0.7, 0.9)], NOW_S, WINDOWS).are_leaving


def test_one_outlier_or_one_missed_reading_changes_no_count() -> None:
    before = [sight("ground", "ground", "ground"), sight("ground", "ground", "ground"), sight(0.5, 0.5, 0.5)]
    after = [sight("ground", "ground", "nothing"), sight("ground", "ground", 3.0), sight(0.5, 0.5, "ground")]
    assert tally(before, NOW_S, WINDOWS) == tally(after, NOW_S, WINDOWS) == Tally(2, 2, 1, 3, False)


def test_a_sensor_at_fault_is_no_voter_and_its_last_ground_counts_while_it_is_held() -> None:
    """An answer that is lost on the bus is no reason to doubt the ground that was seen 0.8 s ago."""
    broken = sight("ground", "ground", "nothing", works=False)
    assert tally([broken], NOW_S, WINDOWS) == Tally(1, 1, 0, 0, False)
    assert tally([sight(0.5, 0.5, works=False)], NOW_S, WINDOWS) == Tally(0, 0, 0, 0, False)
    # Its ground readings were 0.8 and 0.4 s old; held are 1.24 s.
    assert tally([broken], NOW_S + 0.8, WINDOWS).ground == 1, "the newest one alone"
    assert tally([broken], NOW_S + 0.9, WINDOWS).ground == 0


def test_votes_are_held_for_three_turns() -> None:
    sights = [sight("ground", "ground"), sight(0.5, 0.5), sight(0.5, 0.5)]
    assert tally(sights, NOW_S + 0.8, WINDOWS) == Tally(1, 1, 2, 3, False)
    # The older one of each pair is 1.25 s old: the newest ground stands alone, one off is no vote.
    assert tally(sights, NOW_S + 0.85, WINDOWS) == Tally(1, 1, 0, 3, False)
    assert tally(sights, NOW_S + 1.2, WINDOWS).voters == 3
    assert tally(sights, NOW_S + 1.3, WINDOWS) == Tally(0, 0, 0, 0, False)


def test_a_sensor_that_repeats_itself_has_no_vote_against_the_ground() -> None:
    sights = [sight("ground", "ground", repeated=True), sight(0.5, 0.5, repeated=True)]
    assert tally(sights, NOW_S, WINDOWS) == Tally(1, 0, 0, 2, False)


def test_sensors_that_are_in_order_count_with_and_without_an_echo() -> None:
    sights = [
        sight("ground"),
        sight("nothing"),
        sight("ground", works=False),
        sight("ground", repeated=True),
        sight("ground", newest_s=NOW_S - 1.3),
        sight("nothing", newest_s=NOW_S - 1.2),
        Sight(),
    ]
    assert working(sights, NOW_S, WINDOWS) == 3


# A step of the ground.


def step(newest: Sight, *others: Sight) -> float | None:
    return step_m(newest, [*others, newest], NOW_S, WINDOWS)


def test_three_of_four_make_a_step_by_their_median() -> None:
    lower = sight("ground", "ground", 0.50)
    others = sight("ground", "ground", 0.46, newest_s=9.9), sight("ground", "ground", 0.58, newest_s=9.8)
    assert step(lower, *others, sight("ground", "ground", newest_s=9.7)) == pytest.approx(0.50)
    assert step(others[1], others[0], lower, sight("ground", "ground", newest_s=9.7)) == pytest.approx(0.50)


def test_two_of_four_make_none() -> None:
    ground = sight("ground", "ground", newest_s=9.9), sight("ground", "ground", newest_s=9.8)
    lower = sight("ground", "ground", 0.5, newest_s=9.7)
    assert step(sight("ground", "ground", 0.5), lower, *ground) is None
    # Nor where the other two see neither this nor the old ground: half of those that give ranges is not enough.
    outliers = sight(3.0, 2.0, 1.0), sight(-1.0, -2.0, 1.5)
    assert step(sight("ground", "ground", 0.5), lower, *outliers) is None
    # With one of these without a range there are two of three.
    assert step(sight("ground", "ground", 0.5), lower, outliers[0], sight("nothing")) == pytest.approx(0.5)
    assert step(sight("ground", "ground", 0.5), lower, outliers[0], sight(1.5, works=False)) == pytest.approx(0.5)


@pytest.mark.parametrize(("apart_m", "is_step"), [(0.05, True), (0.07, False)])
def test_two_against_one_must_be_close_to_each_other(apart_m: float, is_step: bool) -> None:
    pair = sight("ground", "ground", 0.5), sight("ground", "ground", 0.5 + apart_m, newest_s=9.9)
    held = sight("ground", "ground", newest_s=9.8)
    assert (step(*pair, held) is not None) is is_step
    assert step(*pair) is not None, "nobody holds the old ground"


@pytest.mark.parametrize(("apart_m", "is_step"), [(0.11, True), (0.13, False)])
def test_readings_of_one_step_are_within_twelve_centimetres(apart_m: float, is_step: bool) -> None:
    found = step(sight(0.5), sight(0.5 + apart_m, newest_s=9.9))
    assert found == (pytest.approx(0.5 + apart_m / 2) if is_step else None)


def test_a_reading_that_agrees_must_be_current() -> None:
    newest = sight("ground", "ground", 0.5)
    assert step(newest, sight(0.5, newest_s=NOW_S - 0.6)) == pytest.approx(0.5)
    assert step(newest, sight(0.5, newest_s=NOW_S - 0.7)) is None
    assert step(newest, sight(0.5, newest_s=NOW_S - 0.6, works=False), sight(3.0)) is None


def test_the_newest_reading_must_be_off_the_ground_and_have_a_range() -> None:
    lower = sight(0.5, newest_s=9.9), sight(0.5, newest_s=9.8)
    assert step(sight("ground"), *lower) is None
    assert step(sight("nothing"), *lower) is None
    assert step(sight(0.5, newest_s=NOW_S - 0.7), *lower) is None


@pytest.mark.parametrize(
    ("readings", "lower_m"),
    [
        (["ground", 0.5, 0.6], 0.6),
        (["ground", "ground", 0.5], None),
        ([0.5, "nothing", 0.5], None),
        ([0.5, "ground", 0.5], None),
        ([0.4, 0.53], None),
        ([0.5], None),
    ],
)
def test_a_sensor_that_is_alone_must_see_a_step_twice_in_a_row(readings: list[str], lower_m: float | None) -> None:
    assert step(sight(*readings)) == (None if lower_m is None else pytest.approx(lower_m))
    # Sensors without an echo do not help.
    assert step(sight(*readings), sight("nothing", "nothing")) == (None if lower_m is None else pytest.approx(lower_m))


def test_a_sensor_that_is_alone_does_not_overrule_one_that_has_just_failed_on_the_ground() -> None:
    failed = sight("ground", "ground", "nothing", works=False)
    assert step(sight("ground", 0.5, 0.5), failed) is None
    failed.repeated = True
    assert step(sight("ground", 0.5, 0.5), failed) == pytest.approx(0.5), "it repeated itself: it may be stuck"


def test_where_only_sensors_that_repeat_themselves_hold_the_ground_the_others_may_be_climbing_away_from_it() -> None:
    stuck = [sight("ground", "ground", repeated=True, newest_s=each) for each in (9.9, 9.8)]
    # At 1.5 m/s: what another one saw 0.2 s earlier was 30 cm less.
    rising, earlier = sight("ground", "ground", 0.45), sight("ground", "ground", 0.15, newest_s=9.8)
    assert step(rising, earlier, *stuck) == pytest.approx(0.45), "by the newest, and not by their median"
    # Faster than vehicles move on.
    assert step(sight("ground", "ground", 0.45), sight("ground", "ground", -0.10, newest_s=9.8), *stuck) is None
    # Half a metre away something was passed over: no motion that began at the ground.
    assert step(sight("ground", "ground", 0.75), sight("ground", "ground", 0.45, newest_s=9.8), *stuck) is None
    # Two against two: over even ground good sensors repeat themselves too.
    assert step(sight("ground", "ground", 0.75), sight("ground", "ground", 0.70, newest_s=9.8), *stuck) is None
    # One that does not repeat itself holds the ground: nobody climbs.
    healthy = sight("ground", "ground", newest_s=9.7)
    assert step(rising, earlier, stuck[0], healthy) is None


def test_ground_is_never_part_of_a_step_however_close_it_is() -> None:
    """A step of some centimetres moves what was off close to the ground without making it ground."""
    ground = [sight("ground", newest_s=each) for each in (9.9, 9.8)]
    assert step(sight(0.1), *ground) is None
    assert step(sight("ground"), *[sight(0.1, newest_s=each) for each in (9.9, 9.8)]) is None


def test_a_sensor_at_fault_holds_the_ground_against_two_that_hardly_agree() -> None:
    failed = sight("ground", "ground", "nothing", newest_s=9.8, works=False)
    assert step(sight(0.5), sight(0.6, newest_s=9.9), failed) is None
    assert step(sight(0.5), sight(0.54, newest_s=9.9), failed) == pytest.approx(0.52)
    assert (
        step(sight(0.5), sight(0.54, newest_s=9.9), failed, sight("ground", "ground", "nothing", works=False)) is None
    ), "two have seen it just now"


def test_a_sensor_against_one_that_repeats_itself_is_too_few() -> None:
    assert step(sight("ground", 0.75, 0.75), sight("ground", "ground", newest_s=9.9, repeated=True)) is None


def test_a_sensor_that_repeats_itself_and_agrees_is_one_of_those_that_must_be_more_than_half() -> None:
    outliers = sight(3.0, 2.0, 1.0, newest_s=9.8), sight(-1.0, -2.0, 1.5, newest_s=9.7)
    assert step(sight(0.5), sight(0.5, newest_s=9.9, repeated=True), *outliers) is None


def test_vehicles_climb_away_from_stuck_sensors_at_up_to_two_metres_a_second() -> None:
    stuck = [sight("ground", "ground", repeated=True, newest_s=each) for each in (9.9, 9.8)]
    assert step(sight(0.45), sight(0.1, newest_s=9.8), *stuck) == pytest.approx(0.45)
    # Not where a sensor that varies still sees the ground.
    rising = sight(0.45), sight(0.30, newest_s=9.9), sight(0.15, newest_s=9.8)
    assert step(*rising, sight("ground", "ground", newest_s=9.7)) is None
