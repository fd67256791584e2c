"""Campaign files and their points: what is read, in which order, and what the operator is asked to change."""

from dataclasses import fields
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from msp_lab.campaigns.campaign import load_campaign
from msp_lab.campaigns.flights import is_of_flights, load_flights
from msp_lab.campaigns.plan import Point, Setup, changes, make_plan, reading_s, setup_s
from msp_range.yaml_file import ConfigError
from tests.support.campaigns import PLYWOOD, campaign, condition, written
from tests.support.shipped import CONFIGS

BENCH_CAMPAIGNS = sorted(path.stem for path in (CONFIGS / "campaigns").glob("*.yaml") if not is_of_flights(path))


def points_of(name: str) -> tuple[Point, ...]:
    return make_plan(load_campaign(CONFIGS / f"campaigns/{name}.yaml"))


def of_condition(points: tuple[Point, ...], name: str) -> list[Point]:
    return [point for point in points if point.condition == name]


def changed_parts(before: Setup, after: Setup) -> list[str]:
    return [each.name for each in fields(Setup) if getattr(before, each.name) != getattr(after, each.name)]


def test_bench_campaigns_and_campaigns_of_flights_are_distinguished() -> None:
    assert {"table_4_1", "afternoon", "future"} <= {*BENCH_CAMPAIGNS}
    assert is_of_flights(CONFIGS / "campaigns/flight.yaml")


def test_table_4_1_is_complete() -> None:
    points = points_of("table_4_1")
    twenty = [float(each) for each in range(40, 261, 20)]

    def ranges(name: str, **held: Any) -> list[float]:
        chosen = [
            p for p in of_condition(points, name) if all(p.columns.get(key) == each for key, each in held.items())
        ]
        return sorted(point.setup.range_cm for point in chosen)

    assert ranges("baseline") == ranges("vibration", vibration_hz=60.0) == twenty
    for material in ("plywood", "asphalt", "concrete"):
        assert ranges("material", target=material) == twenty
    for air_c in (8.3, 21.1, 46.1):
        assert ranges("temperature", air_temperature_c=air_c, target_temperature_c=21.1) == twenty
    assert ranges("crosstalk_simultaneous") == ranges("crosstalk_sequential") == twenty
    assert {point.setup.sensors for point in of_condition(points, "crosstalk_sequential")} == {("sensor_1", "sensor_2")}
    assert {point.setup.apart_cm for point in of_condition(points, "crosstalk_sequential")} == {6 * 2.54}
    for range_cm in (50.0, 100.0, 150.0, 200.0):
        angles = {p.setup.angle_deg for p in of_condition(points, "field_of_view") if p.setup.range_cm == range_cm}
        assert {round(1.8 * step, 6) for step in range(-13, 14)} <= angles
        assert max(angles) > 23.4  # the report's largest; beyond it the echo breaks away at 50 cm
    (farthest,) = of_condition(points, "maximum_range")
    assert (farthest.setup.range_cm, farthest.readings) == (500.0, 20000)
    assert farthest.setup.target.size_cm == (101.6, 61.0)
    compensated = of_condition(points, "temperature_compensation")
    assert [point.setup.range_cm for point in compensated] == [305, 335, 366, 396, 427]
    assert len({point.setup.air.air_temperature_c for point in compensated}) == 5
    external = of_condition(points, "external_interference")
    assert {point.columns["external_duty"] for point in external} == {0.0, 0.1, 0.5, 1.0}
    assert {point.columns.get("external_frequency_khz") for point in external} == {None, 40, 41, 42, 43, 44}
    assert {point.columns.get("external_level_db") for point in external} == {None, 70, 90, 110}
    assert {point.columns.get("external_distance_cm") for point in external} == {None, 30, 100, 300}


def test_the_future_is_in_the_order_of_figure_2_2() -> None:
    conditions = list(dict.fromkeys(point.condition for point in points_of("future")))
    assert conditions[:5] == ["maximum_range", "humidity", "natural_ground", "uneven_surface", "moving_target"]
    assert conditions[5:] == ["baseline", "field_of_view"]
    (name,) = {point.setup.sensors for point in of_condition(points_of("future"), "baseline")}
    assert load_campaign(CONFIGS / "campaigns/future.yaml").sensor(name[0]).sensor_model.name == "MB1232"


def test_flights_name_airframe_and_scenarios() -> None:
    flights = load_flights(CONFIGS / "campaigns/flight.yaml")
    assert len(flights.airframe.sensors) == 4
    assert [flight.flight for flight in flights.flights if flight.scenario is None] == ["standing"]


@pytest.mark.parametrize("name", BENCH_CAMPAIGNS)
def test_every_point_has_a_name_of_its_own(name: str) -> None:
    names = [point.name for point in points_of(name)]
    assert len(set(names)) == len(names)


@pytest.mark.parametrize("name", BENCH_CAMPAIGNS)
def test_within_a_condition_one_thing_changes_at_a_time(name: str) -> None:
    for before, after in pairwise(points_of(name)):
        if before.question == after.question != "" and before.setup.movement is None:
            assert len(changed_parts(before.setup, after.setup)) <= 1, (before.name, after.name)


def test_what_is_slow_to_change_changes_last() -> None:
    """Heating a box once for all ranges, and not once a range."""
    points = of_condition(points_of("table_4_1"), "temperature")
    changed = [changed_parts(before.setup, after.setup) for before, after in pairwise(points)]
    assert changed.count(["air"]) == 2
    assert changed.count(["range_cm"]) == 33


def test_a_condition_begins_where_the_one_before_stopped(tmp_path: Path) -> None:
    stone = {"material": "stone"}
    small = campaign(
        tmp_path,
        condition(ranges_cm=[40, 80, 120]),
        condition(condition="material", ranges_cm=[40, 80, 120], targets=[stone, PLYWOOD]),
    )
    points = make_plan(small)
    assert [point.setup.range_cm for point in points] == [40, 80, 120, 120, 80, 40, 40, 80, 120]
    assert [point.setup.target.material for point in points[3:]] == ["plywood"] * 3 + ["stone"] * 3
    assert changes(points[2], points[3]) == []
    assert setup_s(points[2], points[3]) == 0.0


def test_the_operator_is_asked_to_change_what_differs_and_nothing_else(tmp_path: Path) -> None:
    hot = {"air_temperature_c": 46, "target_temperature_c": 21, "how": "Blow warm air into the box."}
    source = {"frequencies_khz": [42], "levels_db": [90], "duties": [0.5], "distances_cm": [100]}
    small = campaign(
        tmp_path,
        condition(setup="Level the sensor.", ranges_cm=[60]),
        condition(condition="shaken", ranges_cm=[60], vibrations_hz=[60]),
        condition(condition="heated", ranges_cm=[60], air=[hot]),
        condition(condition="disturbed", ranges_cm=[60], external=source),
        condition(condition="crosstalk", ranges_cm=[60], sensors=["one", "two"], apart_cm=15.24,
                  firing=["simultaneous", "sequential"]),
        condition(condition="turned", ranges_cm=[60], angles_deg=[0, 1.8], targets=[{"material": "wall"}]),
    )  # fmt: skip
    points = make_plan(small)
    listed = [changes(None, points[0]), *(changes(before, after) for before, after in pairwise(points))]
    assert listed == [
        [
            "Level the sensor.",
            "Connect and mount one alone.",
            "Set the air at the sensor to 22.5 deg C.",
            "Target: plywood, 20 by 20 cm.",
            "Move the target to 60 cm.",
            "Face the target squarely.",
        ],
        ["Vibrate the sensor's housing at 60 Hz."],
        [
            "Set the air at the sensor to 46 deg C, and leave 21 deg C at the target.",
            "Blow warm air into the box.",
            "Switch the vibration off.",
        ],
        [
            "Undo what was done to the air: fans off, boxes away.",
            "Set the air at the sensor to 22.5 deg C.",
            "Switch the transmitter off.",
        ],
        [
            "Set the transmitter to 42 kHz, 90 dB at 30 cm from it, 50% of the time, 100 cm from the sensor.",
        ],
        [
            "Connect and mount one and two side by side, 15.24 cm apart, facing the same target.",
            "Remove the transmitter.",
        ],
        [],
        [
            "Connect and mount one alone.",
            "Target: wall.",
            "Check that it is at 60 cm again.",
        ],
        ["Turn the sensor to +1.8 deg (it was at +0 deg)."],
    ]


def test_columns_say_what_is_known_and_leave_out_what_is_not(tmp_path: Path) -> None:
    first, *_ = make_plan(campaign(tmp_path, room={}))
    assert first.columns == {
        "true_range_cm": 60.0,
        "condition": "baseline",
        "incidence_deg": 0.0,
        "range_rate_cm_s": 0.0,
        "vibration_hz": 0.0,
        "target": "plywood",
        "target_size_cm": 20.0,
        "external_duty": 0.0,
    }


def test_a_moving_target_is_read_in_as_many_movements_as_it_takes(tmp_path: Path) -> None:
    moving = condition(condition="moving", ranges_cm=[100], moving={"to_cm": 40, "rates_cm_s": [20]}, readings=70)
    points = make_plan(campaign(tmp_path, moving))
    assert [point.readings for point in points] == [30, 30, 30]
    assert {point.columns["range_rate_cm_s"] for point in points} == {-20.0}
    assert changes(points[0], points[1]) == [
        "Move the target to 100 cm.",
        "Then move the target to 40 cm at 20 cm/s, and press Enter as it starts.",
    ]


def test_a_target_too_fast_for_one_reading_is_refused(tmp_path: Path) -> None:
    moving = condition(ranges_cm=[100], moving={"to_cm": 101, "rates_cm_s": [50]})
    with pytest.raises(ConfigError, match="end before one reading"):
        make_plan(campaign(tmp_path, moving))


def test_two_sensors_in_turn_take_twice_the_time(tmp_path: Path) -> None:
    both = condition(condition="crosstalk", sensors=["one", "two"], firing=["simultaneous", "sequential"])
    small = campaign(tmp_path, both)
    together, in_turn, *_ = make_plan(small)
    assert (reading_s(small, together), reading_s(small, in_turn)) == (3.0, 6.0)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"ranges_cm": {"first": 40, "last": 70, "step": 20}}, "ranges_cm: .*whole steps"),
        ({"ranges_cm": [60, 60]}, "ranges_cm: found 60.0 more than once"),
        ({"ranges_cm": [-5]}, "ranges_cm"),
        ({"angles": [5]}, "angles_deg"),
        ({"sensors": ["three"]}, "no sensor is named 'three'; the sensors are one, two"),
        ({"firing": ["simultaneous"]}, "found with one sensor"),
        ({"firing": ["at_once"], "sensors": ["one", "two"]}, "firing"),
        ({"air": [{"target_temperature_c": 20}]}, "without air_temperature_c"),
        ({"moving": {"to_cm": 60, "rates_cm_s": [5]}}, "which is also where a movement begins"),
        ({"targets": []}, "targets"),
        ({"readings": 0}, "readings"),
    ],
)
def test_user_errors_are_named(changed: dict[str, Any], message: str, tmp_path: Path) -> None:
    path = written(tmp_path, condition(**changed))
    with pytest.raises(ConfigError, match=message) as caught:
        load_campaign(path)
    assert str(path) in str(caught.value)


def test_two_sensors_at_one_address_are_refused(tmp_path: Path) -> None:
    sensors = [{"name": name, "address": 0x70, "model": str(CONFIGS / "sensors/mb1242.yaml")} for name in ("a", "b")]
    with pytest.raises(ConfigError, match="address 0x70 is given more than once"):
        campaign(tmp_path, sensors=sensors)


def test_a_sensor_model_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"mb1243\.yaml: no such file"):
        campaign(tmp_path, sensors=[{"name": "a", "address": 0x70, "model": str(CONFIGS / "sensors/mb1243.yaml")}])
