"""Scenario files: those that come with the project fly and show what they are for, wrong ones say what is wrong."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from msp_range.yaml_file import ConfigError
from msp_sim.device.device import FAULT_KINDS
from msp_sim.flight.autopilot import AutopilotSection
from msp_sim.flight.scenario import PlannedFault, Scenario, Thermometer, load_scenario
from msp_sim.world.vehicle import Pose
from msp_sim.world.world import MountedBeam, Ping
from tests.support.known import known

CONFIGS = Path(__file__).resolve().parents[4] / "configs"
SCENARIOS = sorted((CONFIGS / "scenarios").glob("*.yaml"))

Change = Callable[[dict[str, Any]], object]
"""Changes the content of a scenario file in place."""


def beams(scenario: Scenario) -> dict[str, MountedBeam]:
    return {
        sensor.name: MountedBeam(sensor.position_m, sensor.boresight, sensor.sensor_model.beam.half_angle_rad)
        for sensor in scenario.airframe.sensors
    }


def pings(name: str, every_s: float = 0.1, seed: int = 0) -> dict[str, list[Ping]]:
    """What each sensor of a scenario's vehicle meets, at equal times."""
    scenario = load_scenario(CONFIGS / "scenarios" / name)
    world = scenario.world()
    vehicle = scenario.vehicle(world, np.random.default_rng(seed))
    poses = [vehicle.pose(time_s) for time_s in np.arange(0.0, scenario.duration_s, every_s)]
    return {sensor: [world.ping(pose, beam) for pose in poses] for sensor, beam in beams(scenario).items()}


@pytest.mark.parametrize("path", SCENARIOS, ids=lambda path: path.stem)
def test_every_scenario_flies_above_its_ground(path: Path) -> None:
    scenario = load_scenario(path)
    assert scenario.name == path.stem
    for seed in (0, 1):
        world = scenario.world()
        vehicle = scenario.vehicle(world, np.random.default_rng(seed))
        assert vehicle.duration_s <= scenario.duration_s + 1e-6
        assert min(vehicle.pose(time_s).clearance_m for time_s in np.arange(0.0, scenario.duration_s, 0.05)) > -0.01


@pytest.mark.parametrize("path", SCENARIOS, ids=lambda path: path.stem)
def test_the_same_seed_flies_the_same_way(path: Path) -> None:
    scenario = load_scenario(path)

    def flown(seed: int) -> list[Pose]:
        vehicle = scenario.vehicle(scenario.world(), np.random.default_rng(seed))
        return [vehicle.pose(time_s) for time_s in np.arange(0.0, scenario.duration_s, 0.5)]

    assert flown(7) == flown(7)
    by_chance = scenario.flight.attitude.sway or any(segment.kind == "random" for segment in scenario.flight.altitude)
    assert (flown(7) != flown(8)) == bool(by_chance)


def test_the_demo_takes_off_hovers_at_six_metres_over_changing_ground_and_lands() -> None:
    scenario = load_scenario(CONFIGS / "scenarios" / "demo.yaml")
    world = scenario.world()
    vehicle = scenario.vehicle(world, np.random.default_rng(0))
    heights_m = [-vehicle.pose(time_s).position_ned_m[2] for time_s in np.arange(0.0, 90.0, 0.1)]
    standing_m = scenario.flight.standing_height_m
    assert max(heights_m) == pytest.approx(6.0 + standing_m)
    assert sum(height_m > 5.9 + standing_m for height_m in heights_m) > 500
    assert vehicle.pose(0.0).clearance_m == pytest.approx(0.0)
    assert vehicle.pose(scenario.duration_s).clearance_m == pytest.approx(0.0)
    for met in pings("demo.yaml").values():
        assert {ping.target for ping in met if ping.has_echo} >= {"grass", "concrete", "asphalt", "gravel", "crate"}
        assert np.mean([ping.has_echo for ping in met]) > 0.99
        ranges_cm = np.array([ping.true_range_cm for ping in met])
        assert 19 < ranges_cm.min() < 21
        assert 610 < ranges_cm.max() < 640


def test_terrain_following_stays_near_its_height() -> None:
    met = pings("terrain.yaml")["front_left"][150:550]
    ranges_cm = np.array([ping.true_range_cm for ping in met])
    assert np.median(ranges_cm) == pytest.approx(265, abs=5)
    assert {ping.target for ping in met} == {"grass", "concrete", "crate"}


def test_the_reports_profile_is_within_the_reports_ranges() -> None:
    ranges_cm = np.array([ping.true_range_cm for ping in pings("report_random.yaml")["rear_right"]])
    assert ranges_cm[:200] == pytest.approx(300)
    assert [ranges_cm[i] for i in (220, 270, 320, 370)] == pytest.approx([275, 225, 350, 325])
    assert ranges_cm[400:].min() >= 230
    assert ranges_cm[400:].max() <= 360


def test_canted_sensors_lose_the_ground_at_the_limit_of_their_beam_only() -> None:
    met = pings("canted.yaml")
    for sensor in met:
        assert 0.5 < np.mean([ping.has_echo for ping in met[sensor]]) <= 1.0
    # The slope leans away from the left sensor: 10 deg of cant and 2 of slope are 0.7 deg more than the beam has at
    # 3.5 m, so that it detects the ground there when the vehicle sways its way.
    assert np.mean([ping.has_echo for ping in met["left"]]) < np.mean([ping.has_echo for ping in met["right"]])


def test_the_forward_sensor_sees_the_wall_come_near() -> None:
    ranges_cm = np.array([ping.true_range_cm for ping in pings("wall.yaml")["forward"] if ping.has_echo])
    assert 100 < ranges_cm.min() < 300
    assert ranges_cm.max() > 765


def test_proximity_sensors_see_their_walls() -> None:
    met = pings("proximity.yaml")
    for sensor in met:
        assert np.mean([ping.target == "brick" and ping.has_echo for ping in met[sensor]]) > 0.95


def test_every_kind_of_fault_is_planned_once() -> None:
    scenario = load_scenario(CONFIGS / "scenarios" / "faults.yaml")
    assert sorted(fault.kind for fault in scenario.faults) == sorted(FAULT_KINDS)
    for fault in scenario.faults:
        planned = fault.on_device()
        assert (planned.kind, planned.start_s, planned.end_s) == (fault.kind, fault.from_s, fault.to_s)


@pytest.mark.parametrize(
    ("kind", "values"),
    [
        ("noisy", {"spread_cm": 40.0}),
        ("offset", {"offset_cm": -30.0}),
        ("drift", {"rate_cm_s": -2.5}),
        ("constant", {"constant_cm": 333}),
        ("fixed_object", {"object_cm": 31.0, "jitter_cm": 1.5, "swing_cm": 4.0, "swing_period_s": 3.0}),
        ("dust", {"dust_cm": 70.0}),
    ],
)
def test_a_planned_fault_has_the_values_of_its_kind_and_of_no_other(kind: str, values: dict[str, float]) -> None:
    planned = PlannedFault.model_validate({"sensor": "a", "kind": kind, "from_s": 1.0, "to_s": 2.0, **values})
    on_device = planned.on_device()
    assert {name: getattr(on_device, name) for name in values} == values
    for name, value in values.items():
        with pytest.raises(ValueError, match=f"{name}: found {value:g}; expected none with the kind 'silent'"):
            PlannedFault.model_validate({"sensor": "a", "kind": "silent", "from_s": 1.0, "to_s": 2.0, name: value})


def test_a_thermometer_in_a_housing_settles() -> None:
    """From 20 C to -15 C with a time constant of 60 s."""
    fault = {"kind": "settle", "from_s": 0.0, "to_s": 600.0, "by_c": 35.0, "time_constant_s": 60.0}
    thermometer = Thermometer.model_validate({"faults": [fault]})
    read_c = [thermometer.reading_c(time_s, lambda time_s: -15.0) for time_s in (0.0, 60.0, 120.0, 600.0)]
    assert read_c == pytest.approx([20.0, -15.0 + 35.0 / math.e, -15.0 + 35.0 / math.e**2, -15.0])


def test_a_thermometer_flaps_between_two_values() -> None:
    fault = {"kind": "flap", "from_s": 10.0, "to_s": 20.0, "by_c": -8.0, "period_s": 3.0}
    thermometer = Thermometer.model_validate({"faults": [fault]})
    read_c = [thermometer.reading_c(time_s, lambda time_s: 5.0) for time_s in (9.9, 10.0, 11.4, 11.6, 12.9, 13.1, 20.0)]
    assert read_c == pytest.approx([5.0, 5.0, 5.0, -3.0, -3.0, 5.0, 5.0])


def test_a_thermometer_is_warmer_jumps_and_freezes() -> None:
    faults = (
        {"kind": "freeze", "from_s": 10.0, "to_s": 20.0},
        {"kind": "jump", "from_s": 15.0, "to_s": 30.0, "by_c": -40.0},
    )
    thermometer = Thermometer(warmer_by_c=2.0, faults=faults)
    read_c = [thermometer.reading_c(time_s, lambda time_s: time_s / 10) for time_s in (9.0, 12.0, 16.0, 25.0, 30.0)]
    assert read_c == pytest.approx([2.9, 3.0, -37.0, -35.5, 5.0])


def test_attitudes_that_make_no_sense() -> None:
    faults = [
        {"kind": "roll", "from_s": 1.0, "to_s": 2.0, "roll_deg": 120.0},
        {"kind": "huge", "from_s": 2.0, "to_s": 3.0},
        {"kind": "not_a_number", "from_s": 3.0, "to_s": 4.0},
    ]
    autopilot = AutopilotSection(attitude_faults=faults)
    poses = [Pose(time_s, (0.0, 0.0, -1.0), 0.1, 0.0, 0.0, (0.0, 0.0, 0.0)) for time_s in (0.5, 1.0, 2.0, 3.0, 4.0)]
    rolls_rad = [autopilot.sent_roll_rad(pose) for pose in poses]
    assert rolls_rad == pytest.approx([0.1, math.radians(120.0), 1e38, math.nan, 0.1], nan_ok=True)


def test_no_autopilot_and_a_late_one() -> None:
    assert load_scenario(CONFIGS / "scenarios" / "no_autopilot.yaml").autopilot is None
    assert known(load_scenario(CONFIGS / "scenarios" / "hover.yaml").autopilot).first_heartbeat_s == 0.0
    assert known(load_scenario(CONFIGS / "scenarios" / "faults.yaml").autopilot).reboots_at_s == (92.0,)


def test_a_pallet_that_stands_reads_its_minimum() -> None:
    for met in pings("hover.yaml").values():
        assert met[0].true_range_cm == pytest.approx(20)
        assert met[300].true_range_cm == pytest.approx(220)
        assert met[300].air_temperature_c == 20.0
        assert math.isclose(known(met[30].range_rate_cm_s), 60, abs_tol=60)


def changed(tmp_path: Path, change: Change) -> Path:
    """The hover scenario with something changed, in a folder of its own."""
    content = yaml.safe_load((CONFIGS / "scenarios" / "hover.yaml").read_text())
    content["airframe"] = str(CONFIGS / "loopback.yaml")
    change(content)
    path = tmp_path / "scenario.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


FAULT = {"sensor": "front_left", "kind": "silent", "from_s": 1.0, "to_s": 2.0}


def with_fault(**fault: Any) -> Change:
    return lambda content: content.update(faults=[FAULT | fault])


def with_segment(**segment: Any) -> Change:
    return lambda content: content["flight"]["altitude"].insert(0, segment)


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        (lambda content: content.update(duration=3), ["duration: unknown key", "Did you mean 'duration_s'?"]),
        (lambda content: content.update(name="Hover 2"), ["name: found 'Hover 2'", "expected", "^[a-z]"]),
        (lambda content: content.pop("flight"), ["flight: this key is missing", "what the vehicle does"]),
        (lambda content: content.update(duration_s=20), ["duration_s: found 20", "expected at least 58.2"]),
        (lambda content: content.update(airframe=3), ["airframe: found 3; expected the path of an airframe file"]),
        (
            lambda content: content.update(airframe="../loopbak.yaml"),
            ["loopbak.yaml: no such file", "scenario.yaml: airframe"],
        ),
        (
            with_fault(sensor="front_lef"),
            ["faults[0].sensor: found 'front_lef'; expected one of front_left, front_right"],
        ),
        (with_fault(kind="silence"), ["faults[0]", "'silence'", "expected one of clock_fault"]),
        (with_fault(to_s=0.5), ["faults[0]: to_s: found 0.5; expected a time after from_s 1"]),
        (with_fault(from_s=70, to_s=80), ["faults[0].from_s: found 70; expected a time before the end, duration_s 60"]),
        (with_fault(probability=1.5), ["faults[0]", "probability 1.5", "more than 0 and at most 1"]),
        (with_fault(word=900), ["faults[0]: word: found 900; expected none with the kind 'silent'"]),
        (with_fault(offset_cm=30), ["faults[0]: offset_cm: found 30; expected none with the kind 'silent'"]),
        (with_fault(kind="noisy", spread_cm=0), ["faults[0].spread_cm: found 0", "greater than 0"]),
        (with_fault(kind="impossible", word=300), ["faults[0]", "0x12c", "expected"]),
        (with_segment(kind="hovver", duration_s=3), ["flight.altitude[0]", "'hovver'", "hold"]),
        (with_segment(kind="hold", duration_s=-3), ["flight.altitude[0].duration_s: found -3", "greater than 0"]),
        (
            with_segment(kind="terrain", height_m=2, duration_s=1e9),
            ["found 60", "1000000050.0"],
        ),
        (lambda content: content.update(duration_s=1e9), ["duration_s: found 1000000000.0; expected", "36000"]),
        (lambda content: content.update(duration_s="1e300"), ["found 1e300, expected a number of at most 1e+12"]),
        (with_segment(kind="climb", to=3), ["flight.altitude[0].to: unknown key", "Did you mean 'to_m'?"]),
        (with_segment(kind="climb", to_m=-0.15), ["flight: at 0.", "deep in what is below", "above the ground"]),
        (
            lambda content: content.update(ground={"boxes": [{"centre_m": [0.0], "size_m": [1, 1], "height_m": 1}]}),
            ["ground.boxes[0].centre_m", "missing"],
        ),
        (
            lambda content: content.update(ground={"steps": [{"at_m": 3}, {"at_m": 2}]}),
            ["ground", "expected steps in order of at_m, but 2.0 comes after 3.0"],
        ),
        (lambda content: content.update(ground={"slope_deg": 60}), ["ground.slope_deg: found 60", "45"]),
        (lambda content: content.update(autopilot={"kind": "ardupilt"}), ["autopilot.kind: found 'ardupilt'", "'px4'"]),
    ],
)
def test_a_wrong_scenario_says_what_was_found_and_expected(tmp_path: Path, change: Change, parts: list[str]) -> None:
    path = changed(tmp_path, change)
    with pytest.raises(ConfigError) as raised:
        load_scenario(path)
    for part in [str(path), *parts]:
        assert part in str(raised.value)


def test_flying_into_a_box_is_found_when_the_file_is_read(tmp_path: Path) -> None:
    def change(content: dict[str, Any]) -> None:
        content["ground"]["boxes"] = [{"centre_m": [10.0, 0.0], "size_m": [2.0, 2.0], "height_m": 2.5}]
        content["flight"]["track"] = {"legs": [{"duration_s": 40, "speed_m_s": 1.0}]}

    with pytest.raises(ConfigError, match=r"at 9\.\d s the vehicle would stand 0\.50 m deep in what is below it"):
        load_scenario(changed(tmp_path, change))


def test_a_landing_while_moving_over_a_slope_is_found_when_the_file_is_read(tmp_path: Path) -> None:
    def change(content: dict[str, Any]) -> None:
        content["ground"]["slope_deg"] = 5.0
        content["flight"]["track"] = {"legs": [{"duration_s": 70, "speed_m_s": 0.1}]}
        content["duration_s"] = 70

    with pytest.raises(ConfigError, match="a landing at rest"):
        load_scenario(changed(tmp_path, change))
