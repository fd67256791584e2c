"""The fused downward distance against closed forms and least squares."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from msp_range.filters.base import Estimate
from msp_range.fusion import MOST_POINTS, NEWEST_S, WINDOW_S, DownwardSensor, Fusion, Oblique

SIGMA_M = 0.02
VARIANCE_M2 = SIGMA_M**2
SLOT_S = 0.1
NAMES = "abcd"


def four(cos_tilt: float = 1.0, below_m: float = 0.0, oblique: Oblique = "slant") -> Fusion:
    return Fusion({name: DownwardSensor(cos_tilt, below_m, oblique) for name in NAMES})


def fly(
    fusion: Fusion, truth_m: Callable[[float], float], readings: int, noise_m: np.ndarray | None = None
) -> list[Estimate]:
    """Four sensors in turn, a reading each slot; the echo times are off the slots by up to 20 ms."""
    jitter_s = np.random.default_rng(8).uniform(0.0, 0.02, readings)
    out = []
    for i in range(readings):
        time_s = i * SLOT_S + jitter_s[i]
        range_m = truth_m(time_s) + (0.0 if noise_m is None else noise_m[i])
        out.append(fusion.update(NAMES[i % 4], time_s, Estimate(range_m, VARIANCE_M2)))
    return out


def error_m(truth_m: Callable[[float], float], out: list[Estimate]) -> np.ndarray:
    jitter_s = np.random.default_rng(8).uniform(0.0, 0.02, len(out))
    return np.array([each.range_m - truth_m(i * SLOT_S + jitter_s[i]) for i, each in enumerate(out)])


@pytest.mark.parametrize("speed_m_s", [0.0, 0.5, -2.0, 4.0, -4.5])
def test_a_ramp_is_followed_without_lag(speed_m_s: float) -> None:
    def ramp(time_s: float) -> float:
        return 50.0 + speed_m_s * time_s

    out = fly(four(), ramp, 60)
    # The speed changes by 4 m/s a second at most, and four readings must be there to see it.
    known = math.ceil(abs(speed_m_s) / 4.0 / SLOT_S) + 5
    np.testing.assert_allclose(error_m(ramp, out)[known:], 0.0, atol=1e-9)


def test_noise_is_averaged_nearly_as_well_as_by_least_squares() -> None:
    """Theil and Sen's line needs at most half as many readings more as the best one does, for normal noise."""

    def climb(time_s: float) -> float:
        return 1.0 + 0.4 * time_s

    readings = 4000
    noise_m = np.random.default_rng(2).normal(scale=SIGMA_M, size=readings)
    out = fly(four(), climb, readings, noise_m)
    errors_m = error_m(climb, out)[10:]
    jitter_s = np.random.default_rng(8).uniform(0.0, 0.02, readings)
    times_s = np.arange(readings) * SLOT_S + jitter_s
    ranges_m = climb(times_s) + noise_m  # type: ignore[arg-type]
    best_m = [
        np.polyval(np.polyfit(times_s[i - 4 : i + 1] - times_s[i], ranges_m[i - 4 : i + 1], 1), 0.0) - climb(times_s[i])
        for i in range(10, readings)
    ]
    assert errors_m.std() < 1.25 * np.std(best_m)
    assert abs(errors_m.mean()) < 0.1 * SIGMA_M
    stated_m2 = np.array([each.variance_m2 for each in out[10:]])
    # Never surer than it has reason to be, and not three times as careful either.
    assert 1 / 3 < np.mean(errors_m**2) / np.mean(stated_m2) < 1.1


@pytest.mark.parametrize("off_m", [-2.0, -0.3, 0.5, 3.0])
@pytest.mark.parametrize("speed_m_s", [0.0, 1.0])
def test_one_sensor_that_sees_something_else_does_not_move_it(off_m: float, speed_m_s: float) -> None:
    def ramp(time_s: float) -> float:
        return 4.0 + speed_m_s * time_s

    noise_m = np.array([off_m if i % 4 == 2 else 0.0 for i in range(80)])
    errors_m = error_m(ramp, fly(four(), ramp, 80, noise_m))[12:]
    # In two windows of four the wild sensor pulls the slope; half a metre a second over two slots is the most.
    assert np.abs(errors_m).max() < (0.15 if speed_m_s else 1e-9)


def test_a_single_wild_reading_does_not_move_it() -> None:
    noise_m = np.zeros(40)
    noise_m[[20, 33]] = [-2.5, 3.0]
    assert {each.range_m for each in fly(four(), lambda time_s: 4.0, 40, noise_m)[5:]} == {4.0}


def test_a_step_of_the_ground_is_followed_within_three_readings() -> None:
    out = fly(four(), lambda time_s: 4.0 if time_s < 2.0 else 3.0, 40)
    assert [each.range_m for each in out[4:20]] == [4.0] * 16
    np.testing.assert_allclose([each.range_m for each in out[23:]], 3.0, atol=0.1)
    np.testing.assert_allclose([each.range_m for each in out[28:]], 3.0, atol=1e-9)


def test_groups_that_ping_together_are_no_motion() -> None:
    """Readings of one ping are milliseconds apart: their difference is noise or a slope of the ground, not a speed."""
    fusion = four()
    draw = np.random.default_rng(6)
    off_m = []
    for i in range(400):
        for name in NAMES:
            range_m = 3.0 + draw.normal(scale=SIGMA_M)
            off_m.append(fusion.update(name, i * SLOT_S + range_m * 2.9e-3, Estimate(range_m, VARIANCE_M2)).range_m)
    assert np.std(off_m[8:]) < SIGMA_M
    assert np.abs(np.array(off_m[8:]) - 3.0).max() < 4 * SIGMA_M


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
    cosine = math.cos(math.radians(tilt_deg))
    fused = fly(four(cosine, 0.07, oblique), lambda time_s: 5.0, 20)[-1]
    assert fused.range_m == pytest.approx(down(5.0, cosine) + 0.07, rel=1e-12)
    # Where it is unknown which, the truth may be half the difference away in every reading alike.
    half_m = (5.0 - 5.0 * cosine) / 2 if oblique == "unknown" else 0.0
    assert fused.variance_m2 == pytest.approx(VARIANCE_M2 * 4 / MOST_POINTS + half_m**2, rel=1e-9)


def test_of_the_first_readings_the_last_one_counts_and_then_the_middle_one() -> None:
    """Two or three readings say more about noise than about speed, and the mean of two would follow a wild one."""
    fusion = four()
    out = [fusion.update("abc"[i], i * SLOT_S, Estimate(3.0 + 0.1 * i, VARIANCE_M2)) for i in range(3)]
    assert out[:2] == [(3.0, VARIANCE_M2), (pytest.approx(3.1), VARIANCE_M2)]
    assert out[2].range_m == pytest.approx(3.1)


def test_the_variance_of_few_readings_and_of_readings_that_disagree() -> None:
    fusion = four()
    first = fusion.update("a", 0.0, Estimate(3.0, VARIANCE_M2))
    assert first == (3.0, VARIANCE_M2)
    for i, (name, range_m) in enumerate(zip("bcda", (3.5, 2.5, 3.5, 2.5), strict=True), start=1):
        last = fusion.update(name, i * SLOT_S, Estimate(range_m, VARIANCE_M2))
    assert math.sqrt(last.variance_m2) > 0.4


@pytest.mark.parametrize(("sensors", "told"), [("a", False), ("ab", True), ("abc", True)])
def test_without_a_reading_two_other_sensors_must_have_seen_the_ground(sensors: str, told: bool) -> None:
    fusion = four()
    for i in range(6):
        fusion.update(sensors[i % len(sensors)], i * SLOT_S, Estimate(3.0 + 0.5 * i * SLOT_S, VARIANCE_M2))
    fused = fusion.at(6 * SLOT_S)
    assert (fused is not None) is told
    if fused is not None:
        assert fused.range_m == pytest.approx(3.3)


def test_nothing_is_told_of_what_was_seen_too_long_ago() -> None:
    fusion = four()
    assert fusion.at(0.0) is None
    fusion.update("a", 1.0, Estimate(3.0, VARIANCE_M2))
    fusion.update("b", 1.1, Estimate(3.0, VARIANCE_M2))
    assert fusion.at(1.1 + NEWEST_S - 0.01) is not None
    assert fusion.at(1.1 + NEWEST_S + 0.01) is None
    # One sensor goes on; the other's reading leaves the window.
    fusion.update("b", 1.5, Estimate(3.0, VARIANCE_M2))
    assert fusion.at(1.0 + WINDOW_S - 0.01) is not None
    assert fusion.at(1.0 + WINDOW_S + 0.01) is None
    assert fusion.update("c", 9.0, Estimate(1.0, VARIANCE_M2)) == (1.0, VARIANCE_M2)


def test_only_downward_sensors_belong_to_it() -> None:
    fusion = four()
    assert (fusion.includes("a"), fusion.includes("forward")) == (True, False)
    with pytest.raises(KeyError):
        fusion.update("forward", 0.0, Estimate(3.0, VARIANCE_M2))


def test_echoes_of_a_group_that_are_out_of_order_make_no_speed() -> None:
    """Sensors that ping together answer in the order of their ranges, and what heard nothing has the ping's time."""
    fusion = Fusion({name: DownwardSensor(1.0, 0.0, "slant") for name in "ab"})
    for turn in range(50):
        assert fusion.update("a", 0.1 * turn + 0.020, Estimate(3.0, 4e-4)).range_m == 3.0
        assert fusion.update("b", 0.1 * turn, Estimate(3.0, 4e-4)).range_m == 3.0
