"""Which of several surfaces is the ground, and how probable that is."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import groupby, pairwise

import numpy as np
import pytest

from msp_range.fusion import AttitudeTrack, DownwardSensor, Fusion, Windows
from msp_range.fusion.belief import Belief, Surface
from msp_range.fusion.ground_filter import GroundFilter
from msp_range.fusion.modes import (
    COMMON,
    COMMON_AGAIN,
    COMMON_LOW,
    LOW,
    START,
    SensorMode,
    ground_prior,
    noise_density,
    object_prior,
)
from msp_range.fusion.response import MotionResponse
from msp_range.fusion.vertical import Rate, VerticalMotion
from msp_range.reading import Reading, Status
from tests.unit.msp_range.fusion.test_fusion import (
    CORNERS,
    DOWN,
    NAMES,
    SIGMA_M,
    SLOT_S,
    WINDOWS,
    accelerate,
    four,
    reading,
    take,
)


def sent_m(range_m: Callable[[str, float], float], until_s: float = 20.0) -> dict[float, float]:
    """What is sent of four sensors that read so, by its time [s]."""
    fusion, draw, sent = four(), np.random.default_rng(1), {}
    for i in range(round(until_s / SLOT_S)):
        time_s = i * SLOT_S
        seen_m = range_m(NAMES[i % 4], time_s) + draw.normal(scale=SIGMA_M)
        if (fused := take(fusion, reading(NAMES[i % 4], time_s, seen_m))) is not None:
            sent[time_s] = fused.range_m
    return sent


def dust(seed: int) -> Callable[[str, float], float]:
    """The range over ground 2 m below [m]; from 5 s on six of seven answers are at random."""
    draw = np.random.default_rng(seed)
    return lambda name, time_s: draw.uniform(0.2, 7.0) if time_s > 5.0 and draw.random() < 0.85 else 2.0


@pytest.mark.parametrize("rise_m", [0.3, 1.0, 2.0, -1.0])
def test_an_edge_that_two_of_four_have_passed_silences_nothing(rise_m: float) -> None:
    """The known ground goes on, however long two sensors see one level and two the other; then the new one."""
    sent = sent_m(lambda name, time_s: 3.0 - rise_m * (time_s > (8.0 if name in "ab" else 12.0)))
    times_s = sorted(sent)
    assert max(late - early for early, late in pairwise(times_s)) < 0.35
    assert all(abs(sent[time_s] - 3.0) < 0.1 for time_s in times_s if time_s < 12.0)
    assert all(abs(sent[time_s] - 3.0 + rise_m) < 0.1 for time_s in times_s if time_s > 12.6)


@pytest.mark.parametrize("names", ["abc", "abcd"])
def test_the_ground_next_to_a_box_is_found_again_after_three_of_four_have_seen_its_corner(names: str) -> None:
    sent = sent_m(lambda name, time_s: 3.0 - 0.8 * (8.0 < time_s < (14.0 if name in "ab" else 8.7) and name in names))
    assert all(abs(range_m - 3.0) < 0.1 for time_s, range_m in sent.items() if time_s > 9.5)
    assert sum(9.5 < time_s < 14.0 for time_s in sent) > 40


def test_a_sensor_that_goes_on_seeing_an_earlier_level_says_nothing_about_the_next_step() -> None:
    """As one that is stuck: where the ground was two steps before is as unlikely as any other level."""
    sent = sent_m(lambda name, time_s: 2.65 if name == "a" or time_s < 5.0 else 2.4 if time_s < 12.0 else 1.9)
    after = [range_m for time_s, range_m in sent.items() if time_s > 12.6]
    assert len(after) > 70
    assert all(abs(range_m - 1.9) < 0.1 for range_m in after)


def test_one_sensor_at_an_earlier_level_and_one_at_a_new_one_leave_no_ground_sure() -> None:
    """The others get no echo: where the ground was a step before is no likelier than any other level."""
    fusion, draw = four(), np.random.default_rng(1)
    for i in range(200):
        name, time_s = NAMES[i % 4], i * SLOT_S
        level_m = 2.65 if name == "a" or time_s < 5.0 else 2.4 if time_s < 12.0 else 1.9
        is_heard = time_s < 12.0 or name in "ad"
        fused = take(fusion, reading(name, time_s, level_m + draw.normal(scale=SIGMA_M) if is_heard else None))
        assert fused is None or time_s < 14.0


def test_a_level_that_three_of_four_have_seen_for_long_goes_on_through_a_tie() -> None:
    def range_m(name: str, time_s: float) -> float:
        return 3.0 if time_s < 8.0 or name == "d" or (name == "c" and time_s > 12.0) else 2.2

    assert all(abs(each_m - 2.2) < 0.1 for time_s, each_m in sent_m(range_m).items() if time_s > 9.5)


@pytest.mark.parametrize("wrong", ["abcd", "abc"])
def test_what_gets_into_the_beams_high_up_is_no_ground(wrong: str) -> None:
    """From 5 m to 0.4 m at once, which no terrain does: silence, or the distance of the one that is right."""
    sent = sent_m(lambda name, time_s: 0.4 if name in wrong and time_s > 10.0 else 5.0)
    assert all(abs(range_m - 5.0) < 0.1 for range_m in sent.values())


def test_a_level_that_three_of_four_see_is_the_ground_and_no_object_below_each() -> None:
    sent = sent_m(lambda name, time_s: 1.5 if name in "bcd" and time_s > 7.0 else 4.0)
    after = [range_m for time_s, range_m in sent.items() if time_s > 7.6]
    assert len(after) > 114
    assert all(abs(range_m - 1.5) < 0.1 for range_m in after)


@pytest.mark.parametrize("seed", range(3))
def test_of_answers_at_random_hardly_any_is_sent(seed: int) -> None:
    """As in thick dust, or with a bus that makes them up: two that agree by chance are soon contradicted."""
    draw = np.random.default_rng(seed)
    sent = sent_m(lambda name, time_s: draw.uniform(0.2, 7.0) if time_s > 6.0 else 2.0, 26.0)
    assert sum(time_s > 7.0 for time_s in sent) < 0.04 * 190


def test_a_strap_that_two_of_five_have_always_seen_is_no_ground_when_the_others_fail() -> None:
    """It was as good a first ground as any before the others were read; then it was a step away from theirs."""
    order = "deabc"
    places = {name: (0.2 * i, 0.1 * (i % 2), 0.0) for i, name in enumerate(order)}
    fusion = Fusion(
        {name: DownwardSensor(place, DOWN, "slant") for name, place in places.items()}, AttitudeTrack(), WINDOWS
    )
    draw = np.random.default_rng(1)
    for i in range(200):
        name, time_s = order[i % 5], i * SLOT_S
        seen = reading(name, time_s, (0.4 if name in "de" else 3.0) + draw.normal(scale=0.01))
        if name in "abc" and time_s > 8.0:
            seen = Reading(time_s, name, Status.NO_ANSWER)
        fused = take(fusion, seen)
        assert fused is None or abs(fused.range_m - 3.0) < 0.1 or time_s < 0.5


def test_in_dust_what_few_answers_say_is_not_taken_for_the_ground() -> None:
    """A sensor that has given answers at random will give more of them."""
    sent = [sent_m(dust(seed)) for seed in range(8)]
    off_m = [abs(range_m - 2.0) for each in sent for time_s, range_m in each.items() if time_s > 5.0]
    assert len(off_m) > 40
    assert sum(each_m > 0.2 for each_m in off_m) < 0.1 * len(off_m)


@pytest.mark.parametrize("slot_s", [0.1, 0.5, 0.8])
def test_two_readings_that_agree_are_a_first_ground_however_slow_the_polling_is(slot_s: float) -> None:
    sensors = {name: DownwardSensor((x, y, 0.0), DOWN, "slant") for name, (x, y) in CORNERS.items()}
    fusion = Fusion(sensors, AttitudeTrack(), Windows(4 * slot_s, slot_s))
    assert take(fusion, reading("a", 0.0, 3.0)) is None
    assert take(fusion, reading("b", slot_s, 3.02)) is not None


def test_a_sensor_with_more_noise_than_an_ultrasonic_one_has_one_ground() -> None:
    """A lidar at 30 m."""
    fusion = four(names="a", maximum_m=60.0)
    draw = np.random.default_rng(2)
    sent = 0
    for i in range(300):
        seen_m = 30.0 + draw.normal(scale=0.15)
        seen = Reading(i * SLOT_S, "a", Status.OK, seen_m, 0.15, round(100 * seen_m))
        sent += take(fusion, seen) is not None
    assert sent > 285


class Moving:
    """Four sensors below a vehicle that climbs by a profile, with an accelerometer and a barometer.

    Parameters
    ----------
    range_m
        What a sensor reads at a time and a height [m]; NaN: it does not answer.
    climbs
        Beginnings of climbs of 1 m in 2 s, with 1 m/s^2 up and down [s].
    climb_m
        As many times that; they are descents where it is negative.
    measured_from_s
        When the accelerometer begins to say something, and the barometer [s].
    names
        Of the sensors.
    late_from_s
        When each sensor begins to answer with its ping before [s].
    in_cm
        Whether readings are as whole centimetres, and have no noise.
    no_pressure_s
        Between these times the barometer says nothing [s].
    """

    def __init__(
        self,
        range_m: Callable[[str, float, float], float],
        climbs: Sequence[float] = (),
        climb_m: float = 1.0,
        seed: int = 1,
        measured_from_s: tuple[float, float] = (-1.0, -1.0),
        names: str = NAMES,
        late_from_s: float = math.inf,
        in_cm: bool = False,
        no_pressure_s: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        self._climbs, self._climb_m = climbs, climb_m
        motion, draw = VerticalMotion(), np.random.default_rng(seed)
        fusion = four(motion=motion, names=names, maximum_m=7.65)
        self.sent: dict[float, float] = {}
        self.statuses: dict[float, Status] = {}
        self.doubts: dict[float, str | None] = {}
        pings: dict[str, Reading] = {}
        for i in range(200):
            time_s = i * SLOT_S
            if time_s > measured_from_s[0]:
                accelerate(motion, time_s - 0.075, lambda moment_s: self._at(moment_s)[1], draw)
            by_pressure_m = 100.0 + self._at(time_s)[0] + draw.normal(0.0, 0.1)
            if time_s > measured_from_s[1] and not no_pressure_s[0] < time_s < no_pressure_s[1]:
                motion.on_pressure_height(time_s, by_pressure_m)
            name = names[i % len(names)]
            seen_m = range_m(name, time_s, self._at(time_s)[0]) + (0.0 if in_cm else draw.normal(scale=SIGMA_M))
            seen = Reading(time_s, name, Status.NO_ANSWER) if math.isnan(seen_m) else reading(name, time_s, seen_m)
            if in_cm:
                seen = replace(seen, raw=round(100 * seen_m))
            before, pings[name] = pings.get(name, seen), seen
            if time_s > late_from_s:
                seen = replace(before, time_s=time_s)
            out = fusion.update(seen, time_s + 0.03)
            self.statuses[time_s] = out.reading.status
            self.doubts[time_s] = {each.key: each.text for each in fusion.conditions()}["doubt"]
            if out.fused is not None:
                self.sent[time_s] = out.fused.range_m
                self.probability = out.fused.probability

    def sent_s(self, from_s: float, to_s: float = math.inf) -> list[float]:
        """When something was sent between two times [s]."""
        return [time_s for time_s in self.sent if from_s < time_s < to_s]

    def sent_m(self, from_s: float) -> list[float]:
        """What was sent from a time on [m]."""
        return [self.sent[time_s] for time_s in self.sent_s(from_s)]

    def _at(self, time_s: float) -> tuple[float, float]:
        """How far it has climbed [m], and its acceleration upwards [m/s^2]."""
        height_m = up_m_s2 = 0.0
        for from_s in self._climbs:
            t = min(max(time_s - from_s, 0.0), 2.0)
            height_m += t * t / 2 if t < 1.0 else 1.0 - (2.0 - t) ** 2 / 2
            up_m_s2 += (1.0 if t < 1.0 else -1.0) if 0.0 < t < 2.0 else 0.0
        return self._climb_m * height_m, self._climb_m * up_m_s2


@pytest.mark.parametrize(("varies_m", "least_sent"), [(0.0, 1), (0.01, 90)])
def test_a_step_in_a_hover_is_sent_where_the_answers_beyond_it_differ(varies_m: float, least_sent: int) -> None:
    """Two sensors that agree on one constant are as likely out of order."""

    def range_m(_name: str, time_s: float, _height_m: float) -> float:
        differs_m = 0.01 * (round(time_s / SLOT_S) % 3)
        return 3.0 + differs_m if time_s < 10.0 else 3.5 + varies_m * round(100 * differs_m)

    flight = Moving(range_m, names="ab", in_cm=True)
    assert flight.probability > 0.9999 or not varies_m
    sent = flight.sent_m(10.05)
    assert least_sent <= len(sent) < least_sent + 12
    assert all(abs(each - 3.5) < 0.05 for each in sent)


def test_the_ground_returns_where_the_barometer_says() -> None:
    """Something in the beams of all sensors for 8 s is no ground; what they see then is."""
    flight = Moving(lambda name, time_s, height_m: 0.4 if 6.0 < time_s < 14.0 else 5.0)
    assert all(abs(range_m - 5.0) < 0.1 for range_m in flight.sent.values())
    assert sum(time_s > 14.5 for time_s in flight.sent) > 50


@pytest.mark.parametrize("base_m", [0.6, 1.5])
def test_it_returns_where_the_vehicle_has_climbed_meanwhile(base_m: float) -> None:
    """By 2 m while all sensors are without an answer of the ground; back at its old height it would be a step."""
    spoilt = np.random.default_rng(5)

    def range_m(name: str, time_s: float, height_m: float) -> float:
        return spoilt.uniform(0.2, 7.0) if 6.0 < time_s < 12.0 else base_m + height_m

    flight = Moving(range_m, climbs=(7.0, 9.0))
    after_m = flight.sent_m(12.7)
    assert len(after_m) > 65
    assert after_m == pytest.approx([base_m + 2.0] * len(after_m), abs=0.15)


def test_it_returns_near_the_ground_where_the_vehicle_has_sunk_meanwhile() -> None:
    """From 2.5 to 0.5 m: without the barometer's descent that would be something in the beams."""
    spoilt = np.random.default_rng(5)

    def range_m(name: str, time_s: float, height_m: float) -> float:
        return spoilt.uniform(2.0, 7.0) if 6.0 < time_s < 12.0 else 2.5 + height_m

    flight = Moving(range_m, climbs=(7.0, 9.0), climb_m=-1.0)
    after_m = flight.sent_m(12.7)
    assert len(after_m) > 65
    assert after_m == pytest.approx([0.5] * len(after_m), abs=0.1)


def test_a_ground_that_is_near_after_a_jump_is_sent_when_it_answers_to_a_climb() -> None:
    flight = Moving(lambda name, time_s, height_m: (4.0 if time_s < 6.0 else 0.5) + height_m, climbs=(10.0,))
    assert not flight.sent_s(6.5, 10.0)
    after_m = flight.sent_m(12.0)
    assert len(after_m) > 70
    assert after_m == pytest.approx([1.5] * len(after_m), abs=0.15)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("climb_m", [1.0, 4.0])
def test_what_does_not_answer_to_a_climb_is_part_of_the_vehicle(climb_m: float, seed: int) -> None:
    """Nor in a hard one, in which its readings would be taken for those of many surfaces."""
    flight = Moving(lambda name, time_s, height_m: 3.0 if time_s < 7.0 else 0.5, (10.0, 13.0), climb_m, seed)
    assert not flight.sent_s(7.5)
    assert Status.FIXED in flight.statuses.values()


def test_priors_fall_with_the_size_of_a_step() -> None:
    priors = [ground_prior(off_m, 0.02, 3.0) for off_m in (0.0, 0.3, 1.0, 3.0)]
    assert priors == sorted(priors, reverse=True)
    assert ground_prior(1.0, 0.02, 0.5) < ground_prior(1.0, 0.02, 1.5)
    nobody_knows_m = 3.0
    near, far = (ground_prior(0.0, nobody_knows_m, height_m) for height_m in (0.5, 1.5))
    assert math.exp(near - far) == pytest.approx(LOW)
    assert object_prior(0.5) > object_prior(3.0) == pytest.approx(math.log(0.03), abs=0.2)


@pytest.mark.parametrize("drop_m", [0.5, 1.2])
@pytest.mark.parametrize("dead", ["a", "d"])
def test_an_edge_silences_three_sensors_of_four_for_no_second_turn(dead: str, drop_m: float) -> None:
    """The front ones, a and b, pass it a second before the others."""
    fusion, draw, sent = four(), np.random.default_rng(1), []
    for i in range(160):
        name, time_s = NAMES[i % 4], i * SLOT_S
        passed_s = 8.0 if name in "ab" else 9.0
        seen = reading(name, time_s, 3.0 + drop_m * (time_s > passed_s) + draw.normal(scale=SIGMA_M))
        if name == dead:
            seen = Reading(time_s, name, Status.NO_ANSWER)
        if take(fusion, seen) is not None:
            sent.append(time_s)
    assert max(late - early for early, late in pairwise(sent)) < 0.65


def test_a_strap_that_the_ground_was_nearer_than_before_the_take_off_is_not_sent_for_long() -> None:
    """Up to 0.57 m the readings follow the climb, and then no more."""
    climbing = Moving(lambda name, time_s, height_m: min(0.2 + height_m, 0.57), [5.0, 9.0])
    assert not climbing.sent_s(9.5)
    at_rest = Moving(lambda name, time_s, height_m: 0.57)
    assert len(at_rest.sent_s(9.5)) > 90


@pytest.mark.parametrize("seed", range(3))
def test_a_strap_is_not_sent_where_the_vehicle_has_risen_before_its_accelerations_are_known(seed: int) -> None:
    """By 4 m by the barometer; a ground that is as near follows that, and is sent."""
    begins_s = (30.0, 1.0)
    strap = Moving(lambda name, time_s, height_m: 0.4, (2.0, 4.0), 2.0, seed, begins_s)
    assert not strap.sent_s(5.0, 15.0)
    strap = Moving(lambda name, time_s, height_m: 0.4, (6.0, 8.0), 2.0, seed, begins_s, no_pressure_s=(2.0, 5.0))
    assert strap.sent_s(3.0, 6.0)
    assert not strap.sent_s(10.0, 15.0), "the climb counts from where the barometer begins anew"
    ground = Moving(lambda name, time_s, height_m: 0.3 + 0.1 * height_m, (2.0, 4.0), 0.5, seed, begins_s)
    assert len(ground.sent_s(5.0)) > 140


@pytest.mark.parametrize("seed", range(3))
def test_what_gets_into_the_beams_in_a_climb_is_no_ground(seed: int) -> None:
    """The ground that nobody sees any more is not one whose sensors repeat themselves."""
    climbs = [8.0 + 1.5 * i for i in range(6)]
    flight = Moving(lambda name, time_s, height_m: 0.25 if time_s > 9.0 else 4.0 + height_m, climbs, 1.0, seed)
    assert not [time_s for time_s, range_m in flight.sent.items() if range_m < 3.0]


@pytest.mark.parametrize("seed", range(3))
def test_a_ground_that_its_last_sensor_misses_once_in_a_climb_stays(seed: int) -> None:
    """Two of four are 1.7 m short and climb with the vehicle; one of the others is dead, and one has an outlier."""

    def range_m(name: str, time_s: float, height_m: float) -> float:
        if name in "cd" and time_s > 4.0:
            return 1.3 + height_m
        if name == "a" and time_s > 8.0:
            return math.nan
        return 2.6 if name == "b" and 11.0 < time_s < 11.4 else 3.0 + height_m

    flight = Moving(range_m, (9.0, 10.0, 11.0), 1.0, seed)
    assert not [time_s for time_s, sent_m in flight.sent.items() if time_s > 11.0 and sent_m < 3.5]


@pytest.mark.parametrize("seed", range(3))
def test_a_strap_that_swings_free_is_not_believed_again(seed: int) -> None:
    """It was found to be fixed, and then is where the ground is no more likely."""
    strap = Moving(lambda name, time_s, height_m: 0.4 if time_s < 9.0 else 0.55, [5.0], 1.0, seed, names="a")
    assert Status.FIXED in strap.statuses.values()
    assert not strap.sent_s(7.5)


@pytest.mark.parametrize("climb_m", [1.0, -1.0], ids=["climb", "descent"])
def test_answers_that_begin_to_come_late_in_a_steady_climb_are_not_sent(climb_m: float) -> None:
    """Each sensor gives its last answer once more, and edges do not end that; a kerb of that height is ground."""
    climbs, level_m = [4.0 + i for i in range(8)], 4.2 - 2.8 * climb_m
    late = Moving(lambda name, time_s, height_m: level_m + height_m, climbs, climb_m, late_from_s=7.95)
    assert not late.sent_s(8.4, 10.0)
    edge = Moving(
        lambda name, time_s, height_m: level_m + height_m - 0.6 * climb_m * ((time_s > 8.75) + (time_s > 9.35)),
        climbs,
        climb_m,
        late_from_s=7.95,
    )
    assert not edge.sent_s(8.4, 10.0)
    kerb = Moving(lambda name, time_s, height_m: level_m + height_m - 0.4 * climb_m * (time_s > 7.95), climbs, climb_m)
    assert len(kerb.sent_s(8.4, 10.0)) > 12


def test_answers_stay_late_on_a_ground_that_was_lost_meanwhile() -> None:
    """For 3 s no sensor answers, which is longer than any surface is remembered; sent are hovers of 3 and 4 m."""

    def range_m(name: str, time_s: float, height_m: float) -> float:
        return math.nan if 11.0 < time_s < 14.0 else 1.0 + height_m

    flight = Moving(range_m, [4.0, 8.0, 16.0], late_from_s=6.0)
    assert not flight.sent_s(16.4, 18.4)
    assert flight.sent_s(14.5, 16.0)
    assert all(abs(sent_m - round(sent_m)) < 0.06 for sent_m in flight.sent_m(9.5))


CHANGED, UNANSWERED = "Range: sudden change, maybe an object or fault", "Range: readings do not follow the motion"


def test_a_doubt_lasts_until_a_ground_is_sent_again() -> None:
    """Also where another reason follows, and while nothing is seen but part of the vehicle."""
    flight = Moving(lambda name, time_s, height_m: 0.4 if 8.0 < time_s < 14.0 else 4.0 + height_m, [10.0], 1.0)
    doubted_s = [time_s for time_s, doubt in flight.doubts.items() if doubt]
    assert Status.FIXED in flight.statuses.values()
    assert doubted_s[0] < 8.6
    assert all(doubt for time_s, doubt in flight.doubts.items() if doubted_s[0] < time_s < 14.0)
    assert doubted_s[-1] < min(time_s for time_s in flight.sent if time_s > 14.0) + 0.15


@pytest.mark.parametrize("seed", range(4))
def test_a_doubt_has_one_reason_after_another(seed: int) -> None:
    """Also after a movement that is too small to decide."""
    flight = Moving(lambda name, time_s, height_m: 0.4 if time_s > 3.0 else 3.0 + height_m, [5.0], 0.4, seed)
    assert [doubt for doubt, _ in groupby(flight.doubts.values())] in ([None, CHANGED], [None, CHANGED, UNANSWERED])


@pytest.mark.parametrize("seed", range(3))
def test_two_sensors_that_drift_alike_are_a_slope_until_it_is_too_steep(seed: int) -> None:
    """Those at the rear get longer by 4 cm/s, 50 cm behind the others: 35 % are sent, 75 % are not."""

    def range_m(name: str, time_s: float, height_m: float) -> float:
        return 4.0 + height_m + 0.5 * min(0.075 * max(time_s - 2.0, 0.0), 0.9) * (CORNERS[name][0] < 0.0)

    flight = Moving(range_m, [], 1.0, seed)
    steep_s = min(time_s for time_s, doubt in flight.doubts.items() if doubt)
    assert 2.0 + 0.35 / 0.075 < steep_s < 2.0 + 0.7 / 0.075
    assert flight.doubts[steep_s] == "Range: ground seems too steep, maybe a fault"
    assert len(flight.sent_s(0.0, steep_s - 0.5)) > 0.95 * (steep_s - 0.5) / SLOT_S - 5
    assert not flight.sent_s(2.0 + 0.75 / 0.075)


def test_what_two_of_four_see_that_does_not_follow_the_motion_is_no_doubt_of_the_ground() -> None:
    """They pass boxes that lie higher and higher while the vehicle rises by as much: the others see the ground."""

    def range_m(name: str, time_s: float, height_m: float) -> float:
        return 2.5 if name in "ab" and time_s > 4.0 else 3.0 + height_m

    flight = Moving(range_m, [5.0], 0.6)
    assert flight.sent_s(4.0)
    assert set(flight.doubts.values()) == {None}


@pytest.mark.parametrize("seed", [1, 2])
def test_what_does_not_follow_the_motion_is_reported_when_it_is_not_sent_any_more(seed: int) -> None:
    flight = Moving(lambda name, time_s, height_m: min(0.2 + height_m, 0.57), [5.0, 9.0], 1.0, seed)
    reported_s = min(time_s for time_s, doubt in flight.doubts.items() if doubt == UNANSWERED)
    last_s = max(time_s for time_s in flight.sent if time_s < 11.0)
    assert reported_s - last_s < 2.5 * SLOT_S


def test_what_is_near_below_one_sensor_is_no_ground_while_others_see_parts_of_the_vehicle() -> None:
    def range_m(name: str, time_s: float, height_m: float) -> float:
        """The strap below a has moved after the others' was found to be fixed."""
        return 0.35 if name == "a" and time_s > 12.0 else 0.45

    strap = Moving(range_m, [3.0, 6.0, 9.0])
    assert Status.FIXED in strap.statuses.values()
    assert not strap.sent_s(12.0)


def test_a_fault_code_does_not_end_an_object() -> None:
    """Sensor a sees a box; one answer of it may be a code, and the next one has no echo."""
    fusion = four()
    for i in range(60):
        name, time_s = NAMES[i % 4], i * SLOT_S
        take(fusion, reading(name, time_s, 2.4 if name == "a" else 3.0))
    assert fusion.object_m("a") == pytest.approx(0.6, abs=0.05)
    take(fusion, reading("a", 6.0, 2.55, raw=255, suspect=True))
    take(fusion, reading("a", 6.1, None))
    assert fusion.object_m("a") == pytest.approx(0.6, abs=0.05)
    take(fusion, reading("a", 6.1 + WINDOWS.memory_s + 0.1, None))
    assert fusion.object_m("a") is None


@pytest.mark.parametrize("seed", range(4))
def test_sensors_see_surfaces_that_are_followed(seed: int) -> None:
    """Also after several of them have become one, as over ground that comes together again."""
    fusion, draw = four(), np.random.default_rng(seed)
    for i in range(800):
        apart_m = 0.4 * abs(math.sin(i / 40.0))
        level = draw.choice([0.0, apart_m, -apart_m, 2 * apart_m], p=[0.4, 0.2, 0.2, 0.2])
        take(fusion, reading(NAMES[i % 4], i * SLOT_S, 3.0 + level + draw.normal(scale=SIGMA_M)))
        belief = fusion._belief
        assert all(mode.sees is None or mode.sees in belief.surfaces for mode in fusion._modes.values())
        assert belief.proven is None or belief.proven in belief.surfaces


def test_a_sensor_that_missed_its_last_echo_of_a_strap_is_held_too() -> None:
    mode = SensorMode(DownwardSensor((0.0, 0.0, 0.0), DOWN, "slant"))
    motion = VerticalMotion()
    for i in range(3):
        assert not mode.is_stuck(45 + i, 0.45, None, motion, 0.4 * i, False)
    assert not mode.is_stuck(765, None, None, motion, 1.2, False)
    mode.hold()
    assert mode.is_fixed


def test_noise_is_less_likely_the_farther_it_is_and_has_no_gap() -> None:
    densities = [noise_density(0.2 + 0.01 * i) for i in range(700)]
    assert all(far <= near for near, far in pairwise(densities))
    assert densities[-1] > 0.05
    assert densities[0] > 0.9


@pytest.mark.parametrize(("was", "becomes"), [(COMMON_AGAIN, COMMON_AGAIN), (COMMON, COMMON_LOW * COMMON)])
def test_what_was_rather_part_of_the_vehicle_still_is_when_it_becomes_the_ground(was: float, becomes: float) -> None:
    """By readings that agree, which those of a strap do; 40 cm is near without any such suspicion."""
    motion = VerticalMotion()
    strap = Surface(GroundFilter(0.4, 1e-4, Rate(0.0, 0.01)), START, math.log(was), MotionResponse(motion, 0.4))
    belief = Belief([], motion, Windows())
    belief.surfaces = [strap]
    belief._prove(strap)
    assert belief.proven is strap
    assert math.exp(strap.common) == pytest.approx(becomes)


def test_what_is_as_near_as_a_part_of_the_vehicle_is_one_more_of_it() -> None:
    """Not the ground so far, nor what is farther; a first surface is judged by its height, too."""
    motion = VerticalMotion()
    belief = Belief([], motion, Windows())
    surfaces = [
        Surface(GroundFilter(height_m, 1e-4, Rate(0.0, 0.01)), START, math.log(COMMON), MotionResponse(motion, 0.4))
        for height_m in (0.2, 0.4, 0.6, 3.0)
    ]
    belief.surfaces = list(surfaces)
    strap, ground, near, far = surfaces
    for each in surfaces:
        belief._appraise(each, None)
    assert [math.exp(each.common) / COMMON for each in surfaces] == pytest.approx([COMMON_LOW] * 3 + [1.0])
    belief.proven = ground
    belief.forget(strap)
    assert math.exp(near.common) == pytest.approx(COMMON_AGAIN)
    assert math.exp(ground.common) == pytest.approx(COMMON_LOW * COMMON)
    assert math.exp(far.common) == pytest.approx(COMMON)


def test_at_an_edge_that_is_sent_what_two_of_four_see_is_no_doubt() -> None:
    """Either alone is about as likely the ground, and the higher one has not answered to the motion."""
    motion = VerticalMotion()
    modes = [SensorMode(DownwardSensor((0.0, 0.0, 0.0), DOWN, "slant")) for _ in range(4)]
    belief = Belief(modes, motion, Windows())
    belief.predict(0.0)
    higher, ground = belief.surfaces = [
        Surface(GroundFilter(height_m, 1e-4, Rate(0.0, 0.01)), prior, math.log(COMMON), MotionResponse(motion, 0.4))
        for height_m, prior in ((1.4, -1.0), (2.0, 0.0))
    ]
    higher.evidence = ground.evidence = 15.0
    higher.response._fixed = -4.0
    belief.proven = belief.reference = ground
    for mode, surface in zip(modes, (higher, higher, ground, ground), strict=True):
        mode.see(surface, 0.0)
    belief.weigh()
    assert belief.ground is ground
    assert belief.sure > 0.99
    assert belief.doubt is None


def noise_of(sees: Sequence[int | None], noise: Sequence[float], readings: Sequence[int], evidence: float) -> float:
    """How probable it is that all is noise, of sensors that see the ground so far (0), a box (1), an outlier (2)."""
    motion = VerticalMotion()
    modes = [SensorMode(DownwardSensor((0.0, 0.0, 0.0), DOWN, "slant")) for _ in sees]
    belief = Belief(modes, motion, Windows())
    belief.predict(0.0)
    ground, box, outlier = surfaces = [
        Surface(GroundFilter(height_m, 1e-4, Rate(0.0, 0.01)), prior, math.log(COMMON), MotionResponse(motion, 0.4))
        for height_m, prior in ((2.0, 0.0), (1.0, -6.0), (3.0, -6.0))
    ]
    ground.evidence, box.evidence, outlier.evidence = evidence, 15.0, 0.0
    belief.surfaces, belief.proven, belief.reference = surfaces, ground, ground
    for mode, seen, nats, count in zip(modes, sees, noise, readings, strict=True):
        mode.sees, mode.seen_s = None if seen is None else surfaces[seen], 0.0
        mode.noise, mode.readings = nats, count
    belief.weigh()
    return belief.noise


def test_whether_all_is_noise_is_asked_of_those_that_may_see_the_ground() -> None:
    """Not of one that goes on seeing a box; of one that sees the ground so far, and of one with an outlier."""
    noise, readings = (10.0, 10.0, -4.0, -4.0), (1, 1, 5, 5)
    assert noise_of((None, None, 1, 0), noise, readings, 15.0) == pytest.approx(0.165, abs=0.01)
    assert noise_of((None, None, 1, 0), noise, readings, -6.0) == pytest.approx(0.004, abs=0.001)
    assert noise_of((None, None, 1, 2), (10.0, 10.0, -4.0, -0.6), (1, 1, 5, 1), 15.0) == pytest.approx(0.855, abs=0.01)
