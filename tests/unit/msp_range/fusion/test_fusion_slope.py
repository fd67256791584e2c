"""A vehicle that sways while it climbs and sinks: a slope is learnt only where the sensors can show one.

The readings come from vectors and planes by scipy and numpy, apart from the product's own geometry.
"""

import math
from itertools import product
from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from msp_range.fusion import Angles, AttitudeTrack, DownwardSensor, Fusion, Oblique, Windows
from msp_range.fusion.vertical import VerticalMotion
from msp_range.reading import Reading, Status
from tests.support.slow import slow

NOISE_M, STATED_M = 0.008, 0.010
LOWEST_M, HIGHEST_M = 0.5, 6.0
SWAY_RAD, SWAY_S = np.radians([4.6, 3.4]), np.array([3.1, 2.3])
SLOT_S, ATTITUDE_S, PRESSURE_S = 0.1, 0.04, 0.1
SETTLED_S = 3.0


def ring(count: int) -> list[tuple[float, float]]:
    turns = 2 * math.pi * (np.arange(count) + 0.5) / count
    return [(0.32 * math.cos(turn), 0.32 * math.sin(turn)) for turn in turns]


CORNERS = [(0.25, -0.2), (0.25, 0.2), (-0.25, -0.2), (-0.25, 0.2)]
LAYOUTS = {
    "one": [(0.0, 0.0)],
    "one at a corner": CORNERS[:1],
    "two across": [(0.0, -0.2), (0.0, 0.2)],
    "two at opposite corners": CORNERS[::3],
    "three on a line": [(0.25, 0.0), (0.0, 0.0), (-0.25, 0.0)],
    "three on a line ahead": [(0.25, -0.2), (0.25, 0.0), (0.25, 0.2)],
    "four on a line": [(0.0, -0.3), (0.0, -0.1), (0.0, 0.1), (0.0, 0.3)],
    "three": CORNERS[:3],
    "four": CORNERS,
    **{f"{count} in a ring": ring(count) for count in (5, 6, 7, 8)},
}
READS: list[tuple[Oblique, str]] = [
    ("slant", "slant"),
    ("nearest", "nearest"),
    ("unknown", "slant"),
    ("unknown", "nearest"),
]


class Errors(NamedTuple):
    """Of the fused distance: how far off each was [m], and in deviations as stated; of the slope, the largest."""

    off_m: np.ndarray
    deviations: np.ndarray
    slope: float

    @property
    def rms_m(self) -> float:
        return math.sqrt(float((self.off_m**2).mean()))


class Swaying:
    """A vehicle that climbs, sinks and sways, and the attitude, acceleration and pressure that it sends."""

    def __init__(self, draw: np.random.Generator, track: AttitudeTrack, motion: VerticalMotion | None) -> None:
        self._draw, self._track, self._motion = draw, track, motion
        self._phase_s = draw.uniform(0, 20, 3)
        self._rate = 2 * math.pi / draw.uniform(16, 24)
        self._next_s = self._pressure_s = 0.0

    def height_m(self, t: float) -> float:
        middle_m, half_m = (HIGHEST_M + LOWEST_M) / 2, (HIGHEST_M - LOWEST_M) / 2
        return middle_m - half_m * math.cos(self._rate * (t + self._phase_s[2]))

    def angles(self, t: float) -> tuple[float, float, float]:
        roll, pitch = SWAY_RAD * np.sin(2 * math.pi * (t + self._phase_s[:2]) / SWAY_S)
        return float(roll), float(pitch), 0.4

    def send(self, until_s: float) -> None:
        """All messages until a time."""
        while self._next_s <= until_s:
            now_s = self._next_s
            assert self._track.update(Angles(now_s, *self.angles(now_s)))
            if self._motion is not None:
                half_m = (HIGHEST_M - LOWEST_M) / 2
                up_m_s2 = half_m * self._rate**2 * math.cos(self._rate * (now_s + self._phase_s[2]))
                self._motion.on_acceleration(now_s, up_m_s2 + self._draw.normal(scale=0.15))
                if self._pressure_s <= now_s:
                    self._motion.on_pressure_height(now_s, 100 + self.height_m(now_s) + self._draw.normal(scale=0.15))
                    self._pressure_s += PRESSURE_S
            self._next_s += ATTITUDE_S


def fly(
    layout: str,
    reads: tuple[Oblique, str],
    witnesses: bool,
    rise: tuple[float, float] = (0.0, 0.0),
    echo_from: int = 8,
    seed: int = 1,
) -> Errors:
    """Climb and sink for 80 s with readings right to a centimetre; only the first ``echo_from`` sensors get an echo."""
    draw = np.random.default_rng(seed)
    configured, truth = reads
    places = LAYOUTS[layout]
    track, motion = AttitudeTrack(), VerticalMotion() if witnesses else None
    vehicle = Swaying(draw, track, motion)
    fusion = Fusion(
        {str(i): DownwardSensor((x, y, 0.0), (0.0, 0.0, 1.0), configured) for i, (x, y) in enumerate(places)},
        track,
        Windows(len(places) * SLOT_S, SLOT_S),
        motion,
        maximum_m=8.0,
    )
    normal = np.array([*rise, 1.0])
    errors, slope = [], 0.0
    for ping in range(800):
        t = ping * SLOT_S
        vehicle.send(t + 0.02)
        name = ping % len(places)
        turned = Rotation.from_euler("ZYX", vehicle.angles(t)[::-1]).as_matrix()
        over_m = vehicle.height_m(t) - normal @ turned @ [*places[name], 0.0]
        axis = normal @ turned[:, 2]
        range_m = over_m / (axis if truth == "slant" else np.linalg.norm(normal)) + draw.normal(scale=NOISE_M)
        reading = Reading(t, str(name), Status.OK, range_m, STATED_M, round(1000 * range_m) + 7 * ping)
        if name >= echo_from:
            reading = Reading(t, str(name), Status.NO_ECHO, raw=765)
        fused = fusion.update(reading, t + 0.03).fused
        if fused is not None and t > SETTLED_S:
            off_m = fused.range_m - vehicle.height_m(t) / axis
            errors.append((off_m, off_m / math.sqrt(fused.variance_m2)))
            slope = max(slope, abs(fused.rise_north - rise[0]), abs(fused.rise_east - rise[1]))
    off_m, deviations = np.array(errors).T
    # Other sensors' missed echoes at 6 m make the stream wait now and then; never is it silent for most of the time.
    assert len(errors) > 600 * min(echo_from, len(places)) / len(places)
    return Errors(off_m, np.abs(deviations), slope)


MORE = (
    "two at opposite corners",
    "three on a line",
    "three on a line ahead",
    "four on a line",
    *(f"{count} in a ring" for count in (5, 6, 7, 8)),
)


SLOW = (
    *product(("one", "four"), READS, (True,)),
    *product(("one at a corner", "two across", "three", *MORE), READS[1:3], (False,)),
)


@pytest.mark.parametrize(
    ("layout", "reads", "witnesses"),
    [
        *product(("one", "four"), READS, (False,)),
        *(pytest.param(*each, marks=pytest.mark.slow) for each in SLOW),
    ],
)
def test_over_level_ground_the_distance_is_right(layout: str, reads: tuple[Oblique, str], witnesses: bool) -> None:
    errors = fly(layout, reads, witnesses)
    assert errors.rms_m < 0.025
    assert np.abs(errors.off_m).max() < 0.08
    assert (errors.deviations > 3).mean() < 0.01


@pytest.mark.parametrize("reads", READS, ids=" ".join)
def test_two_of_four_that_get_an_echo_learn_no_slope(reads: tuple[Oblique, str]) -> None:
    errors = fly("four", reads, witnesses=False, echo_from=2)
    assert errors.slope == 0.0
    assert np.abs(errors.off_m).max() < 0.08


@pytest.mark.parametrize("layout", ["two across", "three on a line ahead", "four on a line"])
def test_sensors_on_a_line_learn_no_slope(layout: str) -> None:
    assert fly(layout, ("nearest", "nearest"), witnesses=False).slope == 0.0


@pytest.mark.parametrize("layout", ["four", *slow("three")])
@pytest.mark.parametrize("rise", [(0.1, 0.0), *slow((-0.14, 0.14))])
@pytest.mark.parametrize(("reads", "rms_m"), [(("slant", "slant"), 0.012), (("nearest", "nearest"), 0.025)])
def test_sensors_that_span_a_plane_learn_a_slope(
    layout: str, rise: tuple[float, float], reads: tuple[Oblique, str], rms_m: float
) -> None:
    errors = fly(layout, reads, witnesses=False, rise=rise)
    assert errors.slope < 0.08
    assert errors.rms_m < rms_m
    assert (errors.deviations > 3).mean() < 0.01
