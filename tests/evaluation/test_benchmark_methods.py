"""Methods of the benchmark find what is plain in a frozen table, and say it in the form that the scorer reads."""

from importlib.util import find_spec
from typing import Any

import pytest

from evaluation.benchmark.methods import METHODS, NEEDS, find

pytestmark = pytest.mark.slow
"""Tests of a benchmark's competitors."""

# Of ten standard errors: a quarter of the slant range; half of it and a thermometer's bias; and nothing.
TILTED, TWO, EMPTY = "t28", "t01", "t13"
NAMING = ["msp-lab gap, slices by its model", "BIC, stepwise", "PASTIS, stepwise"]


def names(found: dict[str, Any]) -> list[str]:
    return [each["name"] for each in found["effects"]]


@pytest.mark.parametrize("method", NAMING)
def test_effect_is_named_with_its_size_and_place(method: str) -> None:
    found = find(method, TILTED)
    (tilt,) = (each for each in found["effects"] if each["name"] == "slant_range")
    assert tilt["low"] < 0.231 < tilt["high"]
    assert tilt["high"] - tilt["low"] < 0.231
    assert "incidence_deg" in {each["column"] for each in found["where"]}
    assert found["seconds"] > 0.0


def test_nothing_is_found_where_nothing_is() -> None:
    for method in ("msp-lab gap", "PASTIS, stepwise"):
        found = find(method, EMPTY)
        assert (found["effects"], found["where"]) == ([], [])
    assert not find("KS of PIT by slice", EMPTY)["where"]


@pytest.mark.parametrize("method", list(NEEDS))
def test_methods_of_others(method: str) -> None:
    if not find_spec(NEEDS[method]):
        pytest.skip("the extra 'bench' is not installed")
    found = find(method, TWO)
    if "effects" in found:
        assert {"slant_range", "thermometer_offset"} <= set(names(found))
    else:
        assert {"channel": "bias", "column": "incidence_deg"} in found["unknown"]


def test_every_method_that_needs_a_package_is_one() -> None:
    assert NEEDS.keys() <= METHODS.keys()
