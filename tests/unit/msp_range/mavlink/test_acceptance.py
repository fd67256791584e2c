"""What the bridge makes of an autopilot's answers, which are frames of pymavlink's own dialect of ArduPilot."""

import math
from collections.abc import Callable
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega

from msp_range.mavlink.acceptance import LAG_S, MISSING_S, Acceptance, AcceptanceWatch
from msp_range.mavlink.dialect import dialect
from msp_range.mavlink.frames import FrameReader
from tests.support.mavlink_ends import Component

LASER = dialect.MAV_SYS_STATUS_SENSOR_LASER_POSITION
STEP_S = 0.1


def distance(range_m: float, orientation: int = 25, number: int = 0) -> Any:
    return ardupilotmega.MAVLink_distance_sensor_message(0, 19, 764, round(100 * range_m), 1, number, orientation, 0)


def status(present: int, health: int) -> Any:
    return ardupilotmega.MAVLink_sys_status_message(present, present, health, *[0] * 10)


def ekf(ratio: float) -> Any:
    return ardupilotmega.MAVLink_ekf_status_report_message(0, 0.1, 0.2, 0.3, 0.4, ratio)


def altitude(height_m: float, terrain_m: float = 0.0) -> Any:
    return ardupilotmega.MAVLink_altitude_message(0, 0, 0, 0, 0, terrain_m, height_m)


def estimator(ratio: float) -> Any:
    return ardupilotmega.MAVLink_estimator_status_message(0, 0, 0, 0, 0, 0, ratio, 0, 0, 0)


class Flight:
    """Distances at 10 Hz, and an autopilot that answers each fourth of them."""

    def __init__(self, autopilot: Any) -> None:
        self.watch, self.now_s = AcceptanceWatch(autopilot), 100.0
        self._reader, self._autopilot = FrameReader(), Component(dialect=ardupilotmega)

    def fly(
        self,
        duration_s: float,
        sent: Callable[[float], float] | float,
        *answers: Any,
        cos_lean: float = 1.0,
        made: Callable[[float], list[Any]] = lambda _: [],
    ) -> Acceptance:
        for step in range(round(duration_s / STEP_S)):
            self.now_s += STEP_S
            range_m = sent(self.now_s) if callable(sent) else sent
            if not math.isnan(range_m):
                self.watch.on_sent(self.now_s, distance(range_m), cos_lean)
            if step % 4 == 0:
                for message in [*answers, *made(self.now_s)]:
                    (frame,) = self._reader.read(self._autopilot.frame(message))
                    self.watch.on_message(self.now_s, frame.decode())
        return self.watch.now(self.now_s)


def test_an_offset_of_two_metres_is_said_within_two_seconds_and_then_that_the_terrain_was_set_anew() -> None:
    flight = Flight("px4")
    found = flight.fly(5.0, 5.0, altitude(5.02), estimator(0.05))
    assert (found.text, found.problem.text) == ("is 5.02 m above the ground, ratio 0.05", None)
    first_s = flight.now_s
    while flight.fly(STEP_S, 3.0, altitude(5.02), estimator(2.5)).problem.text is None:
        pass
    assert flight.now_s - first_s < 2.0
    found = flight.fly(3.0, 3.0, altitude(5.02), estimator(2.5))
    assert found.text == "is 5.02 m above the ground, ratio 2.50: 2.0 m off: rejected"
    assert found.problem.text == "Range: autopilot is 2.0 m off: rejected"
    assert found.off_m == pytest.approx(2.02, abs=1e-6)
    found = flight.fly(2.0, 3.0, altitude(3.01, terrain_m=2.01), estimator(0.1))
    assert found.text == "is 3.01 m above the ground, ratio 0.10: terrain reset by +2.0 m"
    assert found.problem.text is None
    assert "reset" not in flight.fly(10.0, 3.0, altitude(3.01, terrain_m=2.01), estimator(0.1)).text


def test_no_terrain_was_reset_where_the_distances_are_right_again_or_it_moved_while_they_were() -> None:
    flight = Flight("px4")
    flight.fly(2.0, 3.0, altitude(5.0, terrain_m=0.0))
    assert "reset" not in flight.fly(2.0, 5.0, altitude(5.0, terrain_m=0.0)).text
    assert "reset" not in flight.fly(2.0, 5.0, altitude(5.0, terrain_m=3.0)).text


def test_a_rejected_height_that_comes_and_goes_is_rejected_all_the_time_whatever_the_ratio() -> None:
    """As PX4 1.17 does it: by the vehicle's motion, with a ratio of 0.6."""
    flight = Flight("px4")
    flight.fly(2.0, 3.0, altitude(5.0), estimator(0.6))
    found = flight.fly(1.0, 3.0, altitude(math.nan), estimator(0.6))
    assert found.text == "is 5.00 m above the ground, ratio 0.60: 2.0 m off: rejected"
    assert "EKF2_RNG_CTRL" in flight.fly(3.0, 3.0, altitude(math.nan), distance(3.0)).text


@pytest.mark.parametrize("order", [1, -1])
def test_of_two_range_finders_the_first_one_that_looks_down_counts(order: int) -> None:
    forward, lidar, bridge = distance(7.0, orientation=0), distance(5.0, number=1), distance(3.0, number=2)
    found = Flight("ardupilot").fly(8.0, 3.0, *[forward, lidar, bridge][::order])
    assert found.text == "has 5.00 m, which is not what is sent"
    flight = Flight("ardupilot")
    flight.fly(2.0, 3.0, lidar)
    found = flight.fly(8.0, 3.0, bridge)  # the first one is gone
    assert found.text == "has 3.00 m; its estimator: not reported by this autopilot"


def test_distances_from_before_a_silence_are_compared_with_nothing() -> None:
    flight = Flight("px4")
    flight.fly(2.0, 1.0, altitude(1.0))
    flight.fly(3.0, math.nan, altitude(4.0))
    assert flight.fly(0.1, 4.0).problem.text is None


def test_a_climb_and_a_lean_are_no_offset() -> None:
    flight = Flight("px4")

    def late(now_s: float) -> list[Any]:
        return [altitude(2.0 + 2.0 * (now_s - 100.0 - 0.4)), estimator(0.1)]

    assert flight.fly(2.0, lambda now_s: 2.0 + 2.0 * (now_s - 100.0), made=late).problem.text is None
    assert Flight("px4").fly(3.0, 7.0, altitude(5.0), cos_lean=5.0 / 7.0).problem.text is None


def test_above_the_maximum_there_is_nothing_to_compare() -> None:
    found = Flight("px4").fly(3.0, 7.65, altitude(20.0))
    assert (found.problem.text, found.off_m) == (None, None)


def test_px4_without_range_in_its_estimator_and_without_any_answer() -> None:
    assert "EKF2_RNG_CTRL" in Flight("px4").fly(6.0, 3.0, distance(3.0), altitude(math.nan)).text
    assert Flight("px4").fly(6.0, 3.0).text == "reports nothing of the distances"
    assert Flight("px4").fly(6.0, math.nan, altitude(3.0)).text == "is sent nothing now"


@pytest.mark.parametrize(
    ("present", "parameter"), [(0, "RNGFND1_ORIENT 25"), (LASER, "RNGFND1_ADDR")], ids=["orientation", "id"]
)
def test_ardupilot_that_takes_no_distance_says_why(present: int, parameter: str) -> None:
    flight = Flight("ardupilot")
    assert flight.fly(MISSING_S - 0.5, 3.0, status(present, 0)).problem.text is None
    found = flight.fly(1.0, 3.0, status(present, 0), distance(9.0, orientation=0))
    assert found.problem.text == "Range: autopilot does not receive the distances"
    assert parameter in found.text
    assert parameter in found.problem.remedy


def test_what_ardupilot_does_not_report_is_not_made_up() -> None:
    found = Flight("ardupilot").fly(6.0, 3.0, distance(3.02), status(LASER, LASER), ekf(0.0))
    assert found.text == "has 3.02 m, healthy; its estimator: not reported by this autopilot"
    assert found.numbers == {"received_m": 3.02}
    assert Flight("ardupilot").fly(6.0, 3.0).text == "reports nothing of the distances"


def test_ardupilots_ratio_where_range_is_its_height() -> None:
    found = Flight("ardupilot").fly(6.0, 3.0, distance(3.0), status(LASER, LASER), ekf(0.25))
    assert found.text == "has 3.00 m, healthy; its estimator: ratio 0.25"
    found = Flight("ardupilot").fly(6.0, 3.0, distance(3.0), status(LASER, LASER), ekf(1.5))
    assert found.problem.text == "Range: autopilot rejects distances (ratio 1.5)"
    assert found.ratio == 1.5


def test_another_range_finder_is_found_also_where_it_answers_by_turns() -> None:
    flight = Flight("ardupilot")
    assert flight.fly(MISSING_S - 0.5, 3.0, distance(5.2)).problem.text is None
    assert flight.fly(1.0, 3.0, distance(5.2)).problem.text == "Range: autopilot has 5.20 m, not what is sent"
    assert flight.fly(1.0, 3.0, distance(3.05), distance(5.2)).problem.text is None


def test_a_pause_begins_anew_what_has_to_be_received() -> None:
    flight = Flight("ardupilot")
    flight.fly(6.0, 3.0, distance(3.0), status(LASER, LASER))
    flight.fly(LAG_S + 10.0, math.nan)
    assert flight.fly(1.0, 3.0, status(LASER, LASER)).problem.text is None
