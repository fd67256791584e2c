"""PX4's own simulator (SIH) flies on what the bridge tells it: EKF2 takes the height.

Set MSP_RANGE_PX4 to a PX4 SITL build folder (build/px4_sitl_default) or to the `bin/px4` in it; without it this test
skips. It is unverified against a real binary: what it relies on was read in PX4's sources, which the comments name. It
uses PX4's fixed ports, UDP 14550 for the ground station and 14540 for the bridge.
"""

import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from tests.sitl.ground_station import GroundStation, bridge_in_sitl, connected_udp, errors, program

NAMED = os.environ.get("MSP_RANGE_PX4", "")
pytestmark = [
    pytest.mark.skipif(not NAMED, reason="set MSP_RANGE_PX4 to a PX4 SITL build folder"),
    pytest.mark.real_time,
]

TOP_M = 6.0
STANDING_CLEARANCE_M = 0.25
"""How high the body stands above the ground: 0.20 m under the sensors, which are 0.05 m below it (loopback.yaml)."""
PARAMETERS = {
    # params_range_finder.yaml, params_terrain.yaml and module.yaml of modules/ekf2
    "EKF2_RNG_CTRL": 2,
    "EKF2_MIN_RNG": 0.2,
    "EKF2_RNG_POS_Z": 0.05,
    "EKF2_RNG_DELAY": 35,
    # sih_params.yaml: beyond 10000 the simulator's own range finder is off.
    "SIH_DISTSNSR_OVR": 10001,
    "MIS_TAKEOFF_ALT": TOP_M,
    # Nobody has a stick.
    "COM_RC_IN_MODE": 4,
    "NAV_DLL_ACT": 0,
}
NAN = math.nan


@contextmanager
def px4(folder: Path) -> Iterator[GroundStation]:
    """A running PX4 with a ground station.

    `px4 -d BUILD/etc -w FOLDER` (platforms/posix/src/px4/common/main.cpp); the start script sets the parameters that
    the environment names PX4_PARAM_... and starts MAVLink to the ports 14550 and 14540 (init.d-posix/rcS and
    px4-rc.mavlink).
    """
    binary = Path(NAMED) if Path(NAMED).is_file() else Path(NAMED) / "bin" / "px4"
    build = binary.resolve().parents[1]
    environment = os.environ | {"PX4_SIM_MODEL": "sihsim_quadx"}
    environment |= {f"PX4_PARAM_{name}": str(value) for name, value in PARAMETERS.items()}
    command = [str(build / "bin" / "px4"), "-d", str(build / "etc"), "-w", str(folder)]
    with program(command, folder / "px4.log", cwd=folder, env=environment):
        station = GroundStation(connected_udp(14550, 30.0))
        try:
            station.wait("a heartbeat of PX4", lambda: station.all("HEARTBEAT"), 30.0)
            yield station
        finally:
            station.close()


def test_ekf2_takes_the_height(tmp_path: Path) -> None:
    with px4(tmp_path) as station:
        for name in ("HIL_STATE_QUATERNION", "ALTITUDE", "ESTIMATOR_STATUS"):
            station.ask(name, 20.0)

        def heights() -> list[tuple[float, float]]:
            states = station.all("HIL_STATE_QUATERNION")
            return [(time_s, (state.alt - states[0][1].alt) / 1e3) for time_s, state in states if state.lat]

        station.wait("HIL_STATE_QUATERNION", heights, 10.0)
        with bridge_in_sitl("loopback.yaml", "udpin:127.0.0.1:14540", tmp_path / "msp-sim.log"):
            station.command_until_accepted("arming", 90.0, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
            takeoff = (NAN, 0, 0, NAN, NAN, NAN, NAN)
            station.command_until_accepted("take-off", 5.0, mavlink.MAV_CMD_NAV_TAKEOFF, *takeoff)
            station.wait("the climb", lambda: heights()[-1][1] > TOP_M - 1.0, 40.0)
            hovering_s = station.heard[-1][0] + 5.0
            station.wait("the hover", lambda: station.heard[-1][0] > hovering_s + 10.0, 20.0)
            left_s = station.heard[-1][0]
            station.command_until_accepted("landing", 5.0, mavlink.MAV_CMD_NAV_LAND, 0, 0, 0, NAN, NAN, NAN, NAN)
            station.wait("disarmed after landing", lambda: not station.is_armed(), 60.0)

    # Not a number until EKF2 has a terrain estimate (streams/ALTITUDE.hpp).
    clearances = [(time_s, each.bottom_clearance) for time_s, each in station.all("ALTITUDE")]
    hovered = [each for each in clearances if hovering_s <= each[0] <= left_s]
    known = [each for each in hovered if math.isfinite(each[1])]
    assert len(known) > 0.9 * len(hovered)
    truth = [(time_s, height_m + STANDING_CLEARANCE_M) for time_s, height_m in heights()]
    error_m = errors(known, truth, hovering_s, left_s)
    assert np.median(error_m) < 0.2
    assert np.percentile(error_m, 95) < 0.5
    above_ground = [
        bool(status.flags & mavlink.ESTIMATOR_POS_VERT_AGL)
        for time_s, status in station.all("ESTIMATOR_STATUS")
        if hovering_s <= time_s <= left_s
    ]
    assert np.mean(above_ground) > 0.9
