"""Filters against numpy and the report's equations, and the gate in front of them."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

from msp_range.filters.base import Estimate, Filter
from msp_range.filters.chain import MEMORY_S, UNCONFIRMED, Chain, Filtered
from msp_range.filters.kalman import START_SPEED_STD_M_S, KalmanParameters
from msp_range.filters.median import MedianParameters
from msp_range.filters.moving_average import MovingAverageParameters
from msp_range.reading import Reading, Status
from msp_range.reading_model.sensor_model import load_sensor_model

SENSOR = load_sensor_model("mb1242")
SIGMA_M = 0.0195
VARIANCE_M2 = SIGMA_M**2
GENERATOR = np.random.default_rng(20)
RANGES_M = 3.0 + 0.5 * np.cumsum(GENERATOR.normal(size=60)) * 0.1
ROUND_S = 0.4


def run(one: Filter, ranges_m: Sequence[float] = tuple(RANGES_M), times_s: Sequence[float] | None = None) -> Any:
    """Ranges and variances that come out, two columns; a reading that is held back is NaN."""
    if times_s is None:
        times_s = [ROUND_S * i for i in range(len(ranges_m))]
    estimates = [
        one.update(time_s, Estimate(range_m, VARIANCE_M2)) or (math.nan, math.nan)
        for time_s, range_m in zip(times_s, ranges_m, strict=True)
    ]
    return np.array(estimates)


@pytest.mark.parametrize("window", [1, 2, 5, 11])
@pytest.mark.parametrize(
    ("make", "statistic", "factor"),
    [(MovingAverageParameters, np.mean, 1.0), (MedianParameters, np.median, math.pi / 2)],
)
def test_moving_window(make: Any, statistic: Callable[[Any], float], factor: float, window: int) -> None:
    one = make(filter=make.model_fields["filter"].annotation.__args__[0], window=window).make(SENSOR)
    out = run(one)
    windows = [RANGES_M[max(0, i - window + 1) : i + 1] for i in range(len(RANGES_M))]
    np.testing.assert_allclose(out[:, 0], [statistic(each) for each in windows], rtol=1e-12)
    count = np.array([len(each) for each in windows])
    # The median of one or two is their mean, and varies like it.
    np.testing.assert_allclose(out[:, 1], VARIANCE_M2 / count * np.where(count > 2, factor, 1.0), rtol=1e-12)
    one.reset()
    assert run(one)[0, 0] == RANGES_M[0]


def test_the_stated_variance_of_a_median_is_about_that_of_many_medians() -> None:
    """(pi / 2) / M holds for large M; at 3 and 7 the true variances are 0.449 and 0.210 of one reading's."""
    for window, tolerance in [(3, 0.20), (7, 0.10)]:
        medians = np.median(np.random.default_rng(1).normal(size=(40_000, window)), axis=1)
        one = MedianParameters(filter="median", window=window).make(SENSOR)
        stated = run(one, [3.0] * window)[-1, 1] / VARIANCE_M2
        assert stated == pytest.approx(medians.var(), rel=tolerance)


def kalman(**parameters: Any) -> Filter:
    return KalmanParameters(filter="kalman", **parameters).make(SENSOR)


@pytest.mark.parametrize("process_variance_cm2", [0.01, 1.0, 100.0])
@pytest.mark.parametrize("measurement_variance_cm2", [None, 3.7811])
def test_kalman_of_a_constant_is_equations_15_to_19(
    process_variance_cm2: float, measurement_variance_cm2: float | None
) -> None:
    out = run(
        kalman(
            model="constant",
            process_variance_cm2=process_variance_cm2,
            measurement_variance_cm2=measurement_variance_cm2,
            gate_sigmas=None,
        )
    )
    q_m2 = process_variance_cm2 * 1e-4
    r_m2 = VARIANCE_M2 if measurement_variance_cm2 is None else measurement_variance_cm2 * 1e-4
    x, p = RANGES_M[0], r_m2
    for measured_m, (range_m, variance_m2) in zip(RANGES_M[1:], out[1:], strict=True):
        p = p + q_m2  # (16); x stays, F = 1 and no control (15)
        gain = p / (p + r_m2)  # (18)
        x = x + gain * (measured_m - x)  # (17)
        p = (1 - gain) * p  # (19)
        assert (range_m, variance_m2) == (pytest.approx(x, rel=1e-12), pytest.approx(p, rel=1e-9))


@pytest.mark.parametrize("acceleration_std_m_s2", [0.5, 4.0])
def test_kalman_of_a_constant_velocity_takes_irregular_times(acceleration_std_m_s2: float) -> None:
    """Q by integrating the response to an acceleration that is constant between readings: [T^2/2, T] a."""
    times_s = np.cumsum(GENERATOR.uniform(0.05, 0.9, size=len(RANGES_M)))
    out = run(kalman(acceleration_std_m_s2=acceleration_std_m_s2, gate_sigmas=None), tuple(RANGES_M), tuple(times_s))
    x = np.array([RANGES_M[0], 0.0])
    p = np.diag([VARIANCE_M2, START_SPEED_STD_M_S**2])
    h = np.array([1.0, 0.0])
    for i in range(1, len(RANGES_M)):
        elapsed_s = times_s[i] - times_s[i - 1]
        f = np.array([[1.0, elapsed_s], [0.0, 1.0]])
        response = np.array([elapsed_s**2 / 2, elapsed_s]) * acceleration_std_m_s2
        x, p = f @ x, f @ p @ f.T + np.outer(response, response)
        gain = p @ h / (h @ p @ h + VARIANCE_M2)
        x, p = x + gain * (RANGES_M[i] - h @ x), (np.eye(2) - np.outer(gain, h)) @ p
        assert out[i] == pytest.approx((x[0], p[0, 0]), rel=1e-9)


def test_kalman_follows_a_climb_without_lag() -> None:
    climb_m = 1.0 + 0.5 * ROUND_S * np.arange(100)
    out = run(kalman(), tuple(climb_m))
    assert not np.isnan(out).any()
    np.testing.assert_allclose(out[20:, 0], climb_m[20:], atol=1e-3)


def test_kalman_knows_its_own_error() -> None:
    """Normalised errors of independent noise on a steady climb have a variance of about 1, and the gate passes them."""
    noise_m = np.random.default_rng(4).normal(scale=SIGMA_M, size=4000)
    truth_m = 5.0 + 1e-3 * np.arange(4000)
    out = run(kalman(acceleration_std_m_s2=0.05), tuple(truth_m + noise_m))
    passed = ~np.isnan(out[:, 0])
    assert passed.mean() > 0.995
    normalised = (out[passed, 0] - truth_m[passed])[50:] / np.sqrt(out[passed, 1])[50:]
    # The model allows for accelerations that this climb does not have, so it is a little too careful.
    assert 0.5 < normalised.var() < 1.1


@pytest.mark.parametrize("model", ["constant", "constant_velocity"])
def test_kalman_holds_one_outlier_back_and_believes_the_second(model: str) -> None:
    one = kalman(model=model)
    ranges_m = [5.0] * 10 + [2.5] + [5.0] * 5 + [2.5, 2.5, 2.5]
    out = run(one, ranges_m)[:, 0]
    assert np.flatnonzero(np.isnan(out)).tolist() == [10, 16]
    np.testing.assert_allclose(out[:10], 5.0, atol=1e-9)
    np.testing.assert_allclose(out[11:16], 5.0, atol=1e-9)
    assert out[17] == 2.5


@pytest.mark.parametrize("model", ["constant", "constant_velocity"])
def test_kalman_does_not_believe_two_that_disagree(model: str) -> None:
    out = run(kalman(model=model), [5.0] * 10 + [2.0, 6.8] + [5.0] * 3)[:, 0]
    assert np.flatnonzero(np.isnan(out)).tolist() == [10, 11]
    np.testing.assert_allclose(out[12:], 5.0, atol=1e-9)


def test_kalman_without_a_gate_holds_nothing_back() -> None:
    assert not np.isnan(run(kalman(gate_sigmas=None), [5.0] * 10 + [1.0, 7.0])).any()


def test_kalman_starts_anew_after_a_reset() -> None:
    one = kalman()
    run(one, [5.0] * 10)
    one.reset()
    assert one.update(99.0, Estimate(1.0, VARIANCE_M2)) == (1.0, VARIANCE_M2)


def test_kalman_needs_a_variance() -> None:
    with pytest.raises(ValueError, match="measurement_variance_cm2"):
        kalman().update(0.0, Estimate(3.0, math.inf))
    estimate = kalman(measurement_variance_cm2=4.0).update(0.0, Estimate(3.0, math.inf))
    assert estimate == pytest.approx((3.0, 4e-4))


def reading(time_s: float, range_m: float | None, status: Status = Status.OK, *, suspect: bool = False) -> Reading:
    return Reading(time_s, "a", status, range_m, SIGMA_M if range_m else None, suspect=suspect)


def outcome(chain: Chain, time_s: float, range_m: float, *, suspect: bool = False) -> str | float | None:
    """The range that comes out, or why none does."""
    filtered = chain.update(reading(time_s, range_m, suspect=suspect))
    return filtered.rejected if filtered.estimate is None else filtered.estimate.range_m


def started(filters: list[Any], time_s: float, range_m: float, memory_s: float = MEMORY_S) -> Chain:
    """A chain that has two readings alike behind it, the second at ``time_s``."""
    chain = Chain(filters, memory_s)
    assert outcome(chain, time_s - 0.1, range_m) == UNCONFIRMED
    outcome(chain, time_s, range_m)
    return chain


@pytest.mark.parametrize("status", [status for status in Status if not status.has_range])
def test_no_code_passes_the_gate_and_none_touches_a_filter(status: Status) -> None:
    chain = started([MovingAverageParameters(filter="moving_average").make(SENSOR)], 0.0, 3.0)
    assert chain.update(reading(0.4, None, status)) == Filtered(None, status.value)
    assert outcome(chain, 0.8, 4.5) == 3.5


def test_an_empty_chain_gives_the_reading_and_its_variance() -> None:
    assert started([], 0.0, 3.0).update(reading(0.1, 3.0)).estimate == pytest.approx((3.0, VARIANCE_M2))
    at_minimum = Reading(0.1, "a", Status.AT_MINIMUM, 0.2)
    assert started([], 0.0, 0.2).update(at_minimum).estimate == (0.2, math.inf)


def test_filters_run_in_order() -> None:
    median, mean = MedianParameters(filter="median", window=3), MovingAverageParameters(filter="moving_average")
    chain = Chain([median.make(SENSOR), mean.make(SENSOR)])
    out = [outcome(chain, ROUND_S * i, range_m) for i, range_m in enumerate([3.0, 3.0, 9.0, 3.0])]
    assert out == [UNCONFIRMED, 3.0, 3.0, 3.0]


def test_what_a_filter_holds_back_goes_no_further() -> None:
    chain = Chain([kalman(), MovingAverageParameters(filter="moving_average").make(SENSOR)])
    for i in range(5):
        outcome(chain, ROUND_S * i, 5.0)
    assert outcome(chain, 2.0, 1.0) == "unexpected"
    assert outcome(chain, 2.4, 5.0) == pytest.approx(5.0)


@pytest.mark.parametrize(
    ("ranges_m", "passes"),
    [
        ([], False),
        # After 0.4 s at rest: 15 cm, and 20 more a second.
        ([2.77], True),
        ([2.79], False),
        ([2.33], True),
        ([2.31], False),
        ([5.00], False),
        ([3.15, 2.85], True),
        ([1.95, 2.25], True),
        # As fast as a vehicle may be, and faster.
        ([5.75, 4.15], True),
        ([7.55, 5.05], False),
        # On the way up, and past.
        ([2.55, 2.85], False),
        ([5.00, 5.00, 5.00], False),
    ],
)
def test_255_passes_where_the_prediction_contains_it(ranges_m: list[float], passes: bool) -> None:
    chain = started([], 59.9, 4.0)
    # A flight before, whose speed must be forgotten.
    for time_s, range_m in [(60.0, 4.0), (60.4, 5.5)]:
        outcome(chain, time_s, range_m)
    for range_m in ranges_m[:1]:
        assert outcome(chain, 70.0 - 1e-3, range_m) == UNCONFIRMED
    for i, range_m in enumerate(ranges_m):
        assert outcome(chain, 70.0 + ROUND_S * i, range_m) == range_m
    assert outcome(chain, 70.0 + ROUND_S * len(ranges_m), 2.55, suspect=True) == (2.55 if passes else "suspect")


def test_255_for_ever_is_believed_only_where_the_vehicle_was_there() -> None:
    for start_m, believed in [(3.2, False), (2.6, True)]:
        chain = Chain([])
        outcome(chain, 0.0, start_m)
        outcome(chain, ROUND_S, start_m)
        out = [outcome(chain, ROUND_S * i, 2.55, suspect=True) for i in range(2, 40)]
        assert set(out) == ({2.55} if believed else {"suspect"})


def test_an_ordinary_reading_at_255_needs_no_prediction() -> None:
    assert outcome(started([], 0.0, 2.6), 0.1, 2.55) == 2.55


@pytest.mark.parametrize(("gap_s", "forgotten"), [(1.4, False), (1.6, True)])
def test_after_a_gap_the_filters_start_anew(gap_s: float, forgotten: bool) -> None:
    chain = started([MovingAverageParameters(filter="moving_average").make(SENSOR)], 10.0, 3.0)
    first, second = outcome(chain, 10.0 + gap_s, 4.5), outcome(chain, 10.1 + gap_s, 4.5)
    assert (first, second) == ((UNCONFIRMED, 4.5) if forgotten else (3.5, pytest.approx(3.75)))


def test_the_memory_follows_the_polling() -> None:
    chain = started([], 10.0, 3.0, memory_s=8.0)
    assert outcome(chain, 17.9, 4.0) == 4.0


def test_after_a_start_two_readings_must_agree() -> None:
    """As after a long time without an echo, when an outlier comes alone."""
    chain = Chain([])
    ranges_m = [0.32, 4.0, 3.9, 3.8]
    out = [outcome(chain, 20.0 + ROUND_S * i, range_m) for i, range_m in enumerate(ranges_m)]
    assert out == [UNCONFIRMED, UNCONFIRMED, 3.9, 3.8]
    # A vehicle that climbs fast agrees with itself, and a reading of long ago with nothing.
    assert outcome(started([], 10.0, 3.0), 30.0, 3.0) == UNCONFIRMED
    fast = Chain([])
    assert [outcome(fast, 0.4 * i, 3.0 + 2.0 * i) for i in range(2)] == [UNCONFIRMED, 5.0]


@pytest.mark.parametrize(("gap_s", "passes"), [(1.4, True), (1.6, False)])
def test_a_prediction_is_as_old_as_the_filters_memory_at_most(gap_s: float, passes: bool) -> None:
    chain = started([], 10.0, 2.55)
    assert outcome(chain, 10.0 + gap_s, 2.55, suspect=True) == (2.55 if passes else "suspect")


def test_after_a_gap_every_filter_of_the_chain_starts_anew() -> None:
    both: list[Any] = [MedianParameters(filter="median", window=3), MovingAverageParameters(filter="moving_average")]
    for filters in (both, both[::-1]):
        chain = Chain([parameters.make(SENSOR) for parameters in filters])
        for number in range(5):
            chain.update(Reading(0.1 * number, "a", Status.OK, 6.0, 0.02, 600))
        chain.update(Reading(2.9, "a", Status.OK, 1.0, 0.02, 100))
        filtered = chain.update(Reading(3.0, "a", Status.OK, 1.0, 0.02, 100))
        assert filtered.estimate is not None
        assert filtered.estimate.range_m == 1.0
