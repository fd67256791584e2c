"""The filter of the ground against dense matrices, and what its three ways to move are for."""

import math

import numpy as np
import pytest
from scipy.linalg import expm

from msp_range.fusion import ground_filter
from msp_range.fusion.ground_filter import SLOPE_LASTS_S, SLOPE_STD, GroundFilter
from msp_range.fusion.mounting import LEVEL, DownwardSensor, View
from msp_range.fusion.vertical import Rate
from msp_range.geometry import rotation_matrix

R_M2 = 0.02**2
AT_REST = Rate(0.0, 0.33)
STRAIGHT = View(2.0, 1.0, 0.0, 0.0, 0.0)
CORNERS = [View(2.0, 1.0, -x, -y, 0.0) for x, y in ((0.25, -0.2), (0.25, 0.2), (-0.25, -0.2), (-0.25, 0.2))]


def mean_of(known: GroundFilter) -> np.ndarray:
    return np.array([known.height_m, known.climb_m_s, known.rise_north, known.rise_east])


def covariance_of(known: GroundFilter) -> np.ndarray:
    """Of height, climb and both rises: the mixture's, by the spread of the three filters' means and their own."""
    mean, total = mean_of(known), np.zeros((4, 4))
    (nn, ne, ee), weights = known._slope, known._weights
    for weight, (h, w, hh, hw, ww, hn, he, wn, we) in zip(weights, known._filters, strict=True):
        off = np.array([h, w, *mean[2:]]) - mean
        own = np.array([[hh, hw, hn, he], [hw, ww, wn, we], [hn, wn, nn, ne], [he, we, ne, ee]])
        total += weight * (own + np.outer(off, off))
    return total


def test_with_one_way_to_move_it_is_a_kalman_filter(monkeypatch: pytest.MonkeyPatch) -> None:
    density = 0.3
    for name in ("QUIET_M2_S3", "CRUISE_M2_S3", "MANOEUVRE_M2_S3"):
        monkeypatch.setattr(ground_filter, name, density)
    draw = np.random.default_rng(3)
    known = GroundFilter(2.0, R_M2, Rate(1.0, 0.25))
    mean = np.array([2.0, 1.0])
    covariance = np.array([[R_M2, 0.0], [0.0, 0.25]])
    for i in range(200):
        t = draw.uniform(0.01, 0.2)
        # Van Loan: the noise of white acceleration over t from a matrix exponential.
        block = expm(np.array([[0, -1, 0, 0], [0, 0, 0, density], [0, 0, 0, 0], [0, 0, 1, 0]], float) * t)
        transition = block[2:, 2:].T
        mean, covariance = transition @ mean, transition @ covariance @ transition.T + transition @ block[:2, 2:]
        known.predict(t)
        scale = 1.0 + 0.05 * (i % 3)
        row = np.array([scale, 0.0])
        innovation_m = draw.normal(scale=0.03)
        total = row @ covariance @ row + R_M2
        gain = covariance @ row / total
        mean, covariance = mean + gain * innovation_m, covariance - np.outer(gain, row @ covariance)
        square = known.update(View(2.0, scale, 0.0, 0.0, 0.0), innovation_m, R_M2)
        assert square == pytest.approx(innovation_m**2 / total, rel=1e-6)
        np.testing.assert_allclose(mean_of(known)[:2], mean, rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(covariance_of(known)[:2, :2], covariance, rtol=1e-6, atol=1e-12)
    assert known.variance(0.9, 0.0, 0.0) == pytest.approx(0.81 * covariance[0, 0], rel=1e-6)
    # One place gives no information on the slope.
    assert mean_of(known)[2:].tolist() == [0.0, 0.0]
    np.testing.assert_allclose(covariance_of(known)[2:, 2:], SLOPE_STD**2 * np.eye(2))


@pytest.mark.parametrize("learns", [True, False])
def test_with_one_way_to_move_the_slope_is_that_of_a_dense_filter(
    monkeypatch: pytest.MonkeyPatch, learns: bool
) -> None:
    """A Kalman filter of four states, or one with the gain of the slope set to zero (Schmidt), in Joseph's form."""
    density = 0.02
    for name in ("QUIET_M2_S3", "CRUISE_M2_S3", "MANOEUVRE_M2_S3"):
        monkeypatch.setattr(ground_filter, name, density)
    draw = np.random.default_rng(4)
    lever = (0.25, -0.2)
    known = GroundFilter(2.0, R_M2, AT_REST, lever)
    mean, covariance = np.array([2.0, 0.0, 0.0, 0.0]), covariance_of(known)
    at_lever = np.array([1.0, 0.0, -lever[0], -lever[1]])
    assert at_lever @ covariance @ at_lever == pytest.approx(R_M2), "there the height has been read"
    for _ in range(300):
        t = draw.uniform(0.02, 0.2)
        stays = 1 - t / SLOPE_LASTS_S
        transition = np.diag([1.0, 1.0, stays, stays])
        transition[0, 1] = t
        noise = np.diag([0.0, 0.0, 1.0, 1.0]) * SLOPE_STD**2 * (1 - stays**2)
        noise[:2, :2] = density * np.array([[t**3 / 3, t**2 / 2], [t**2 / 2, t]])
        mean, covariance = transition @ mean, transition @ covariance @ transition.T + noise
        known.predict(t)
        row = np.array([1.02, 0.0, *draw.normal(scale=0.3, size=2)])
        innovation_m = draw.normal(scale=0.03)
        gain = covariance @ row / (row @ covariance @ row + R_M2)
        if not learns:
            gain[2:] = 0.0
        keeps = np.eye(4) - np.outer(gain, row)
        mean = mean + gain * innovation_m
        covariance = keeps @ covariance @ keeps.T + R_M2 * np.outer(gain, gain)
        known.update(View(2.0, row[0], row[2], row[3], 0.0), innovation_m, R_M2, learns)
        np.testing.assert_allclose(mean_of(known), mean, rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(covariance_of(known), covariance, rtol=1e-6, atol=1e-10)
    assert known.variance(0.9, 0.2, -0.1) == pytest.approx(
        np.array([0.9, 0, 0.2, -0.1]) @ covariance @ [0.9, 0, 0.2, -0.1]
    )
    assert (known.rise_north != 0.0) == learns


def test_four_corners_give_the_slope_and_their_variance_its_accuracy() -> None:
    draw = np.random.default_rng(8)
    rise = np.array([0.08, -0.12])
    squares = []
    for _ in range(200):
        known = GroundFilter(2.0, R_M2, AT_REST)
        for i in range(40):
            known.predict(0.1)
            view = CORNERS[i % 4]
            off = float((rise - [known.rise_north, known.rise_east]) @ [view.by_north, view.by_east])
            known.update(view, 2.0 - known.height_m + off + draw.normal(scale=0.02), R_M2)
        errors = (mean_of(known) - [2.0, 0.0, *rise])[[0, 2, 3]]
        squares.append(errors**2 / np.diag(covariance_of(known))[[0, 2, 3]])
    assert np.all(np.mean(squares, axis=0) < 1.6)
    assert np.all(np.mean(squares, axis=0) > 0.3)


def test_one_corner_alone_knows_the_middle_no_better_than_the_slope_is_known() -> None:
    known = GroundFilter(2.0, R_M2, AT_REST)
    for _ in range(400):
        known.predict(0.1)
        known.update(CORNERS[0], 2.0 - known.height_m, R_M2)
    covariance = covariance_of(known)
    lever_m = math.hypot(0.25, 0.2)
    assert math.sqrt(covariance[0, 0]) == pytest.approx(SLOPE_STD * lever_m, rel=0.1)
    # Where it looks, it knows better.
    assert math.sqrt(known.variance(1.0, -0.25, 0.2)) < 0.02
    assert np.linalg.eigvalsh(covariance).min() > 0
    row = np.array([0.9, 0.0, 0.2, -0.1])
    assert known.variance(0.9, 0.2, -0.1) == pytest.approx(row @ covariance @ row, rel=1e-9)


def hover(known: GroundFilter, truth_m: np.ndarray, draw: np.random.Generator) -> np.ndarray:
    """Errors and normalised squares of readings that come each tenth of a second from the reference point."""
    out = []
    for height_m in truth_m:
        known.predict(0.1)
        known.update(STRAIGHT, height_m + draw.normal(scale=0.02) - known.height_m, R_M2)
        out.append((known.height_m - height_m, (known.height_m - height_m) ** 2 / known.variance(1.0, 0.0, 0.0)))
    return np.array(out)


def test_a_quiet_vehicle_is_known_to_half_the_noise_as_the_variance_states() -> None:
    out = hover(GroundFilter(2.0, R_M2, AT_REST), np.full(6000, 2.0), np.random.default_rng(1))[100:]
    assert out[:, 0].std() < 0.5 * 0.02
    # Kalman filters of a real vehicle had better be careful: a steady one is the easiest case.
    assert 0.4 < out[:, 1].mean() < 1.2


@pytest.mark.parametrize(("swing_m", "period_s"), [(0.05, 3.0), (1.0, 6.0), (1.0, 4.0)])
def test_a_vehicle_that_moves_is_followed_at_least_as_well_as_by_the_readings(swing_m: float, period_s: float) -> None:
    truth_m = 3.0 + swing_m * np.sin(2 * math.pi / period_s * 0.1 * np.arange(3000))
    known = GroundFilter(3.0, R_M2, AT_REST)
    out = hover(known, truth_m, np.random.default_rng(2))[100:]
    assert math.sqrt((out[:, 0] ** 2).mean()) < 0.02
    assert 0.5 < out[:, 1].mean() < 2.0
    # That the three filters differ, as they do now, is part of what is uncertain.
    known.predict(1.0)
    row = np.array([0.9, 0.0, 0.2, -0.1])
    assert known.variance(0.9, 0.2, -0.1) == pytest.approx(row @ covariance_of(known) @ row, rel=1e-9)


def test_a_step_moves_the_height_only_and_leaves_it_uncertain() -> None:
    known = GroundFilter(2.0, R_M2, AT_REST)
    hover(known, 2.0 + 0.05 * np.arange(50), np.random.default_rng(5))
    before, covariance = mean_of(known), covariance_of(known)
    known.shift(-0.4, 0.05**2, 0.3**2)
    np.testing.assert_allclose(mean_of(known) - before, [-0.4, 0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(np.diag(covariance_of(known) - covariance), [0.05**2, 0.3**2, 0, 0], atol=1e-12)


def test_time_that_stands_still_or_goes_back_changes_nothing() -> None:
    known = GroundFilter(2.0, R_M2, AT_REST)
    before = mean_of(known), covariance_of(known)
    known.predict(0.0)
    known.predict(-0.01)
    np.testing.assert_array_equal(mean_of(known), before[0])
    np.testing.assert_array_equal(covariance_of(known), before[1])


def test_a_slope_whose_frame_has_changed_is_forgotten() -> None:
    known = GroundFilter(2.0, R_M2, AT_REST)
    for i in range(30):
        known.predict(0.1)
        known.update(CORNERS[i % 4], 0.02 * (-1) ** i, R_M2)
    assert abs(known.rise_north) + abs(known.rise_east) > 0
    known.level()
    assert (known.rise_north, known.rise_east) == (0.0, 0.0)
    assert known.variance(0.0, 1.0, 0.0) == pytest.approx(SLOPE_STD**2)


@pytest.mark.parametrize("seed", range(8))
def test_variances_stay_positive_however_the_vehicle_is_turned(seed: int) -> None:
    """Attitudes that jump by up to 75 deg between readings, as no vehicle turns and a damaged link says."""
    draw = np.random.default_rng(seed)
    sensors = [DownwardSensor((x, y, 0.0), (0.0, 0.0, 1.0), "unknown") for x in (0.25, -0.25) for y in (0.2, -0.2)]
    known = GroundFilter(3.0, R_M2, AT_REST)
    for i in range(4000):
        known.predict(float(draw.choice([0.05, 0.1, 0.1, 1.0])), float(draw.normal(scale=0.5)) if i % 3 else None)
        roll, pitch, yaw = draw.uniform([-1.2, -1.2, -3.0], [1.2, 1.2, 3.0]).tolist()
        rotation = rotation_matrix(roll, pitch, yaw) if draw.random() < 0.5 else LEVEL
        view = sensors[i % 4].turned(rotation).view(known.height_m, known.rise_north, known.rise_east)
        if view is None:
            continue
        assert math.isfinite(known.density(view, 0.1, R_M2))
        known.update(view, float(draw.normal(scale=0.02)), R_M2, bool(draw.random() < 0.7))
        assert np.diag(covariance_of(known)).min() > 0.0
        assert known.variance(1.0, 0.0, 0.0) > 0.0
        assert min(motion[2] for motion in known._filters) > 0.0
        assert min(motion[4] for motion in known._filters) > 0.0
