"""PX4's own simulator (SIH) flies on what the bridge sends: EKF2 takes the height."""

import time
from pathlib import Path

import pytest

from tests.sitl.autopilot import running
from tests.sitl.figures import measure, note
from tests.sitl.ground_station import BRIDGE
from tests.sitl.kinds import needs_px4
from tests.sitl.msp_sim import msp_sim
from tests.sitl.px4 import Px4

pytestmark = [needs_px4, pytest.mark.real_time]


def test_ekf2_takes_the_height(tmp_path: Path) -> None:
    px4 = Px4(tmp_path)
    with running(px4), msp_sim(px4):
        px4.take_off()
        hovering_s = time.monotonic()
        px4.wait(10.0)
        hovered = measure(px4, hovering_s, time.monotonic())
        px4.land()
        note(px4, "take-off on command to 6 m, hover, landing", "uses it", hovered)
    assert hovered.median_m < 0.2
    assert hovered.p95_m < 0.5
    assert hovered.healthy > 0.9


def test_started_in_flight_msp_sim_sends_nothing_before_the_landing(tmp_path: Path) -> None:
    """PX4 takes off without a range finder, so it can be in flight before `msp-sim sitl` is."""
    px4 = Px4(tmp_path)
    with running(px4):
        px4.take_off()
        with msp_sim(px4) as simulation:
            simulation.wait_for("armed, so the height is not known")
            px4.wait(5.0)
            assert not px4.station.all("DISTANCE_SENSOR", BRIDGE)
            px4.land()
            px4.station.wait("distances", lambda: px4.station.all("DISTANCE_SENSOR", BRIDGE))
            px4.wait(2.0)
            landed_cm = [message.current_distance for _, message in px4.station.all("DISTANCE_SENSOR", BRIDGE)]
        note(px4, "msp-sim sitl started in hover", "receives nothing until it has landed")
    assert all(abs(distance_cm - 20) <= 5 for distance_cm in landed_cm)
