"""The ground below four sensors: what it follows, what it leaves out, and what it reports of that."""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
import pytest

from msp_range.fusion import Angles, AttitudeTrack, DownwardSensor, Fused, Fusion, Oblique, Windows
from msp_range.fusion.attitude import OLDEST_S
from msp_range.fusion.vertical import VerticalMotion
from msp_range.geometry import Vector, boresight
from msp_range.reading import Reading, Status
from tests.support.known import known

SIGMA_M = 0.02
SLOT_S = 0.1
NAMES = "abcd"
CORNERS = {"a": (0.25, -0.2), "b": (0.25, 0.2), "c": (-0.25, -0.2), "d": (-0.25, 0.2)}
DOWN: Vector = (0.0, 0.0, 1.0)
WINDOWS = Windows()
NEWEST_S, MEMORY_S, HELD_S = WINDOWS.newest_s, WINDOWS.memory_s, WINDOWS.held_s


def four(
    oblique: Oblique = "slant",
    attitude: AttitudeTrack | None = None,
    motion: VerticalMotion | None = None,
    names: str = NAMES,
    maximum_m: float = 1000.0,
) -> Fusion:
    """Sensors under the corners of a pallet, straight down."""
    sensors = {name: DownwardSensor((*CORNERS[name], 0.0), DOWN, oblique) for name in names}
    return Fusion(sensors, attitude or AttitudeTrack(), WINDOWS, motion, maximum_m=maximum_m)


def reading(name: str, time_s: float, range_m: float | None, raw: int | None = None, suspect: bool = False) -> Reading:
    """One with a range, or one without an echo; two alike have different raw answers unless they are given."""
    if range_m is None:
        return Reading(time_s, name, Status.NO_ECHO, raw=765)
    raw = hash((name, time_s)) & 0x7FFF if raw is None else raw
    return Reading(time_s, name, Status.OK, range_m, SIGMA_M, raw, suspect)


def take(fusion: Fusion, each: Reading) -> Fused | None:
    return fusion.update(each, each.time_s + 0.03).fused


def fly(
    fusion: Fusion,
    range_m: Callable[[str, float], float | None],
    readings: int,
    noise_m: Sequence[float] | np.ndarray | None = None,
    start: int = 0,
) -> list[Fused | None]:
    """Four sensors in turn, a reading each slot."""
    out = []
    for i in range(start, start + readings):
        name, time_s = NAMES[i % 4], i * SLOT_S
        seen_m = range_m(name, time_s)
        if seen_m is not None and noise_m is not None:
            seen_m += noise_m[i - start]
        out.append(take(fusion, reading(name, time_s, seen_m)))
    return out


def accelerate(
    motion: VerticalMotion, time_s: float, up_m_s2: Callable[[float], float], draw: np.random.Generator
) -> None:
    """Four accelerations in a slot, with the noise of an autopilot's."""
    for moment_s in (time_s + 0.025 * k for k in range(4)):
        motion.on_acceleration(moment_s, up_m_s2(moment_s) + draw.normal(0.0, 0.3))


def noise(count: int, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).normal(scale=SIGMA_M, size=count)


def errors_m(out: Sequence[Fused | None], truth_m: Callable[[float], float], start: int = 0) -> np.ndarray:
    return np.array([each.range_m - truth_m(i * SLOT_S) for i, each in enumerate(out, start) if each is not None])


@pytest.mark.parametrize("speed_m_s", [0.0, 0.5, -2.0, 4.0, -4.5])
def test_a_ramp_is_followed_without_lag(speed_m_s: float) -> None:
    def ramp(time_s: float) -> float:
        return 50.0 + speed_m_s * time_s

    fusion = four()
    out = fly(fusion, lambda name, time_s: ramp(time_s), 80)
    assert np.abs(errors_m(out[40:], ramp, 40)).max() < 0.005
    assert fusion.climb_m_s == pytest.approx(speed_m_s, abs=0.01)


def test_noise_is_halved_and_the_variance_says_by_how_much() -> None:
    out = fly(four(), lambda name, time_s: 3.0, 4000, noise(4000))[50:]
    assert None not in out
    off_m = errors_m(out, lambda time_s: 3.0)
    assert off_m.std() < 0.5 * SIGMA_M
    stated_m2 = np.array([each.variance_m2 for each in out if each is not None])
    assert 0.3 < np.mean(off_m**2) / np.mean(stated_m2) < 1.1


@pytest.mark.parametrize("acceleration_m_s2", [3.0, -3.0, 4.5])
def test_hard_acceleration_does_not_silence_it(acceleration_m_s2: float) -> None:
    def height_m(time_s: float) -> float:
        """At rest, a second at the acceleration, then at a steady speed."""
        t = max(time_s - 5.0, 0.0)
        return 20.0 + acceleration_m_s2 * (t * t / 2 if t < 1 else t - 0.5)

    out = fly(four(), lambda name, time_s: height_m(time_s), 80, noise(80))
    times_s = [i * SLOT_S for i, each in enumerate(out) if each is not None]
    assert max(late - early for early, late in pairwise(times_s)) < 0.35
    assert np.abs(errors_m(out, height_m)).max() < 0.25


@pytest.mark.parametrize("off_m", [-2.0, -0.3, 0.5, 3.0])
@pytest.mark.parametrize("speed_m_s", [0.0, 1.0])
def test_one_sensor_that_sees_something_else_does_not_move_it_and_is_reported(off_m: float, speed_m_s: float) -> None:
    def ramp(time_s: float) -> float:
        return 4.0 + speed_m_s * time_s

    fusion = four()
    fly(fusion, lambda name, time_s: ramp(time_s), 40, noise(40))
    out = fly(fusion, lambda name, time_s: ramp(time_s) + (off_m if name == "c" else 0.0), 40, noise(40, 2), 40)
    assert None not in out
    assert np.abs(errors_m(out, ramp, 40)).max() < 0.06
    assert fusion.object_m("c") == pytest.approx(-off_m, abs=0.06)
    assert [fusion.object_m(name) for name in "abd"] == [None, None, None]
    out = fly(fusion, lambda name, time_s: ramp(time_s), 12, noise(12), 80)
    assert fusion.object_m("c") is None


def test_at_an_edge_the_ground_is_not_lost_before_the_sensors_that_see_it_were_read_again() -> None:
    """Two sensors are over the edge; the third does not answer, the fourth is read next."""
    fusion = four()
    fly(fusion, lambda name, time_s: 3.2, 40, noise(40))
    over: list[tuple[str, float | None]] = [
        ("b", 2.23),
        ("c", 3.2),
        ("b", 4.41),
        ("d", None),
        ("b", 4.4),
        ("a", 4.42),
        ("b", 4.42),
    ]
    tied: list[tuple[str, float | None]] = [("c", 3.2), ("d", 3.21), ("a", 4.4), ("b", 4.41), ("c", 3.19), ("d", 3.2)]
    out = []
    for i, (name, range_m) in enumerate(over + tied):
        lost = Reading(4.0 + i * SLOT_S, name, Status.NO_ANSWER)
        out.append(take(fusion, lost if range_m is None else reading(name, lost.time_s, range_m)))
    assert [each and round(each.range_m, 1) for each in out[len(over) + 1 :]] == [3.2] * 5


@pytest.mark.parametrize("speed_m_s", [0.02, -0.03])
@pytest.mark.parametrize("drifts", NAMES)
def test_one_sensor_that_drifts_moves_it_by_less_than_16_cm(drifts: str, speed_m_s: float) -> None:
    """The plane through all would tilt until the others were called objects."""
    track = AttitudeTrack()
    fusion = four(oblique="unknown", attitude=track)
    draw = np.random.default_rng(1)
    for i in range(400):
        name, time_s = NAMES[i % 4], i * SLOT_S
        track.update(Angles(time_s, 0.0, 0.0, 0.0))
        off_m = speed_m_s * max(time_s - 5.0, 0.0) if name == drifts else 0.0
        out = take(fusion, reading(name, time_s, 5.0 + off_m + draw.normal(scale=SIGMA_M)))
        assert i < 20 or (out is not None and abs(out.range_m - 5.0) < 0.16), time_s
    assert [name for name in NAMES if fusion.object_m(name) is not None] == [drifts]


@pytest.mark.parametrize("drifts", "ac")
def test_once_a_sensor_that_drifts_is_isolated_the_distance_is_that_of_the_others(drifts: str) -> None:
    """At once: the slope that the sensor has made up goes with it."""
    track = AttitudeTrack()
    fusion = four(attitude=track)
    draw = np.random.default_rng(1)
    off_m = {}
    for i in range(300):
        name, time_s = NAMES[i % 4], i * SLOT_S
        track.update(Angles(time_s, 0.0, 0.0, 0.0))
        drift_m = -0.03 * max(time_s - 5.0, 0.0) if name == drifts else 0.0
        fused = take(fusion, reading(name, time_s, 5.0 + drift_m + draw.normal(scale=SIGMA_M)))
        if fused is not None:
            off_m[time_s] = abs(fused.range_m - 5.0)
    worst_s = max(off_m, key=lambda time_s: off_m[time_s])
    assert off_m[worst_s] > 0.04
    assert max(each_m for time_s, each_m in off_m.items() if time_s > worst_s + 0.35) < 0.025


def test_a_single_outlier_does_not_move_it_and_is_no_object() -> None:
    fusion = four()
    noise_m = noise(80)
    noise_m[[40, 53, 58]] = [-2.5, 3.0, -0.4]
    out = fly(fusion, lambda name, time_s: 4.0, 80, noise_m)
    assert np.abs(errors_m(out[20:], lambda time_s: 4.0)).max() < 0.05
    assert [fusion.object_m(name) for name in NAMES] == 4 * [None]


def test_a_step_of_the_ground_is_followed_at_the_third_reading() -> None:
    out = fly(four(), lambda name, time_s: 4.0 if time_s < 4.95 else 3.0, 80, noise(80))
    assert np.abs(errors_m(out[30:51], lambda time_s: 4.0)).max() < 0.06
    assert np.abs(errors_m(out[52:], lambda time_s: 3.0)).max() < 0.10
    assert np.abs(errors_m(out[60:], lambda time_s: 3.0)).max() < 0.06


def test_groups_that_ping_together_are_no_motion() -> None:
    """Readings of one ping are milliseconds apart: their difference is noise or a slope of the ground, not a speed."""
    fusion = four()
    draw = np.random.default_rng(6)
    off_m = []
    for i in range(300):
        for name in NAMES:
            range_m = 3.0 + draw.normal(scale=SIGMA_M)
            fused = take(fusion, reading(name, i * SLOT_S + range_m * 2.9e-3, range_m))
            off_m.append(0.0 if fused is None else fused.range_m - 3.0)
    assert np.std(off_m[8:]) < 0.5 * SIGMA_M
    assert np.abs(np.array(off_m[8:])).max() < 3 * SIGMA_M


def test_echoes_of_a_group_that_are_out_of_order_make_no_speed() -> None:
    """Sensors that ping together answer in the order of their ranges, and one without an echo has the ping's time."""
    fusion = four()
    for turn in range(50):
        take(fusion, reading("a", 0.1 * turn + 0.020, 3.0))
        fused = take(fusion, reading("b", 0.1 * turn, 3.0))
    assert fused is not None
    assert (fused.height_m, fused.climb_m_s) == pytest.approx((3.0, 0.0), abs=1e-6)


@pytest.mark.parametrize("tilt_deg", [0.0, 10.0, 30.0])
@pytest.mark.parametrize(
    ("oblique", "down"),
    [
        ("slant", lambda range_m, cosine: range_m * cosine),
        ("nearest", lambda range_m, cosine: range_m),
        ("unknown", lambda range_m, cosine: range_m * (1 + cosine) / 2),
    ],
)
def test_a_canted_sensor_reads_the_slant_or_the_nearest_point(
    tilt_deg: float, oblique: Oblique, down: Callable[[float, float], float]
) -> None:
    sensors = {
        name: DownwardSensor(
            (0.0, 0.0, 0.07), boresight(0.0, math.radians(tilt_deg - 90), math.radians(90 * i)), oblique
        )
        for i, name in enumerate(NAMES)
    }
    fused = known(fly(Fusion(sensors, AttitudeTrack(), WINDOWS), lambda name, time_s: 5.0, 40)[-1])
    cosine = math.cos(math.radians(tilt_deg))
    assert fused.range_m == pytest.approx(down(5.0, cosine) + 0.07, rel=1e-6)
    # Where it is unknown which, the truth may be half the difference away in every reading alike.
    half_m = (5.0 - 5.0 * cosine) / 2 if oblique == "unknown" else 0.0
    assert half_m**2 < fused.variance_m2 < half_m**2 + SIGMA_M**2


def test_a_first_ground_is_sent_while_more_than_half_of_those_that_were_read_agree_on_it() -> None:
    """The two that were read first may be the two that are wrong."""
    fusion = four()
    assert take(fusion, reading("a", 0.0, 3.0)) is None
    fused = take(fusion, reading("b", 0.1, 3.02))
    assert known(fused).range_m == pytest.approx(3.02, abs=0.01)
    fusion = four()
    out = fly(fusion, lambda name, time_s: 3.0 if name in "ab" else 5.0, 100)
    assert out[3:] == [None] * 97, "two against two"
    fusion = four()
    out = fly(fusion, lambda name, time_s: 3.0 if name in "ab" else None, 8)
    assert [each is None for each in out] == [True] + [False] * 7, "one without an echo does not object"


def test_a_first_reading_that_does_not_agree_makes_the_others_wait_until_two_agree() -> None:
    fusion = four()
    out = [take(fusion, reading(NAMES[i % 4], i * SLOT_S, 1.2 if i == 0 else 3.0)) for i in range(12)]
    assert [each is None for each in out] == [True] * 2 + [False] * 10
    assert all(each.range_m == pytest.approx(3.0) for each in out if each is not None)


def test_one_sensor_alone_needs_three_readings_to_believe_a_step_and_knows_no_objects() -> None:
    fusion = four(names="a")
    ranges_m = [4.0] * 20 + [2.0] + [4.0] * 9 + [3.0] * 10
    out = [take(fusion, reading("a", i * SLOT_S, range_m)) for i, range_m in enumerate(ranges_m)]
    assert [i for i, each in enumerate(out) if each is None] == [0, 20, 30, 31]
    assert known(out[29]).range_m == pytest.approx(4.0, abs=0.01)
    assert known(out[32]).range_m == pytest.approx(3.0, abs=0.01)
    assert fusion.object_m("a") is None


@pytest.mark.parametrize(("sensors", "is_sent"), [("a", False), ("ab", True), ("abc", True)])
def test_without_a_reading_two_other_sensors_must_have_seen_the_ground(sensors: str, is_sent: bool) -> None:
    fusion = four()
    for i in range(30):
        take(fusion, reading(sensors[i % len(sensors)], i * SLOT_S, 3.0 + 0.5 * i * SLOT_S))
    fused = take(fusion, reading("d", 30 * SLOT_S, None))
    assert (fused is not None) is is_sent
    if fused is not None:
        assert fused.range_m == pytest.approx(4.5, abs=0.03)


def test_nothing_is_sent_of_ground_that_was_seen_too_long_ago() -> None:
    def after(gap_s: float, told_s: float = 0.03) -> Fused | None:
        fusion = four()
        fly(fusion, lambda name, time_s: 3.0, 20)
        return fusion.update(reading("a", 1.9 + gap_s, None), 1.9 + gap_s + told_s).fused

    assert after(NEWEST_S - 0.01) is not None
    assert after(NEWEST_S + 0.01) is None
    # A ranging that is reported long after it was made, as after a pause of the program.
    assert after(0.1, told_s=0.3) is None
    fusion = four()
    fly(fusion, lambda name, time_s: 3.0, 20)
    assert take(fusion, reading("a", 1.9 + MEMORY_S + 0.1, 1.0)) is None, "ground as good as new: two readings again"
    assert take(fusion, reading("b", 2.0 + MEMORY_S + 0.1, 1.0)) is not None


def test_of_two_sensors_one_must_go_on_seeing_the_ground() -> None:
    fusion = four()
    for i in range(20):
        take(fusion, reading("ab"[i % 2], i * SLOT_S, 3.0))
    for i in range(20, 34):
        take(fusion, reading("a", i * SLOT_S, 3.0))
        # The other's last reading was at 1.9 s.
        is_sent = take(fusion, reading("c", (i + 0.5) * SLOT_S, None)) is not None
        assert is_sent is ((i + 0.5) * SLOT_S <= 1.9 + HELD_S), i


def test_only_downward_sensors_belong_to_it() -> None:
    fusion = four()
    with pytest.raises(KeyError):
        fusion.update(reading("forward", 0.0, 3.0), 0.0)


def test_a_fault_code_that_is_a_range_passes_only_for_ground_that_is_there() -> None:
    """255 on a vehicle at 2.75 m that gets no echo now and then, and on one that is at 2.55 m."""
    fusion = four()
    fly(fusion, lambda name, time_s: 2.75, 40, noise(40))
    for i in range(40, 60):
        fused = take(fusion, reading(NAMES[i % 4], i * SLOT_S, 2.55, suspect=True))
    assert fused is None or abs(fused.range_m - 2.75) < 0.05
    assert [fusion.object_m(name) for name in NAMES] == 4 * [None]
    fusion = four()
    fly(fusion, lambda name, time_s: 2.6, 40, noise(40))
    for i in range(40, 60):
        fused = take(fusion, reading(NAMES[i % 4], i * SLOT_S, 2.55, raw=255, suspect=True))
        assert fused is not None
    assert known(fused).range_m == pytest.approx(2.55, abs=0.03)


def test_a_box_that_follows_a_hole_has_its_own_height() -> None:
    """And not a mean of the two, which would be none of either."""
    fusion, draw = four(), np.random.default_rng(1)
    for i in range(120):
        off_m = 0.0 if i < 40 or NAMES[i % 4] != "c" else 0.6 if i < 80 else -0.7
        take(fusion, reading(NAMES[i % 4], i * SLOT_S, 2.0 + off_m + draw.normal(scale=SIGMA_M)))
        if i > 60:
            assert fusion.object_m("c") == pytest.approx(-0.6 if i < 90 else 0.7, abs=0.08)


def test_an_object_whose_distance_does_not_vary_stays_known() -> None:
    fusion = four()
    draw = np.random.default_rng(3)
    for i in range(120):
        name = NAMES[i % 4]
        is_object = name == "b" and i >= 40
        range_m = 2.5 if is_object else 3.0 + draw.normal(scale=SIGMA_M)
        take(fusion, reading(name, i * SLOT_S, range_m, raw=250 if is_object else None))
        if i > 52:
            assert fusion.object_m("b") == pytest.approx(0.5, abs=0.06)


# What is stuck.


def climbing(stuck: str, speed_m_s: float, readings: int = 120, hover: int = 40) -> tuple[Fusion, list[Fused | None]]:
    """A hover at 3 m, then a climb; the sensors ``stuck`` keep the answer that they had 3 s before it."""
    fusion, out, draw = four(), [], np.random.default_rng(4)
    for i in range(readings):
        name, time_s = NAMES[i % 4], i * SLOT_S
        truth_m = 3.0 + speed_m_s * max(time_s - hover * SLOT_S, 0.0)
        range_m = round(truth_m + draw.normal(scale=SIGMA_M), 2)
        if name in stuck and i >= hover - 30:
            range_m = 3.01
        out.append(take(fusion, reading(name, time_s, range_m, raw=round(100 * range_m))))
    return fusion, out


@pytest.mark.parametrize("stuck", ["a", "d", "ab", "ac", "bc"])
@pytest.mark.parametrize("speed_m_s", [0.3, 1.0, -0.5])
def test_stuck_sensors_do_not_hold_the_ground_and_are_faults(stuck: str, speed_m_s: float) -> None:
    """It would make an autopilot climb away; two of four that are stuck must not outvote the two that are not."""
    fusion, out = climbing(stuck, speed_m_s)
    end_m = 3.0 + speed_m_s * 7.9
    assert known(out[-1]).range_m == pytest.approx(end_m, abs=0.06)
    for name in NAMES:
        judged = fusion.update(reading(name, 8.0, 3.01, raw=301), 8.0).reading
        assert (judged.status is Status.STUCK) is (name in stuck)
        assert (judged.range_m is None) is (name in stuck)
    # What it reads is not an object either.
    assert [fusion.object_m(name) for name in stuck] == [None] * len(stuck)
    healthy = fusion.update(reading(stuck[0], 8.1, end_m, raw=round(100 * end_m)), 8.1).reading
    assert healthy.status is Status.OK


def test_of_two_sensors_the_one_that_is_stuck_does_not_silence_the_other() -> None:
    """A second after the other one has begun to move away from it."""
    fusion = four(names="ab")
    draw = np.random.default_rng(4)
    for i in range(160):
        t = min(max(i * SLOT_S - 8.0, 0.0), 2.0)
        truth_m = 1.4 + (t * t / 2 if t < 1.0 else 1.0 - (2.0 - t) ** 2 / 2)
        seen_m = 1.4 if i % 2 and i > 60 else round(truth_m + draw.normal(scale=SIGMA_M), 2)
        fused = take(fusion, reading("ab"[i % 2], i * SLOT_S, seen_m, raw=round(100 * seen_m)))
        if i > 91:
            assert fused is not None, i * SLOT_S
            assert fused.range_m == pytest.approx(truth_m, abs=0.12)


def test_a_sensor_that_repeats_itself_over_calm_ground_is_not_stuck() -> None:
    fusion = four()
    for i in range(200):
        each = reading(NAMES[i % 4], i * SLOT_S, 3.0, raw=300)
        outcome = fusion.update(each, each.time_s)
        assert outcome.reading is each
        assert outcome.fused is not None or i == 0


def test_sensors_at_their_minimum_on_the_ground_are_not_stuck() -> None:
    """They all read 20 until the vehicle is higher than that."""
    fusion = four()
    for i in range(150):
        height_m = 0.1 + max(0.0, 0.5 * (i * SLOT_S - 5.0))
        range_m = max(round(height_m, 2), 0.20)
        each = reading(NAMES[i % 4], i * SLOT_S, range_m, raw=round(100 * range_m))
        outcome = fusion.update(each, each.time_s)
        assert outcome.reading is each
        fused = outcome.fused
    assert known(fused).range_m == pytest.approx(height_m, abs=0.05)


def test_a_landed_vehicle_does_not_take_one_outlier_for_a_take_off() -> None:
    """All sensors read 20 for as long as it stands: what another one reads once moves nothing and makes none stuck."""
    motion, draw = VerticalMotion(), np.random.default_rng(3)
    fusion = four(motion=motion)
    for i in range(200):
        accelerate(motion, i * SLOT_S, lambda moment_s: 0.0, draw)
        status, range_m = (Status.OK, 0.35) if i == 150 else (Status.AT_MINIMUM, 0.20)
        each = Reading(i * SLOT_S, NAMES[i % 4], status, range_m, SIGMA_M, round(100 * range_m))
        outcome = fusion.update(each, each.time_s)
        assert outcome.reading is each
        assert i < 10 or known(outcome.fused).range_m == pytest.approx(0.20, abs=0.03)


def test_a_sensor_that_missed_a_bounce_is_not_stuck_on_the_ground() -> None:
    """It was read at each touch, while the others saw half a metre between; a sensor that stays so in flight is."""
    fusion, statuses = four(), {}
    for i in range(300):
        time_s, name = i * SLOT_S, NAMES[i % 4]
        above_m = 0.5 * math.sin(math.pi * (time_s - 5.0) / 2.0) if 5.0 < time_s < 7.0 else max(time_s - 25.0, 0.0)
        range_m = 0.20 if name == "d" else 0.20 + round(above_m, 2)
        status = Status.OK if range_m > 0.20 else Status.AT_MINIMUM
        each = Reading(time_s, name, status, range_m, SIGMA_M, round(100 * range_m))
        judged = fusion.update(each, each.time_s).reading.status
        if name == "d":
            statuses[time_s] = judged
    assert {judged for time_s, judged in statuses.items() if 9.0 < time_s < 25.0} == {Status.AT_MINIMUM}
    assert {judged for time_s, judged in statuses.items() if 6.5 < time_s < 7.0 or time_s > 27.0} == {Status.STUCK}


def test_a_sensor_that_repeats_itself_while_the_others_pass_a_box_is_not_stuck() -> None:
    """They see its flank, its top and the ground by turns: that is no motion of the vehicle."""
    fusion, draw = four(), np.random.default_rng(2)
    for i in range(200):
        name, t = NAMES[i % 4], i * SLOT_S
        seen_m = 3.0 if name in "ad" or t % 4.0 < 2.0 else 2.7 if t % 4.0 < 2.5 else 2.2
        seen_m = 3.0 if name == "a" else seen_m + draw.normal(scale=SIGMA_M)
        each = reading(name, t, seen_m, raw=300 if name == "a" else round(100 * seen_m))
        assert fusion.update(each, each.time_s).reading is each


@pytest.mark.parametrize(("between", "after"), [(Status.NO_ECHO, Status.OK), (Status.CLOCK_FAULT, Status.STUCK)])
def test_no_echo_shows_that_a_sensor_is_not_stuck_and_a_fault_does_not(between: Status, after: Status) -> None:
    """Above the maximum no echo and answers of 255 come by turns, and the latter several times in a row by chance."""
    fusion, _ = climbing("a", 0.3)
    answers = [reading("a", time_s, 3.01, raw=301) for time_s in (8.0, 8.8)]
    answers.insert(1, Reading(8.4, "a", between, raw=765))
    statuses = [fusion.update(each, each.time_s).reading.status for each in answers]
    assert statuses == [Status.STUCK, between, after]


# Attitude and slope.


class Turned:
    """A vehicle whose angles are a function of time."""

    def __init__(self, angles: Callable[[float], tuple[float, float, float]]) -> None:
        self.angles = angles

    def ranges(self, height_m: float, rise: tuple[float, float]) -> Callable[[str, float], float]:
        """Distances along the axes of the four sensors, by vectors."""

        def range_m(name: str, time_s: float) -> float:
            from scipy.spatial.transform import Rotation

            rotation = Rotation.from_euler("ZYX", self.angles(time_s)[::-1]).as_matrix()
            normal = np.array([*rise, 1.0])
            at = rotation @ np.array([*CORNERS[name], 0.0])
            return float(normal @ (np.array([0, 0, height_m]) - at) / (normal @ rotation[:, 2]))

        return range_m


@pytest.mark.parametrize("rise", [(0.0, 0.0), (0.15, 0.0), (-0.05, 0.10)])
def test_with_attitude_the_height_is_straight_up_and_the_distance_along_the_vehicles_axis(
    rise: tuple[float, float],
) -> None:
    """Height and slope are the ground's while the vehicle leans and turns; the message is what a sensor would read."""
    vehicle = Turned(lambda t: (0.15 * math.sin(t), 0.12 * math.sin(1.3 * t), 0.2 * t))
    ranges, track = vehicle.ranges(2.5, rise), AttitudeTrack()
    fusion = four(attitude=track)
    off_m = []
    for i in range(300):
        time_s = i * SLOT_S
        assert track.update(Angles(time_s + 0.01, *vehicle.angles(time_s + 0.01)))
        fused = take(fusion, reading(NAMES[i % 4], time_s, ranges(NAMES[i % 4], time_s)))
        if fused is not None and i > 100:
            roll, pitch, _ = vehicle.angles(time_s)
            axis = fused.height_m / fused.range_m
            slope_free = math.cos(roll) * math.cos(pitch)
            assert axis == pytest.approx(slope_free, abs=0.05 if rise != (0.0, 0.0) else 1e-3)
            off_m.append(fused.height_m - 2.5)
    assert np.abs(off_m).max() < 0.01
    assert fused is not None
    assert (fused.rise_north, fused.rise_east) == pytest.approx(rise, abs=0.01)


def test_without_attitude_a_leaning_vehicle_sees_a_slope_and_the_same_distance() -> None:
    vehicle = Turned(lambda t: (0.0, 0.1, 0.0))
    fusion = four()
    fused = fly(fusion, vehicle.ranges(2.5, (0.0, 0.0)), 200)[-1]
    assert known(fused).range_m == pytest.approx(2.5 / math.cos(0.1), abs=0.005)


def test_angles_are_interpolated_between_messages_and_old_ones_forgotten() -> None:
    track = AttitudeTrack()
    assert track.rotation_at(0.0) is None
    assert track.update(Angles(1.0, 0.0, 0.0, math.radians(350)))
    for number in (math.nan, math.inf):
        for angles in ((number, 0.0, 0.0), (0.0, number, 0.0), (0.0, 0.0, number)):
            assert not track.update(Angles(1.1, *angles)), angles
    assert track.update(Angles(1.2, 0.0, 0.2, math.radians(10)))
    assert not track.update(Angles(1.2005, 0.0, 0.9, 0.0)), "the same buffer"
    rotation = known(track.rotation_at(1.1))
    assert -rotation[2][0] == pytest.approx(math.sin(0.1))
    assert rotation[1][0] == pytest.approx(0.0, abs=1e-9), "north lies between 350 and 10 deg"
    assert track.rotation_at(1.2 + OLDEST_S - 0.01) is not None
    assert track.rotation_at(1.2 + OLDEST_S + 0.01) is None


# What a filter has to be.


def test_it_is_equivariant_to_an_offset_and_blind_to_the_origin_of_time() -> None:
    def out(higher_m: float, later_s: float) -> list[tuple[float, float] | None]:
        fusion, rng = four(), np.random.default_rng(9)
        out = []
        for i in range(300):
            range_m = 4.0 + 0.3 * math.sin(0.1 * i) + rng.normal(scale=SIGMA_M) + (rng.random() < 0.03) * rng.normal()
            fused = take(fusion, reading(NAMES[i % 4], later_s + i * SLOT_S, range_m + higher_m, raw=i))
            out.append(None if fused is None else (fused.range_m - higher_m, fused.climb_m_s))
        return out

    for changed in (out(2.5, 0.0), out(0.0, 1024.0)):
        for one, other in zip(out(0.0, 0.0), changed, strict=True):
            assert (one is None) == (other is None)
            assert one is None or other is None or one == pytest.approx(other, abs=1e-8)


def test_readings_that_leave_the_ground_stop_the_stream() -> None:
    """A take-off at 3 m/s^2 with one outlier in it: what was sent last is held for half a second and soon far off."""
    fusion = four()
    fly(fusion, lambda name, time_s: 0.25, 8)
    assert take(fusion, reading("a", 0.8, 0.70)) is not None
    assert take(fusion, reading("b", 0.9, 1.10)) is None


def test_at_the_sensors_minimum_the_stated_deviation_covers_a_vehicle_on_the_ground() -> None:
    """They report 20 cm at any less: the landing gear may hold them 5 cm above the ground."""
    fusion = four()
    for i in range(40):
        at_minimum = Reading(i * SLOT_S, NAMES[i % 4], Status.AT_MINIMUM, 0.20, SIGMA_M, 20)
        fused = take(fusion, at_minimum)
    assert 0.15 < 2 * math.sqrt(known(fused).variance_m2) < 0.3


def test_a_take_off_is_followed_where_the_sensors_read_their_minimum_until_late() -> None:
    """They do so, on a slope, until the vehicle climbs fast: only its acceleration shows that it does."""
    motion, draw = VerticalMotion(), np.random.default_rng(1)
    fusion, sent = four(motion=motion, maximum_m=7.65), []
    leaves = [0.20, 0.20, 0.20, 0.20, 0.20, 0.21, 0.33, 0.32, 0.38, 0.39, 0.42, 0.49, 0.51, 0.56, 0.58, 0.61, 0.66]
    for i, range_m in enumerate([0.20] * 100 + leaves):
        time_s, is_least = i * SLOT_S, range_m == 0.20
        accelerate(motion, time_s, lambda moment_s: 0.7 if 10.0 < moment_s < 10.5 else 0.0, draw)
        status = Status.AT_MINIMUM if is_least else Status.OK
        sent.append(take(fusion, Reading(time_s, NAMES[i % 4], status, range_m, SIGMA_M, round(100 * range_m))))
        if range_m == 0.33:
            assert fusion.fit < 0.1, "the ground has moved there, and the reading does not contradict it"
    assert None not in sent[10:]
    for fused, range_m in zip(sent[107:], leaves[7:], strict=True):
        assert known(fused).range_m == pytest.approx(range_m, abs=0.04)


def test_a_landing_that_bounces_is_no_part_of_the_vehicle() -> None:
    """At the minimum the range does not respond: the ground is that near or nearer."""
    motion, draw = VerticalMotion(), np.random.default_rng(1)
    fusion = four(motion=motion, maximum_m=7.65)
    for i in range(400):
        time_s = i * SLOT_S
        for moment_s in (time_s + 0.025 * k for k in range(4)):
            up_m_s2 = 2.0 * math.sin(2 * math.pi * 1.3 * moment_s) if 10.0 < moment_s < 20.0 else 0.0
            motion.on_acceleration(moment_s, up_m_s2 + draw.normal(0.0, 0.3))
            motion.on_pressure_height(moment_s, draw.normal(0.0, 0.15))
        at_minimum = Reading(time_s, NAMES[i % 4], Status.AT_MINIMUM, 0.20, SIGMA_M, 20)
        fused = take(fusion, at_minimum)
        assert i < 10 or fused is not None, time_s


def test_what_is_fixed_to_the_vehicle_is_found_in_a_hard_climb() -> None:
    """Its range leaves the ground that the accelerometer predicts within a turn, and no reading is of it then."""
    motion, draw = VerticalMotion(), np.random.default_rng(1)
    fusion, found_s = four(motion=motion, maximum_m=7.65), []

    def up_m_s2(moment_s: float) -> float:
        return 3.75 if 10.0 < moment_s < 10.8 else -3.75 if 12.0 < moment_s < 12.8 else 0.0

    for i in range(160):
        time_s = i * SLOT_S
        accelerate(motion, time_s, up_m_s2, draw)
        out = fusion.update(reading(NAMES[i % 4], time_s, 0.5 + draw.normal(scale=SIGMA_M)), time_s + 0.03)
        found_s += [time_s] * (out.reading.status is Status.FIXED)
    assert 10.0 < found_s[0] < 12.0


def test_the_first_reading_of_a_flank_is_no_climb() -> None:
    """After a step of 1.3 m one reading is of the edge's flank: the next ones are the ground's."""
    fusion = four()
    fly(fusion, lambda name, time_s: 2.92, 40, noise(40))
    beyond = [("b", 4.22), ("d", 4.22), ("a", 4.22), ("b", 3.98), ("c", 4.17), ("d", 4.22), ("a", 4.24), ("c", 4.21)]
    out = [take(fusion, reading(name, 4.0 + i * SLOT_S, range_m)) for i, (name, range_m) in enumerate(beyond)]
    assert out[-1] is not None
    assert all(each is None or abs(each.range_m - 4.2) < 0.25 for each in out[2:])
    assert out[-1].range_m == pytest.approx(4.2, abs=0.05)


def test_answers_of_the_ping_before_are_reported_and_sent_only_while_the_vehicle_hovers() -> None:
    """It goes up and down by 1 m, and hovers from 20 s on."""
    motion, draw = VerticalMotion(), np.random.default_rng(1)
    fusion, late = four(motion=motion, maximum_m=7.65), {}
    omega = 2 * math.pi / 5.0
    for i in range(300):
        time_s = i * SLOT_S
        accelerate(motion, time_s, lambda at_s: omega**2 * math.cos(omega * (at_s - 5.0)) * (5.0 < at_s < 20.0), draw)
        phase = omega * (min(max(time_s - 4 * SLOT_S, 5.0), 20.0) - 5.0)
        range_m = 3.0 - math.cos(phase) + draw.normal(scale=SIGMA_M)
        out = fusion.update(reading(NAMES[i % 4], time_s, range_m), time_s + 0.03)
        if fusion.conditions()[0].text is not None:
            late[time_s] = out.fused
            height_m = 3.0 - math.cos(omega * (min(time_s, 20.0) - 5.0))
            assert out.fused is None or abs(out.fused.range_m - height_m) < 0.2
    assert min(late) > 5.0
    assert sum([fused is None for time_s, fused in late.items() if time_s < 20.0]) > 50
    assert None not in [fused for time_s, fused in late.items() if time_s > 22.0]
    assert max(late) > 29.8


@pytest.mark.parametrize("is_late", [True, False])
def test_in_a_steady_climb_one_sensor_at_a_time_is_asked_out_of_turn_until_it_is_in_time(is_late: bool) -> None:
    """A sensor that is asked comes after the next one, as `RoundRobin.again` gives it a turn."""
    motion, draw = VerticalMotion(), np.random.default_rng(1)
    fusion = four(motion=motion)
    order, before_s, asked = list(NAMES), dict.fromkeys(NAMES, -1.0), []
    for i in range(200):
        time_s, name = i * SLOT_S, order.pop(0)
        for k in range(3):
            motion.on_acceleration(time_s - 0.04 * (2 - k), float(draw.normal(0.0, 0.1)))
        since_s, before_s[name] = time_s - before_s[name], time_s
        late_s = since_s if is_late and time_s > 5.0 else 0.0
        range_m = 2.0 + 0.5 * (time_s - late_s) + float(draw.normal(0.0, 0.01))
        order = order or list(NAMES)
        if fusion.asks_again(fusion.update(reading(name, time_s, range_m), time_s + 0.03)):
            order.insert(1, name)
            asked.append((i, name))
    texts = [each.text for each in fusion.conditions()]
    assert ("Range: answers are those of the ping before" in texts) is is_late
    assert asked
    if not is_late:
        assert asked[-1][0] < 100
        assert all(name != before or i - k > 2 for (k, before), (i, name) in pairwise(asked))
