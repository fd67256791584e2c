"""What docs/sitl.md shows of ArduPilot's sim_vehicle.py and PX4's make, typed word by word, flies."""

import time
from pathlib import Path

import pytest

from tests.peers import mavproxy_env
from tests.sitl.arducopter import ARDUCOPTER
from tests.sitl.autopilot import Autopilot, running
from tests.sitl.figures import measure, note
from tests.sitl.kinds import needs_arducopter, needs_px4
from tests.sitl.msp_sim import msp_sim
from tests.sitl.px4 import PX4
from tests.sitl.shown import AUTOTEST, PX4_TREE, SIM_VEHICLE_AT, MadePx4, SimVehicle
from tests.sitl.test_ardupilot import wait_for_walls

pytestmark = pytest.mark.real_time
needs_sim_vehicle = pytest.mark.skipif(
    not (AUTOTEST / "sim_vehicle.py").exists() or not mavproxy_env.is_made(),
    reason=f"{ARDUCOPTER} is in no ArduPilot tree, or MAVProxy has no environment of its own (make mavproxy)",
)
needs_px4_tree = pytest.mark.skipif(not (PX4_TREE / "Makefile").exists(), reason=f"{PX4} is in no PX4 tree")


def flies(autopilot: Autopilot, what: str) -> None:
    """Take off, hover and land by what is typed, on the distances of the bridge."""
    with running(autopilot), msp_sim(autopilot):
        autopilot.take_off()
        hovering_s = time.monotonic()
        autopilot.wait(8.0)
        hovered = measure(autopilot, hovering_s, time.monotonic())
        autopilot.land()
        note(autopilot, what, "uses it", hovered)
    assert hovered.median_m < 0.2
    assert hovered.p95_m < 0.5
    assert hovered.healthy > 0.9


@needs_arducopter
@needs_sim_vehicle
def test_sim_vehicle(tmp_path: Path) -> None:
    flies(SimVehicle(tmp_path), "sim_vehicle.py, typed: take-off in GUIDED to 6 m, hover, landing")


@needs_arducopter
@needs_sim_vehicle
def test_sim_vehicle_between_walls(tmp_path: Path) -> None:
    copter = SimVehicle(tmp_path, "ArduPilot with proximity sensors", SIM_VEHICLE_AT)
    with running(copter), msp_sim(copter):
        wait_for_walls(copter)


@needs_px4
@needs_px4_tree
def test_make_px4(tmp_path: Path) -> None:
    flies(MadePx4(tmp_path), "make, typed: take-off to 6 m, hover, landing")
