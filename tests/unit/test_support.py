"""Whether the ground that is known may be sent: what a few readings that are not of it change."""

import pytest

from msp_range.fusion.support import GroundSupport
from msp_range.fusion.votes import Sight
from msp_range.fusion.windows import Windows

NOW_S = 10.0


class Seen:
    """Sensors that have all seen the ground three times, just now."""

    def __init__(self, names: str, windows: Windows | None = None) -> None:
        self.sights = {name: Sight() for name in names}
        self.support = GroundSupport(list(self.sights.values()), windows or Windows(), widest_m=1.0)
        self.support.on_new_ground(in_doubt=False)
        for _ in range(3):
            for sight in self.sights.values():
                sight.works, sight.read_s = True, NOW_S
                sight.ground(NOW_S)
                self.support.on_ground(NOW_S)
        assert self.support.is_enough(NOW_S, NOW_S, was_ground=True)

    def off(self, sensor: str, off_m: float, is_object: bool = False) -> bool:
        """One more reading, not of the ground; whether the ground may still be sent."""
        self.sights[sensor].off(NOW_S, off_m)
        self.support.on_other(sensor, off_m, is_object)
        return self.support.is_enough(NOW_S, NOW_S, was_ground=False)


def test_outliers_of_three_sensors_in_a_row_stop_it_and_of_two_where_there_are_two() -> None:
    # To either side of the ground, so that nobody leaves it, and none like another.
    four = Seen("abcd")
    assert [four.off("a", 1.0), four.off("b", -1.0), four.off("c", 3.0)] == [True, True, False]
    two = Seen("ab")
    assert [two.off("a", 1.0), two.off("b", -1.0)] == [True, False]
    again = Seen("abcd")
    assert [again.off("a", 1.0), again.off("b", -1.0)] == [True, True]
    again.support.on_ground(NOW_S)
    assert again.off("c", 3.0), "a reading of the ground in between"


@pytest.mark.parametrize(
    ("windows", "apart_m", "sent"),
    [
        # 0.12 m, and what a vehicle at 2 m/s moves on between two readings.
        (Windows(0.4, 0.1), 0.30, False),
        (Windows(0.4, 0.1), 0.34, True),
        (Windows(1.2, 0.3), 0.70, False),
        (Windows(1.2, 0.3), 0.74, True),
        # And never more than a metre.
        (Windows(4.0, 1.0), 0.98, False),
        (Windows(4.0, 1.0), 1.02, True),
    ],
)
def test_two_that_agree_on_another_ground_stop_it(windows: Windows, apart_m: float, sent: bool) -> None:
    seen = Seen("abcd", windows)
    assert seen.off("a", 2.0)
    assert seen.off("b", 2.0 + apart_m) is sent


def test_one_sensor_does_not_agree_with_itself_and_known_objects_raise_no_doubt() -> None:
    seen = Seen("abcd")
    assert [seen.off("a", 1.0), seen.off("a", 1.0)] == [True, True]
    objects = Seen("abcd")
    assert [objects.off(name, -0.5, is_object=True) for name in "ab"] == [True, True]


def test_a_ground_in_doubt_is_sent_after_three_readings_in_a_row_beyond_the_first() -> None:
    seen = Seen("abcd")
    seen.support.on_new_ground(in_doubt=True)
    sent = []
    for number in range(8):
        if number == 2:
            seen.support.on_other("a", 3.0, is_object=False)
        else:
            seen.support.on_ground(NOW_S)
        sent.append(seen.support.is_enough(NOW_S, NOW_S, was_ground=number != 2))
    # The one that is not of the ground begins the count anew.
    assert sent == [False] * 5 + [True] * 3


def test_a_reading_that_was_passed_on_late_says_nothing_of_now() -> None:
    seen = Seen("abcd")
    assert seen.support.is_enough(NOW_S, NOW_S + 0.24, was_ground=True)
    assert not seen.support.is_enough(NOW_S, NOW_S + 0.26, was_ground=True)


def test_it_is_not_sent_while_most_newest_readings_lie_to_one_side_even_where_one_is_of_it() -> None:
    """The vehicle may be leaving it too fast for them to agree."""
    for sides, sent in (((1.0, 2.0, 3.0), False), ((-1.0, -2.0, -3.0), False), ((1.0, -2.0, 3.0), True)):
        seen = Seen("abcd")
        for name, off_m in zip("abc", sides, strict=True):
            seen.off(name, off_m)
        seen.sights["d"].ground(NOW_S)
        seen.support.on_ground(NOW_S)
        assert seen.support.is_enough(NOW_S, NOW_S, was_ground=True) is sent, sides


def test_after_more_outliers_than_ground_a_new_ground_is_in_doubt() -> None:
    """Eight readings count, and half of them are not more."""
    for outliers, in_doubt in ((4, False), (5, True)):
        seen = Seen("abcd")
        for _ in range(8 - outliers):
            seen.support.on_ground(NOW_S)
        for number in range(outliers):
            seen.support.on_other("abcd"[number % 4], 1.0, is_object=True)
        seen.support.on_new_ground(in_doubt=False)
        seen.support.on_ground(NOW_S)
        assert seen.support.is_enough(NOW_S, NOW_S, was_ground=True) is not in_doubt


def test_two_against_two_is_no_ground_that_two_sensors_have_agreed_on() -> None:
    """A pair that is sent once stays so against another pair; one that never was does not begin."""
    for agreed_before in (True, False):
        seen = Seen("abcd")
        if not agreed_before:
            seen.support.on_new_ground(in_doubt=False)
        for _ in range(2):
            for name in "cd":
                seen.sights[name].off(NOW_S, 2.0)
                seen.support.on_other(name, 2.0, is_object=False)
        for name in "ab":
            seen.sights[name].ground(NOW_S)
            seen.support.on_ground(NOW_S)
        assert seen.support.is_enough(NOW_S, NOW_S, was_ground=True) is agreed_before


def test_what_was_agreed_on_is_forgotten_when_the_ground_was_not_seen_for_a_turn() -> None:
    windows = Windows()
    for away_s, remembered in ((windows.fresh_s - 0.01, True), (windows.fresh_s + 0.01, False)):
        seen = Seen("abcd")
        later_s = NOW_S + away_s
        assert not seen.support.is_enough(later_s, later_s, was_ground=False)
        for name, off_m in (("c", 2.0), ("d", 2.0)) * 2:
            seen.sights[name].off(later_s, off_m)
        for name in "ab":
            seen.sights[name].ground(later_s)
            seen.support.on_ground(later_s)
        assert seen.support.is_enough(later_s, later_s, was_ground=True) is remembered
