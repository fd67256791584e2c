"""Altitude profiles, tracks and attitude: continuous, bounded, as drawn, and the same for the same seed."""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

from msp_sim.world.profiles import (
    ClimbSegment,
    Course,
    Height,
    HoldSegment,
    LandSegment,
    Leg,
    RampSegment,
    RandomSegment,
    Segment,
    SinusoidSegment,
    StepSegment,
    TerrainSegment,
    TrackSection,
)
from msp_sim.world.vehicle import AttitudeSection, FlightSection, Heave, Lean, Sway, Vehicle

FINE_S = 0.001


def flat(time_s: float) -> float:
    return 0.0


def step(to_m: float) -> StepSegment:
    return StepSegment(kind="step", to_m=to_m)


def hold(duration_s: float) -> HoldSegment:
    return HoldSegment(kind="hold", duration_s=duration_s)


def climb(to_m: float, **limits: float) -> ClimbSegment:
    return ClimbSegment(kind="climb", to_m=to_m, **limits)


def fly(*segments: Segment, surface_m: Callable[[float], float] = flat, seed: int = 0) -> Course:
    height = Height(surface_m, np.random.default_rng(seed))
    for segment in segments:
        segment.fly(height)
    return height


def sampled(course: Course, step_s: float = FINE_S) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    times_s = np.arange(0.0, course.end_s + 0.5, step_s)
    motions = np.array([course.at(time_s) for time_s in times_s])
    return times_s, motions[:, 0], motions[:, 1]


def stepped_slope(time_s: float) -> float:
    """Ground that rises 3 cm a second, with a step up of 0.6 m at 10 s and one down of 0.8 m at 20 s."""
    return 0.03 * time_s + 0.6 * (time_s >= 10) - 0.8 * (time_s >= 20)


@pytest.mark.parametrize(
    ("segments", "fastest_m_s", "hardest_m_s2"),
    [
        ([climb(6.0, speed_m_s=1.5, acceleration_m_s2=0.8)], 1.5, 0.8),
        ([climb(0.2, speed_m_s=1.5, acceleration_m_s2=0.8)], 1.5, 0.8),
        (
            [step(4.0), LandSegment(kind="land", speed_m_s=0.5, acceleration_m_s2=1.0)],
            0.5,
            1.0,
        ),
        # A swing of 2A = 1.2 m in T = 3 s: speed pi 2A / T, acceleration 2 pi^2 2A / T^2.
        ([SinusoidSegment(kind="sinusoid", swing_m=1.2, period_s=3.0, cycles=2)], 1.2566, 2.6319),
        ([TerrainSegment(kind="terrain", height_m=2.0, duration_s=30, speed_m_s=1.5, acceleration_m_s2=2.0)], 1.5, 2.0),
        (
            [climb(2.0), hold(2), LandSegment(kind="land")],
            1.0,
            1.0,
        ),
    ],
    ids=["climb", "short climb", "land", "sinusoid", "terrain", "up and down"],
)
def test_what_a_vehicle_flies_is_continuous_and_bounded(
    segments: Sequence[Segment], fastest_m_s: float, hardest_m_s2: float
) -> None:
    _, heights_m, speeds_m_s = sampled(fly(*segments, surface_m=stepped_slope))
    assert np.abs(speeds_m_s).max() <= fastest_m_s * (1 + 1e-4)
    assert np.abs(np.diff(heights_m)).max() <= fastest_m_s * FINE_S * (1 + 1e-4)
    if segments[0].kind != "sinusoid":  # which starts with its full acceleration
        assert np.abs(np.diff(speeds_m_s)).max() <= hardest_m_s2 * FINE_S * (1 + 1e-4)
    # The reported speed is the derivative of the height; the mean of two speeds errs by a^2 at most.
    between_m_s = (speeds_m_s[1:] + speeds_m_s[:-1]) / 2
    assert np.diff(heights_m) / FINE_S == pytest.approx(between_m_s, abs=hardest_m_s2 * FINE_S)


def test_a_climb_takes_the_time_of_its_three_parts_and_ends_where_it_should() -> None:
    course = fly(climb(6.0, speed_m_s=1.2, acceleration_m_s2=0.9))
    # Speeding up and slowing down each take 1.5 v / a, at the mean speed v / 2.
    assert course.end_s == pytest.approx(6.0 / 1.2 + 1.5 * 1.2 / 0.9)
    assert course.at(course.end_s / 2) == pytest.approx((3.0, 1.2, 0.0))
    assert course.at(course.end_s + 100) == (6.0, 0.0, 0.0)


def test_acceleration_is_the_derivative_of_speed() -> None:
    course = fly(climb(6.0), SinusoidSegment(kind="sinusoid", swing_m=-1.0, period_s=4.0, cycles=1))
    for time_s in (0.3, 1.2, 4.0, 7.0, 9.0, 10.0):
        numeric_m_s2 = (course.at(time_s + 1e-5)[1] - course.at(time_s - 1e-5)[1]) / 2e-5
        assert course.at(time_s)[2] == pytest.approx(numeric_m_s2, abs=1e-6)


def test_a_sinusoid_goes_once_to_the_other_end_and_back_each_cycle() -> None:
    course = fly(step(2.0), SinusoidSegment(kind="sinusoid", swing_m=1.5, period_s=4.0, cycles=3))
    assert course.end_s == pytest.approx(12.0)
    for cycle in range(3):
        heights_m = [course.at(4.0 * cycle + quarter)[0] for quarter in (0.0, 1.0, 2.0, 3.0)]
        assert heights_m == pytest.approx([2.0, 2.75, 3.5, 2.75])


def test_steps_are_sharp_and_ramps_straight() -> None:
    course = fly(
        step(2.75),
        hold(5),
        step(2.25),
        hold(5),
        RampSegment(kind="ramp", to_m=3.25, duration_s=4),
    )
    assert course.at(4.999) == (2.75, 0.0, 0.0)
    assert course.at(5.0) == (2.25, 0.0, 0.0)
    assert course.at(11.0) == pytest.approx((2.5, 0.25, 0.0))
    assert course.at(14.0) == (3.25, 0.0, 0.0)


def test_a_landing_ends_on_what_is_below() -> None:
    course = fly(step(3.0), LandSegment(kind="land"), surface_m=lambda time_s: 0.4)
    assert course.end_m == 0.4


def test_terrain_following_keeps_its_height_and_finds_it_again_after_a_step() -> None:
    course = fly(
        climb(2.0),
        TerrainSegment(kind="terrain", height_m=2.0, duration_s=40),
        surface_m=stepped_slope,
    )
    times_s = np.arange(4.0, 40.0, 0.1)
    errors_m = np.array([course.at(time_s)[0] - stepped_slope(time_s) - 2.0 for time_s in times_s])
    # With gain k a ramp of the ground is followed speed / k behind.
    settled = ((times_s > 8) & (times_s < 10)) | ((times_s > 17) & (times_s < 20)) | (times_s > 27)
    assert np.abs(errors_m[settled]).max() < 0.035
    # It never flies further off than the step itself, so it does not overshoot by more than it lags.
    assert errors_m[(times_s > 10) & (times_s < 20)].max() < 0.035
    assert errors_m[times_s > 20].min() > -0.035


def stretches(course: Course) -> list[tuple[int, float, float]]:
    """(samples, first value, value at the end) of the straight parts of a profile sampled at 10 Hz."""
    times_s = np.arange(0.0, course.end_s - 0.05, 0.1) + 0.05
    lines = [(round(speed, 9), round(height - speed * t, 6), t) for t in times_s for height, speed, _ in [course.at(t)]]
    borders = [0, *(i + 1 for i, (a, b) in enumerate(pairwise(lines)) if a[:2] != b[:2]), len(lines)]
    parts = []
    for first, last in pairwise(borders):
        speed, offset, time_s = lines[first]
        start_s, end_s = time_s - 0.05, lines[last - 1][2] + 0.05
        parts.append((last - first, offset + speed * start_s, offset + speed * end_s))
    return parts


def test_the_random_profile_is_drawn_as_it_says() -> None:
    course = fly(step(3.0), RandomSegment(kind="random", duration_s=2400))
    parts = stretches(course)[:-1]  # the last one is cut
    assert len(parts) == pytest.approx(2000, rel=0.05)
    samples = np.array([part[0] for part in parts])
    assert samples.min() == 5
    assert samples.max() == 19
    assert stats.chisquare(np.bincount(samples)[5:]).pvalue > 0.001
    is_ramp = np.array([abs(end - start) > 1e-4 for _, start, end in parts])
    assert is_ramp.mean() == pytest.approx(0.5, abs=4 * 0.5 / math.sqrt(len(parts)))
    for (_, _, before), (_, start, _), ramp in zip(parts, parts[1:], is_ramp[1:], strict=False):
        assert not ramp or start == pytest.approx(before, abs=1e-4)
    levels_m = np.array([end for _, _, end in parts])
    assert stats.kstest(levels_m, stats.uniform(2.3, 1.3).cdf).pvalue > 0.001


def test_the_random_profile_stops_in_time_and_stays_within_its_levels() -> None:
    course = fly(step(3.0), RandomSegment(kind="random", duration_s=20, low_m=2.3, high_m=3.6))
    assert course.end_s == pytest.approx(20.0)
    _, heights_m, _ = sampled(course, 0.01)
    assert heights_m.min() >= 2.3
    assert heights_m.max() <= 3.6


@pytest.mark.parametrize("seed", range(6))
def test_a_shorter_random_profile_is_the_beginning_of_a_longer_one(seed: int) -> None:
    short, long = (fly(RandomSegment(kind="random", duration_s=duration_s), seed=seed) for duration_s in (20.3, 40))
    for time_s in np.arange(0.0, 20.3, 0.05):
        assert short.at(time_s) == pytest.approx(long.at(time_s))


def test_a_track_changes_speed_smoothly_and_comes_to_rest() -> None:
    track = TrackSection(
        start_m=(3.0, -2.0),
        acceleration_m_s2=0.8,
        legs=(Leg(duration_s=2), Leg(duration_s=10, speed_m_s=2.0, heading_deg=30), Leg(duration_s=8, speed_m_s=1.0)),
    )
    north, east = track.courses()
    assert (north.at(2.0)[0], east.at(2.0)[0]) == (3.0, -2.0)
    assert (north.at(11.0)[1], east.at(11.0)[1]) == pytest.approx((2 * math.cos(math.pi / 6), 1.0))
    assert (north.at(19.9)[1], east.at(19.9)[1]) == pytest.approx((1.0, 0.0))
    assert north.end_s == pytest.approx(east.end_s)
    times_s, norths_m, north_m_s = sampled(north)
    _, easts_m, east_m_s = sampled(east)
    assert np.hypot(north_m_s, east_m_s).max() <= 2.0 + 1e-9
    accelerations = np.hypot(np.diff(north_m_s), np.diff(east_m_s)) / FINE_S
    assert accelerations.max() == pytest.approx(0.8, rel=1e-3)
    assert np.abs(np.diff(norths_m)).max() <= 2.0 * FINE_S
    assert (north_m_s[-1], east_m_s[-1]) == (0.0, 0.0)
    # A change of speed goes at the mean of both speeds: 2 m/s reached in 3.75 s.
    assert easts_m[times_s <= 12][-1] == pytest.approx(-2.0 + 1.0 * (10 - 3.75 / 2), abs=0.002)


def test_a_leg_too_short_for_its_speed_reaches_what_it_can() -> None:
    north, _ = TrackSection(acceleration_m_s2=1.0, legs=(Leg(duration_s=1.5, speed_m_s=3.0),)).courses()
    _, _, speeds_m_s = sampled(north)
    assert speeds_m_s.max() == pytest.approx(1.0)
    assert north.end_s == pytest.approx(1.5 + 1.5)


def vehicle(seed: int = 0, altitude_m: float = 3.0, **flight: Any) -> Vehicle:
    segments = (step(altitude_m), hold(600))
    return Vehicle(FlightSection(altitude=segments, **flight), lambda north_m, east_m: 0.0, np.random.default_rng(seed))


@pytest.mark.parametrize("yaw_deg", [0.0, 70.0, -150.0])
def test_thrust_points_where_the_vehicle_accelerates(yaw_deg: float) -> None:
    track = TrackSection(acceleration_m_s2=2.0, legs=(Leg(duration_s=20, speed_m_s=8.0, heading_deg=35),))
    flying = vehicle(track=track, attitude=AttitudeSection(yaw_deg=yaw_deg))
    for time_s in (0.5, 2.0, 5.0):
        pose = flying.pose(time_s)
        later, earlier = flying.pose(time_s + 1e-4), flying.pose(time_s - 1e-4)
        acceleration = (np.array(later.velocity_ned_m_s) - earlier.velocity_ned_m_s) / 2e-4
        thrust = acceleration - [0, 0, 9.80665]
        body = Rotation.from_euler("ZYX", [pose.yaw_rad, pose.pitch_rad, pose.roll_rad]).as_matrix()
        assert -body[:, 2] == pytest.approx(thrust / np.linalg.norm(thrust), abs=1e-6)
        assert pose.yaw_rad == math.radians(yaw_deg)


def test_a_vehicle_without_tilt_or_sway_keeps_its_attitude() -> None:
    track = TrackSection(legs=(Leg(duration_s=20, speed_m_s=4.0),))
    attitude = AttitudeSection(roll_deg=3, pitch_deg=-5, yaw_deg=20, tilt_with_acceleration=False)
    pose = vehicle(track=track, attitude=attitude).pose(1.0)
    assert pose[2:5] == pytest.approx((math.radians(3), math.radians(-5), math.radians(20)))


def test_sway_has_its_size_and_follows_its_seed() -> None:
    attitude = AttitudeSection(roll_deg=1.0, sway=Sway(roll_rms_deg=1.5, pitch_rms_deg=0.5, period_s=2.0))
    times_s = np.arange(0.0, 600.0, 0.05)
    poses = [vehicle(attitude=attitude).pose(time_s) for time_s in (0.0, 1.0)]
    flying = vehicle(attitude=attitude)
    rolls_deg, pitches_deg = np.degrees([flying.pose(time_s)[2:4] for time_s in times_s]).T
    assert [flying.pose(time_s) for time_s in (0.0, 1.0)] == poses
    assert vehicle(seed=1, attitude=attitude).pose(1.0) != poses[1]
    assert rolls_deg.mean() == pytest.approx(1.0, abs=0.05)
    # 600 s hold some 300 swings; three sinusoids beat, which leaves a few per cent.
    assert rolls_deg.std() == pytest.approx(1.5, rel=0.05)
    assert pitches_deg.std() == pytest.approx(0.5, rel=0.05)
    assert np.abs(rolls_deg - 1.0).max() <= 2.5 * 1.5


def test_heave_has_its_size_and_its_velocity_is_that_of_the_position() -> None:
    """Also while it grows with the height, in the first half metre of a climb."""
    flight = FlightSection(
        altitude=(climb(3.0, speed_m_s=0.2), hold(600)),
        heave=Heave(rms_m=0.1, period_s=3.0),
    )
    flying = Vehicle(flight, lambda north_m, east_m: 0.0, np.random.default_rng(3))
    heights_m = [-flying.pose(time_s).position_ned_m[2] - 0.25 for time_s in np.arange(20.0, 600.0, 0.05)]
    assert np.mean(heights_m) == pytest.approx(3.0, abs=0.01)
    assert np.std(heights_m) == pytest.approx(0.1, rel=0.05)
    assert flying.pose(0.0).position_ned_m[2] == -0.25
    for time_s in (1.0, 1.7, 2.2, 30.0):
        before, after = flying.pose(time_s - 1e-5), flying.pose(time_s + 1e-5)
        climb_m_s = (before.position_ned_m[2] - after.position_ned_m[2]) / 2e-5
        assert -flying.pose(time_s).velocity_ned_m_s[2] == pytest.approx(climb_m_s, abs=1e-6)


def test_a_vehicle_leans_for_a_while() -> None:
    """20 deg from 5 to 15 s, with two seconds to lean over and to straighten up."""
    lean = Lean(from_s=5.0, to_s=15.0, roll_deg=20.0, pitch_deg=-10.0, change_s=2.0)
    leaning = vehicle(attitude=AttitudeSection(roll_deg=1.0, leans=(lean,)))
    turned_deg = [np.degrees(leaning.pose(time_s)[2:4]) for time_s in (4.0, 6.0, 10.0, 14.0, 16.0)]
    assert np.array(turned_deg) == pytest.approx(
        np.array([[1.0, 0.0], [11.0, -5.0], [21.0, -10.0], [11.0, -5.0], [1.0, 0.0]])
    )


def test_a_vehicle_that_stands_does_not_sway() -> None:
    standing = vehicle(altitude_m=0.0, attitude=AttitudeSection(sway=Sway()), standing_height_m=0.3)
    assert {standing.pose(time_s)[1:5] for time_s in (0.0, 0.4, 1.3)} == {((0.0, 0.0, -0.3), 0.0, 0.0, 0.0)}


def test_a_vehicle_starts_on_the_surface_and_its_velocity_is_that_of_its_position() -> None:
    flight = FlightSection(
        altitude=(climb(4.0), hold(30)),
        track=TrackSection(start_m=(5.0, 2.0), legs=(Leg(duration_s=30, speed_m_s=1.0, heading_deg=-40),)),
        standing_height_m=0.2,
    )
    flying = Vehicle(flight, lambda north_m, east_m: 0.1 * north_m, np.random.default_rng(0))
    assert flying.pose(0.0).position_ned_m == pytest.approx((5.0, 2.0, -0.7))
    assert flying.pose(0.0).clearance_m == pytest.approx(0.0)
    for time_s in (0.5, 1.4, 3.0, 20.0):
        before, after = flying.pose(time_s - 1e-5), flying.pose(time_s + 1e-5)
        moved_m = np.subtract(after.position_ned_m, before.position_ned_m)
        assert flying.pose(time_s).velocity_ned_m_s == pytest.approx(moved_m / 2e-5, abs=1e-6)
