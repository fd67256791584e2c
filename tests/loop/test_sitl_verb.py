"""`msp-sim sitl` as a real process, flown by a small autopilot that no part of msp_range or msp_sim is in.

The autopilot is a point mass with a socket: it sends the poses that it is asked for, flies to 6 m and lands, and for
two seconds of the hover sends no pose while it goes down. Three of them fly at the same time: one with a simulator's
truth and a wrong estimate, one with an estimate only, and one that is in flight already when `msp-sim sitl` starts.
Times are the autopilot's: a distance is compared with the height that the autopilot had at the distance's own
`time_boot_ms`.
"""

import bisect
import json
import math
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from msp_range.config import load_airframe
from msp_range.recording.reader import Recording
from msp_range.yaml_file import ConfigError
from msp_sim.flight.flight_log import SensorTrack
from msp_sim.sitl.flying import load_scene
from msp_sim.sitl.sitl import POSE_STALE_S, AutopilotVehicle, status_line
from tests.support.known import known
from tests.support.shipped import CONFIGS
from tests.support.waiting import LIMIT_S, until

SYSTEM = 7
STANDING_RANGE_M = 0.20
"""What configs/loopback.yaml's fused stream reads on the ground: by default the sensors stand at their minimum."""
SPEED_M_S, ACCELERATION_M_S2 = 2.5, 2.5
"""Of the point mass, up and down: ArduCopter climbs at 2.5 m/s by default, and accelerates less."""
CLIMB_S, SILENT_S, HEARD_S, LANDED_S = 0.3, 4.2, 6.2, 8.8
"""Times of the flight: it leaves the ground, falls silent, sends poses again, has landed [s]."""
SILENCE_TARGET_M, TOP_M = 3.5, 6.0
RATE_HZ = 200.0
FLIGHTS, HOVER_DISTANCES = 3, 3
"""So many distances in the hover show its error; on a busy computer it is flown so often."""
SILENT_SENSOR = f"""
name: silent
airframe: {CONFIGS / "loopback.yaml"}
duration_s: 600
flight: {{altitude: [{{kind: climb, to_m: 1.0}}, {{kind: land}}]}}
faults: [{{sensor: rear_left, kind: silent, from_s: 0, to_s: 600}}]
"""
"""A scenario for `--ground`."""


def heartbeat(base_mode: int) -> Any:
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, base_mode, 0, mavlink.MAV_STATE_ACTIVE, 3
    )


DISARMED, ARMED = heartbeat(0), heartbeat(mavlink.MAV_MODE_FLAG_SAFETY_ARMED)


def sim_state(alt_m: float, **fields: float) -> Any:
    values = dict.fromkeys(mavlink.MAVLink_sim_state_message.fieldnames, 0) | {"alt": alt_m} | fields
    return mavlink.MAVLink_sim_state_message(**values)


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
    """The other end of a UDP link, with a flight in it; it is armed from shortly before the climb to the landing.

    Parameters
    ----------
    truth
        It is a simulator that sends its truth in SIM_STATE; its estimate is then made wrong.
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
        """Time since it has been asked for every pose and has received a distance; before that 0."""
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

    def is_armed(self) -> bool:
        return CLIMB_S / 2 <= self.flight_s() < LANDED_S

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
                if self.first_s is None and mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED in self.asked_hz:
                    self.first_s = self.now_s()

    def _speak(self, now_s: float) -> None:
        if self._is_due(mavlink.MAVLINK_MSG_ID_HEARTBEAT, 1.0):
            self._send(ARMED if self.is_armed() else DISARMED)
        if self.is_silent():
            return
        boot_ms, height_m, climb_m_s = round(now_s * 1e3), self._mass.height_m, self._mass.climb_m_s
        if self.truth and self._is_asked(mavlink.MAVLINK_MSG_ID_SIM_STATE):
            # At 584 m above the sea, as ArduPilot's default place; only what the simulator uses is filled in.
            self._send(sim_state(584.0 + height_m, vd=-climb_m_s, lat_int=-353632610, lon_int=1491652300))
        if self._is_asked(mavlink.MAVLINK_MSG_ID_ATTITUDE):
            self._send(mavlink.MAVLink_attitude_message(boot_ms, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0))
        if self._is_asked(mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED):
            # An origin that is not where the vehicle stands; next to the truth, an estimate that is no good.
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
        self.socket.sendto(frame, known(self._peer))


class InFlight(FakeAutopilot):
    """One that hovers at `TOP_M` when it is first connected to, descends after `STAYS_S`, and is then disarmed."""

    STAYS_S = 4.0

    def __init__(self) -> None:
        super().__init__(truth=True)
        self.disarmed_s = math.inf
        self._mass.height_m = TOP_M

    def flight_s(self) -> float:
        if self.first_s is None and self._peer is not None:
            self.first_s = self.now_s()
        return self.now_s() - self.first_s if self.first_s is not None else 0.0

    def is_armed(self) -> bool:
        if self.flight_s() > self.STAYS_S and self._mass.height_m == 0.0:
            self.disarmed_s = min(self.disarmed_s, self.now_s())
        return self.disarmed_s == math.inf

    def is_silent(self) -> bool:
        return False

    def _target_m(self) -> float:
        return TOP_M if self.flight_s() < self.STAYS_S else 0.0


@dataclass
class Flown:
    """What is left of one flight."""

    autopilot: FakeAutopilot
    exit_code: int
    printed: str


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("sitl")


@pytest.fixture(scope="module")
def flights(out: Path) -> dict[str, Flown]:
    """All flights; again where the computer gave a bridge no processor for all of the hover: that shows nothing."""
    for _ in range(FLIGHTS):
        flown = fly_all(out)
        measured = [heights_climbs_errors(flown[name].autopilot) for name in BOTH]
        if all(is_hover(*each).sum() >= HOVER_DISTANCES and each[0].max() > TOP_M - 0.1 for each in measured):
            break
    return flown


def fly_all(out: Path) -> dict[str, Flown]:
    """All flights at the same time; one ends by SIGINT, the others by SIGTERM."""
    autopilots = {"truth": FakeAutopilot(truth=True), "estimate": FakeAutopilot(truth=False), "in flight": InFlight()}
    scenario = out / "silent.yaml"
    scenario.write_text(SILENT_SENSOR)
    options = {
        "truth": ["--out", str(out), "--record", str(out), "--force"],
        "estimate": [],
        "in flight": ["--ground", str(scenario)],
    }
    ends = {"truth": signal.SIGINT, "estimate": signal.SIGTERM, "in flight": signal.SIGTERM}
    programs = {}
    try:
        for name, autopilot in autopilots.items():
            autopilot.start()
            link = f"udpout:127.0.0.1:{autopilot.port}"
            command = ["sitl", str(CONFIGS / "loopback.yaml"), "--link", link, "--seed", "3", *options[name]]
            programs[name] = subprocess.Popen(
                [sys.executable, "-c", "from msp_sim.cli import main; main()", *command],
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
            )

        def have_landed() -> bool:
            for program in programs.values():
                assert program.poll() is None, program.communicate()
            return all(autopilot.flight_s() >= LANDED_S for autopilot in autopilots.values())

        until(have_landed, 2 * LIMIT_S, seen=lambda: [autopilot.flight_s() for autopilot in autopilots.values()])
        for name, program in programs.items():
            program.send_signal(ends[name])
        printed = {name: program.communicate(timeout=LIMIT_S)[0] for name, program in programs.items()}
        return {name: Flown(autopilots[name], programs[name].returncode, printed[name]) for name in autopilots}
    finally:
        for autopilot in autopilots.values():
            autopilot.ended = True
        for autopilot in autopilots.values():
            if autopilot.is_alive():
                autopilot.join()
        for program in programs.values():
            if program.poll() is None:
                program.kill()
                program.communicate()


BOTH = ("truth", "estimate")
both = pytest.mark.parametrize("name", BOTH)


def in_real_time(test: Callable[..., None]) -> Callable[..., None]:
    """A test of the flights, which take a while."""
    slow: Callable[..., None] = pytest.mark.slow(pytest.mark.real_time(test))
    return slow


def heights_climbs_errors(autopilot: FakeAutopilot) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of each distance that was to come: the true height [m], the climb [m/s] and the error [m]."""
    assert autopilot.first_s is not None
    rows = []
    for arrived_s, message in autopilot.distances:
        silent = SILENT_S < arrived_s - autopilot.first_s < HEARD_S + 1.0
        if message.current_distance <= message.max_distance and not silent:
            boot_s = message.time_boot_ms / 1e3
            height_m = autopilot.height_at(boot_s)
            climb_m_s = (autopilot.height_at(boot_s + 0.05) - autopilot.height_at(boot_s - 0.05)) / 0.1
            rows.append((height_m, climb_m_s, message.current_distance / 100 - STANDING_RANGE_M - height_m))
    heights_m, climbs_m_s, errors_m = np.array(rows).reshape(-1, 3).T
    return heights_m, climbs_m_s, errors_m


def is_hover(heights_m: np.ndarray, climbs_m_s: np.ndarray, errors_m: np.ndarray) -> np.ndarray:
    """Of which distances the vehicle was in the air and neither climbed nor sank."""
    return (heights_m > 0.3) & (abs(climbs_m_s) < 0.2)


@both
@in_real_time
def test_distances_follow_the_height(flights: dict[str, Flown], name: str) -> None:
    autopilot = flights[name].autopilot
    for _, message in autopilot.distances:
        assert message.orientation == mavlink.MAV_SENSOR_ROTATION_PITCH_270
        assert (message.get_srcSystem(), message.get_srcComponent()) in ((SYSTEM, 191), (1, 191))
    heights_m, climbs_m_s, errors_m = heights_climbs_errors(autopilot)
    assert heights_m.max() > TOP_M - 0.1
    # The sensor model scatters by 1.9 cm, so a fused distance by 1 cm, and the few of the hover are fused from some of
    # the same readings: four standard deviations. On the ground it stands at 20 cm.
    assert abs(np.median(errors_m[is_hover(heights_m, climbs_m_s, errors_m)])) < 0.04
    # On the way up it is late by some 14 ms, as the filter is; of a busy computer a pose may come late too.
    assert abs(np.median(errors_m[climbs_m_s > 0.5 * SPEED_M_S])) < 0.05 * SPEED_M_S
    # A speed is believed from the second reading of a sensor on, 0.4 s later, in which 2.5 m/s^2 make 0.2 m.
    assert np.percentile(abs(errors_m), 95) < 0.2
    assert len(errors_m) > 5 * (SILENT_S + LANDED_S - HEARD_S - 1.0)


@both
@in_real_time
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
@in_real_time
def test_it_asks_for_poses_and_ends_cleanly(flights: dict[str, Flown], name: str) -> None:
    flown = flights[name]
    for message in ("SIM_STATE", "ATTITUDE", "LOCAL_POSITION_NED"):
        assert 20.0 <= flown.autopilot.asked_hz[getattr(mavlink, f"MAVLINK_MSG_ID_{message}")] <= 50.0
    assert flown.exit_code == 0, flown.printed
    assert "Traceback" not in flown.printed
    source = "SIM_STATE" if name == "truth" else "LOCAL_POSITION_NED"
    assert f"poses in {source}" in flown.printed
    assert re.findall(r"DISTANCE_SENSOR +(\d+)", flown.printed)[0] == str(len(flown.autopilot.distances))


@in_real_time
def test_started_in_flight_no_distance_goes_out_until_it_has_landed(flights: dict[str, Flown]) -> None:
    flown = flights["in flight"]
    autopilot = flown.autopilot
    assert isinstance(autopilot, InFlight)
    assert "armed, so the height is not known" in flown.printed
    assert min(arrived_s for arrived_s, _ in autopilot.distances) > autopilot.disarmed_s
    assert {round(message.current_distance, -1) for _, message in autopilot.distances} == {20}


@in_real_time
def test_faults_of_the_scenario_are_flown(flights: dict[str, Flown]) -> None:
    printed = flights["in flight"].printed
    for name in ("front_left", "front_right", "rear_right"):
        assert f"Range {name}: good again" in printed
    assert "Range rear_left: no answer" in printed
    assert "Range rear_left: good again" not in printed


def test_a_fault_of_a_sensor_that_the_airframe_does_not_have_is_refused(tmp_path: Path) -> None:
    scenario = tmp_path / "silent.yaml"
    scenario.write_text(SILENT_SENSOR)
    quad = CONFIGS / "proximity.yaml"
    with pytest.raises(ConfigError, match=r"silent.yaml: faults: found sensor 'rear_left'; expected one of .*front"):
        load_scene(scenario, None, load_airframe(quad), quad)


def test_the_status_line_has_what_a_sensor_that_is_only_fused_reads() -> None:
    good = SensorTrack([0.9], [2.0], [2.01], [None], [None], [None])
    missed = SensorTrack([0.9], [2.0], [None], [None], ["no_echo"], [None])
    single = SensorTrack([0.9], [2.0], [2.01], [1.98], [None], [None])
    flight = SimpleNamespace(fused=good, tracks={"good": good, "missed": missed, "single": single})
    vehicle = SimpleNamespace(age_s=lambda now_s: None)
    sitl: Any = SimpleNamespace(now_s=lambda: 9.0, vehicle=vehicle, flight=flight, is_autopilot_connected=lambda: True)
    assert status_line(sitl).endswith("fused -, good 2.01 m, missed no_echo, single 1.98 m")


@in_real_time
def test_it_leaves_a_summary_a_picture_and_a_recording(flights: dict[str, Flown], out: Path) -> None:
    summary = json.loads((out / "summary.json").read_text())
    # 25 poses a second but in the silence.
    assert summary["poses"]["SIM_STATE"] > 20 * (LANDED_S - HEARD_S + SILENT_S)
    assert set(summary["sensors"]) == {"front_left", "front_right", "rear_left", "rear_right"}
    # What the program takes for true is what its autopilot knows: the ground is flat, and the same error is left.
    assert summary["fused"]["over_edges"] == 0
    assert summary["fused"]["error"]["count"] > 40
    assert (out / "flight.png").read_bytes().startswith(b"\x89PNG")
    recording, *_ = out.glob("*.mcap")
    topics = {message.topic for message in Recording(recording)}
    assert {"/truth/front_left", "/fused", "/mavlink/sent"} <= topics


def flat(north_m: float, east_m: float) -> float:
    return 0.0


def receive(vehicle: AutopilotVehicle, time_s: float, *messages: Any) -> None:
    """Let messages arrive at a time."""
    for message in messages:
        vehicle.on_message(time_s, message)


def local_position(z_m: float, vz_m_s: float = 0.0) -> Any:
    return mavlink.MAVLink_local_position_ned_message(0, 0.0, 0.0, z_m, 0.0, 0.0, vz_m_s)


LEVEL = mavlink.MAVLink_attitude_message(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def test_a_pose_moves_on_with_its_speed_but_not_into_the_ground() -> None:
    vehicle = AutopilotVehicle(flat, 0.25)
    receive(vehicle, 1.0, LEVEL, local_position(-0.7))
    assert vehicle.pose(1.0).position_ned_m[2] == pytest.approx(-0.25)
    vehicle.on_message(2.0, local_position(-2.7, vz_m_s=4.0))
    assert vehicle.pose(2.1).position_ned_m[2] == pytest.approx(-1.85)
    assert vehicle.pose(1.95).position_ned_m[2] == pytest.approx(-2.45)
    assert vehicle.pose(2.9).position_ned_m[2] == -0.25


def test_where_the_vehicle_is_is_known_from_fresh_poses_after_it_was_disarmed() -> None:
    vehicle = AutopilotVehicle(flat, 0.25)
    assert not vehicle.is_known(100.0), "no autopilot yet: it may be in flight"
    vehicle.on_message(100.0, DISARMED)
    assert vehicle.is_known(100.0), "a disarmed vehicle stands on the ground, wherever that is"
    vehicle.on_message(100.0, ARMED)
    assert not vehicle.is_known(100.0)
    vehicle.on_message(100.0, local_position(0.0))
    assert vehicle.source is None, "a position without an attitude is no pose"
    receive(vehicle, 100.0, LEVEL, local_position(0.0))
    assert not vehicle.is_known(100.0), "armed before its first pose: it may have climbed meanwhile"
    receive(vehicle, 100.0, DISARMED, ARMED)
    assert vehicle.is_known(100.0 + POSE_STALE_S)
    vehicle.on_message(101.1, local_position(0.0))
    assert not vehicle.is_known(101.1), "an old attitude is no pose either"


def test_a_vehicle_that_was_never_received_disarmed_has_no_known_height() -> None:
    vehicle = AutopilotVehicle(flat, 0.25)
    receive(vehicle, 0.0, ARMED, sim_state(590.0))
    assert not vehicle.is_known(0.0)
    receive(vehicle, 9.0, sim_state(584.0), DISARMED)
    receive(vehicle, 9.1, ARMED, sim_state(585.0))
    assert vehicle.is_known(9.1)
    assert vehicle.pose(9.1).position_ned_m[2] == pytest.approx(-1.25)


def test_a_disarmed_vehicle_stands_on_the_ground_whatever_its_estimate_does() -> None:
    """PX4's EKF2 may reset its height before the simulator's truth comes."""
    vehicle = AutopilotVehicle(lambda north_m, east_m: 0.1 * north_m, 0.25)
    receive(vehicle, 0.0, DISARMED, LEVEL, local_position(0.0))
    vehicle.on_message(0.5, local_position(-1.3))
    vehicle.on_message(0.6, sim_state(584.0))
    vehicle.on_message(1.0, DISARMED)
    assert vehicle.pose(1.0).position_ned_m == pytest.approx((0.0, 0.0, -0.25))
    receive(vehicle, 2.0, ARMED, sim_state(590.0))
    assert vehicle.pose(2.0).position_ned_m[2] == pytest.approx(-6.25)


def test_truth_goes_on_where_the_estimate_was_and_then_counts_alone() -> None:
    vehicle = AutopilotVehicle(flat, 0.25)
    receive(vehicle, 0.0, LEVEL, local_position(5.0))
    receive(vehicle, 0.1, local_position(3.0), sim_state(584.0))
    assert vehicle.pose(0.1).position_ned_m[2] == pytest.approx(-2.25)
    vehicle.on_message(0.2, local_position(-9.0))
    assert vehicle.source == "SIM_STATE"
    vehicle.on_message(0.3, sim_state(585.0, vn=2.0, pitch=0.1))
    pose = vehicle.pose(0.4)
    assert pose.position_ned_m == pytest.approx((0.2, 0.0, -3.25))
    assert (pose.roll_rad, pose.pitch_rad, pose.yaw_rad) == (0.0, 0.1, 0.0)


def test_degrees_become_metres_from_the_start() -> None:
    vehicle = AutopilotVehicle(flat, 0.0, start_m=(10.0, 20.0))
    vehicle.on_message(0.0, sim_state(584.0, lat_int=600_000_000, lon_int=100_000_000))
    vehicle.on_message(0.1, sim_state(584.0, lat_int=600_000_100, lon_int=100_000_100))
    north_m, east_m, _ = vehicle.pose(0.1).position_ned_m
    # A minute of latitude is a nautical mile, and half as much of longitude at 60 deg; the radius differs by 0.1 %.
    assert north_m - 10.0 == pytest.approx(1852 * 60 * 1e-5, rel=2e-3)
    assert east_m - 20.0 == pytest.approx(1852 * 60 * 1e-5 / 2, rel=2e-3)


def test_px4_sends_its_truth_as_a_quaternion() -> None:
    def state(latitude_1e7: int, altitude_mm: int) -> Any:
        # The nose points east.
        quaternion = (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))
        velocity_cm_s = (100, -200, -300)
        return mavlink.MAVLink_hil_state_quaternion_message(
            0, quaternion, 0, 0, 0, latitude_1e7, 0, altitude_mm, *velocity_cm_s, 0, 0, 0, 0, 0
        )

    vehicle = AutopilotVehicle(flat, 0.2)
    vehicle.on_message(0.0, state(0, 0))
    assert vehicle.source is None
    vehicle.on_message(0.0, state(473977420, 489_400))
    vehicle.on_message(1.0, state(473977420, 495_400))
    pose = vehicle.pose(1.1)
    assert vehicle.source == "HIL_STATE_QUATERNION"
    assert pose.position_ned_m == pytest.approx((0.1, -0.2, -6.5))
    assert pose.velocity_ned_m_s == (1.0, -2.0, -3.0)
    assert (pose.roll_rad, pose.pitch_rad, pose.yaw_rad) == pytest.approx((0.0, 0.0, math.pi / 2))
