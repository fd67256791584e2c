"""When 'above the maximum' is reported, and when sensors without an echo mean silence."""

import pytest

from msp_range.fusion.above import AboveMaximum
from msp_range.fusion.vertical import Known, VerticalMotion

NAMES = "abcd"
MAXIMUM_M = 7.65


class Flight:
    """Four sensors and a vehicle whose barometer, if it has one, measures how it climbs."""

    def __init__(self, barometer: bool = True) -> None:
        self.motion = VerticalMotion()
        self.above = AboveMaximum(MAXIMUM_M, self.motion)
        self.barometer = barometer
        self.time_s, self.height_m, self._i = 0.0, 2.0, 0
        self.faces = True

    def fly(self, seconds: float, to_m: float | None = None, with_range: str = "", faulty: str = "") -> list[bool]:
        """One reading each 0.1 s; ``with_range`` are sensors with a range. What is decided at each."""
        steps, out = round(seconds / 0.1), []
        climb_m = 0.0 if to_m is None else (to_m - self.height_m) / steps
        for _ in range(steps):
            name, self._i = NAMES[self._i % 4], self._i + 1
            self.time_s, self.height_m = self.time_s + 0.1, self.height_m + climb_m
            if self.barometer:
                self.motion.on_acceleration(self.time_s, 0.0)
                self.motion.on_pressure_height(self.time_s, self.height_m)
            self.above.update(name, name not in with_range, name not in faulty, faces=self.faces)
            out.append(self.above.decide(self.time_s))
        return out

    def see(self, climb_m_s: float = 0.0) -> None:
        """The ground is seen now."""
        mark = self.motion.mark(self.time_s)
        self.above.on_ground_seen(Known(self.time_s, self.height_m, self.height_m, climb_m_s, mark))


def test_a_ground_that_is_not_heard_any_more_is_not_above_the_maximum() -> None:
    flight = Flight()
    flight.fly(10.0, with_range=NAMES)
    flight.see()
    assert not any(flight.fly(30.0)), "nobody has climbed 5 m"
    flight = Flight()
    flight.fly(10.0, to_m=7.5, with_range=NAMES)
    flight.see()
    assert any(flight.fly(1.0, to_m=8.0))
    assert all(flight.fly(20.0, to_m=10.0))


def test_a_descent_that_nobody_hears_ends_what_was_above_the_maximum() -> None:
    flight = Flight()
    flight.height_m = 9.0
    assert any(flight.fly(5.0)), "a restart in cruise"
    assert all(flight.fly(10.0))
    assert not any(flight.fly(10.0, to_m=3.0)[-20:])


def test_without_a_barometer_it_counts_what_a_vehicle_can_climb() -> None:
    flight = Flight(barometer=False)
    flight.fly(2.0, with_range=NAMES)
    flight.see()
    out = flight.fly(5.0)
    # 5.35 m at 2 m/s^2.
    assert out.index(True) == pytest.approx(23, abs=2)
    assert all(out[out.index(True) :])
    rising = Flight(barometer=False)
    rising.height_m = 7.0
    rising.fly(2.0, with_range=NAMES)
    rising.see(climb_m_s=3.0)
    assert rising.fly(1.0).index(True) <= 2


def test_where_no_ground_was_ever_seen_all_sensors_must_miss_it_for_three_turns() -> None:
    out = Flight().fly(2.0)
    assert out.index(True) == 11
    assert Flight().fly(2.0, faulty="b").index(True) == 11, "a dead sensor has no vote"
    assert not any(Flight().fly(2.0, with_range="c"))
    assert not any(Flight().fly(2.0, faulty=NAMES))


def test_one_outlier_in_cruise_changes_nothing_and_two_that_hear_the_ground_do() -> None:
    flight = Flight()
    flight.fly(3.0)
    assert all(flight.fly(1.0, with_range="b"))
    assert not flight.fly(1.0, with_range="ab")[-1]


@pytest.mark.parametrize(("height_m", "above"), [(7.34, False), (7.36, True)])
def test_the_ground_may_be_lost_30_cm_below_the_maximum(height_m: float, above: bool) -> None:
    flight = Flight()
    flight.height_m = height_m
    flight.fly(10.0, with_range=NAMES)
    flight.see()
    for name in NAMES:
        flight.above.update(name, True, True, faces=True)
    assert flight.above.decide(flight.time_s) is above


@pytest.mark.parametrize(("height_m", "above"), [(4.0, False), (4.5, True)])
def test_a_climb_may_be_three_standard_deviations_longer_than_the_barometer_says(height_m: float, above: bool) -> None:
    """Its drift is 1.04 m in 100 s."""
    flight = Flight()
    flight.height_m = height_m
    flight.fly(10.0, with_range=NAMES)
    flight.see()
    assert flight.fly(100.0)[-1] is above


def test_without_a_barometer_no_vehicle_climbs_faster_than_five_metres_a_second() -> None:
    flight = Flight(barometer=False)
    flight.height_m = 0.1
    flight.fly(2.0, with_range=NAMES)
    flight.see(climb_m_s=20.0)
    # 7.25 m at 5 m/s.
    assert flight.fly(3.0).index(True) == pytest.approx(14, abs=1)


@pytest.mark.parametrize("barometer", [False, True])
def test_a_vehicle_that_leans_is_above_the_maximum_only_where_it_climbed_so_far_for_sure(barometer: bool) -> None:
    """Its beams miss the ground at any height."""
    flight = Flight(barometer)
    flight.fly(2.0, with_range="abcd")
    flight.see()
    flight.faces = False
    assert not any(flight.fly(5.0, to_m=6.6))
    assert flight.fly(5.0, to_m=12.0)[-1] is barometer
    flight.faces = True
    assert flight.fly(1.0)[-1]
    flight.faces = False
    assert flight.fly(1.0)[-1], "it was above before it leaned"
    assert flight.fly(10.0, to_m=6.6)[-1] is not barometer
