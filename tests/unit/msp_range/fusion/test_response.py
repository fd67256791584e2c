"""What follows the vehicle's motion, what is fixed to it, and what answers a ping late."""

import math
import random
from collections.abc import Callable

import pytest

from msp_range.fusion.modes import ANSWERED, ANSWERED_MOST, FOLLOWS
from msp_range.fusion.response import HeightReading, MotionResponse
from msp_range.fusion.vertical import VerticalMotion

TURN_S, GAP_S = 0.4, 0.1
NAMES = ("a", "b", "c", "d")


def fly(
    height_m: Callable[[float], float],
    range_m: Callable[[float], float],
    until_s: float,
    *,
    may_slope: bool = False,
    pressure_m: Callable[[float], float] | None = None,
    from_s: float = -10.0,
    seed: int = 1,
) -> tuple[float | None, float | None]:
    """When what is seen at a height is found to be fixed, and when to be late [s]; None: never.

    Readings have 1 cm of noise, accelerations 0.3 m/s^2 and a bias of 0.1, pressures 0.15 m; both from a time on.
    """
    draw = random.Random(seed)
    motion = VerticalMotion()
    response = MotionResponse(motion, TURN_S)
    fixed_s = late_s = None
    time_s, read_s, i = from_s, 0.0, 0
    while read_s < until_s:
        while time_s <= read_s:
            h = 0.02
            up_m_s2 = (height_m(time_s + h) - 2 * height_m(time_s) + height_m(time_s - h)) / h**2
            motion.on_acceleration(time_s, up_m_s2 + 0.1 + draw.gauss(0.0, 0.3))
            motion.on_pressure_height(time_s, (pressure_m or height_m)(time_s) + draw.gauss(0.0, 0.15))
            time_s += 0.04
        response.update(
            HeightReading(NAMES[i % 4], read_s, TURN_S, range_m(read_s) + draw.gauss(0.0, 0.01), 0.01**2),
            0.0,
            may_slope,
        )
        fixed_s = read_s if fixed_s is None and response.is_fixed else fixed_s
        late_s = read_s if late_s is None and response.is_late else late_s
        read_s, i = read_s + GAP_S, i + 1
    return fixed_s, late_s


def ramp(from_s: float, speed_m_s: float, until_s: float, acceleration_m_s2: float = 1.0) -> Callable[[float], float]:
    """A climb that begins and ends with an acceleration."""
    lasts_s = speed_m_s / acceleration_m_s2

    def speed(time_s: float) -> float:
        return min(max(time_s - from_s, 0.0), lasts_s, max(until_s - time_s, 0.0)) * acceleration_m_s2

    steps = [0.0]
    for k in range(8000):
        steps.append(steps[-1] + 0.005 * speed(-10.0 + 0.005 * (k + 0.5)))
    return lambda time_s: steps[min(max(round((time_s + 10.0) / 0.005), 0), 8000)]


def accelerate(
    motion: VerticalMotion,
    height_m: Callable[[float], float],
    read_s: float,
    draw: random.Random,
    bias_m_s2: float = 0.0,
) -> None:
    """The accelerations in the tenth of a second before a reading, with 0.3 m/s^2 of noise."""
    for time_s in (read_s - 0.08, read_s - 0.04, read_s):
        up_m_s2 = (height_m(time_s + 0.02) - 2 * height_m(time_s) + height_m(time_s - 0.02)) / 0.02**2
        motion.on_acceleration(time_s, up_m_s2 + bias_m_s2 + draw.gauss(0.0, 0.3))


@pytest.mark.parametrize("may_slope", [False, True])
@pytest.mark.parametrize("seed", range(5))
def test_ground_is_never_fixed_or_late(seed: int, may_slope: bool) -> None:
    climb = ramp(5.0, 1.0, 12.0)
    assert fly(climb, lambda time_s: climb(time_s) + 0.3, 25.0, may_slope=may_slope, seed=seed) == (None, None)


@pytest.mark.parametrize("seed", range(5))
def test_a_sensor_that_comes_back_to_the_ground_beyond_a_step_is_not_late(seed: int) -> None:
    """The others have passed the step one after the other: 25 cm that they read farther since then are their own.

    In a descent one that is asked out of turn, and still knows itself from before, would seem to answer late.
    """
    descent, draw, motion = ramp(10.0, 0.5, 30.0), random.Random(seed), VerticalMotion()
    response, odds = MotionResponse(motion, TURN_S), []
    beyond_s = {"a": 3.0, "b": 4.0, "c": 5.0, "d": 12.0}
    for i in range(200):
        read_s, name = 0.1 * i, NAMES[i % 4]
        accelerate(motion, lambda time_s: -descent(time_s), read_s, draw)
        if name == "d" and 2.0 < read_s < 12.0:
            continue
        since_s = TURN_S / 2 if name == "d" and 12.0 <= read_s < 13.6 else TURN_S
        seen_m = 6.0 - descent(read_s) + 0.25 * (read_s > beyond_s[name]) + draw.gauss(0.0, 0.01)
        response.update(HeightReading(name, read_s, since_s, seen_m, 0.01**2), 0.0, False)
        odds.append(response.log_odds)
    assert min(odds[-80:]) > -2.0


@pytest.mark.parametrize("seed", range(5))
def test_what_does_not_follow_a_take_off_is_fixed(seed: int) -> None:
    found_s, _ = fly(ramp(5.0, 1.0, 12.0), lambda time_s: 0.4, 20.0, seed=seed)
    assert found_s is not None
    assert 5.0 < found_s < 6.5


@pytest.mark.parametrize("seed", range(5))
def test_a_range_that_stops_in_a_steady_climb_is_fixed(seed: int) -> None:
    """As below a payload: the ground is nearer at first, and leaves without an acceleration."""
    climb = ramp(5.0, 0.8, 12.0)
    found_s, _ = fly(climb, lambda time_s: min(climb(time_s) + 0.3, 1.0), 11.5, seed=seed)
    assert found_s is not None
    assert 6.2 < found_s < 8.0


@pytest.mark.parametrize("seed", range(5))
def test_a_range_that_has_stopped_is_doubted_before_it_is_fixed_and_has_answered_to_nothing(seed: int) -> None:
    climb, draw, motion = ramp(5.0, 0.8, 12.0), random.Random(seed), VerticalMotion()
    response, odds, before = MotionResponse(motion, TURN_S), [], 0.0
    for i in range(80):
        read_s = 0.1 * i
        accelerate(motion, climb, read_s, draw)
        seen_m = min(climb(read_s) + 0.3, 1.0) + draw.gauss(0.0, 0.01)
        if read_s < 6.0:
            before = response._answered
        response.update(HeightReading(NAMES[i % 4], read_s, TURN_S, seen_m, 1e-4), 0.0, False)
        odds += [] if response.is_fixed else [response.log_odds]
    assert min(odds) < -5.0
    assert response._answered < before + 5.0


def test_a_long_climb_is_much_of_an_answer_and_no_more_than_that() -> None:
    """What two sensors see that drift alike has answered as well: a slope of 90 % stays unlikely."""
    climb, draw, motion = ramp(2.0, 4.0, 12.0, 2.0), random.Random(1), VerticalMotion()
    response, odds = MotionResponse(motion, TURN_S), []
    for i in range(140):
        accelerate(motion, climb, 0.1 * i, draw)
        seen_m = climb(0.1 * i) + 0.5 + draw.gauss(0.0, 0.01)
        response.update(HeightReading(NAMES[i % 4], 0.1 * i, TURN_S, seen_m, 1e-4), 0.0, False)
        odds.append(response.log_odds)
    assert max(odds) > ANSWERED
    assert max(odds) <= FOLLOWS + ANSWERED_MOST


@pytest.mark.parametrize("seed", range(5))
def test_a_hill_that_is_followed_is_ground(seed: int) -> None:
    """The vehicle begins to climb with the ground, and its range stays."""
    assert fly(ramp(5.0, 0.3, 20.0), lambda time_s: 3.0, 20.0, may_slope=True, seed=seed) == (None, None)


def test_pressure_that_changes_below_the_rotors_alone_decides_nothing() -> None:
    burst = ramp(5.0, 3.0, 6.0, 6.0)
    assert fly(lambda time_s: 0.0, lambda time_s: 0.3, 20.0, may_slope=True, pressure_m=burst) == (None, None)


@pytest.mark.parametrize("off_m", [-2.5, 2.5])
@pytest.mark.parametrize("seed", range(5))
def test_a_take_off_in_pressure_of_the_rotors_is_a_take_off(seed: int, off_m: float) -> None:
    """Up to 1 m, where the rotors change the pressure, soon after a start: the accelerometer seems to have a bias."""
    climb = ramp(2.0, 1.0, 3.0)
    lifted = ramp(1.0, 2.0 * abs(off_m), 2.0, 4.0 * abs(off_m))

    def pressure_m(time_s: float) -> float:
        return climb(time_s) + math.copysign(min(lifted(time_s), abs(off_m)), off_m)

    assert fly(climb, lambda time_s: climb(time_s) + 0.3, 20.0, pressure_m=pressure_m, from_s=0.0, seed=seed) == (
        None,
        None,
    )


def test_no_hill_rises_so_fast() -> None:
    """Without an acceleration that shows: only the barometer does."""
    found_s, _ = fly(ramp(0.0, 1.5, 30.0, 0.3), lambda time_s: 3.0, 20.0, may_slope=True)
    assert found_s is not None
    assert found_s < 12.0


@pytest.mark.parametrize("may_slope", [False, True])
@pytest.mark.parametrize("seed", range(5))
def test_answers_that_follow_a_turn_late_are_late(seed: int, may_slope: bool) -> None:
    """A slope that begins is not like that: it needs no longer where the ground may slope."""
    climb = ramp(5.0, 1.0, 10.0)
    fixed_s, late_s = fly(climb, lambda time_s: climb(time_s - TURN_S) + 0.3, 20.0, may_slope=may_slope, seed=seed)
    assert fixed_s is None
    assert late_s is not None
    assert 5.0 < late_s < 6.3


@pytest.mark.parametrize("speed_m_s", [-6.0, 4.0])
def test_a_rate_that_a_surface_had_when_it_was_first_seen_says_nothing(speed_m_s: float) -> None:
    """As at a start of the bridge in a climb: it has no acceleration that the accelerometer would show."""
    draw = random.Random(1)
    motion = VerticalMotion()
    response = MotionResponse(motion, TURN_S)
    for i in range(200):
        time_s = i * 0.025
        motion.on_acceleration(time_s, draw.gauss(0.0, 0.3))
        motion.on_pressure_height(time_s, speed_m_s * time_s + draw.gauss(0.0, 0.15))
        if i % 4 == 0:
            seen_m = 40.0 + speed_m_s * time_s + draw.gauss(0.0, 0.02)
            response.update(HeightReading(NAMES[i // 4 % 4], time_s, TURN_S, seen_m, 0.02**2), speed_m_s, False)
            assert abs(response.log_odds) < 3.0


def test_a_reading_that_is_not_of_the_ground_does_not_move_what_follows_the_motion() -> None:
    """One, in a climb, where something fixed to the vehicle would be."""
    motion, draw, climb = VerticalMotion(), random.Random(1), ramp(5.0, 1.2, 20.0, 3.0)
    response = MotionResponse(motion, TURN_S)
    for i in range(58):
        read_s = 0.1 * i
        for time_s in (read_s - 0.075, read_s - 0.05, read_s - 0.025, read_s):
            up_m_s2 = (climb(time_s + 0.02) - 2 * climb(time_s) + climb(time_s - 0.02)) / 0.02**2
            motion.on_acceleration(time_s, up_m_s2 + draw.gauss(0.0, 0.3))
        seen_m = 0.5 + (climb(read_s) if i < 55 else 0.0) + draw.gauss(0.0, 0.01)
        response.update(HeightReading(NAMES[i % 4], read_s, TURN_S, seen_m, 1e-4), 0.0, False, i < 55)
    follows_m, fixed_m, _ = response.offs_m(HeightReading("a", 5.8, TURN_S, 0.5 + climb(5.8), 1e-4))
    assert follows_m < 0.1
    assert fixed_m > 0.3


@pytest.mark.parametrize(("outlier_m", "most_m"), [(0.12, 0.02), (-0.12, 0.02)])
def test_an_outlier_at_rest_does_not_move_what_follows_the_motion(outlier_m: float, most_m: float) -> None:
    """Though it is near: the good readings after it would call the ground fixed."""
    motion = VerticalMotion()
    response = MotionResponse(motion, TURN_S)
    for i in range(61):
        for k in range(3):
            motion.on_acceleration(0.1 * i - 0.08 + 0.04 * k, 0.0)
        is_ground = i < 60
        seen_m = 1.7 + (0.0 if is_ground else outlier_m)
        response.update(HeightReading(NAMES[i % 4], 0.1 * i, TURN_S, seen_m, 4e-4), 0.0, False, is_ground)
    assert response.offs_m(HeightReading("b", 6.1, TURN_S, 1.7, 4e-4))[0] < most_m


def test_one_sensor_alone_is_neither_higher_nor_lower_than_others() -> None:
    """The predictions follow its readings, as where a thermometer's jump has moved them."""
    motion = VerticalMotion()
    response = MotionResponse(motion, 0.2)
    for i in range(100):
        for k in range(5):
            motion.on_acceleration(0.2 * i - 0.16 + 0.04 * k, 0.0)
        response.update(HeightReading("a", 0.2 * i, 0.2, 1.5 if i < 50 else 2.0, 4e-4), 0.0, False)
    assert max(response.offs_m(HeightReading("a", 20.0, 0.2, 2.0, 4e-4))) < 0.05


def test_without_an_accelerometer_nothing_is_decided() -> None:
    response = MotionResponse(VerticalMotion(), TURN_S)
    for i in range(100):
        response.update(HeightReading("a", 0.1 * i, 0.1, 0.4, 1e-4), 0.0, False)
    assert not response.is_fixed
    assert not response.is_late


def test_late_answers_stay_late_at_rest_and_on_another_surface_until_they_are_in_time() -> None:
    climbs = [ramp(5.0, 1.5, 10.0), ramp(25.0, 1.5, 30.0)]

    def height_m(time_s: float) -> float:
        return sum([climb(time_s) for climb in climbs])

    draw, motion, verdicts = random.Random(1), VerticalMotion(), {}
    response = MotionResponse(motion, TURN_S)
    for i in range(400):
        read_s = 0.1 * i
        accelerate(motion, height_m, read_s, draw)
        if i == 120:
            old, response = response, MotionResponse(motion, TURN_S)
            response.inherit(old)
        seen_m = 0.3 + height_m(read_s - (TURN_S if read_s < 20.0 else 0.0)) + draw.gauss(0.0, 0.01)
        response.update(HeightReading(NAMES[i % 4], read_s, TURN_S, seen_m, 1e-4), 0.0, False)
        verdicts[i] = response.is_late
        if 105 < i < 120:
            assert response.log_odds > 3.0, "a hover, in which late answers are the ground's"
    assert not verdicts[49]
    assert all(verdicts[i] for i in range(100, 249))
    assert not verdicts[330]


@pytest.mark.parametrize("nats", [5.0, 0.0])
def test_answers_that_seem_late_on_a_surface_are_so_where_they_have_been_on_the_one_before(nats: float) -> None:
    """What was shown meanwhile counts; but on the ground before it may have been by readings of the new one."""
    before, new = MotionResponse(VerticalMotion(), TURN_S), MotionResponse(VerticalMotion(), TURN_S)
    new.suspect_late(nats)
    new.confirm_late(before)
    assert not new.is_late
    before.suspect_late(20.0)
    new.confirm_late(before)
    assert new.is_late is (nats > 0.0)
    assert new._late == pytest.approx(before._late if nats else 0.0), "as much is needed to show that they are in time"


def test_a_turn_as_short_as_an_accelerometers_delay_decides_nothing() -> None:
    climb = ramp(5.0, 1.5, 10.0)
    motion, draw = VerticalMotion(), random.Random(1)
    response = MotionResponse(motion, 0.1)
    for i in range(1500):
        read_s = 0.02 * i
        up_m_s2 = (climb(read_s + 0.02) - 2 * climb(read_s) + climb(read_s - 0.02)) / 0.02**2
        motion.on_acceleration(read_s, up_m_s2 + draw.gauss(0.0, 0.3))
        if i % 5 == 0:
            seen_m = 0.3 + climb(read_s - 0.1) + draw.gauss(0.0, 0.01)
            response.update(HeightReading("a", read_s, 0.1, seen_m, 1e-4), 0.0, False)
        assert not response.is_late


def test_a_gap_in_the_accelerations_forgets_nothing_that_was_shown() -> None:
    climb = ramp(5.0, 1.5, 10.0)
    motion, draw = VerticalMotion(), random.Random(1)
    response = MotionResponse(motion, TURN_S)
    for i in range(200):
        read_s = 0.1 * i
        if not 12.0 < read_s < 13.0:
            accelerate(motion, climb, read_s, draw)
        seen_m = 0.3 + climb(read_s - TURN_S) + draw.gauss(0.0, 0.01)
        response.update(HeightReading(NAMES[i % 4], read_s, TURN_S, seen_m, 1e-4), 0.0, False)
        if read_s > 11.0:
            assert response.is_late


@pytest.mark.parametrize("is_late", [True, False])
@pytest.mark.parametrize("seed", range(5))
def test_a_sensor_that_is_asked_again_answers_with_a_younger_ping(seed: int, is_late: bool) -> None:
    """Every fifth ping is one sensor's once more, so that turns are of 0.3 to 0.5 s."""
    climb = ramp(5.0, 1.5, 10.0)
    motion, draw = VerticalMotion(), random.Random(seed)
    response = MotionResponse(motion, TURN_S)
    pinged_s: dict[str, float] = {}
    found = False
    for i in range(120):
        read_s = 0.1 * i
        accelerate(motion, climb, read_s, draw, 0.1)
        name = NAMES[(i - i // 5) % 4] if i % 5 else "a"
        before_s, pinged_s[name] = pinged_s.get(name, read_s), read_s
        seen_m = 0.3 + climb(before_s if is_late else read_s) + draw.gauss(0.0, 0.01)
        response.update(HeightReading(name, read_s, read_s - before_s, seen_m, 1e-4), 0.0, False)
        assert is_late or not (response.is_late or response.is_fixed)
        found |= response.is_late
    assert found is is_late


@pytest.mark.parametrize("turn_s", [0.4, 0.16])
@pytest.mark.parametrize("is_late", [True, False])
def test_at_a_steady_rate_a_sensor_that_is_asked_out_of_turn_shows_late_answers(is_late: bool, turn_s: float) -> None:
    """Without any acceleration; of two sensors with a turn that is as short as an accelerometer's delay, too."""
    motion, draw = VerticalMotion(), random.Random(1)
    response = MotionResponse(motion, turn_s)
    names = NAMES[:4] if turn_s > 0.2 else NAMES[:2]
    gap_s = turn_s / len(names)
    order = [name for _ in range(10) for name in (*names, *names, *names, names[0])]  # The first one twice in a row.
    before_s = dict.fromkeys(names, -turn_s)
    found = may_be = False
    for i, name in enumerate(order):
        read_s = gap_s * i
        for k in range(8):
            motion.on_acceleration(read_s - gap_s * (1 - (k + 1) / 8), draw.gauss(0.0, 0.3))
        since_s, before_s[name] = read_s - before_s[name], read_s
        seen_m = 3.0 + 1.0 * (read_s - (since_s if is_late else 0.0)) + draw.gauss(0.0, 0.01)
        response.update(HeightReading(name, read_s, since_s, seen_m, 1e-4), 1.0, False)
        found |= response.is_late
        may_be |= response.may_be_late
    assert found is is_late
    assert may_be
    assert not response.may_be_late


def test_eight_slow_sensors_learn_what_each_sees_of_its_own_before_they_say_anything() -> None:
    """In the first turn each reading is another sensor's first one, which is no measurement of the rate."""
    climb = ramp(4.0, 1.0, 8.0)
    motion, draw = VerticalMotion(), random.Random(1)
    response = MotionResponse(motion, 8 * 0.28)
    time_s = 0.0
    for i in range(40):
        read_s = 0.28 * i
        while time_s <= read_s:
            up_m_s2 = (climb(time_s + 0.02) - 2 * climb(time_s) + climb(time_s - 0.02)) / 0.02**2
            motion.on_acceleration(time_s, up_m_s2 + 0.1 + draw.gauss(0.0, 0.3))
            time_s += 0.04
        seen_m = 0.3 + climb(read_s) + 0.03 * (i % 8 - 4) + draw.gauss(0.0, 0.02)
        response.update(HeightReading(f"{i % 8}", read_s, 8 * 0.28, seen_m, 4e-4), 0.0, False)
        assert response.log_odds > -4.0


@pytest.mark.parametrize(("turn_s", "is_late"), [(0.4, True), (0.1, False)])
def test_sensors_that_ping_together_are_never_late(turn_s: float, is_late: bool) -> None:
    """An accelerometer's delay looks the same as a turn of theirs."""
    response = MotionResponse(VerticalMotion(), turn_s)
    response.suspect_late(20.0)
    assert response.is_late is is_late


def test_a_surface_that_is_seen_with_other_answers_does_not_take_back_that_answers_are_late() -> None:
    response = MotionResponse(VerticalMotion(), TURN_S)
    for nats in (10.0, -10.0, 2.0):
        assert not response.is_late
        response.suspect_late(nats)
    assert response.is_late


def handed_on(
    height_m: Callable[[float], float],
    seen_m: Callable[[float], float],
    new_s: float,
    until_s: float,
    seed: int,
) -> dict[float, float]:
    """The log odds after each reading, by its time [s], where the surface is a new one from a time on.

    ``seen_m`` is what is read at a time [m]; NaN: nothing.
    """
    motion, draw = VerticalMotion(), random.Random(seed)
    response, found = MotionResponse(motion, TURN_S), {}
    for i in range(round(until_s / GAP_S)):
        read_s = GAP_S * i
        accelerate(motion, height_m, read_s, draw)
        if i == round(new_s / GAP_S):
            before, response = response, MotionResponse(motion, TURN_S)
            response.inherit(before)
        if math.isfinite(read_m := seen_m(read_s) + draw.gauss(0.0, 0.01)):
            response.update(HeightReading(NAMES[i % 4], read_s, TURN_S, read_m, 1e-4), 0.8, False)
            found[read_s] = response.log_odds
    return found


@pytest.mark.parametrize("seed", range(5))
def test_on_another_surface_the_vehicle_climbs_on_whose_range_must_then_grow(seed: int) -> None:
    """A payload is nearer than the ground that the vehicle leaves at a steady rate: no acceleration shows it."""
    climb = ramp(5.0, 0.8, 12.0)
    found = handed_on(climb, lambda time_s: 0.5 if time_s > 6.95 else 0.3 + climb(time_s), 7.0, 8.5, seed)
    assert all(found[time_s] > 0.0 for time_s in found if 6.8 < time_s < 6.95)
    assert min(found.values()) < -8.0


@pytest.mark.parametrize("seed", range(5))
def test_what_did_not_answer_to_the_motion_does_not_hand_it_on(seed: int) -> None:
    """A payload in a take-off, and then the ground, which moves as the accelerations say."""
    climb = ramp(5.0, 0.8, 12.0)
    found = handed_on(climb, lambda time_s: 0.5 if time_s < 6.15 else 0.3 + climb(time_s), 6.2, 8.5, seed)
    assert all(found[time_s] < -3.0 for time_s in found if 6.05 < time_s < 6.15)
    assert min(found[time_s] for time_s in found if time_s > 6.15) > -3.0


@pytest.mark.parametrize("seed", range(5))
def test_a_motion_of_long_ago_is_not_handed_on(seed: int) -> None:
    """The ground was lost in a climb, and is seen again eight seconds later, as the vehicle sinks steadily."""
    up, down = ramp(0.0, 3.0, 6.0), ramp(7.0, 1.5, 16.0)

    def height_m(time_s: float) -> float:
        return 1.0 + up(time_s) - down(time_s)

    found = handed_on(
        height_m, lambda time_s: math.nan if 2.95 < time_s < 10.95 else height_m(time_s), 11.0, 14.5, seed
    )
    assert min(found.values()) > -3.0
