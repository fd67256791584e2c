"""The flights of a campaign: which group a flight belongs to, and its airframe, profile, air and faults.

A campaign's seed and the index of a flight enter; a `Plan` leaves, whose two files any command of `msp-sim` can fly. A
plan depends on seed and index alone, so that a flight can be flown again whatever else was flown with it.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from evaluation import CONFIGS
from evaluation.faults import families
from evaluation.faults.dice import Dice
from evaluation.faults.families import FAMILIES
from evaluation.faults.faults import ADD, ATTITUDE_KINDS, COMMON_KINDS, SENSOR_KINDS
from evaluation.faults.profiles import draw_flight
from msp_range.yaml_file import read_yaml
from msp_sim.flight.autopilot import BAROMETER_WARMER_C

SENSOR_MODEL = "sensors/mb1242.yaml"

SHARES = {
    "no fault": 10,
    "hover": 1,
    "one": 24,
    "two": 15,
    "two, common height": 6,
    "three or four": 13,
    "all at 255": 3,
    "temperature": 10,
    "thermometer": 3,
    "attitude": 3,
    "reboot": 2,
    "airframe": 10,
}
"""Flights of each group in a hundred. More flights of a group make its figures firmer; the sum must stay 100."""
AIRFRAMES = ["1 sensor", "2 sensors", "3 sensors", "8 sensors", "canted", "px4", "slow"]
SOURCES = ["fixed", "file", "file with bias", "mavlink", "none"]
TURNS = {
    "one": SENSOR_KINDS,
    "two, common height": COMMON_KINDS,
    "temperature": SOURCES,
    "thermometer": ["file", "mavlink"],
    "attitude": ATTITUDE_KINDS,
    "airframe": AIRFRAMES,
}
"""Kinds that take turns in a group."""
ROWS_BY_TURN = ("one", "temperature", "airframe")
"""Groups whose kinds have a row of the table each."""
STRIDE = 37
"""Indices that follow each other are of groups this far apart, so that a short campaign has flights of all; any number
without a common divisor with 100 does."""
THERMOMETER_STD_C, BIAS_STD_C, DIE_STD_C = 0.7, 1.5, 4.0
"""How far thermometers are off [C]: one in outside air, half a degree of its own and some of the sun's; one whose bias
was measured on another day; a barometer's die, whose board runs hotter or cooler than usual."""
FIXED_STD_C = 12.0
"""A fixed temperature is set once for all seasons: the air differs from it by this, one standard deviation [K]."""

_GROUPS = [group for group, share in SHARES.items() for _ in range(share)]


@dataclass(frozen=True)
class Plan:
    """One flight."""

    seed: int
    index: int
    """Of the campaign, and of the flight in it."""
    airframe: dict[str, Any]
    scenario: dict[str, Any]
    """Content of the two files."""
    flight_seed: int
    """Random seed of the simulated flight."""
    facts: dict[str, Any]
    """What was drawn, for those who look for a pattern."""
    sensor_model: dict[str, Any] = field(default_factory=dict)
    """Changes of the sensor model's file."""

    def write(self, folder: Path) -> Path:
        """Write airframe, sensor model and scenario; the path of the scenario."""
        (folder / "sensors").mkdir(parents=True, exist_ok=True)
        sensor_model = read_yaml(CONFIGS / SENSOR_MODEL) | self.sensor_model
        files = {SENSOR_MODEL: sensor_model, "airframe.yaml": self.airframe, "scenario.yaml": self.scenario}
        for name, content in files.items():
            text = yaml.dump(content, Dumper=yaml.CSafeDumper, sort_keys=False)
            (folder / name).write_text(text, encoding="utf-8")
        return folder / "scenario.yaml"


def group_of(index: int) -> str:
    """The group or the hostile family of a flight."""
    if index >= families.FIRST:
        return families.family_of(index)
    return _GROUPS[index * STRIDE % len(_GROUPS)]


def turn_of(index: int) -> str:
    """Which of its group's kinds a flight is; empty where there are none."""
    if index >= families.FIRST:
        return families.turn_of(index)
    group = group_of(index)
    kinds = TURNS.get(group, [""])
    cycles, rest = divmod(index, len(_GROUPS))
    before = cycles * SHARES[group] + sum(group_of(each) == group for each in range(rest))
    return kinds[before % len(kinds)]


def row_of(index: int) -> str:
    """The row of the table that a flight counts in."""
    if index >= families.FIRST:
        return families.row_of(index)
    group = group_of(index)
    return f"{group}: {turn_of(index)}" if group in ROWS_BY_TURN else group


def draw_plan(seed: int, index: int, sends_motion: bool = True) -> Plan:
    """Draw one flight of a campaign; ``sends_motion``: of an autopilot that sends acceleration and pressure."""
    dice, group, turn = Dice(seed, index), group_of(index), turn_of(index)
    family = FAMILIES.get(group)
    if family is None:
        airframe = _airframe(dice, turn if group == "airframe" else "quad")
        flight = draw_flight(dice, hover=group == "hover")
    else:
        airframe = _airframe(dice, family.airframe(dice, turn))
        flight = family.fly(dice, turn)
    on_air = group in ("temperature", "thermometer")
    source = turn if on_air else "file"
    if source == "none":
        # Nothing is stated: 20 C, and air that is 12 C from it, as the bridge then assumes.
        ground_c = min(max(dice.around(20.0, FIXED_STD_C), -20.0), 45.0)
    else:
        ground_c = dice.between(-20.0, 45.0) if on_air else dice.between(-5.0, 35.0)
    air: dict[str, Any] = {"ground_c": ground_c}
    if on_air and dice.happens(0.3):
        air["warm_layer"] = {"bottom_m": -1.0, "top_m": 1.0, "warmer_by_c": dice.between(1.0, 5.0)}
    airframe["temperature"], warmer_by_c = _thermometer(dice, source, ground_c)
    scenario = {
        "name": "fault_campaign",
        "airframe": "airframe.yaml",
        **flight.scenario,
        "air": air,
        "thermometer": {"warmer_by_c": warmer_by_c},
        "faults": [],
        "autopilot": {"sends_motion": sends_motion},
    }
    names = [sensor["name"] for sensor in airframe["sensors"]]
    if group in ADD:
        ADD[group](dice, scenario, names, turn)
    if family is not None:
        scenario["autopilot"]["barometer"] = families.draw_barometer(dice)
        family.add(dice, scenario, names, turn)
    interval_s = airframe.get("polling", {}).get("ping_interval_s")
    facts = {"flight": flight.kind, "ground": flight.ground, "source": source, "air_c": air["ground_c"]}
    facts |= {"sensors": len(names), "ping_interval_s": interval_s}
    return Plan(seed, index, airframe, scenario, dice.seed(), facts, family.sensor_model if family else {})


def _airframe(dice: Dice, name: str) -> dict[str, Any]:
    """The quad with four sensors, another number of sensors or pings, canted sensors, or PX4."""
    airframe: dict[str, Any] = read_yaml(CONFIGS / ("canted_pallet.yaml" if name == "canted" else "quad_pallet.yaml"))
    airframe.pop("recording", None)
    if name == "px4":
        airframe["link"]["autopilot"] = "px4"
    elif name == "slow" or name[0].isdigit():
        count = dice.one_of([1, 2, 3, 4]) if name == "slow" else int(name[0])
        sensors = airframe["sensors"]
        for i, sensor in enumerate(list(sensors)):
            x, y, z = sensor["position_m"]
            inner = {"name": f"{sensor['name']}_2", "id": 11 + i, "address": 0x60 + i, "position_m": [x / 2, y / 2, z]}
            sensors.append(sensor | inner)
        airframe["sensors"] = sensors[:count]
        interval_s = dice.magnitude(0.5, 2.0) if name == "slow" else dice.magnitude(0.05, 0.5)
        airframe["polling"] = {"ping_interval_s": interval_s}
    return airframe


def _thermometer(dice: Dice, source: str, ground_c: float) -> tuple[dict[str, Any], float]:
    """The airframe's section for a source of temperature, and how much too warm the thermometers are [K]."""
    file = {"source": "file", "path": "/sys/bus/i2c/devices/1-0044/hwmon/hwmon*/temp1_input"}
    error_c = dice.around(0.0, THERMOMETER_STD_C)
    if source == "fixed":
        return {"fixed_c": min(max(dice.around(ground_c, FIXED_STD_C), -20.0), 45.0)}, error_c
    if source == "file":
        return {"sources": [file]}, error_c
    if source == "file with bias":
        bias_c = dice.between(2.0, 15.0)
        return {"sources": [file | {"bias_c": bias_c}]}, dice.around(bias_c, BIAS_STD_C)
    if source == "mavlink":
        barometer = {"source": "mavlink", "message": "SCALED_PRESSURE", "bias_c": BAROMETER_WARMER_C}
        return {"sources": [barometer]}, dice.around(0.0, DIE_STD_C)
    return {}, error_c
