"""Climb by accelerometer and barometer: what it knows, its variance, and what it does not believe."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from msp_range.fusion.vertical import CLIMB_STD_M, Acceleration, VerticalMotion, corrected, moved

IMU_S, PRESSURE_S = 0.04, 0.1


def fly(
    height_m: Callable[[float], float], until_s: float, seed: int = 1, bias_m_s2: float = 0.15, noise: float = 1.0
) -> VerticalMotion:
    """A motion as noisy sensors see it; the acceleration by second differences."""
    motion, draw = VerticalMotion(), np.random.default_rng(seed)
    drift_m = 0.0
    for i in range(round(until_s / IMU_S)):
        time_s = i * IMU_S
        up_m_s2 = (height_m(time_s + 1e-3) - 2 * height_m(time_s) + height_m(time_s - 1e-3)) / 1e-6
        motion.on_acceleration(time_s, up_m_s2 + bias_m_s2 + noise * draw.normal(scale=0.3))
        if i % 2 == 0:
            drift_m += noise * draw.normal(scale=0.05 * math.sqrt(2 * IMU_S))
            motion.on_pressure_height(time_s, 250.0 + height_m(time_s) + drift_m + noise * draw.normal(scale=0.15))
    return motion


def bob(time_s: float) -> float:
    return 3.0 + 1.5 * math.sin(0.8 * time_s)


@pytest.mark.parametrize("seed", range(5))
def test_a_climb_is_known_within_three_of_its_deviations(seed: int) -> None:
    draw, off = np.random.default_rng(seed + 50), []
    for end_s in (20.0, 27.0, 40.0):
        back_s = draw.uniform(0.3, 6.0)
        motion = fly(bob, end_s, seed)
        early = fly(bob, end_s - back_s, seed)
        # The same seed gives the same start: a mark of the shorter flight is one of the longer.
        mark = early.mark(end_s - back_s)
        climb = motion.climbed(mark, end_s)
        assert mark is not None
        assert climb is not None
        assert climb.std_m < 0.6
        off.append((climb.height_m - (bob(end_s) - bob(end_s - back_s))) / climb.std_m)
    assert max(map(abs, off)) < 3.0


def test_the_accelerometers_bias_is_learnt() -> None:
    motion = fly(lambda time_s: 3.0, 60.0, bias_m_s2=0.3, noise=0.2)
    up_m_s2 = motion.acceleration(59.0, 60.0)
    assert up_m_s2 == pytest.approx(0.0, abs=0.1)
    rate = motion.rate(60.0)
    assert rate is not None
    assert rate.m_s == pytest.approx(0.0, abs=0.1)


def test_the_drift_of_the_barometer_makes_a_long_climb_unsure() -> None:
    motion = fly(lambda time_s: 3.0, 100.0)
    mark = fly(lambda time_s: 3.0, 1.0).mark(1.0)
    short, long = motion.climbed(motion.mark(99.9), 100.0), motion.climbed(mark, 100.0)
    assert short is not None
    assert long is not None
    assert short.std_m < 0.1
    assert long.std_m == pytest.approx(math.hypot(CLIMB_STD_M, 0.1 * math.sqrt(99)), rel=0.01)


def test_what_is_old_or_makes_no_sense_is_not_used() -> None:
    motion = fly(lambda time_s: 3.0, 10.0)
    mark = motion.mark(9.9)
    assert mark is not None
    assert motion.acceleration(9.9, 10.0) is not None
    assert motion.acceleration(10.9, 11.0) is None
    assert motion.mark(11.0) is None
    assert motion.climbed(mark, 11.0) is None
    for nonsense in (math.nan, math.inf, -1e38, 100.0):
        assert not motion.on_acceleration(10.0, nonsense)
    assert not motion.on_pressure_height(10.0, math.nan)
    assert motion.climbed(mark, 10.0) is not None
    # Another level of pressure, as after a reboot or a valve: nobody has climbed 80 m.
    assert not motion.on_pressure_height(10.1, 330.0)
    assert motion.climbed(mark, 10.1) is None
    assert motion.mark(10.1) is not None


def test_pressures_alone_give_a_climb_too() -> None:
    motion = VerticalMotion()
    for i in range(201):
        motion.on_pressure_height(i * PRESSURE_S, 0.7 * i * PRESSURE_S)
        if i == 150:
            mark = motion.mark(i * PRESSURE_S)
    climb = motion.climbed(mark, 20.0)
    assert climb is not None
    assert climb.height_m == pytest.approx(3.5, abs=0.05)
    assert motion.acceleration(19.9, 20.0) is None


def test_accelerations_are_those_between_the_times() -> None:
    """Each is the mean since the one before: 1 m/s^2 until 2 s, 3 m/s^2 from then on."""
    motion = VerticalMotion()
    for i in range(26):
        assert motion.update(Acceleration(0.1 * i, 1.0 if i <= 20 else 3.0))
        if i == 0:
            assert motion.measured(-0.1, 0.0) == pytest.approx(1.0)
    assert motion.measured(1.5, 2.0) == pytest.approx(1.0)
    assert motion.measured(1.9, 2.4) == pytest.approx(2.6)
    assert motion.measured(2.1, 2.5) == pytest.approx(3.0)
    assert motion.measured(2.5, 3.0) is None


def test_covariances_are_those_of_matrices() -> None:
    draw = np.random.default_rng(1)
    root = draw.normal(size=(3, 3))
    before = root @ root.T
    t, variance_m2 = 0.3, 0.7
    f = np.array([[1, t, -t * t / 2], [0, 1, -t], [0, 0, 1]])
    upper = np.triu_indices(3)
    assert moved(tuple(before[upper]), t) == pytest.approx((f @ before @ f.T)[upper])
    gains, after = corrected(tuple(before[upper]), variance_m2)
    expected = before[:, 0] / (before[0, 0] + variance_m2)
    assert gains == pytest.approx(expected)
    assert after == pytest.approx((before - np.outer(expected, before[0]))[upper])
