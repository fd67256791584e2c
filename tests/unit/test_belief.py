"""Which of several surfaces is the ground, and how probable that is."""

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

from msp_range.fusion import AttitudeTrack, DownwardSensor, Fusion
from msp_range.fusion.modes import ground_prior, object_prior
from msp_range.fusion.vertical import VerticalMotion
from tests.unit.test_fusion import CORNERS, DOWN, NAMES, SIGMA_M, SLOT_S, WINDOWS, four, reading, take


def sent_m(range_m: Callable[[str, float], float], until_s: float = 20.0) -> dict[float, float]:
    """What is sent of four sensors that read so, by its time [s]."""
    fusion, draw, sent = four(), np.random.default_rng(1), {}
    for i in range(round(until_s / SLOT_S)):
        time_s = i * SLOT_S
        seen_m = range_m(NAMES[i % 4], time_s) + draw.normal(scale=SIGMA_M)
        if (fused := take(fusion, reading(NAMES[i % 4], time_s, seen_m))) is not None:
            sent[time_s] = fused.range_m
    return sent


@pytest.mark.parametrize("rise_m", [0.3, 1.0, 2.0, -1.0])
def test_an_edge_that_two_of_four_have_passed_silences_nothing(rise_m: float) -> None:
    """The known ground goes on, however long two sensors see one level and two the other; then the new one."""
    sent = sent_m(lambda name, time_s: 3.0 - rise_m * (time_s > (8.0 if name in "ab" else 12.0)))
    times_s = sorted(sent)
    assert max(late - early for early, late in pairwise(times_s)) < 0.35
    assert all(abs(sent[time_s] - 3.0) < 0.1 for time_s in times_s if time_s < 12.0)
    assert all(abs(sent[time_s] - 3.0 + rise_m) < 0.1 for time_s in times_s if time_s > 12.6)


@pytest.mark.parametrize("wrong", ["abcd", "abc"])
def test_what_gets_into_the_beams_high_up_is_no_ground(wrong: str) -> None:
    """From 5 m to 0.4 m at once, which no terrain does: silence, or the distance of the one that is right."""
    sent = sent_m(lambda name, time_s: 0.4 if name in wrong and time_s > 10.0 else 5.0)
    assert all(abs(range_m - 5.0) < 0.1 for range_m in sent.values())


def test_the_ground_returns_where_the_barometer_says() -> None:
    """Something in the beams of all sensors for 8 s is no ground; what they see then is."""
    motion = VerticalMotion()
    sensors = {name: DownwardSensor((x, y, 0.0), DOWN, "slant") for name, (x, y) in CORNERS.items()}
    fusion, draw = Fusion(sensors, AttitudeTrack(), WINDOWS, motion), np.random.default_rng(1)
    for i in range(200):
        time_s = i * SLOT_S
        for k in range(4):
            motion.on_acceleration(time_s + 0.025 * k, draw.normal(0.0, 0.3))
            motion.on_pressure_height(time_s + 0.025 * k, draw.normal(0.0, 0.1))
        range_m = (0.4 if 6.0 < time_s < 14.0 else 5.0) + draw.normal(scale=SIGMA_M)
        fused = take(fusion, reading(NAMES[i % 4], time_s, range_m))
        assert fused is None or abs(fused.range_m - 5.0) < 0.1, time_s
        assert fused is not None or time_s <= 14.5, time_s


def test_priors_fall_with_the_size_of_a_step() -> None:
    priors = [ground_prior(off_m, 0.02, 3.0) for off_m in (0.0, 0.3, 1.0, 3.0)]
    assert priors == sorted(priors, reverse=True)
    assert ground_prior(1.0, 0.02, 0.5) < ground_prior(1.0, 0.02, 1.5)
    assert object_prior(0.5) > object_prior(3.0) == pytest.approx(math.log(0.03), abs=0.2)
