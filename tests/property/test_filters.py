"""What holds for every filter: a shifted scene gives a shifted estimate, and it lies among the readings."""

import math
from typing import Any

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter

from msp_range.filters.base import Estimate
from msp_range.filters.chain import MEMORY_S, Chain, Filtered
from msp_range.filters.table import BUILT_IN, FilterParameters
from msp_range.reading import Reading, Status
from msp_range.reading_model.sensor_model import Weights
from tests.support.shipped import SENSOR

STD_M = 0.0207
"""Of a reading: not round, or four of them would be whole centimetres, and rounding would decide at the gate."""
ADAPTER: TypeAdapter[Any] = TypeAdapter(FilterParameters)
CHAINS: list[list[dict[str, Any]]] = [
    [],
    [{"filter": "moving_average", "window": 4}],
    [{"filter": "median", "window": 5}],
    [{"filter": "kalman", "model": "constant"}],
    [{"filter": "kalman"}],
    [{"filter": "median", "window": 3}, {"filter": "kalman"}],
]
ALONE = [[{"filter": name}] for name in BUILT_IN]
"""Every filter as it is without parameters."""

steps_s = st.floats(0.03, 2.0).map(lambda step_s: step_s * math.pi / 3)
"""Not round either: after 0.4 s two readings 2.2 m apart are exactly at the limit for a start."""
ranges_cm = st.integers(20, 700)
flights = st.lists(st.tuples(steps_s, ranges_cm), min_size=1, max_size=30)


QUIET = SENSOR.model_copy(
    update={
        "reading_model": SENSOR.reading_model.model_copy(
            update={"weights": Weights(hit=0.97, short=0.0, missed=0.02, random=0.01)}
        )
    }
)
"""A sensor whose outliers are as likely anywhere: where a scene is does not matter to the filter."""
CHANGEPOINT = {"filter": "changepoint"}


def run(
    filters: list[dict[str, Any]], flight: list[tuple[float, int]], offset_cm: int = 0, start_s: float = 0.0
) -> list[Filtered]:
    chain = Chain([ADAPTER.validate_python(each).make(QUIET) for each in filters])
    time_s, out = start_s, []
    for step_s, range_cm in flight:
        time_s += step_s
        out.append(chain.update(Reading(time_s, "a", Status.OK, (range_cm + offset_cm) / 100, STD_M)))
    return out


def check_alike(
    here: list[Filtered], there: list[Filtered], offset_m: float, tolerance_m: float, variance_rel: float = 0.3
) -> None:
    for one, other in zip(here, there, strict=True):
        assert one.rejected == other.rejected
        if one.estimate is not None and other.estimate is not None:
            assert other.estimate.range_m - one.estimate.range_m == pytest.approx(offset_m, abs=tolerance_m)
            assert other.estimate.variance_m2 == pytest.approx(one.estimate.variance_m2, rel=variance_rel)


@pytest.mark.parametrize("filters", CHAINS, ids=lambda filters: "+".join(each["filter"] for each in filters) or "none")
@given(flight=flights, offset_cm=st.integers(-15, 60))
def test_a_shifted_scene_gives_a_shifted_estimate(
    filters: list[dict[str, Any]], flight: list[tuple[float, int]], offset_cm: int
) -> None:
    check_alike(run(filters, flight), run(filters, flight, offset_cm), offset_cm / 100, 1e-7, 1e-6)


@pytest.mark.parametrize("filters", CHAINS[:4], ids=lambda filters: "+".join(each["filter"] for each in filters) or "-")
@given(flight=flights)
def test_an_estimate_lies_among_the_readings(filters: list[dict[str, Any]], flight: list[tuple[float, int]]) -> None:
    lowest_m, highest_m = (pick(range_cm for _, range_cm in flight) / 100 for pick in (min, max))
    for filtered in run(filters, flight):
        if filtered.estimate is not None:
            assert lowest_m - 1e-9 <= filtered.estimate.range_m <= highest_m + 1e-9
            assert 0 < filtered.estimate.variance_m2 <= STD_M**2 * (1 + 1e-9)


# Enough for steps and slopes, and not so much that two runs are equally probable, when rounding would decide.
walks = st.lists(st.tuples(st.sampled_from((0.1, 0.2, 0.4)), st.integers(-8, 8)), min_size=1, max_size=25).map(
    lambda steps: [(step_s, 300 + sum(by for _, by in steps[: index + 1])) for index, (step_s, _) in enumerate(steps)]
)


@settings(max_examples=40)
@given(flight=walks, offset_cm=st.integers(-60, 60))
def test_a_shifted_scene_gives_a_shifted_changepoint_estimate(flight: list[tuple[float, int]], offset_cm: int) -> None:
    """Up to what the sensor's limits make of it: 'unlocated' is uniform between them."""
    here, there = run([CHANGEPOINT], flight), run([CHANGEPOINT], flight, offset_cm=offset_cm)
    check_alike(here, there, offset_cm / 100, 2e-3)


@pytest.mark.parametrize("filters", [*CHAINS, *ALONE], ids=lambda filters: "+".join(f["filter"] for f in filters))
@settings(max_examples=25)
@given(flight=walks, start_s=st.sampled_from((1.0, 1024.0, 65536.0)))
def test_shifted_time_stamps_change_nothing(
    filters: list[dict[str, Any]], flight: list[tuple[float, int]], start_s: float
) -> None:
    check_alike(run(filters, flight), run(filters, flight, start_s=start_s), 0.0, 1e-4)


@pytest.mark.parametrize("parameters", [*(chain[0] for chain in (*CHAINS[1:3], *ALONE))], ids=str)
@settings(max_examples=25)
@given(flight=flights)
def test_a_chain_of_one_is_that_one(parameters: dict[str, Any], flight: list[tuple[float, int]]) -> None:
    """But for what the chain is there for: after a long gap it starts anew, once two readings agree."""
    one, last_s = ADAPTER.validate_python(parameters).make(SENSOR), float("-inf")
    chain = Chain([ADAPTER.validate_python(parameters).make(SENSOR)])
    time_s = 0.0
    for step_s, range_cm in flight:
        time_s += step_s
        if time_s - last_s > MEMORY_S:
            one.reset()
            one.update(time_s, Estimate(range_cm / 100, STD_M * STD_M))
            assert chain.update(Reading(time_s, "a", Status.OK, range_cm / 100, STD_M)).estimate is None
            time_s += 0.1
        last_s = time_s
        alone = one.update(time_s, Estimate(range_cm / 100, STD_M * STD_M))
        assert chain.update(Reading(time_s, "a", Status.OK, range_cm / 100, STD_M)).estimate == alone


codes = st.sampled_from([status for status in Status if not status.has_range])
answers = st.lists(
    st.tuples(st.floats(0.0, 3.0), st.one_of(codes, st.integers(20, 765)), st.booleans()), min_size=1, max_size=40
)


@pytest.mark.parametrize("filters", [*CHAINS, *ALONE], ids=lambda filters: "+".join(f["filter"] for f in filters))
@settings(max_examples=40)
@given(answers=answers)
@example(answers=[*((0.0, range_cm, False) for range_cm in (27, 28, 20, 20)), (1e-297, 20, False)])
def test_whatever_a_sensor_answers_what_comes_out_is_a_distance_or_a_reason(
    filters: list[dict[str, Any]], answers: list[tuple[float, Status | int, bool]]
) -> None:
    chain = Chain([ADAPTER.validate_python(each).make(SENSOR) for each in filters])
    time_s = 0.0
    for step_s, answer, suspect in answers:
        time_s += step_s
        if isinstance(answer, Status):
            filtered = chain.update(Reading(time_s, "a", answer, None, None))
            assert filtered == Filtered(None, answer.value)
            continue
        filtered = chain.update(Reading(time_s, "a", Status.OK, answer / 100, STD_M, answer, suspect))
        assert (filtered.estimate is None) != (filtered.rejected is None)
        if filtered.estimate is not None:
            assert math.isfinite(filtered.estimate.range_m)
            assert 0 < filtered.estimate.variance_m2 < math.inf
            assert -10 < filtered.estimate.range_m < 20
