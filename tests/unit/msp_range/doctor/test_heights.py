"""Heights of return and mission against the range's maximum, asked of an autopilot that pymavlink plays."""

from typing import Any

import pytest

from msp_range.clock import SystemClock
from msp_range.config import load_airframe
from msp_range.doctor.finding import Finding
from msp_range.doctor.heights import check_before_flight
from msp_range.mavlink.distance_sensor import Autopilot
from msp_range.mavlink.transport import open_transport
from tests.support.far_ends import by_udp
from tests.support.parameter_autopilot import RANGE_FINDER, ParameterAutopilot

COPTER = RANGE_FINDER | {"RTL_ALT_M": 15.0, "RTL_ALT_TYPE": 0.0, "WP_RFND_USE": 1.0, "EK3_SRC1_POSZ": 1.0}
PX4 = {"EKF2_RNG_CTRL": 2.0, "EKF2_HGT_REF": 1.0, "EKF2_MIN_RNG": 0.2, "EKF2_RNG_POS_Z": 0.05}
PX4 |= {"RTL_RETURN_ALT": 60.0, "RTL_DESCEND_ALT": 30.0, "MIS_TAKEOFF_ALT": 2.5}
HOME, TERRAIN, SEA = 6, 11, 5
WAYPOINT, JUMP = 16, 177
RETURN, GLOBAL, LOCAL = 20, 0, 1
MISSION = [(SEA, WAYPOINT, 584.0), (HOME, WAYPOINT, 5.0), (TERRAIN, WAYPOINT, 20.0), (HOME, JUMP, 99.0)]
MISSION += [(GLOBAL, RETURN, 0.0)]


def asked(
    values: dict[str, float], end_s: float = 4.0, expects: Autopilot | None = None, **options: Any
) -> dict[str, Finding]:
    """What is found, by step."""
    expects = expects or ("px4" if options.get("px4") else "ardupilot")
    airframe = load_airframe("quad_pallet").changed(autopilot=expects)
    clock = SystemClock()
    with by_udp(lambda url: ParameterAutopilot(url, values, **options)) as url:
        transport = open_transport(url, clock)
        found = list(check_before_flight(airframe, transport, clock, clock.now() + end_s))
        transport.close()
    return {each.step: each for each in found}


@pytest.mark.parametrize(
    ("changes", "mission", "verdict", "words", "remedy"),
    [
        ({}, [], "right", "RTL_ALT_M 15 m: above 7.65 m distances read 'above the maximum', and the auto", None),
        ({"RTL_ALT_M": 5.0}, [], "right", "RTL_ALT_M 5 m: within the range's maximum of 7.65 m", None),
        ({"RTL_ALT_TYPE": 1.0}, [], "wrong", "RTL_ALT_M 15 m: above the range's", "RTL_ALT_TYPE 0 (above home)"),
        ({"RTL_ALT_TYPE": 1.0, "WP_RFND_USE": 0.0}, [], "right", "does not rely on them there", None),
        ({"EK3_SRC1_POSZ": 2.0}, [], "wrong", "the autopilot relies on it there", "EK3_SRC1_POSZ 1"),
        ({}, MISSION, "wrong", "mission item 2 above the terrain 20 m: above", "WP_RFND_USE 0"),
        (
            {"WP_RFND_USE": 0.0, "RTL_ALT_M": 5.0},
            MISSION,
            "right",
            "mission item 2 above the terrain 20 m: above 7",
            None,
        ),
    ],
)
def test_a_height_above_the_maximum_is_wrong_only_where_the_autopilot_relies_on_the_range(
    changes: dict[str, float], mission: list[tuple[int, int, float]], verdict: str, words: str, remedy: str | None
) -> None:
    found = asked(COPTER | changes, mission=mission)
    heights = found["heights"]
    assert (heights.verdict, words in heights.text) == (verdict, True), heights
    assert remedy is None or remedy in (heights.remedy or "")
    assert found["parameters"].verdict == "right"
    assert "mission" not in found  # all of it was read, home above sea level is not of it


def test_a_return_height_before_4_7_is_in_centimetres_and_a_mission_that_is_not_read_is_named() -> None:
    values = {name: value for name, value in COPTER.items() if name not in ("RTL_ALT_M", "WP_RFND_USE")}
    found = asked(values | {"RTL_ALT": 1500.0, "WPNAV_RFND_USE": 1.0, "RTL_ALT_TYPE": 1.0})
    assert "RTL_ALT 15 m: above the range's maximum" in found["heights"].text
    assert (found["mission"].verdict, found["mission"].text[:8]) == ("unknown", "not read")


@pytest.mark.parametrize(("reference", "verdict"), [(1.0, "right"), (2.0, "wrong")])
def test_px4(reference: float, verdict: str) -> None:
    mission = [(3, 22, 12.0), (SEA, WAYPOINT, 600.0)]
    found = asked(PX4 | {"EKF2_HGT_REF": reference}, px4=True, mission=mission)
    assert found["heights"].verdict == verdict
    above = "RTL_RETURN_ALT 60 m, RTL_DESCEND_ALT 30 m, mission item 0 12 m: above"
    assert found["heights"].text.startswith(above)
    assert found["mission"].text == "waypoints above sea level are not compared: 1"


@pytest.mark.parametrize("name", ["RTL_ALT_M", "EK3_SRC1_POSZ", "WP_RFND_USE"])
def test_without_an_answer_for_one_parameter_heights_are_unknown(name: str) -> None:
    found = asked({other: value for other, value in COPTER.items() if other != name}, mission=[])["heights"]
    assert (found.verdict, found.text) == ("unknown", f"the autopilot did not answer for {name}")
    values = {other: value for other, value in COPTER.items() if other != name} | {"EK3_SRC1_POSZ": 2.0}
    if name == "WP_RFND_USE":  # what is wrong is so whatever else is not known
        assert asked(values, mission=[])["heights"].verdict == "wrong"


def test_a_return_at_the_present_height_is_at_any_height() -> None:
    found = asked(COPTER | {"RTL_ALT_M": 0.0}, mission=[])["heights"]
    assert (found.verdict, found.text[:30]) == ("unknown", "with RTL_ALT_M 0 m the vehicle")


def test_waypoints_in_frames_of_their_own_are_named() -> None:
    found = asked(PX4, px4=True, mission=[(LOCAL, WAYPOINT, 3.0)])
    assert found["mission"].text == "waypoints in frames of their own are not compared: 1"


def test_of_an_autopilot_of_another_kind_nothing_else_is_asked() -> None:
    found = asked(PX4, expects="ardupilot", px4=True)
    assert [each.verdict for each in found.values()] == ["wrong"], found


def test_what_there_is_no_time_for_is_not_called_wrong() -> None:
    assert asked(COPTER, end_s=0.0)["autopilot"].verdict == "unknown"
    found = asked(COPTER, end_s=0.6, version=None, mission=[])
    assert found["mission"].text == "not read: no time was left"
    assert {step: each.verdict for step, each in found.items() if each.verdict != "right"} == {
        "parameters": "unknown",
        "mission": "unknown",
    }
