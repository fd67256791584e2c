"""Which of several heights the bridge sends, and when it sends none: the whole bridge in virtual time."""

import math
import random
from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any

import pytest
from pymavlink.dialects.v20 import common

from msp_range.config import Airframe
from msp_range.mavlink.inertial import SCALE_HEIGHT_M
from msp_sim.device.device import Fault
from tests.support.bench import FUSED_ID, Bench, airframe, sensor

NAMES = "abcd"
HEARTBEAT = common.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3)
SILENCE = "Range: no distance to the ground"
ABOVE_CM = 766
FIRST_TURN_S = 0.4
"""All four sensors were read."""


def with_barometer(bench: Bench, until_s: float, height_m: Callable[[float], float]) -> Bench:
    """Fly while the autopilot sends 20 pressures and accelerations a second; these say that it keeps its speed."""
    for i in range(round(until_s / 0.05)):
        time_s = 0.05 * i
        bench.receive(
            HEARTBEAT,
            common.MAVLink_attitude_message(round(1000 * time_s), 0.0, 0.0, 0.0, 0, 0, 0),
            common.MAVLink_raw_imu_message(0, 0, 0, -1000, 0, 0, 0, 0, 0, 0),
            common.MAVLink_scaled_pressure_message(0, 1000 * math.exp(-height_m(time_s) / SCALE_HEIGHT_M), 0, 0),
        )
        bench.fly(time_s + 0.05)
    return bench


# A reference point below the sensors.


def measuring_from(below_m: float) -> Airframe:
    """An airframe whose fused stream measures from a point so far below the sensors."""
    return airframe(send={"fused": {"id": FUSED_ID, "reference_down_m": below_m}})


@pytest.mark.parametrize(("true_cm", "sent_cm"), [(5, 5), (15, 15), (60, 60), (500, 500)])
def test_distances_below_the_sensors_minimum_are_sent_from_a_reference_point_below_them(
    true_cm: int, sent_cm: int
) -> None:
    """Sensors 30 cm above the landing gear's feet read 35 cm where the feet are 5 cm above the ground."""
    bench = Bench(measuring_from(0.30), true_cm + 30).fly(3.0)
    assert set(bench.distances_cm()) == {sent_cm}
    message = bench.sent()[-1].message
    assert message.min_distance < sent_cm
    assert (message.min_distance, message.max_distance) == (0, 735)


@pytest.mark.parametrize(("below_m", "bounds_cm"), [(0.0, (19, 765)), (0.10, (9, 755)), (-0.25, (44, 790))])
def test_bounds_are_counted_from_the_reference_point(below_m: float, bounds_cm: tuple[int, int]) -> None:
    bench = Bench(measuring_from(below_m), 20).fly(3.0)
    message = bench.sent()[-1].message
    assert (message.min_distance, message.max_distance) == bounds_cm
    # 20 is the shortest that a sensor reports, and inside the bounds.
    assert message.current_distance == bounds_cm[0] + 1


def test_above_the_maximum_is_counted_from_the_reference_point() -> None:
    assert set(Bench(measuring_from(0.30), 765).fly(5.0).distances_cm()) == {736}
    assert set(Bench(measuring_from(-0.25), 760).fly(5.0).distances_cm()) == {785}


# Two against two.


def pairs(
    order: str,
    missed: float = 0.0,
    from_s: float = 0.0,
    spoilt: Mapping[tuple[str, int], int] | None = None,
    **bench: Any,
) -> Bench:
    """a and b read 3 m; c and d 5 m from a time on.

    A share of the readings has no echo, and those of ``spoilt``, counted for each sensor from that time on, are what
    they are there. The noise is so large that no sensor repeats itself: then it would have no vote.
    """
    draw, count = random.Random(1), Counter[str]()

    def world(name: str, time_s: float) -> int:
        count[name] += time_s >= from_s
        range_cm = 300 if name in "ab" or time_s < from_s else 500
        reading_cm = 765 if draw.random() < missed else round(range_cm + draw.gauss(0.0, 2.5))
        return (spoilt or {}).get((name, count[name]), reading_cm)

    return Bench(airframe([sensor(name, number) for number, name in enumerate(order, start=1)]), world, **bench)


@pytest.mark.parametrize("order", ["abcd", "acbd", "cdab"])
@pytest.mark.parametrize("missed", [0.0, 0.05])
def test_two_sensors_against_two_at_the_start_are_silence_and_a_text(order: str, missed: float) -> None:
    bench = pairs(order, missed).fly(20.0)
    # The first two may agree before the others were read.
    assert bench.distances_cm(from_s=FIRST_TURN_S) == []
    assert SILENCE in bench.texts()
    states = {message.system_status for time_s, message in bench.sent("HEARTBEAT") if time_s > 2.5}
    assert states == {common.MAV_STATE_CRITICAL}


def test_lost_answers_of_two_sensors_do_not_make_the_other_two_right() -> None:
    bench = pairs("abcd", faults={name: [Fault("clock_fault", 0.0, 30.0, probability=0.1)] for name in "cd"})
    assert bench.fly(30.0).distances_cm(from_s=FIRST_TURN_S) == []
    assert SILENCE in bench.texts()


@pytest.mark.parametrize("wrong", ["cd", "ab"])
def test_a_barometer_decides_between_two_pairs_once_the_vehicle_climbs(wrong: str) -> None:
    """Two follow the climb, two keep reading 6 m: by the barometer these are stuck."""

    def height_m(time_s: float) -> float:
        return 2.0 + 0.5 * min(max(time_s - 5.0, 0.0), 6.0)

    draw = random.Random(2)

    def world(name: str, time_s: float) -> int:
        return 600 if name in wrong else round(100 * height_m(time_s) + draw.gauss(0.0, 2.0))

    bench = with_barometer(Bench(airframe(), world), 20.0, height_m)
    sent = bench.timed_cm(from_s=FIRST_TURN_S)
    assert all(abs(distance_cm - 100 * height_m(time_s)) < 40 for time_s, distance_cm in sent)
    settled = [distance_cm for time_s, distance_cm in sent if time_s > 12.0]
    assert len(settled) > 70
    assert all(abs(distance_cm - 500) < 10 for distance_cm in settled)


SPOILT: list[tuple[dict[tuple[str, int], int], float]] = [
    # The one misses a reading in the turn in which the other one reads something else: no ground is seen in that turn.
    ({("a", 10): 765, ("b", 10): 120, ("a", 20): 640, ("b", 20): 765}, 0.55),
    # Each a turn apart from the other's; an outlier that is farther, too, makes three that may be leaving.
    ({("a", 10): 765, ("b", 12): 120, ("b", 20): 765, ("a", 22): 640}, 0.55),
    # Two of one sensor's last three: it has no vote until it has seen the ground twice more.
    ({("a", 10): 765, ("a", 11): 120}, 0.95),
]


@pytest.mark.parametrize(("spoilt", "longest_s"), SPOILT)
def test_a_pair_keeps_its_vote_over_a_missed_reading_and_an_outlier(
    spoilt: dict[tuple[str, int], int], longest_s: float
) -> None:
    """All four saw the ground; from 5 s on two see something else. Readings of the other two are counted from there."""
    bench = pairs("abcd", from_s=5.0, spoilt=spoilt).fly(25.0)
    sent = bench.timed_cm(from_s=FIRST_TURN_S)
    assert all(abs(distance_cm - 300) < 15 for _, distance_cm in sent)
    assert bench.longest_gap_s(FIRST_TURN_S) < longest_s
    assert SILENCE not in bench.reported()


# Above the maximum, or a ground that is not heard.


@pytest.mark.parametrize("deaf_from_s", [0.0, 5.0])
@pytest.mark.parametrize("seeing", NAMES)
def test_a_descent_that_one_of_four_sensors_sees_is_never_above_the_maximum(seeing: str, deaf_from_s: float) -> None:
    def height_cm(time_s: float) -> int:
        return round(190 - 20 * min(max(time_s - 6.0, 0.0), 8.0))

    def world(name: str, time_s: float) -> int:
        return 765 if name != seeing and time_s >= deaf_from_s else height_cm(time_s)

    bench = Bench(airframe(), world).fly(16.0)
    sent = bench.timed_cm()
    assert all(abs(distance_cm - height_cm(time_s)) < 12 for time_s, distance_cm in sent)
    assert len(bench.distances_cm(from_s=6.5, to_s=14.0)) > 15
    assert sent[-1][1] == pytest.approx(30, abs=2)


@pytest.mark.parametrize("seed", range(4))
def test_a_descent_in_which_all_sensors_miss_half_is_never_above_the_maximum(seed: int) -> None:
    draw = random.Random(seed)

    def world(name: str, time_s: float) -> int:
        height_cm = round(190 - 20 * min(max(time_s - 6.0, 0.0), 8.0))
        return 765 if time_s > 5.0 and draw.random() < 0.5 else height_cm

    bench = Bench(airframe(), world).fly(16.0)
    assert max(bench.distances_cm()) < 200


@pytest.mark.parametrize("dead", ["", "b", "abd"])
def test_a_restart_in_cruise_is_above_the_maximum_after_three_turns(dead: str) -> None:
    bench = Bench(airframe(), 765, absent=dead).fly(6.0)
    assert set(bench.distances_cm()) == {ABOVE_CM}
    first_s = bench.sent()[0].time_s
    read = Counter(name for ping_s, name, _ in bench.pings if ping_s < first_s - 0.01)
    assert min(read.values()) == 3
    assert set(read) == set(NAMES) - set(dead)
    assert max(read.values()) <= 4
    assert bench.longest_gap_s() < 0.35


def test_codes_of_all_sensors_do_not_keep_the_vehicle_above_the_maximum() -> None:
    """255 of all sensors is a fault of the bus; a quarter of the readings without an echo are that, too."""
    draw = random.Random(1)
    bench = Bench(airframe(), lambda name, time_s: 255 if time_s >= 30.0 or draw.random() < 0.25 else 765).fly(40.0)
    assert bench.longest_gap_s(to_s=30.0) < 0.35
    assert bench.sent()[-1].time_s < 31.0
    assert "Range: no distance to the ground" in bench.texts()


def test_a_restart_in_cruise_over_ground_that_one_sensor_sees_is_not_above_the_maximum() -> None:
    bench = Bench(airframe(), lambda name, time_s: 700 if name == "c" else 765).fly(6.0)
    assert set(bench.distances_cm()) == {700}


def test_a_descent_seen_by_two_of_eight_slow_sensors_is_no_longer_above_the_maximum() -> None:
    """The others last pinged up to 3.6 s before, when they had no echo."""

    def height_m(time_s: float) -> float:
        return 6.5 + min(0.9 * max(time_s - 10.0, 0.0), 2.5) - 0.9 * max(time_s - 40.0, 0.0)

    vehicle = airframe([sensor(f"s{i}", i) for i in range(1, 9)], polling={"ping_interval_s": 0.45})
    readings = Bench(vehicle, lambda name, time_s: round(100 * height_m(time_s)) if height_m(time_s) < 7.4 else 765)
    bench = with_barometer(readings, 45.5, height_m)
    sent = [(height_m(time_s), sent_cm) for time_s, sent_cm in bench.timed_cm()]
    above_m = [true_m for true_m, sent_cm in sent if sent_cm == ABOVE_CM]
    assert len(above_m) > 60
    assert min(above_m) > 6.9
    assert sent[-1][1] == pytest.approx(100 * height_m(45.5), abs=50)


@pytest.mark.parametrize("noise_cm", [0.0, 0.5, 1.0, 1.5, 3.0])
def test_a_pair_that_jumps_does_not_take_the_ground_from_a_pair_that_repeats_itself(noise_cm: float) -> None:
    """Good sensors repeat themselves over even ground, and are not stuck for that."""
    draw = random.Random(4)

    def world(name: str, time_s: float) -> int:
        range_cm = 300 if name in "ab" or time_s < 5.0 else 500
        return round(range_cm + draw.gauss(0.0, noise_cm))

    bench = Bench(airframe(), world).fly(30.0)
    assert all(abs(distance_cm - 300) < 10 for distance_cm in bench.distances_cm(from_s=5.0))


def test_a_pair_that_repeats_itself_is_the_ground_while_another_pair_sees_a_step() -> None:
    """Over calm ground at an edge good sensors repeat themselves; that they are stuck shows when the vehicle moves."""
    draw = random.Random(4)

    def world(name: str, time_s: float) -> int:
        return 300 if name in "ab" or time_s < 5.0 else round(370 + draw.gauss(0.0, 2.0))

    bench = Bench(airframe(), world).fly(20.0)
    assert len(bench.distances_cm(from_s=6.0)) > 130
    assert all(abs(distance_cm - 300) < 5 for distance_cm in bench.distances_cm(from_s=6.0))


def test_one_outlier_that_hits_the_other_pairs_height_moves_nothing() -> None:
    """Two against two for long, the first pair proven; single readings of a then agree with c and d."""
    bench = pairs("abcd", from_s=5.0, spoilt={("a", number): 511 for number in range(20, 60, 8)}).fly(40.0)
    sent_cm = bench.distances_cm(from_s=5.0)
    assert len(sent_cm) > 300
    assert all(abs(distance_cm - 300) < 15 for distance_cm in sent_cm)


@pytest.mark.parametrize("speed_m_s", [0.05, -0.05, 0.1])
@pytest.mark.parametrize("stuck", ["ab", "ac"])
def test_two_stuck_sensors_hold_nothing_back_in_a_slow_climb(stuck: str, speed_m_s: float) -> None:
    """Near the ground they cannot be distinguished from it, but the two that move on know better."""
    draw = random.Random(4)

    def height_m(time_s: float) -> float:
        return 3.0 + speed_m_s * max(time_s - 6.0, 0.0)

    def read(name: str, time_s: float) -> int:
        return 301 if name in stuck and time_s > 3.0 else round(100 * height_m(time_s) + draw.gauss(0.0, 1.0))

    bench = with_barometer(Bench(airframe(), read), 12.0, height_m)
    sent = [
        (message.current_distance - 100 * height_m(time_s - 0.03), message.covariance**0.5)
        for time_s, message in bench.sent()
        if time_s > 6.0
    ]
    assert max(abs(off_cm) for off_cm, _ in sent) < 7.0
    assert sum(abs(off_cm) <= 3.0 * std_cm for off_cm, std_cm in sent) > 0.95 * len(sent) > 50


@pytest.mark.parametrize("seed", [4, 5, 6])
def test_a_climb_past_a_fault_code_of_all_sensors_gets_away_from_it(seed: int) -> None:
    """All sensors saturate at 255; at 2.55 m that is the ground, and above it the vehicle climbs by its barometer."""
    draw = random.Random(seed)

    def height_m(time_s: float) -> float:
        return min(2.0 + 0.5 * max(time_s - 4.0, 0.0), 5.0)

    def read(name: str, time_s: float) -> int:
        return min(round(100 * height_m(time_s) + draw.gauss(0.0, 1.5)), 255)

    bench = with_barometer(Bench(airframe(), read), 12.0, height_m)
    sent = [each for each in bench.timed_cm() if each[1] < ABOVE_CM]
    assert max(abs(sent_cm - 100 * height_m(time_s - 0.03)) for time_s, sent_cm in sent) < 30
    assert max(time_s for time_s, _ in sent) > 4.5
    assert SILENCE in bench.reported()


@pytest.mark.parametrize("below", ["a", "ab", "ac"])
def test_holes_below_some_sensors_are_no_noise_of_the_others(below: str) -> None:
    draw = random.Random(2)

    def read(name: str, time_s: float) -> int:
        return round(300 + (60 if name in below and time_s > 5.0 else 0) + draw.gauss(0.0, 1.5))

    bench = Bench(airframe(), read).fly(25.0)
    assert max(message.covariance for time_s, message in bench.sent() if time_s > 8.0) <= 3
    assert sorted(bench.reported(2.0)) == [f"Range {name}: hole below, 0.6 m deep" for name in below]


# Three against one that may be right.


@pytest.mark.parametrize(
    ("longer_cm", "text"), [(256, "Range d 2.6 m longer: garbled?"), (150, "Range d: hole below, 1.5 m deep")]
)
def test_a_sensor_that_sees_farther_by_a_lost_byte_puts_the_ground_in_doubt(longer_cm: int, text: str) -> None:
    bench = Bench(airframe(), lambda name, time_s: 140 + (longer_cm if name == "d" and time_s > 2.0 else 0))
    bench.fly(6.0)
    assert text in bench.texts()
