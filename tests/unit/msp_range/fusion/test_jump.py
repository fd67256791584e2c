"""What all sensors see changes at once: over an edge it is the ground, and in its beams it is not sent."""

import random
from collections.abc import Callable, Sequence
from itertools import pairwise

import pytest

from msp_range.fusion import AttitudeTrack, DownwardSensor, Fusion, Windows
from msp_range.fusion.vertical import VerticalMotion
from msp_range.geometry import Vector
from msp_range.reading import Reading, Status

CORNERS = {"a": (0.25, -0.2), "b": (0.25, 0.2), "c": (-0.25, -0.2), "d": (-0.25, 0.2)}
DOWN: Vector = (0.0, 0.0, 1.0)
SLOT_S = 0.1
JUMP_S, END_S = 8.0, 16.0
DOUBTED = "Range: sudden change, maybe an object or fault"
SCATTERED = "Range: readings scatter, as in dust"
OfTime = Callable[[str, float], float]


class Hover:
    """A vehicle at rest whose sensors read whole centimetres, with an accelerometer and a barometer.

    Parameters
    ----------
    range_m
        What a sensor would read at a time [m].
    names
        The sensors that it has.
    noise_m
        Of a reading [m].
    """

    def __init__(self, range_m: OfTime, names: Sequence[str] = "abcd", noise_m: float = 0.02, seed: int = 1) -> None:
        motion = VerticalMotion()
        sensors = {name: DownwardSensor((*CORNERS[name], 0.0), DOWN, "slant") for name in names}
        self.fusion = Fusion(sensors, AttitudeTrack(), Windows(SLOT_S * len(names), SLOT_S), motion)
        self.sent: list[tuple[float, float]] = []
        self.doubted_s: list[float] = []
        self.scattered_s: list[float] = []
        self.fits: list[float] = []
        draw = random.Random(seed)
        for i in range(round(END_S / SLOT_S)):
            time_s, name = i * SLOT_S, names[i % len(names)]
            for k in range(4):
                motion.on_acceleration(time_s - 0.075 + 0.025 * k, draw.gauss(0.0, 0.3))
            motion.on_pressure_height(time_s, draw.gauss(100.0, 0.2))
            seen_m = range_m(name, time_s)
            noisy_m = seen_m if seen_m == CONSTANT_M else seen_m + draw.gauss(0.0, noise_m)
            raw = round(100 * noisy_m)
            out = self.fusion.update(Reading(time_s, name, Status.OK, raw / 100, noise_m, raw), time_s + 0.03)
            if out.fused is not None:
                self.sent.append((time_s, out.fused.range_m))
            self.fits.append(self.fusion.fit)
            texts = [each.text for each in self.fusion.conditions()]
            if DOUBTED in texts:
                self.doubted_s.append(time_s)
            if SCATTERED in texts:
                self.scattered_s.append(time_s)

    def sent_m(self, from_s: float, to_s: float = END_S) -> list[float]:
        """Distances that are sent in a time [m]."""
        return [distance_m for time_s, distance_m in self.sent if from_s <= time_s < to_s]


CONSTANT_M = 3.33
"""A range without noise."""


@pytest.mark.parametrize("names", ["abcd", "abc", "ab", "a"])
@pytest.mark.parametrize(("from_m", "to_m"), [(5.0, 0.4), (3.0, 0.6), (2.5, 0.3)])
def test_what_gets_into_all_beams_is_not_sent_and_reported(names: str, from_m: float, to_m: float) -> None:
    flight = Hover(lambda name, time_s: from_m if time_s < JUMP_S else to_m, names)
    assert len(flight.sent_m(1.0, JUMP_S)) > 60
    assert all(abs(distance_m - from_m) < 0.1 for distance_m in flight.sent_m(1.0))
    assert not flight.sent_m(JUMP_S + 0.5)
    assert JUMP_S < flight.doubted_s[0] < JUMP_S + 1.0
    assert END_S - flight.doubted_s[-1] < 2 * SLOT_S


def test_when_it_is_gone_the_ground_is_sent_again_at_once() -> None:
    flight = Hover(lambda name, time_s: 0.4 if JUMP_S <= time_s < JUMP_S + 4.0 else 5.0)
    assert not flight.sent_m(JUMP_S + 0.5, JUMP_S + 4.0)
    assert len(flight.sent_m(JUMP_S + 4.5)) > 30
    assert flight.doubted_s[-1] < JUMP_S + 4.5


@pytest.mark.parametrize("from_m", [6.0, 5.0, 2.0])
@pytest.mark.parametrize("names", ["abcd", "ab"])
def test_one_constant_of_all_sensors_is_not_sent_for_long_and_reported(from_m: float, names: str) -> None:
    flight = Hover(lambda name, time_s: from_m if time_s < JUMP_S else CONSTANT_M, names)
    assert not flight.sent_m(JUMP_S + 1.5)
    assert JUMP_S < flight.doubted_s[0] < JUMP_S + 1.5


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("from_m", "to_m"), [(3.0, 1.0), (4.0, 2.0), (2.0, 4.0), (6.0, 3.0), (1.0, 6.0), (3.0, 2.7)])
@pytest.mark.parametrize("names", ["abcd", "a"])
def test_edges_are_sent_without_a_text(names: str, from_m: float, to_m: float, seed: int) -> None:
    """The front pair is over the edge half a second before the rear pair."""

    def range_m(name: str, time_s: float) -> float:
        return from_m if time_s < JUMP_S + (0.5 if name in "cd" else 0.0) else to_m

    flight = Hover(range_m, names, seed=seed)
    assert flight.doubted_s == []
    assert len(flight.sent_m(JUMP_S + 1.0)) > 60
    assert all(abs(distance_m - to_m) < 0.1 for distance_m in flight.sent_m(JUMP_S + 1.5))


@pytest.mark.parametrize("names", ["ab", "a"])
def test_a_ground_that_no_sensor_sees_any_more_does_not_silence_the_one_that_they_see(names: str) -> None:
    """Over a kerb, near the ground: what is left behind is as probable as what is seen."""
    flight = Hover(lambda name, time_s: 0.64 if time_s < JUMP_S else 0.5, names)
    assert len(flight.sent_m(JUMP_S, JUMP_S + 2.0)) >= 16
    assert all(abs(distance_m - 0.5) < 0.1 for distance_m in flight.sent_m(JUMP_S + 0.5))


def test_a_step_in_the_way_of_a_doubted_one_is_compared_with_the_ground_before_both() -> None:
    """From 5 m to 0.6 and 0.4 m: the second step is small, and no ground either."""
    flight = Hover(lambda name, time_s: 5.0 if time_s < JUMP_S else 0.6 if time_s < JUMP_S + 3.0 else 0.3)
    assert not flight.sent_m(JUMP_S + 0.5)


class Dust:
    """A share of the readings of some sensors is spread between 20 cm and a distance."""

    def __init__(self, share: float, widest_m: float = 0.8, names: str = "abcd", from_m: float = 3.0) -> None:
        self._share, self._widest_m, self._names, self._from_m = share, widest_m, names, from_m
        self._draw = random.Random(5)

    def __call__(self, name: str, time_s: float) -> float:
        if time_s >= JUMP_S and name in self._names and self._draw.random() < self._share:
            return self._draw.uniform(0.2, self._widest_m)
        return self._from_m


@pytest.mark.parametrize("names", ["abcd", "abc"])
@pytest.mark.parametrize("widest_m", [0.8, 2.5])
def test_in_dust_nothing_is_sent_and_it_is_reported(names: str, widest_m: float) -> None:
    flight = Hover(Dust(0.9, widest_m), names)
    assert JUMP_S < flight.scattered_s[0] <= JUMP_S + 2.5
    assert not flight.sent_m(JUMP_S + 2.5)


def test_dust_below_two_sensors_is_no_ground_where_the_others_see_payload() -> None:
    """Two that see something else say nothing about the ground: what is left of it are answers at random."""
    dust = Dust(0.8, 1.7, "cd", 2.3)
    flight = Hover(lambda name, time_s: 0.26 if name in "ab" and time_s >= JUMP_S else dust(name, time_s))
    assert all(abs(distance_m - 2.3) < 0.1 for distance_m in flight.sent_m(1.0))
    assert JUMP_S < flight.scattered_s[0] <= JUMP_S + 4.0


def test_the_edges_of_a_box_say_nothing_against_the_ground_and_answers_at_random_do() -> None:
    """The mean square of the deviations makes 'readings are noisy' beyond 4."""

    def at_edge(name: str, time_s: float) -> float:
        if time_s < JUMP_S or name in "ab":
            return 2.0
        return draw.uniform(1.0, 2.0) if draw.random() < 0.5 else 1.0

    def at_random(name: str, time_s: float) -> float:
        if name == "c" and time_s >= JUMP_S:
            return 1.5
        return draw.uniform(0.3, 7.0) if time_s >= JUMP_S and draw.random() < 0.35 else 2.0

    draw = random.Random(2)
    assert max(Hover(at_edge).fits) < 3.0
    assert max(Hover(Dust(0.9, 2.5, "ab")).fits) > 4.0
    assert max(Hover(at_random).fits) > 4.0, "an object below one sensor excuses only what lies between"


def test_an_outlier_is_counted_once_whatever_comes_after_it() -> None:
    for after_m in (2.0, None):
        fusion = Hover(lambda name, time_s: 2.0).fusion
        fits: list[float] = []
        for i in range(round(END_S / SLOT_S), round(END_S / SLOT_S) + 12):
            time_s, name = i * SLOT_S, "abcd"[i % 4]
            seen_m = 4.0 if not fits else after_m if name == "a" else 2.0
            status = Status.NO_ECHO if seen_m is None else Status.OK
            raw = 765 if seen_m is None else round(100 * seen_m) + i % 2
            fusion.update(Reading(time_s, name, status, seen_m, 0.02, raw), time_s + 0.03)
            fits.append(fusion.fit)
        rises = [late > early + 0.5 for early, late in pairwise(fits)]
        assert sum(rises) == 1


@pytest.mark.parametrize("dust", [Dust(0.2), Dust(0.9, names="a"), Dust(0.9, names="ab")])
def test_in_some_dust_and_with_two_sensors_that_see_nothing_the_ground_goes_on(dust: Dust) -> None:
    flight = Hover(dust)
    assert all(abs(distance_m - 3.0) < 0.1 for distance_m in flight.sent_m(1.0))
    assert len(flight.sent_m(JUMP_S)) > 50
    assert not flight.scattered_s


def test_when_dust_has_settled_the_ground_is_sent_again() -> None:
    dust = Dust(0.9)
    flight = Hover(lambda name, time_s: dust(name, time_s) if time_s < JUMP_S + 3.0 else 3.0)
    assert len(flight.sent_m(JUMP_S + 5.0)) > 25
    assert flight.scattered_s[-1] < JUMP_S + 5.0


def test_two_outliers_of_a_single_sensor_are_no_dust() -> None:
    flight = Hover(lambda name, time_s: 0.5 if JUMP_S <= time_s < JUMP_S + 1.5 * SLOT_S else 2.0, "a")
    assert not flight.scattered_s
    assert len(flight.sent_m(JUMP_S + 1.0)) > 65
