"""The ground of the standing course, and its judge on a flight that is known: no autopilot is needed for either."""

import math
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from msp_range.config import load_airframe
from msp_sim.flight.scenario import load_scenario
from msp_sim.sitl.sitl import EARTH_RADIUS_M
from tests.sitl.autopilot import STANDING_RANGE_M, Autopilot
from tests.sitl.course import (
    AIRFRAME,
    BOXES,
    EDGES,
    END_M,
    GRADE,
    HEIGHT_M,
    SLOPE_M,
    TREAD_M,
    Leg,
    Truth,
    followed,
    write_course,
)

CLEARANCE_M = 0.25
"""Height of loopback.yaml's reference point when it stands: its sensors are 0.05 m below, and read 0.20 m."""
PERIOD_S = 0.02
HIGH_M, HIGH_FROM_M = 0.2, (16.5, 24.0)
"""How much too high it flies, and from where to where: the section with the edge of 1.2 m."""
LOST_S, GAP_S = (20.0, 20.3), (48.0, 48.7)
"""Without its range finder, and without a distance; at 1 m/s these are metres north, too."""


BEAM_DEG = 12.0
"""A crate this far from the axis gives an echo from its corner, 3 m below [deg]; at 13 deg none does."""


def test_ground_has_its_edges_slope_and_boxes(tmp_path: Path) -> None:
    world = load_scenario(write_course(tmp_path)).world()
    for at_m, rise_m in EDGES:
        assert world.elevation_m(at_m + 0.01, 0.0) - world.elevation_m(at_m - 0.01, 0.0) == pytest.approx(rise_m)
    first_m, last_m = SLOPE_M
    for north_m in np.linspace(first_m, last_m, 50, endpoint=False):
        slope_m = 1.2 + GRADE * (north_m - first_m)
        assert world.elevation_m(north_m, 0.0) == pytest.approx(slope_m, abs=abs(GRADE) * TREAD_M + 1e-9)
    assert [world.elevation_m(north_m, 0.0) for north_m in (0.0, END_M)] == pytest.approx([0.0, 0.0], abs=1e-9)
    met = []
    for box in BOXES:
        (_, right_m), (_, width_m) = cast("list[list[float]]", [box["centre_m"], box["size_m"]])
        beside_m = [
            max(abs(sensor.position_m[1] - right_m) - width_m / 2, 0.0) for sensor in load_airframe(AIRFRAME).sensors
        ]
        down_m = HEIGHT_M - cast("float", box["height_m"])
        met.append([math.degrees(math.atan2(each_m, down_m)) < BEAM_DEG for each_m in beside_m])
    assert met == [[True] * 4, [False, True, False, True], [True, False, True, False]]


def test_judge_finds_what_a_flight_has(tmp_path: Path) -> None:
    autopilot = flown(tmp_path)
    truth = Truth(autopilot, tmp_path / "course.yaml")
    arrivals_s = [at_s for at_s in np.arange(0.0, END_M + 5.0, 0.1).tolist() if not GAP_S[0] < at_s < GAP_S[1] - 1e-6]
    sections = followed(autopilot, truth, arrivals_s, Leg(1.0, HEIGHT_M, 0.5, END_M))
    edges, boxes, all_of_it = sections["edge of 1.2 m"], sections["boxes of 0.5 and 0.8 m"], sections["all"]
    assert edges.rms_m == pytest.approx(HIGH_M, abs=0.01)
    assert boxes.rms_m == pytest.approx(0.0, abs=0.01)
    high = (HIGH_FROM_M[1] - HIGH_FROM_M[0]) / (END_M - 0.5)
    assert all_of_it.rms_m == pytest.approx(HIGH_M * math.sqrt(high), abs=0.01)
    assert edges.unhealthy_s == all_of_it.unhealthy_s == pytest.approx(LOST_S[1] - LOST_S[0], abs=0.051)
    assert boxes.unhealthy_s == 0.0
    assert boxes.gap_s == all_of_it.gap_s == pytest.approx(GAP_S[1] - GAP_S[0])
    assert edges.gap_s == pytest.approx(0.1)
    assert (edges.silences, boxes.silences, all_of_it.silences) == (0, 1, 1)


def test_judge_leaves_out_what_was_not_reached(tmp_path: Path) -> None:
    autopilot = flown(tmp_path)
    truth = Truth(autopilot, tmp_path / "course.yaml")
    sections = followed(autopilot, truth, [0.0, 0.1], Leg(1.0, HEIGHT_M, 0.5, 10.0))
    assert list(sections) == ["edges of 0.3 and 0.6 m", "all"]


def flown(folder: Path) -> Autopilot:
    """An autopilot that has flown the course at 1 m/s, exactly but for `HIGH_M` and `LOST_S`."""
    world = load_scenario(write_course(folder)).world()
    sender = mavlink.MAVLink(None, 1, 1)

    def sent(message: Any) -> Any:
        message.pack(sender)
        return message

    def messages() -> Iterator[tuple[float, Any]]:
        yield -2.0, sent(mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 0, 3))
        yield -1.0, sim_state(0.0, CLEARANCE_M)
        yield -1.0, sent(mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 0, 3))
        yield 0.0, sent(mavlink.MAVLink_heartbeat_message(2, 3, mavlink.MAV_MODE_FLAG_SAFETY_ARMED, 0, 0, 3))
        for time_s in np.arange(PERIOD_S, END_M + 1.0, PERIOD_S).tolist():
            extra_m = HIGH_M if HIGH_FROM_M[0] <= time_s < HIGH_FROM_M[1] else 0.0
            height_m = world.elevation_m(time_s, 0.0) + HEIGHT_M + CLEARANCE_M - STANDING_RANGE_M + extra_m
            yield time_s, sim_state(time_s, height_m)

    def sim_state(north_m: float, height_m: float) -> Any:
        fields: dict[str, float] = dict.fromkeys(mavlink.MAVLink_sim_state_message.fieldnames, 0.0)
        fields |= {"lat_int": round(1e7 * math.degrees(north_m / EARTH_RADIUS_M)), "lon_int": 0, "alt": height_m}
        return sent(mavlink.MAVLink_sim_state_message(**fields))

    healthy = [(at_s, not LOST_S[0] <= at_s < LOST_S[1]) for at_s in np.arange(-1.0, END_M + 1.0, 0.05).tolist()]
    station = SimpleNamespace(received=list(messages()))
    return cast(Autopilot, SimpleNamespace(station=station, standing_m=STANDING_RANGE_M, healthy=lambda: healthy))
