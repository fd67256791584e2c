"""The first ground: how many readings it takes, what speaks against it, and what a barometer adds."""

from collections.abc import Callable

import pytest

from msp_range.fusion.start import Candidate, Found, Start
from msp_range.fusion.vertical import Known, VerticalMotion
from msp_range.fusion.windows import Windows

SLOT_S = 0.1
FIRST_S = 20.0
"""Time of the first reading: a barometer has been received since 0 s."""


class First:
    """Heights enter slot by slot; the first ground leaves.

    Parameters
    ----------
    working
        Sensors that are in order.
    climb_m_s
        What a barometer reads all the time; None: there is none.
    """

    def __init__(self, working: int, climb_m_s: float | None = None) -> None:
        self.motion = VerticalMotion()
        self.start = Start(Windows(), self.motion)
        self._working, self._climb_m_s = working, climb_m_s
        self._time_s = 0.0
        self.listen(FIRST_S)

    def listen(self, until_s: float) -> None:
        """Accelerations and pressures until then."""
        while self._climb_m_s is not None and self._time_s <= until_s:
            self.motion.on_acceleration(self._time_s, 0.0)
            self.motion.on_pressure_height(self._time_s, 100.0 + self._climb_m_s * self._time_s)
            self._time_s += 0.05

    def see(self, after_s: float, sensor: str, height_m: float, *garbled_m: float) -> Found | None:
        """A height so long after the first slot."""
        time_s = FIRST_S + after_s
        self.listen(time_s)
        mark = self.motion.mark(time_s)
        return self.start.add(Candidate(time_s, sensor, height_m, 0.02**2, garbled_m, mark), self._working)

    def turns(self, names: str, height_m: Callable[[str, float], float]) -> list[Found | None]:
        """One slot each for sensors in this order."""
        times_s = [SLOT_S * slot for slot in range(len(names))]
        return [self.see(time_s, name, height_m(name, time_s)) for name, time_s in zip(names, times_s, strict=True)]


def first(out: list[Found | None]) -> int | None:
    """The reading that made a ground, counted from 1."""
    return next((i for i, found in enumerate(out, 1) if found is not None), None)


def test_two_sensors_that_agree_make_a_ground_with_all_that_is_known_of_it() -> None:
    begin = First(2)
    assert begin.see(0.0, "a", 3.0) is None
    found = begin.see(0.1, "b", 3.04)
    assert found is not None
    assert (found.newest.sensor, found.newest.height_m) == ("b", 3.04)
    assert (found.earlier.sensor, found.earlier.height_m) == ("a", 3.0)
    assert found.sensors == {"a", "b"}
    assert not found.in_doubt


@pytest.mark.parametrize(
    ("apart_m", "elapsed_s", "needed"),
    [
        # 15 cm are a slope and noise.
        (0.14, 0.1, 2),
        (-0.14, 0.1, 2),
        # 1 m/s is a speed that two readings are enough for, 1.7 m/s takes a third one.
        (0.19, 0.2, 2),
        (-0.19, 0.2, 2),
        (0.34, 0.2, 3),
        (-0.34, 0.2, 3),
        # 4.8 m/s is a vehicle's.
        (0.96, 0.2, 3),
        (1.04, 0.2, None),
    ],
)
def test_heights_of_one_ground_lie_on_a_line_that_a_vehicle_can_climb(
    apart_m: float, elapsed_s: float, needed: int | None
) -> None:
    begin = First(3)
    out = [begin.see(i * elapsed_s, name, 10.0 + i * apart_m) for i, name in enumerate("abc")]
    assert first(out) == needed


@pytest.mark.parametrize(
    ("names", "working", "needed"),
    [
        ("aaaaaa", 1, 2),
        # Others are in order and have no echo.
        ("aaaaaa", 2, 4),
        ("aaaaaa", 4, 4),
        ("ababab", 2, 2),
        ("ababab", 3, 2),
        # Two of four are no more than those without an echo.
        ("ababab", 4, 4),
        ("ababab", 5, 4),
        ("abcabc", 4, 3),
        ("abcabc", 5, 3),
    ],
)
def test_the_fewer_of_the_working_sensors_agree_the_more_readings_it_takes(
    names: str, working: int, needed: int
) -> None:
    assert first(First(working).turns(names, lambda name, time_s: 3.0)) == needed


def test_a_reading_that_does_not_agree_makes_four_necessary_and_leaves_a_doubt() -> None:
    begin = First(4)
    out = begin.turns("abcda", lambda name, time_s: 1.2 if name == "a" and time_s == 0.0 else 3.0)
    assert first(out) == 5
    found = out[4]
    assert found is not None
    assert found.in_doubt
    assert found.sensors == set("abcd")


def test_more_than_twice_as_many_must_agree_as_do_not() -> None:
    """Two outliers of one turn ask for five readings, and more than four as long as both are of the last turn."""
    out = First(3).turns("abcabcabc", lambda name, time_s: {"a": 1.0, "b": 7.0}[name] if time_s < 0.15 else 3.0)
    assert first(out) == 7
    assert out[6] is not None
    assert out[6].in_doubt


@pytest.mark.parametrize(("age_s", "needed"), [(0.60, 4), (0.68, 2)])
def test_an_outlier_speaks_against_a_ground_for_a_turn_and_a_half(age_s: float, needed: int) -> None:
    begin = First(2)
    begin.see(0.0, "a", 9.0)
    assert first([begin.see(age_s + 0.01 * (i - 1), "ba"[i % 2], 3.0) for i in range(5)]) == needed


def test_heights_are_forgotten() -> None:
    begin = First(2)
    begin.see(0.0, "a", 3.0)
    assert begin.see(1.49, "b", 3.0) is not None
    begin = First(2)
    begin.see(0.0, "a", 3.0)
    assert begin.see(1.51, "b", 3.0) is None
    begin.start.clear()
    assert begin.see(1.6, "a", 3.0) is None
    begin.start.without("a")
    assert begin.see(1.7, "b", 3.0) is None, "the other one's newest reading had no range"
    assert begin.see(1.8, "a", 3.0) is not None


def test_only_the_last_four_heights_of_a_sensor_count() -> None:
    """One that has passed on to a new ground is not held back by what it saw before."""
    begin = First(1)
    for i in range(8):
        begin.see(0.05 * i, "a", 1.0 if i % 2 else 2.0)
    out = [begin.see(0.4 + 0.05 * i, "a", 3.0) for i in range(5)]
    assert first(out) == 4
    assert out[3] is not None
    assert not out[3].in_doubt


def test_of_two_lines_the_one_that_more_sensors_are_on_is_taken() -> None:
    """At rest b and c agree; at 0.4 m/s all three do."""
    begin = First(3)
    begin.see(0.0, "a", 3.00)
    begin.see(0.5, "b", 3.12)
    found = begin.see(0.7, "c", 3.26)
    assert found is not None
    assert found.sensors == set("abc")
    assert found.earlier.sensor == "a"


# Garbled readings.


def test_a_reading_that_is_the_garbled_form_of_another_one_speaks_for_and_against_nothing() -> None:
    """2.47 m is what 5.03 m becomes with its high byte lost."""
    begin = First(3)
    assert begin.see(0.0, "a", 2.47, 5.03, 7.59) is None
    found = begin.see(0.1, "b", 5.03)
    assert found is None, "one reading so far"
    found = begin.see(0.2, "c", 5.03)
    assert found is not None
    assert not found.in_doubt
    begin = First(3)
    assert begin.see(0.0, "a", 5.03) is None
    assert begin.see(0.1, "b", 2.47, 5.03) is None
    assert begin.see(0.2, "c", 2.47, 5.03) is None, "garbled forms of the first one"
    assert begin.see(0.3, "b", 5.03) is not None
    # What they would have been is a different height: nothing explains them.
    begin = First(3)
    begin.see(0.0, "a", 7.9)
    assert begin.see(0.1, "b", 2.47, 5.03) is None
    out = [begin.see(0.2 + SLOT_S * i, "cbcb"[i], 2.47, 5.03) for i in range(4)]
    assert first(out) == 3
    assert out[2] is not None
    assert out[2].in_doubt


def test_the_ground_that_was_known_before_explains_garbled_readings_while_the_vehicle_is_near_it() -> None:
    def after(known_s: float, barometer: bool) -> int | None:
        begin = First(2, 0.0 if barometer else None)
        mark = begin.motion.mark(FIRST_S)
        begin.start.on_ground_seen(Known(FIRST_S, 5.03, 5.03, 0.0, mark))
        return first([begin.see(known_s + SLOT_S * i, "ab"[i % 2], 2.47, 5.03) for i in range(6)])

    # Without a barometer a vehicle may be a metre away after 0.17 s: the third reading is believed.
    assert after(0.05, False) == 3
    assert after(0.18, False) == 2
    # With one it is known to be near for two seconds.
    assert after(0.05, True) is None
    assert after(1.5, True) is None
    assert after(4.0, True) == 2


def test_a_remembered_ground_at_another_height_explains_nothing() -> None:
    begin = First(2, 0.0)
    begin.start.on_ground_seen(Known(FIRST_S, 4.0, 4.0, 0.0, begin.motion.mark(FIRST_S)))
    begin.see(0.1, "a", 2.47, 5.03)
    assert begin.see(0.2, "b", 2.47, 5.03) is not None


# With a barometer.


@pytest.mark.parametrize("climb_m_s", [0.0, 1.0, -3.0])
def test_heights_that_climb_as_the_barometer_does_need_no_third_one(climb_m_s: float) -> None:
    begin = First(2, climb_m_s)
    out = begin.turns("abab", lambda name, time_s: 6.0 + climb_m_s * time_s)
    assert first(out) == 2


def test_heights_that_climb_and_a_barometer_that_does_not_are_no_ground() -> None:
    """Without the barometer their line would be one."""
    names = "ab" * 8
    assert first(First(2, 0.0).turns(names, lambda name, time_s: 4.0 + 3.0 * time_s)) is None
    assert first(First(2).turns(names, lambda name, time_s: 4.0 + 3.0 * time_s)) == 3
    assert first(First(2, 3.0).turns(names, lambda name, time_s: 4.0)) is None
    assert first(First(2).turns(names, lambda name, time_s: 4.0)) == 2


def test_of_two_against_two_the_barometer_takes_those_that_climb_with_it() -> None:
    begin = First(4, 2.0)
    out = begin.turns("acbd" * 4, lambda name, time_s: 2.0 + 2.0 * time_s if name in "ab" else 5.0)
    found = next((each for each in out if each is not None), None)
    assert found is None or found.sensors == set("ab")


def test_a_barometer_that_has_just_begun_is_not_used() -> None:
    """Its first value gives no rate: heights that climb make a ground by their own line, of three."""
    begin = First(3)
    begin.motion.on_pressure_height(FIRST_S, 100.0)
    assert first([begin.see(SLOT_S * i, "abc"[i], 4.0 + 0.3 * i) for i in range(3)]) == 3


def test_a_garbled_reading_is_compared_along_the_climb() -> None:
    """At 2 m/s 5.03 m are 6.03 m half a second later."""
    begin = First(3, 2.0)
    assert begin.see(0.0, "a", 2.47, 5.03) is None
    assert begin.see(0.5, "b", 6.03) is None
    found = begin.see(0.6, "c", 6.23)
    assert found is not None
    assert not found.in_doubt
    later = First(3, 2.0)
    assert later.see(0.0, "a", 5.03) is None
    assert later.see(0.5, "b", 3.47, 6.03) is None
    found = later.see(0.6, "c", 6.23)
    assert found is not None
    assert not found.in_doubt


def test_three_answers_that_may_be_garbled_forms_of_one_are_not_overruled_by_it() -> None:
    """One sensor that is 2.56 m off looks like the ground of which the others have lost the high byte."""
    begin = First(4)
    for i in range(16):
        height_m, *garbled_m = (2.78,) if i % 4 == 0 else (0.22, 2.78)
        assert begin.see(SLOT_S * i, "abcd"[i % 4], height_m, *garbled_m) is None
