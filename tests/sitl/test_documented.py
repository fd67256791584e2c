"""Other documents state the same parameters as docs/sitl.md, with which the tests here fly."""

import re

import pytest

from tests.sitl import documented

FLOWN = documented.parameters("ArduPilot") | documented.parameters("PX4 (SIH)")


@pytest.mark.parametrize("path", ["docs/flying.md", "configs/quad_pallet.yaml", "configs/canted_pallet.yaml"])
def test_other_documents_state_the_parameters_that_are_flown(path: str) -> None:
    text = (documented.ROOT / path).read_text(encoding="utf-8")
    stated = re.findall(r"\b([A-Z0-9]+_[A-Z0-9_]+)`? (-?[0-9.]*[0-9])", text)
    compared = [(name, value) for name, value in stated if name in FLOWN]
    assert len(compared) >= 3
    for name, value in compared:
        assert float(value) == float(FLOWN[name]), name


def test_the_vehicle_looks_north_in_the_proximity_yard() -> None:
    assert documented.home("ArduPilot with proximity sensors").split(",")[3] == "0"
