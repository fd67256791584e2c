"""Either side of the link is killed and comes back: `msp-range run` in hover, the autopilot on the ground."""

import signal
import time
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from tests.sitl.arducopter import ArduCopter
from tests.sitl.autopilot import TOP_M, Autopilot, running
from tests.sitl.figures import measure, note
from tests.sitl.ground_station import BRIDGE
from tests.sitl.kinds import both, needs_arducopter
from tests.sitl.service import Service, outage_s, running_service

pytestmark = pytest.mark.real_time

TERRAIN_FAILSAFE_S = 1.4
"""ArduCopter 4.7 returns home when it flies a take-off or target above the terrain and has had no distance for 1.45 s:
0.5 s until the range finder says 'no data' and 1 s until the last range is stale (mode_guided.cpp, takeoff_run;
AP_SurfaceDistance.cpp)."""
BACK_S = 3.0
"""Distances of a running bridge come back this soon after the autopilot's first heartbeat [s]."""


@both
def test_the_bridge_is_killed_in_hover(kind: type[Autopilot], tmp_path: Path) -> None:
    autopilot = kind(tmp_path)
    with running(autopilot):
        autopilot.get_ready()
        with running_service(autopilot) as service:
            autopilot.take_off()
            killed_s = service.kill_and_restart()
            silent_s = outage_s(autopilot, killed_s)
            autopilot.wait(8.0)
            assert autopilot.flies_as_commanded(), (silent_s, autopilot.texts(killed_s))
            flown = measure(autopilot, killed_s, time.monotonic())
            autopilot.land()
            note(
                autopilot,
                "bridge killed by SIGKILL in hover, started as systemd does",
                "flight continues",
                flown,
                silent_s,
            )
    assert silent_s < TERRAIN_FAILSAFE_S
    assert flown.p95_m < 0.5


@needs_arducopter
def test_how_long_arducopter_flies_without_distances(tmp_path: Path) -> None:
    """The bridge is stopped and goes on, so that an outage lasts as long as it should."""
    copter = ArduCopter(tmp_path)
    with running(copter):
        copter.get_ready()
        with running_service(copter) as service:
            copter.take_off()
            flies_on(copter, service, 1.0, "hovers after a take-off in GUIDED")
            copter.go_to(TOP_M, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT)
            copter.wait(2.0)
            flies_on(copter, service, 6.0, "hovers at a target above home")
            copter.go_to(TOP_M - 1.0)
            copter.wait_for_hover(TOP_M - 1.0)
            paused_s = service.pause(2.0)
            silent_s = outage_s(copter, paused_s)
            assert copter.mode() == ArduCopter.RTL
            failed_s = [time_s for time_s, each in copter.station.all("STATUSTEXT") if "Failsafe" in each.text]
            after_s = failed_s[0] - paused_s
            note(
                copter,
                "in hover at a target above the terrain",
                f"terrain failsafe after {after_s:.2f} s",
                None,
                silent_s,
            )
            assert after_s > TERRAIN_FAILSAFE_S - 0.1
            copter.land()


def flies_on(copter: ArduCopter, service: Service, duration_s: float, what: str) -> None:
    """The bridge stops for a while, and the copter flies on."""
    paused_s = service.pause(duration_s)
    silent_s = outage_s(copter, paused_s)
    copter.wait(2.0)
    assert copter.flies_as_commanded(), copter.texts(paused_s)
    note(copter, what, "flight continues", None, silent_s)


@both
def test_the_autopilot_is_killed_and_starts_anew(kind: type[Autopilot], tmp_path: Path) -> None:
    autopilot = kind(tmp_path)
    with running(autopilot), running_service(autopilot) as service:
        autopilot.station.wait("distances", lambda: autopilot.station.all("DISTANCE_SENSOR", BRIDGE))
        autopilot.end(signal.SIGKILL)
        autopilot.start()
        note(autopilot, "autopilot killed and restarted", "receives distances again", None, back_s(autopilot))
        assert service.is_running


@needs_arducopter
def test_the_autopilot_reboots(tmp_path: Path) -> None:
    copter = ArduCopter(tmp_path)
    with running(copter), running_service(copter) as service:
        copter.station.wait("distances", lambda: copter.station.all("DISTANCE_SENSOR", BRIDGE))
        copter.station.command(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1)
        copter.wait(2.0)
        copter.connect()
        note(copter, "autopilot reboots by command", "receives distances again", None, back_s(copter))
        assert service.is_running


def back_s(autopilot: Autopilot) -> float:
    """Time from a new autopilot's first heartbeat to the first distance, 0 where that was sooner [s]."""
    began_s = autopilot.station.all("HEARTBEAT")[0][0]
    distances = autopilot.station.wait("distances", lambda: autopilot.station.all("DISTANCE_SENSOR", BRIDGE))
    assert distances[0][0] - began_s < BACK_S
    return max(distances[0][0] - began_s, 0.0)
