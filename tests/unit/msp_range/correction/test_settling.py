"""Thermometers that settle: when it is noticed, and how far the air may be ahead."""

import math
import random
from collections.abc import Callable

import pytest

from msp_range.correction.settling import LARGEST_C, SLOWEST_S, Settling

OfTime = Callable[[float], float]
STEP_S = 30.0


def settled(shown_c: OfTime, until_s: float, period_s: float = 1.0) -> list[tuple[float, float, float, float]]:
    """Time [s], lag, correction and its deviation [deg C] after each value; at most 100 values are looked at."""
    settling = Settling(0.0, shown_c(0.0))
    found = []
    for number in range(1, int(until_s / period_s) + 1):
        settling.update(number * period_s, shown_c(number * period_s))
        found.append((number * period_s, settling.lag_c, settling.ahead_c, settling.std_c))
        assert len(settling._values) <= 100
    return found


def lags(shown_c: OfTime, until_s: float, period_s: float = 1.0) -> list[tuple[float, float]]:
    """Time [s] and lag [deg C] after each value."""
    return [(time_s, lag_c) for time_s, lag_c, _, _ in settled(shown_c, until_s, period_s)]


def follows(air_c: OfTime, time_constant_s: float, step_s: float = 0.1) -> OfTime:
    """A first-order thermometer in this air, integrated in small steps; asked at growing times."""
    state = [0.0, air_c(0.0)]

    def at(time_s: float) -> float:
        while state[0] < time_s - 1e-9:
            state[0] += step_s
            state[1] += (air_c(state[0]) - state[1]) * (1 - math.exp(-step_s / time_constant_s))
        return state[1]

    return at


def measured(shown_c: OfTime, noise_c: float, step_c: float) -> OfTime:
    draw = random.Random(7)

    def at(time_s: float) -> float:
        value_c = shown_c(time_s) + draw.gauss(0.0, noise_c)
        return round(value_c / step_c) * step_c

    return at


@pytest.mark.parametrize("change_c", [-35.0, 25.0])
@pytest.mark.parametrize("time_constant_s", [20.0, 60.0, SLOWEST_S])
def test_the_lag_and_a_thermometers_own_deviation_contain_the_air(change_c: float, time_constant_s: float) -> None:
    """From the first 3 C on that the reading has moved, as `TemperatureTrack.air` adds them."""

    def shown_c(time_s: float) -> float:
        return 20.0 + change_c * (1 - math.exp(-max(time_s - STEP_S, 0.0) / time_constant_s))

    found = settled(measured(shown_c, 0.05, 0.0625), 400.0)
    assert all(lag_c == 0.0 for time_s, lag_c, _, _ in found if time_s < STEP_S)
    noticed = [each for each in found if abs(shown_c(each[0]) - 20.0) > 3.0]
    assert all(0.0 <= lag_c * change_c <= LARGEST_C * abs(change_c) for _, lag_c, _, _ in noticed)
    off_c = [20.0 + change_c - shown_c(time_s) - ahead_c for time_s, _, ahead_c, _ in noticed]
    covered = [
        abs(each_c) <= 1.96 * math.hypot(math.sqrt(2), std_c)
        for each_c, (_, _, _, std_c) in zip(off_c, noticed, strict=True)
    ]
    assert sum(covered) >= 0.95 * len(covered) > 300
    # It is off by much less than an uncorrected one, whatever its time constant.
    uncorrected_c = [20.0 + change_c - shown_c(time_s) for time_s, _, _, _ in noticed if time_s > STEP_S + 20.0]
    corrected_c = off_c[-len(uncorrected_c) :]
    assert sum(map(abs, corrected_c)) < 0.67 * sum(map(abs, uncorrected_c))
    if time_constant_s < SLOWEST_S:
        assert found[-1][1] == 0.0


def test_a_quick_thermometer_is_soon_known_well_again() -> None:
    found = lags(follows(lambda time_s: 20.0 if time_s < STEP_S else 10.0, 5.0), 100.0)
    assert max(abs(lag_c) for _, lag_c in found) > 20.0
    assert all(lag_c == 0.0 for time_s, lag_c in found if time_s > STEP_S + 40.0)


@pytest.mark.parametrize(("time_constant_s", "noise_c"), [(10.0, 0.5), (20.0, 0.2)])
def test_a_quick_thermometer_with_noise_is_not_taken_for_a_slow_one(time_constant_s: float, noise_c: float) -> None:
    """A change that seems to begin before it does looks slow: the correction would be many degrees too large."""

    def shown_c(time_s: float) -> float:
        return 30.0 - 10.0 * math.exp(-max(time_s - STEP_S, 0.0) / time_constant_s)

    found = settled(measured(shown_c, noise_c, 0.0625), STEP_S + 2 * time_constant_s + 20.0)
    off_c = [30.0 - shown_c(time_s) - ahead_c for time_s, _, ahead_c, _ in found if shown_c(time_s) > 23.0]
    assert sum(map(abs, off_c)) < 3.0 * len(off_c)


ORDINARY: dict[str, OfTime] = {
    "sun and shade": lambda time_s: 19.0 + 2.0 * (int(time_s) // 40 % 2),
    "sinking from 1000 m at 3 m/s": lambda time_s: 13.5 + 0.0065 * min(3.0 * time_s, 1000.0),
    "climbing through 100 m at 10 m/s": lambda time_s: 20.0 - 0.0065 * min(10.0 * time_s, 100.0),
}


@pytest.mark.parametrize(("noise_c", "step_c"), [(0.0, 0.01), (0.0, 0.5), (0.05, 0.0625), (0.5, 0.01), (0.15, 0.5)])
@pytest.mark.parametrize("time_constant_s", [0.1, 10.0])
@pytest.mark.parametrize("name", ORDINARY)
def test_what_happens_in_ordinary_flights_is_no_settling(
    name: str, time_constant_s: float, noise_c: float, step_c: float
) -> None:
    shown_c = measured(follows(ORDINARY[name], time_constant_s), noise_c, step_c)
    assert {lag_c for _, lag_c in lags(shown_c, 600.0)} == {0.0}


def test_a_change_that_is_over_when_the_noise_turns_out_to_be_small_is_no_settling() -> None:
    """As at a take-off out of air that the ground has warmed by 3 C."""
    assert {lag_c for _, lag_c in lags(lambda time_s: 27.0 if time_s < 4.0 else 24.0, 120.0)} == {0.0}


@pytest.mark.parametrize("period_s", [0.02, 10.0, 60.0])
def test_values_come_as_often_as_they_like(period_s: float) -> None:
    """50 per second of an autopilot, or one per minute of a file; not all of them are kept."""
    shown_c = follows(lambda time_s: 20.0 if time_s < STEP_S else -15.0, 120.0, min(period_s, 0.1))
    found = lags(shown_c, 150.0, period_s)
    value_s, lag_c = found[-1]
    assert lag_c == pytest.approx(-35.0 * math.exp(-(value_s - STEP_S) / 120.0), rel=0.4)


@pytest.mark.parametrize(("change_c", "time_constant_s"), [(-35.0, 60.0), (-35.0, SLOWEST_S), (30.0, 90.0)])
def test_one_that_is_switched_on_in_other_air_is_noticed_within_seconds(
    change_c: float, time_constant_s: float
) -> None:
    """Later a change by so little may be a shadow."""

    def shown_c(time_s: float) -> float:
        return 20.0 + change_c * (1 - math.exp(-max(time_s, 0.0) / time_constant_s))

    at_start = next(time_s for time_s, lag_c in lags(measured(shown_c, 0.1, 0.05), 60.0) if lag_c)
    later = next(
        time_s for time_s, lag_c in lags(measured(lambda time_s: shown_c(time_s - STEP_S), 0.1, 0.05), 90.0) if lag_c
    )
    assert at_start <= 6.0
    assert at_start < later - STEP_S
