"""The LIDAR-Lite v3: its transfers, its faults through the whole bridge, and its address."""

import errno
import math
from pathlib import Path

import pytest
from numpy.random import SeedSequence
from pymavlink.dialects.v20 import common

from msp_range.clock import VirtualClock
from msp_range.reading import Status
from msp_range.recording.pings import read_recorded
from msp_range.recording.replay_bus import ReplayBus
from msp_range.recording.writer import Recorder
from msp_range.replay import RecordedFlight
from msp_range.sensors.addressing import change_address, check_new_address, scan
from msp_range.sensors.base import AddressError, FoundDevice
from msp_range.sensors.lidar_lite_v3 import LidarLiteV3
from msp_range.sensors.polling import Poller, Ranging
from msp_range.sensors.schedule import AnswerTiming, PolledSensor, RoundRobin
from msp_sim.device.bus import EmulatedBus
from msp_sim.device.device import Fault
from msp_sim.device.emulated import Surroundings, emulated_bus
from msp_sim.device.lidar_lite_v3 import EmulatedLidarLiteV3
from msp_sim.device.mb1242 import EmulatedMB1242
from msp_sim.flight.flight import Simulation
from msp_sim.flight.scenario import load_scenario
from msp_sim.world.surfaces import Box, GroundSection
from msp_sim.world.vehicle import Pose
from msp_sim.world.world import AirSection, MountedBeam, Ping, World
from tests.support.bench import Bench, airframe, assert_reported, sensor
from tests.support.plain_device import PlainDevice
from tests.support.scripted_bus import Expected, read, scripted_bus, write
from tests.support.shipped import CONFIGS

ADDRESS, OTHER = 0x62, 0x64
MODEL = {"model": "sensors/lidar_lite_v3.yaml"}
MEASURE = bytes([0x00, 0x04])
FROM_S, TO_S, END_S = 5.0, 8.0, 12.0


def status(value: int) -> list[Expected]:
    return [write(ADDRESS, b"\x01"), read(ADDRESS, bytes([value]))]


def distance(answer: bytes) -> list[Expected]:
    return [write(ADDRESS, b"\x8f"), read(ADDRESS, answer)]


def poll(*script: Expected) -> Ranging:
    """What one ranging of a sensor on a scripted bus comes to; the first look is 20 ms after the ping."""
    clock = VirtualClock()
    with scripted_bus(clock, *script) as bus:
        polled = PolledSensor("down", LidarLiteV3(bus, ADDRESS), AnswerTiming(0.020, 0.030, 6.67e-9))
        poller = Poller(bus, clock, RoundRobin([[polled]], 0.1, clock.now()))
        while clock.now() < 0.09:
            for ranging in poller.step():
                return ranging
            clock.sleep_until(poller.next_event_s)
    raise AssertionError("no ranging ended")


def test_it_is_asked_until_it_is_not_busy_and_then_for_its_distance() -> None:
    script = [write(ADDRESS, MEASURE, at_s=0.0), *status(0x21), *status(0x20), *distance(b"\x0b\xb8")]
    ranging = poll(*script)
    reading = ranging.reading
    assert (reading.status, reading.range_m, reading.raw) == (Status.OK, 30.0, 3000)
    assert ranging.answered_s == pytest.approx(0.023)
    assert reading.time_s == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("register", "answer", "expected", "raw"),
    [
        (0x28, b"\x00\x01", Status.NO_ECHO, 4000),
        (0x20, b"\x0f\xa0", Status.NO_ECHO, 4000),
        (0x20, b"\x12\x34", Status.NO_ECHO, 0x1234),
        (0x20, b"\x00\x00", Status.IMPOSSIBLE, 0),
        (0x20, b"\x00\x04", Status.IMPOSSIBLE, 4),
        (0x20, b"\x00\x05", Status.OK, 5),
        (0x20, b"\xff\xff", Status.IMPOSSIBLE, 0xFFFF),
        (0x60, b"\x01\x02", Status.IMPOSSIBLE, 0x8102),
        (0x00, b"\x01\x02", Status.IMPOSSIBLE, 0x8102),
    ],
)
def test_what_status_and_distance_mean(register: int, answer: bytes, expected: Status, raw: int) -> None:
    reading = poll(write(ADDRESS, MEASURE), *status(register), *distance(answer)).reading
    assert (reading.status, reading.raw) == (expected, raw)


def test_one_that_stays_busy_gives_no_answer() -> None:
    ranging = poll(write(ADDRESS, MEASURE), *[each for _ in range(5) for each in status(0x21)])
    assert ranging.reading.status is Status.NO_ANSWER
    assert ranging.error is not None
    assert ranging.error.errno == errno.EBUSY


# --- through the whole bridge ---


def one_down(**changed: object) -> dict[str, object]:
    return sensor("a", 1) | MODEL | {"address": ADDRESS} | changed


def lidar(*faults: Fault, reading_cm: int = 2000, **changed: object) -> Bench:
    """One that looks down from 20 m, and its own stream, in air that would matter to sound."""
    vehicle = airframe([one_down()], send={"sensors": ["a"]}, filters=[], temperature={"fixed_c": -20.0}, **changed)
    return Bench(vehicle, reading_cm, faults={"a": faults})


def test_a_message_is_of_a_laser_and_the_air_does_not_matter() -> None:
    bench = lidar().fly(3.0)
    message = bench.sent()[-1].message
    assert message.current_distance == 2000
    assert message.type == common.MAV_DISTANCE_SENSOR_LASER
    assert message.horizontal_fov == pytest.approx(0.008, rel=1e-3)
    # 2.5 cm, and 0.5 cm for each of 20 m: 106 cm^2; 12 C that are not known would be 40 cm alone.
    assert message.covariance == math.ceil(2.5**2 + 10.0**2 + 1 / 12)
    assert bench.reported() == ["Range: all 1 sensors good"]


FAULTS = [
    ("silent", {}, "no_answer", "no answer (errno 121)"),
    ("impossible", {"word": 0xFFFF}, "impossible", "impossible answers"),
    ("impossible", {"word": 0}, "impossible", "impossible answers"),
]


@pytest.mark.parametrize(("kind", "more", "reason", "text"), FAULTS)
def test_a_fault_is_silence_and_is_reported(kind: str, more: dict[str, int], reason: str, text: str) -> None:
    bench = lidar(Fault(kind, FROM_S, TO_S, **more)).fly(END_S)
    assert set(bench.distances_cm(1)) == {2000}
    assert bench.distances_cm(1, FROM_S + 0.1, TO_S) == []
    assert_reported(bench, FROM_S, TO_S, text, reason)


def test_no_signal_is_above_the_maximum_and_no_fault() -> None:
    bench = lidar(Fault("no_echo", FROM_S, TO_S)).fly(END_S)
    assert set(bench.distances_cm(1, FROM_S + 0.1, TO_S)) == {4001}
    assert bench.reported(FROM_S) == []


def test_a_missed_read_costs_nothing_but_time() -> None:
    bench = lidar(Fault("missed_read", 0.0, END_S)).fly(END_S)
    assert {step.ranging.reading.status for step in bench.steps} == {Status.OK}


def test_power_that_goes_while_it_measures_gives_no_distance() -> None:
    ping_s = lidar().fly(6.0).pings[50][0]
    bench = lidar(Fault("power_cycle", ping_s + 0.005, ping_s + 0.005)).fly(END_S)
    statuses = [step.ranging.reading.status for step in bench.steps]
    assert (statuses.count(Status.IMPOSSIBLE), statuses.count(Status.OK)) == (1, len(statuses) - 1)


FOUR = [sensor(name, number) | MODEL | {"address": 0x60 + 2 * number} for number, name in enumerate("abcd", start=1)]


@pytest.mark.parametrize("kind", ["lost_high_byte", "or_ed", "offset", "noisy"])
def test_one_of_four_that_is_garbled_does_not_move_the_height(kind: str) -> None:
    bench = Bench(airframe(FOUR), 1500, faults={"c": [Fault(kind, FROM_S, TO_S)]}).fly(END_S)
    assert bench.distances_cm(from_s=FROM_S, to_s=TO_S)
    assert all(abs(distance_cm - 1500) <= 10 for distance_cm in bench.distances_cm())


def test_one_of_four_that_is_stuck_is_found_in_a_climb() -> None:
    def climb(name: str, time_s: float) -> int:
        return 1000 + round(100 * min(max(time_s - FROM_S, 0.0), END_S))

    bench = Bench(airframe(FOUR), climb, faults={"d": [Fault("stuck", FROM_S, END_S)]}).fly(END_S)
    assert "Range d: stuck" in " ".join(bench.reported())
    last_s, message = bench.sent()[-1]
    assert message.current_distance == pytest.approx(climb("", last_s), abs=15)


# --- its address ---


def wires(*devices: tuple[int, int]) -> tuple[EmulatedBus, VirtualClock, list[EmulatedLidarLiteV3]]:
    """Sensors by address and serial number."""
    clock = VirtualClock(10.0)
    sensors = [EmulatedLidarLiteV3(address, clock.now, lambda ping_s: 258) for address, _ in devices]
    for each, (_, serial) in zip(sensors, devices, strict=True):
        each.serial = serial
    return EmulatedBus(sensors, clock.now), clock, sensors


def test_a_sensor_moves_until_its_power_is_switched_off() -> None:
    bus, clock, (first, other) = wires((ADDRESS, 0x3080), (0x66, 0x1234))
    assert change_address(bus, clock, ADDRESS, OTHER, LidarLiteV3) == FoundDevice(OTHER, True, "LIDAR-Lite v3: 258 cm")
    assert (first.address, first.also_at, other.address) == (OTHER, None, 0x66)
    assert change_address(bus, clock, OTHER, 0x68, LidarLiteV3).address == 0x68
    first.power_cycle()
    assert first.address == ADDRESS
    assert not LidarLiteV3.keeps_address


def test_two_sensors_at_one_address_stay_there() -> None:
    bus, clock, sensors = wires((ADDRESS, 0x3081), (ADDRESS, 0x1234))
    with pytest.raises(AddressError, match="still answers at 0x62, and nothing is at 0x64: were two sensors"):
        change_address(bus, clock, ADDRESS, OTHER, LidarLiteV3)
    assert [each.address for each in sensors] == [ADDRESS, ADDRESS]


@pytest.mark.parametrize(
    ("devices", "old", "new", "message"),
    [
        ([(ADDRESS, 1)], ADDRESS, 0x65, "a LIDAR-Lite v3 ignores the address 0x65"),
        ([(OTHER, 1)], OTHER, ADDRESS, "switch its power off and on"),
        ([(ADDRESS, 1), (OTHER, 2)], ADDRESS, OTHER, "0x64 is in use"),
        ([], ADDRESS, OTHER, "nothing acknowledges at 0x62"),
    ],
)
def test_a_change_that_is_refused(devices: list[tuple[int, int]], old: int, new: int, message: str) -> None:
    bus, clock, sensors = wires(*devices)
    with pytest.raises(AddressError, match=message):
        change_address(bus, clock, old, new, LidarLiteV3)
    assert [(each.address, each.serial) for each in sensors] == devices


def test_a_scan_asks_for_one_where_one_should_be() -> None:
    clock = VirtualClock(10.0)
    lidar, sonar = (
        EmulatedLidarLiteV3(ADDRESS, clock.now, lambda _: 4000),
        EmulatedMB1242(0x70, clock.now, lambda _: 258),
    )
    bus = EmulatedBus([lidar, sonar, PlainDevice(0x44)], clock.now)
    found = {each.address: each for each in scan(bus, clock, identify=True)}
    assert {address: each.ranged for address, each in found.items()} == {0x44: False, ADDRESS: True, 0x70: True}
    assert (found[ADDRESS].answer, found[0x70].answer) == ("LIDAR-Lite v3: no signal", "MB1242: 258 cm")


@pytest.mark.parametrize(
    ("answer", "words"), [(b"\x00\x00", "is not busy after the command"), (b"\x21\x21", "stays busy")]
)
def test_another_device_is_no_lidar(answer: bytes, words: str) -> None:
    clock = VirtualClock()
    bus = EmulatedBus([PlainDevice(ADDRESS, answer)], clock.now)
    found = LidarLiteV3.identify(bus, clock, ADDRESS)
    assert (found.ranged, words in found.answer, "SCD4x" in found.answer) == (False, True, True)


def test_an_airframe_with_an_odd_address_is_refused() -> None:
    with pytest.raises(ValueError, match="a LIDAR-Lite v3 cannot have the address 0x65"):
        airframe([one_down(address=0x65)])
    check_new_address(0x66, LidarLiteV3)


# --- in the simulator, and again ---


def test_a_ray_meets_the_spot_that_it_points_at_and_no_edge_beside_it() -> None:
    box = Box(centre_m=(0.5, 0.0), size_m=(0.6, 0.6), height_m=1.0)
    world = World(GroundSection(boxes=(box,)), AirSection())
    level = Pose(0.0, (0.0, 0.0, -5.0), 0.0, 0.0, 0.0, (0.0, 0.0, 0.0))
    down, slanting = (0.0, 0.0, 1.0), (-math.sin(1.0), 0.0, math.cos(1.0))
    by_light = world.ping(level, MountedBeam((0.0, 0.0, 0.0), down, None))
    by_sound = world.ping(level, MountedBeam((0.0, 0.0, 0.0), down, lambda range_m: math.radians(12.0)))
    assert (by_light.has_echo, by_light.slant_range_cm) == pytest.approx((True, 500.0))
    assert (by_sound.has_echo, by_sound.true_range_cm) == pytest.approx((True, 100 * math.hypot(4.0, 0.2)))
    aslant = world.ping(level, MountedBeam((0.0, 0.0, 0.0), slanting, None))
    assert (aslant.has_echo, aslant.slant_range_cm) == pytest.approx((True, 500.0 / math.cos(1.0)))


def test_an_emulated_flight_of_light_is_one_of_rays() -> None:
    scenario = load_scenario(CONFIGS / "scenarios" / "lidar.yaml")
    pings: list[Ping] = []
    bus = emulated_bus(
        scenario.airframe,
        {"down": scenario.airframe.sensors[0].sensor_model},
        Surroundings(
            World(GroundSection(slope_deg=10.0), AirSection()),
            lambda time_s: Pose(time_s, (0.0, 0.0, -10.0), 0.0, 0.0, 0.0, (0.0, 0.0, 0.0)),
            lambda name, time_s, ping, extra: pings.append(ping),
        ),
        lambda: 0.0,
        SeedSequence(1),
        {},
    )
    bus.write(ADDRESS, MEASURE)
    # Sound in so narrow a beam would get no echo from a slope of 10 degrees.
    assert [ping.has_echo for ping in pings] == [True]


def test_it_flies_higher_than_sound_and_a_replay_has_the_same_answers(tmp_path: Path) -> None:
    scenario = load_scenario(CONFIGS / "scenarios" / "lidar.yaml")
    clock = VirtualClock()
    path = tmp_path / "flight.mcap"
    recorder = Recorder(path, clock)
    simulation = Simulation(scenario, clock, 1, recorder=recorder)
    first = [step.ranging.reading for steps in simulation.fly() for step in steps]
    recorder.close()
    fused = simulation.flight.fused
    off_m = [
        abs(found - truth)
        for found, truth, why in zip(fused.filtered_m, fused.truth_m, fused.why, strict=True)
        if truth is not None and found is not None and why is None
    ]
    assert max(truth for truth in fused.truth_m if truth is not None) > 29
    # 10 degrees below zero would be 6 % of a range of sound: 1.8 m.
    assert sorted(off_m)[len(off_m) * 95 // 100] < 0.15
    assert read_recorded(path).air == []
    vehicle = scenario.airframe
    clock = VirtualClock(first[0].time_s)
    bus = ReplayBus({ADDRESS: read_recorded(path).pings["down"]}, clock, {ADDRESS: LidarLiteV3.playback})
    poller = Poller(bus, clock, RecordedFlight(vehicle, bus, read_recorded(path)))
    again = []
    while poller.next_event_s < math.inf:
        clock.sleep_until(poller.next_event_s)
        again += [each.reading for each in poller.step()]
    assert {reading.status for reading in first} == {Status.OK, Status.NO_ECHO}
    assert [(each.status, each.raw, each.range_m) for each in again] == [
        (each.status, each.raw, each.range_m) for each in first
    ]
