"""`msp-sim sitl` as a real process, flown by a small autopilot that no part of msp_range or msp_sim is in.

The autopilot is a point mass with a socket: it sends the poses that it is asked for, flies to 6 m and lands, and for
two seconds of the hover sends no pose while it goes down. Two of them fly at the same time, one with a simulator's truth
and a wrong estimate, the other with an estimate only. Times are the autopilot's: a distance is compared with the height
that the autopilot had at the distance's own `time_boot_ms`.
"""

import bisect
import json
import math
import signal
import socket
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from msp_sim.sitl import POSE_STALE_S

CONFIGS = Path(__file__).parents[2] / "configs"
SYSTEM = 7
STANDING_RANGE_M = 0.20
"""What configs/loopback.yaml's fused stream reads on the ground: by default the sensors stand at their minimum."""
SPEED_M_S, ACCELERATION_M_S2 = 2.5, 2.5
"""Of the point mass, up and down: ArduCopter climbs at 2.5 m/s as it comes, and accelerates less."""
CLIMB_S, SILENT_S, HEARD_S, LANDED_S = 0.4, 4.4, 6.4, 9.2
"""Times after it has been asked for poses and has heard a distance: it leaves the ground, falls silent, sends poses again, ends."""
SILENCE_TARGET_M, TOP_M = 3.5, 6.0
RATE_HZ = 200.0


class PointMass:
    """A vehicle that goes to a height as fast as its speed and acceleration allow."""

    def __init__(self) -> None:
        self.height_m = 0.0
        self.climb_m_s = 0.0

    def step(self, target_m: float, dt_s: float) -> None:
        error_m = target_m - self.height_m
        wanted_m_s = math.copysign(min(math.sqrt(2 * ACCELERATION_M_S2 * abs(error_m)), SPEED_M_S), error_m)
        reach_m_s = ACCELERATION_M_S2 * dt_s
        self.climb_m_s += min(max(wanted_m_s - self.climb_m_s, -reach_m_s), reach_m_s)
        self.height_m = max(self.height_m + self.climb_m_s * dt_s, 0.0)


class FakeAutopilot(threading.Thread):
    """The other end of a UDP link, with a flight in it.

    Parameters
    ----------
    truth
        It is a simulator that tells its truth in SIM_STATE; its estimate is then made wrong.
    """

    def __init__(self, truth: bool) -> None:
        super().__init__(daemon=True)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(1 / RATE_HZ)
        self.port = self.socket.getsockname()[1]
        self.truth = truth
        self.asked_hz: dict[int, float] = {}
        self.sent_s: dict[int, float] = {}
        self.boot_s: list[float] = []
        self.height_m: list[float] = []
        self.distances: list[tuple[float, Any]] = []
        self.first_s: float | None = None
        self.ended = False
        self._mav = mavlink.MAVLink(None, srcSystem=SYSTEM, srcComponent=1)
        self._mav.robust_parsing = True
        self._switched_on_s = time.monotonic() - 300.0
        self._peer: tuple[str, int] | None = None
        self._mass = PointMass()

    def now_s(self) -> float:
        """Time since the autopilot's boot."""
        return time.monotonic() - self._switched_on_s

    def flight_s(self) -> float:
        """Time since it has been asked for poses and has heard a distance; before that 0."""
        return self.now_s() - self.first_s if self.first_s is not None else 0.0

    def run(self) -> None:
        last_s = self.now_s()
        with self.socket:
            while not self.ended:
                self._receive()
                now_s = self.now_s()
                self._mass.step(self._target_m(), now_s - last_s)
                last_s = now_s
                self.boot_s.append(now_s)
                self.height_m.append(self._mass.height_m)
                if self._peer is not None:
                    self._speak(now_s)

    def height_at(self, boot_s: float) -> float:
        """Its own height at a time of its own clock."""
        return float(np.interp(boot_s, self.boot_s, self.height_m))

    def is_silent(self) -> bool:
        return SILENT_S <= self.flight_s() < HEARD_S

    def _target_m(self) -> float:
        plan_m = (0.0, TOP_M, SILENCE_TARGET_M, 0.0)
        return plan_m[bisect.bisect((CLIMB_S, SILENT_S, HEARD_S), self.flight_s())]

    def _receive(self) -> None:
        try:
            datagram, self._peer = self.socket.recvfrom(2048)
        except TimeoutError:
            return
        for message in self._mav.parse_buffer(datagram) or ():
            kind = message.get_type()
            if kind == "TIMESYNC" and message.tc1 == 0:
                self._send(mavlink.MAVLink_timesync_message(round(self.now_s() * 1e9), message.ts1))
            elif kind == "COMMAND_LONG" and message.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
                self.asked_hz[int(message.param1)] = 1e6 / message.param2
            elif kind == "DISTANCE_SENSOR":
                self.distances.append((self.now_s(), message))
                if self.first_s is None and self.asked_hz:
                    self.first_s = self.now_s()

    def _speak(self, now_s: float) -> None:
        if self._is_due(mavlink.MAVLINK_MSG_ID_HEARTBEAT, 1.0):
            self._send(
                mavlink.MAVLink_heartbeat_message(
                    mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
                )
            )
        if self.is_silent():
            return
        boot_ms, height_m, climb_m_s = round(now_s * 1e3), self._mass.height_m, self._mass.climb_m_s
        if self.truth and self._is_asked(mavlink.MAVLINK_MSG_ID_SIM_STATE):
            # At 584 m above the sea, as ArduPilot's default place; only what the simulator uses is filled in.
            fields = dict.fromkeys(mavlink.MAVLink_sim_state_message.fieldnames, 0)
            fields |= {"alt": 584.0 + height_m, "vd": -climb_m_s, "lat_int": -353632610, "lon_int": 1491652300}
            self._send(mavlink.MAVLink_sim_state_message(**fields))
        if self._is_asked(mavlink.MAVLINK_MSG_ID_ATTITUDE):
            self._send(mavlink.MAVLink_attitude_message(boot_ms, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0))
        if self._is_asked(mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED):
            # An origin that is not where the vehicle stands; beside the truth, an estimate that is no good.
            height_m, climb_m_s = (2 * height_m, 2 * climb_m_s) if self.truth else (height_m, climb_m_s)
            self._send(
                mavlink.MAVLink_local_position_ned_message(boot_ms, 3.0, 4.0, -0.7 - height_m, 0.0, 0.0, -climb_m_s)
            )

    def _is_asked(self, message_id: int) -> bool:
        return message_id in self.asked_hz and self._is_due(message_id, self.asked_hz[message_id])

    def _is_due(self, message_id: int, rate_hz: float) -> bool:
        now_s = self.now_s()
        if now_s - self.sent_s.get(message_id, float("-inf")) < 1 / rate_hz:
            return False
        self.sent_s[message_id] = now_s
        return True

    def _send(self, message: Any) -> None:
        frame = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        self.socket.sendto(frame, self._peer)


@dataclass
class Flown:
    """What is left of one flight."""

    autopilot: FakeAutopilot
    exit_code: int
    printed: str
    summary: dict[str, Any]


@pytest.fixture(scope="module")
def flights(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Flown]:
    """Both flights, flown at the same time; one ends by SIGINT, the other by SIGTERM."""
    out = tmp_path_factory.mktemp("sitl")
    autopilots = {"truth": FakeAutopilot(truth=True), "estimate": FakeAutopilot(truth=False)}
    ends = {"truth": signal.SIGINT, "estimate": signal.SIGTERM}
    programs = {}
    try:
        for name, autopilot in autopilots.items():
            autopilot.start()
            link = f"udpout:127.0.0.1:{autopilot.port}"
            command = ["sitl", str(CONFIGS / "loopback.yaml"), "--link", link, "--seed", "3", "--out", str(out / name)]
            programs[name] = subprocess.Popen(
                [sys.executable, "-c", "from msp_sim.cli import main; main()", *command],
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
            )
        deadline_s = time.monotonic() + 40.0
        while min(autopilot.flight_s() for autopilot in autopilots.values()) < LANDED_S:
            assert all(program.poll() is None for program in programs.values())
            assert time.monotonic() < deadline_s
            time.sleep(0.05)
        flown = {}
        for name, program in programs.items():
            program.send_signal(ends[name])
        for name, program in programs.items():
            printed, _ = program.communicate(timeout=20.0)
            summary = json.loads((out / name / "summary.json").read_text())
            flown[name] = Flown(autopilots[name], program.returncode, printed, summary)
        return flown
    finally:
        for autopilot in autopilots.values():
            autopilot.ended = True
        for autopilot in autopilots.values():
            autopilot.join()
        for program in programs.values():
            if program.poll() is None:
                program.kill()
            program.communicate()


both = pytest.mark.parametrize("name", ["truth", "estimate"])


@both
@pytest.mark.real_time
def test_distances_follow_the_height(flights: dict[str, Flown], name: str) -> None:
    autopilot = flights[name].autopilot
    assert autopilot.first_s is not None
    errors_m = []
    heights_m = []
    for arrived_s, message in autopilot.distances:
        assert message.orientation == mavlink.MAV_SENSOR_ROTATION_PITCH_270
        assert (message.get_srcSystem(), message.get_srcComponent()) in ((SYSTEM, 191), (1, 191))
        silent = SILENT_S < arrived_s - autopilot.first_s < HEARD_S + 1.0
        if message.current_distance <= message.max_distance and not silent:
            height_m = autopilot.height_at(message.time_boot_ms / 1e3)
            heights_m.append(height_m)
            errors_m.append(abs(message.current_distance / 100 - STANDING_RANGE_M - height_m))
    assert max(heights_m) > TOP_M - 0.1
    print(np.median(errors_m), np.percentile(errors_m,95), np.max(errors_m))
    # The sensor model scatters by 1.9 cm, and the message has whole centimetres.
    assert np.median(errors_m) < 0.03
    # A speed is believed from the second reading of a sensor on, 0.4 s later, in which 2.5 m/s^2 make 0.2 m.
    assert np.percentile(errors_m, 95) < 0.2
    assert len(errors_m) > 5 * (SILENT_S + LANDED_S - HEARD_S - 1.0)


@both
@pytest.mark.real_time
def test_no_distance_is_made_up_when_no_poses_come(flights: dict[str, Flown], name: str) -> None:
    autopilot = flights[name].autopilot
    assert autopilot.first_s is not None
    arrived_s = np.array([each - autopilot.first_s for each, _ in autopilot.distances])
    # After the last pose has become stale, fused readings of before may speak for one window (0.65 s) more.
    assert not ((arrived_s > SILENT_S + POSE_STALE_S + 0.75) & (arrived_s < HEARD_S)).any()
    assert ((arrived_s > SILENT_S - 0.5) & (arrived_s < SILENT_S)).any()
    assert (arrived_s > HEARD_S).any()
    assert "no answer" in flights[name].printed


@both
@pytest.mark.real_time
def test_it_asks_for_poses_and_ends_cleanly(flights: dict[str, Flown], name: str) -> None:
    flown = flights[name]
    for message in ("SIM_STATE", "ATTITUDE", "LOCAL_POSITION_NED"):
        assert 20.0 <= flown.autopilot.asked_hz[getattr(mavlink, f"MAVLINK_MSG_ID_{message}")] <= 50.0
    assert flown.exit_code == 0, flown.printed
    assert "Traceback" not in flown.printed
    source = "SIM_STATE" if name == "truth" else "LOCAL_POSITION_NED"
    assert flown.summary["poses"][source] > 100
    assert f"poses in {source}" in flown.printed
    assert set(flown.summary["sensors"]) == {"front_left", "front_right", "rear_left", "rear_right"}
    assert flown.summary["link"]["sent"]["DISTANCE_SENSOR"]["messages"] == len(flown.autopilot.distances)
    print(flown.summary["fused"])
    assert flown.summary["fused"]["error"]["count"] > 40
