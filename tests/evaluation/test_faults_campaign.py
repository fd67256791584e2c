"""Flights with other values of the belief's constants, as ``--set`` gives them."""

import argparse

import pytest

from evaluation.faults.campaign import other_constants
from evaluation.faults.command import options
from msp_range.fusion import modes, odd, response
from msp_range.fusion.response import MotionResponse
from msp_range.fusion.vertical import VerticalMotion


def given(*values: str) -> dict[str, float]:
    parser = argparse.ArgumentParser(exit_on_error=False)
    options(parser)
    return dict(parser.parse_args(["--set", *values]).set)


def test_a_constant_has_its_other_value_wherever_it_is_used_and_its_own_again_afterwards() -> None:
    own = modes.ODD
    with other_constants(given("ODD=1e9")):
        assert modes.ODD == odd.ODD == 1e9
    assert modes.ODD == odd.ODD == own


def test_a_constant_of_the_start_is_that_of_the_flight() -> None:
    with other_constants(given("B_START_M_S2=3")):
        other = MotionResponse(VerticalMotion(), 0.4)
    assert response.B_START_M_S2 != 3.0
    assert other._covariance[5] == 9.0


def test_whole_numbers_stay_whole() -> None:
    assert repr(given("ABOVE_TURNS=4", "ODD=4")) == "{'ABOVE_TURNS': 4, 'ODD': 4.0}"


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ("ODDS=1", "found 'ODDS'; expected one of: ABOVE_CODES, "),
        ("ODD", "found 'ODD'; expected ODD=NUMBER, such as ODD=1e9"),
        ("ODD=many", "found 'ODD=many'; expected ODD=NUMBER"),
        ("ABOVE_TURNS=2.5", "found 'ABOVE_TURNS=2.5'; expected a whole number"),
    ],
)
def test_what_is_no_constant_or_no_number_is_refused(value: str, words: str) -> None:
    with pytest.raises(argparse.ArgumentError, match=words):
        given(value)
