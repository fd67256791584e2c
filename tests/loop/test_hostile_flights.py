"""Flights of the campaign's hostile families that showed what a rule of the fusion is for."""

import pytest

from evaluation.faults.campaign import fly_plan
from evaluation.faults.plans import draw_plan


@pytest.mark.parametrize(
    ("seed", "index", "most_wrong_s", "most_silent_s"),
    [
        pytest.param(501, 1_000_204, 0.0, 0.0, id="a landing that bounces is not silent"),
        pytest.param(501, 1_000_156, 0.0, 0.5, id="an edge below three sensors of four"),
        pytest.param(501, 1_000_460, 2.0, None, id="what did not answer on one surface may be another one now"),
        pytest.param(501, 1_000_550, 0.0, None, id="two of four sensors see a strap that was the ground"),
        pytest.param(501, 1_000_040, 1.7, None, id="a strap from which the vehicle seems to climb away"),
        pytest.param(812, 1_000_390, 5.0, None, id="a strap that the ground was nearer than before the take-off"),
        pytest.param(812, 1_000_240, 5.0, None, id="near parts of the vehicle below one sensor after another"),
        pytest.param(501, 1_000_273, 1.0, None, id="dust in which surfaces of chance were the ground"),
        pytest.param(818, 1_000_003, 0.5, None, id="one constant where an outlier has been before"),
        pytest.param(818, 1_000_020, 2.0, None, id="a strap that was in doubt and stuck, and answers anew"),
        pytest.param(818, 1_000_443, 1.0, None, id="the constant of two sensors that the other two have, too"),
        pytest.param(818, 1_000_170, 3.0, 30.0, id="eight sensors see the ground again after a strap is gone"),
        pytest.param(818, 1_000_379, 4.0, None, id="two sensors that drift alike are no slope of 80 %"),
        pytest.param(819, 1_000_206, 0.0, 0.5, id="an edge where answers have seemed late, undecided"),
        pytest.param(819, 1_000_928, 0.0, 0.5, id="a single outlier in a climb makes nothing late"),
        pytest.param(819, 1_000_480, 1.0, None, id="a payload takes the place of a near ground, which is no slope"),
        pytest.param(819, 1_001_110, 0.5, None, id="a payload that swings takes the place of a ground that is left"),
        pytest.param(820, 1_001_004, 0.0, 0.0, id="a take-off from a slope"),
        pytest.param(820, 1_000_074, 0.0, 0.0, id="a take-off with eight slow sensors, and an outlier"),
        pytest.param(820, 1_000_349, 2.0, None, id="two sensors that drift are no slope of 90 %, however it answers"),
        pytest.param(822, 1_001_014, 0.0, 2.0, id="a landing that bounces, below one slow sensor"),
        pytest.param(821, 1_000_270, 0.0, None, id="a strap below a vehicle that climbs fast between two readings"),
        pytest.param(821, 1_000_444, 2.0, 0.5, id="a landing that bounces so hard that the accelerometer leads away"),
        pytest.param(824, 1_000_483, 0.0, None, id="one constant of all, as far as the ground could be, in a hover"),
        pytest.param(824, 1_000_963, 0.0, None, id="one constant of two sensors, as likely as a step"),
        pytest.param(825, 1_000_129, 1.0, None, id="an outlier of one sensor at a height that two others are wrong by"),
        pytest.param(827, 1_000_770, 0.0, None, id="eight slow sensors see a strap, and the barometer a climb"),
        pytest.param(827, 1_000_366, 0.0, 0.5, id="a step where a hover's noise has left a little doubt"),
        pytest.param(825, 1_000_744, 0.0, 0.5, id="a landed vehicle whose barometer rises"),
        pytest.param(821, 1_000_557, 0.0, 1.0, id="the ground next to a box that more than half have met for a moment"),
        pytest.param(1, 445, 0.0, None, id="a ground that more sensors find again than see the wrong one"),
        pytest.param(1, 497, 0.0, 1.0, id="an outlier in a hover that follows the motion and not what is fixed"),
        pytest.param(94, 216, 0.0, 1.0, id="one sensor after a fast descent is neither higher nor lower than others"),
        pytest.param(51, 266, 0.0, 1.0, id="a noisy reading where a late one would be"),
        pytest.param(501, 1_000_173, 8.0, None, id="late answers over a hover between two movements"),
    ],
)
def test_a_hostile_flight(seed: int, index: int, most_wrong_s: float, most_silent_s: float | None) -> None:
    flown = fly_plan(draw_plan(seed, index))
    verdict = flown["verdict"]
    assert flown["crashed"] is None
    # Later there may be silence, with parts of the vehicle below all sensors.
    assert verdict["valid_s"] > 0.5
    assert sum(event.for_s for event in verdict["wrong"]) <= most_wrong_s
    if most_silent_s is not None:
        assert sum(event.for_s for event in verdict["silences"]) <= most_silent_s


@pytest.mark.parametrize(
    ("seed", "index"),
    [
        pytest.param(815, 1_000_173, id="late answers are reported as soon as nothing is sent"),
        pytest.param(822, 1_000_173, id="late answers are reported as soon if the flight before them was long"),
        pytest.param(827, 1_000_333, id="late answers on a new surface that the sensors have seen before it was known"),
    ],
)
def test_what_is_wrong_is_reported_in_time(seed: int, index: int) -> None:
    verdict = fly_plan(draw_plan(seed, index))["verdict"]
    assert verdict["wrong"]
    assert all(event.reported for event in verdict["wrong"])


def test_where_half_of_the_sensors_see_what_does_not_follow_the_motion_a_text_says_so() -> None:
    """One of two, with a strap at another height below the other."""
    warnings = fly_plan(draw_plan(820, 1_000_150))["verdict"]["warnings"]
    assert any("do not follow the motion" in warning for warning in warnings if float(warning.split()[0]) < 7.0)


def test_where_nothing_is_sent_and_sensors_have_no_echo_outliers_do_not_disagree() -> None:
    """A vehicle above the maximum that leans: the silence is reported, and is all that there is to say."""
    warnings = fly_plan(draw_plan(827, 1_000_125))["verdict"]["warnings"]
    assert {warning.split(": ", 1)[1] for warning in warnings} == {"Range: no distance to the ground"}
