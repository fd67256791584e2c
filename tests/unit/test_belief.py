"""Which of several surfaces is the ground, and how probable that is."""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
import pytest

from msp_range.fusion import AttitudeTrack, DownwardSensor, Fusion
from msp_range.fusion.modes import ground_prior, object_prior
from msp_range.fusion.vertical import VerticalMotion
from msp_range.reading import Status
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


class Moving:
    """Four sensors below a vehicle that climbs by a profile, with an accelerometer and a barometer.

    Parameters
    ----------
    range_m
        What a sensor reads at a time and a height [m].
    climbs
        Beginnings of climbs of 1 m in 2 s, with 1 m/s^2 up and down [s].
    """

    def __init__(self, range_m: Callable[[str, float, float], float], climbs: Sequence[float] = ()) -> None:
        self._climbs = climbs
        motion, draw = VerticalMotion(), np.random.default_rng(1)
        sensors = {name: DownwardSensor((x, y, 0.0), DOWN, "slant") for name, (x, y) in CORNERS.items()}
        fusion = Fusion(sensors, AttitudeTrack(), WINDOWS, motion)
        self.sent: dict[float, float] = {}
        self.statuses: dict[float, Status] = {}
        for i in range(200):
            time_s = i * SLOT_S
            for k in range(4):
                moment_s = time_s - 0.075 + 0.025 * k
                motion.on_acceleration(moment_s, self._at(moment_s)[1] + draw.normal(0.0, 0.3))
            motion.on_pressure_height(time_s, 100.0 + self._at(time_s)[0] + draw.normal(0.0, 0.1))
            seen_m = range_m(NAMES[i % 4], time_s, self._at(time_s)[0]) + draw.normal(scale=SIGMA_M)
            out = fusion.update(reading(NAMES[i % 4], time_s, seen_m), time_s + 0.03)
            self.statuses[time_s] = out.reading.status
            if out.fused is not None:
                self.sent[time_s] = out.fused.range_m

    def _at(self, time_s: float) -> tuple[float, float]:
        """How far it has climbed [m], and its acceleration upwards [m/s^2]."""
        height_m = up_m_s2 = 0.0
        for from_s in self._climbs:
            t = min(max(time_s - from_s, 0.0), 2.0)
            height_m += t * t / 2 if t < 1.0 else 1.0 - (2.0 - t) ** 2 / 2
            up_m_s2 += (1.0 if t < 1.0 else -1.0) if 0.0 < t < 2.0 else 0.0
        return height_m, up_m_s2


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
    after = {time_s: range_m for time_s, range_m in flight.sent.items() if time_s > 12.7}
    assert len(after) > 65
    assert all(abs(range_m - base_m - 2.0) < 0.15 for range_m in after.values())


def test_a_ground_that_is_near_after_a_jump_is_sent_when_it_answers_to_a_climb() -> None:
    flight = Moving(lambda name, time_s, height_m: (4.0 if time_s < 6.0 else 0.5) + height_m, climbs=(10.0,))
    assert not [time_s for time_s in flight.sent if 6.5 < time_s < 10.0]
    after = {time_s: range_m for time_s, range_m in flight.sent.items() if time_s > 12.0}
    assert len(after) > 70
    assert all(abs(range_m - 1.5) < 0.15 for range_m in after.values())


def test_what_does_not_answer_to_a_climb_is_part_of_the_vehicle() -> None:
    flight = Moving(lambda name, time_s, height_m: 4.0 if time_s < 6.0 else 0.5, climbs=(10.0, 13.0))
    assert not [time_s for time_s in flight.sent if time_s > 6.5]
    assert flight.statuses[16.0] is Status.FIXED


def test_priors_fall_with_the_size_of_a_step() -> None:
    priors = [ground_prior(off_m, 0.02, 3.0) for off_m in (0.0, 0.3, 1.0, 3.0)]
    assert priors == sorted(priors, reverse=True)
    assert ground_prior(1.0, 0.02, 0.5) < ground_prior(1.0, 0.02, 1.5)
    assert object_prior(0.5) > object_prior(3.0) == pytest.approx(math.log(0.03), abs=0.2)
