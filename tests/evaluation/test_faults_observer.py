"""The ideal observer of the fault campaign, on flights whose messages are computed here."""

import math
from collections.abc import Callable, Sequence

import numpy as np
import pytest

from evaluation.faults.families import FAMILIES
from evaluation.faults.judge import Distance, Event
from evaluation.faults.observer import DECIDED_NATS, GRAVITY_M_S2, SCALE_HEIGHT_M, Messages, decide, gains
from evaluation.faults.report import Sum, worst_table

pytestmark = pytest.mark.slow

CORNERS_M = [(0.25, -0.2, 0.0), (0.25, 0.2, 0.0), (-0.25, -0.2, 0.0), (-0.25, 0.2, 0.0)]
AIR_C = 22.5
"""Air in which an answer is the distance."""
STANDING_M, TURN_S, UNTIL_S = 0.2, 0.4, 20.0


def height_m(time_s: float, to_m: float = 3.0) -> float:
    """Stand for 4 s, then climb within 4 s."""
    u = min(max((time_s - 4.0) / 4.0, 0.0), 1.0)
    return STANDING_M + (to_m - STANDING_M) * u * u * (3 - 2 * u)


def flight(
    answer_m: Callable[[float, int], float],
    sensors: int = 4,
    air_c: Callable[[float], float] = lambda time_s: AIR_C,
    height: Callable[[float], float] = height_m,
) -> tuple[Messages, list[Distance]]:
    """What the bridge received, and the distances that it would send if it believed every answer."""
    draws, step_s = np.random.default_rng(5), 0.04
    forces = []
    for time_s in np.arange(0.0, UNTIL_S, step_s):
        change_m_s2 = (height(time_s) - 2 * height(time_s - step_s) + height(time_s - 2 * step_s)) / step_s**2
        x, y, z = draws.normal([0.0, 0.0, -GRAVITY_M_S2 - change_m_s2], 0.3)
        forces.append((float(time_s), float(x), float(y), float(z)))
    pressures = [
        (float(time_s), 1013.0 * math.exp(-(height(time_s) + draws.normal(0.0, 0.15)) / SCALE_HEIGHT_M))
        for time_s in np.arange(0.0, UNTIL_S, 0.1)
    ]
    answers, distances = [], []
    for i in range(round(UNTIL_S / TURN_S * sensors)):
        time_s, sensor = i * TURN_S / sensors, i % sensors
        raw = round(max(100 * answer_m(time_s, sensor) + draws.normal(0.0, 1.9), 20.0))
        answers.append((time_s, sensor, raw))
        distances.append(Distance(time_s + 0.03, time_s, raw / 100, 0.19, 7.65, 0.02, 95))
    temperatures = [(float(second), air_c(second)) for second in range(math.ceil(UNTIL_S))]
    corners_m = CORNERS_M[:sensors]
    return Messages(answers, [], forces, pressures, temperatures, corners_m, lambda range_m: 0.2), distances


def tolerance_m(distance_m: float) -> float:
    return max(0.2, 0.05 * distance_m)


def decided(messages: Messages, distances: Sequence[Distance], from_s: float) -> float | None:
    """How long after its beginning a wrong distance is decided, which lasts to the end."""
    (seconds,) = decide(messages, distances, [Event(from_s, UNTIL_S - from_s, 1.0, None)], tolerance_m)
    return seconds


@pytest.mark.parametrize("sensors", [1, 4])
def test_right_distances_are_never_decided(sensors: int) -> None:
    messages, distances = flight(lambda time_s, sensor: height_m(time_s), sensors)
    assert max(gains(messages, distances, tolerance_m, UNTIL_S)) < 0.5 * DECIDED_NATS


@pytest.mark.parametrize("sensors", [1, 4])
def test_what_is_fixed_to_the_vehicle_is_decided_in_a_climb(sensors: int) -> None:
    messages, distances = flight(lambda time_s, sensor: min(height_m(time_s), 0.4), sensors)
    seconds = decided(messages, distances, from_s=5.4)
    assert seconds is not None
    assert seconds < (2.0 if sensors > 1 else 3.0)


@pytest.mark.parametrize(("near_m", "is_decided"), [(0.4, True), (1.8, False)])
def test_an_object_is_decided_where_no_edge_can_be(near_m: float, is_decided: bool) -> None:
    """In hover at 3 m: 0.4 m is nearer than any edge or box, 1.8 m may be either."""

    def answer_m(time_s: float, sensor: int) -> float:
        return height_m(time_s) if time_s < 12.0 else near_m

    seconds = decided(*flight(answer_m), from_s=12.0)
    assert (seconds is not None and seconds < 2.0) == is_decided


def test_answers_of_the_ping_before_are_decided_by_the_acceleration() -> None:
    late = flight(lambda time_s, sensor: height_m(time_s - TURN_S, 6.0), height=lambda time_s: height_m(time_s, 6.0))
    assert decided(*late, from_s=5.3) is not None


def test_a_thermometer_that_settles_is_decided() -> None:
    """It comes from 20 C into -15 C: distances are up to 6 % too long."""
    true = math.sqrt((273.15 - 15.0) / (273.15 + AIR_C))
    messages, distances = flight(
        lambda time_s, sensor: height_m(time_s, 5.0) / true,
        air_c=lambda time_s: -15.0 + 35.0 * math.exp(-time_s / 90.0),
        height=lambda time_s: height_m(time_s, 5.0),
    )
    assert decided(messages, distances, from_s=9.0) == 0.0


def test_a_flapping_thermometer_decides_nothing() -> None:
    flaps = flight(lambda time_s, sensor: height_m(time_s), air_c=lambda time_s: AIR_C + 40.0 * (time_s % 2.0 >= 1.0))
    assert max(gains(*flaps, tolerance_m, UNTIL_S)) < 0.5 * DECIDED_NATS


@pytest.mark.parametrize(
    ("decidable_s", "counted"),
    [([None, 0.4, 0.1], "1 of 2"), ([None, 2.5, 0.1], "0 of 2"), ([2.0, 2.0, None], "2 of 2"), ([], "0 of 2")],
)
def test_the_tables_count_and_mark_what_is_decidable(decidable_s: list[float | None], counted: str) -> None:
    """Two wrong distances without a report, of 9 and of 3 s, and one with a report."""
    wrong = [[1.0, 9.0, -1.0, None], [20.0, 3.0, 1.0, None], [30.0, 2.0, 1.0, "text"]]
    zero = dict.fromkeys(["above_wrong", "above_wrong_s", "in_range_s", "honest_in_range_s"], 0.0)
    line = {
        "again": "1:1",
        "group": next(iter(FAMILIES)),
        "row": "fixed: 1 sensor",
        "faults": [],
        "crashed": None,
        "verdict": {"wrong": wrong, "silences": [], "false_objects": [], **zero},
        "decidable_s": decidable_s,
    }
    assert Sum([line]).decidable == counted
    (row,) = worst_table([line])[1:]
    assert row[3].endswith("undecidable") == (counted != "2 of 2")
