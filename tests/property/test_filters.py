"""What holds for every filter: a shifted scene gives a shifted estimate, and it lies among the readings."""

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter

from msp_range.filters.chain import Chain, Filtered
from msp_range.filters.table import FilterParameters
from msp_range.reading import Reading, Status

STD_M = 0.0207
"""Of a reading: not round, or four of them would be whole centimetres, and rounding would decide at the gate."""
ADAPTER: TypeAdapter[Any] = TypeAdapter(FilterParameters)
CHAINS = [
    [],
    [{"filter": "moving_average", "window": 4}],
    [{"filter": "median", "window": 5}],
    [{"filter": "kalman", "model": "constant"}],
    [{"filter": "kalman"}],
    [{"filter": "median", "window": 3}, {"filter": "kalman"}],
]

steps_s = st.floats(0.03, 2.0)
ranges_cm = st.integers(20, 700)
flights = st.lists(st.tuples(steps_s, ranges_cm), min_size=1, max_size=30)


def run(filters: list[dict[str, Any]], flight: list[tuple[float, int]], offset_cm: int = 0) -> list[Filtered]:
    chain = Chain([ADAPTER.validate_python(each).make() for each in filters])
    time_s, out = 0.0, []
    for step_s, range_cm in flight:
        time_s += step_s
        out.append(chain.update(Reading(time_s, "a", Status.OK, (range_cm + offset_cm) / 100, STD_M)))
    return out


@pytest.mark.parametrize("filters", CHAINS, ids=lambda filters: "+".join(each["filter"] for each in filters) or "none")
# Without a deadline: the first Kalman filter imports filterpy.
@settings(deadline=None)
@given(flight=flights, offset_cm=st.integers(-15, 60))
def test_a_shifted_scene_gives_a_shifted_estimate(
    filters: list[dict[str, Any]], flight: list[tuple[float, int]], offset_cm: int
) -> None:
    for here, there in zip(run(filters, flight), run(filters, flight, offset_cm), strict=True):
        assert here.rejected == there.rejected
        if here.estimate is not None and there.estimate is not None:
            assert there.estimate.range_m - here.estimate.range_m == pytest.approx(offset_cm / 100, abs=1e-7)
            assert there.estimate.variance_m2 == pytest.approx(here.estimate.variance_m2, rel=1e-6)


@pytest.mark.parametrize("filters", CHAINS[:4], ids=lambda filters: "+".join(each["filter"] for each in filters) or "-")
# Without a deadline: the first Kalman filter imports filterpy.
@settings(deadline=None)
@given(flight=flights)
def test_an_estimate_lies_among_the_readings(filters: list[dict[str, Any]], flight: list[tuple[float, int]]) -> None:
    lowest_m, highest_m = (pick(range_cm for _, range_cm in flight) / 100 for pick in (min, max))
    for filtered in run(filters, flight):
        if filtered.estimate is not None:
            assert lowest_m - 1e-9 <= filtered.estimate.range_m <= highest_m + 1e-9
            assert 0 < filtered.estimate.variance_m2 <= STD_M**2 * (1 + 1e-9)
