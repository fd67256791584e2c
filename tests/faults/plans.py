"""The flights of a campaign: which group a flight belongs to, and its airframe, profile, air and faults.

A campaign's seed and the index of a flight enter; a `Plan` leaves, whose two files any command of `msp-sim` can fly. A
plan depends on seed and index alone, so that a flight can be flown again whatever else was flown with it.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.random import Generator

from msp_range.yaml_file import read_yaml
from msp_sim.autopilot import BAROMETER_WARMER_C
from msp_sim.device import FAULT_KINDS
from tests.faults.profiles import draw_flight

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
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
GROUPS = [group for group, share in SHARES.items() for _ in range(share)]
STRIDE = 37
"""Indices that follow each other are of groups this far apart in `GROUPS`, so that a short campaign has flights of all;
any number without a common divisor with 100 does."""

SENSOR_KINDS = [kind for kind in FAULT_KINDS if kind != "locked_up"]
"""Faults of one sensor. A locked-up bus takes all of them away and is flown in the group 'three or four'."""
COMMON_KINDS = ["or_ed", "lost_high_byte", "saturated", "stuck", "offset"]
"""Faults that give two sensors the same wrong height. The first three are alike: they leave eight bits, and 765 reads
255 or 253."""
ALIKE = dict.fromkeys(["or_ed", "lost_high_byte", "saturated"], "eight bits") | {"stuck": "stuck", "offset": "offset"}
ALWAYS = {"power_cycle", "locked_up"}
AIRFRAMES = ["1 sensor", "2 sensors", "3 sensors", "8 sensors", "canted", "px4", "slow"]
SOURCES = ["fixed", "file", "file with bias", "mavlink", "none"]
FIXED_STD_C = 12.0
"""A fixed temperature is set once for all seasons: the air differs from it by this, one standard deviation [K]."""


@dataclass(frozen=True)
class Plan:
    """One flight.

    Attributes
    ----------
    seed, index
        Of the campaign, and of the flight in it.
    group, row
        Group of `SHARES`, and row of the table: the group, with the kind of fault or airframe where it has several.
    airframe, scenario
        Content of the two files.
    flight_seed
        Random seed of the simulated flight.
    facts
        What was drawn, for those who look for a pattern.
    """

    seed: int
    index: int
    group: str
    row: str
    airframe: dict[str, Any]
    scenario: dict[str, Any]
    flight_seed: int
    facts: dict[str, Any] = field(default_factory=dict)

    def write(self, folder: Path) -> Path:
        """Write airframe, sensor model and scenario; the path of the scenario."""
        (folder / "sensors").mkdir(exist_ok=True)
        model = folder / SENSOR_MODEL
        if not model.exists():
            model.write_text((CONFIGS / SENSOR_MODEL).read_text(encoding="utf-8"), encoding="utf-8")
        for name, content in (("airframe", self.airframe), ("scenario", self.scenario)):
            text = yaml.dump(content, Dumper=yaml.CSafeDumper, sort_keys=False)
            (folder / f"{name}.yaml").write_text(text, encoding="utf-8")
        return folder / "scenario.yaml"


def group_of(index: int) -> str:
    """The group of a flight."""
    return GROUPS[index * STRIDE % len(GROUPS)]


def ordinal_of(index: int) -> int:
    """How many flights of the same group come before this one: kinds take turns by it."""
    cycles, rest = divmod(index, len(GROUPS))
    group = group_of(index)
    return cycles * SHARES[group] + sum(group_of(each) == group for each in range(rest))


def row_of(index: int) -> str:
    """The row of the table that a flight counts in."""
    group, ordinal = group_of(index), ordinal_of(index)
    if group == "one":
        return f"one: {SENSOR_KINDS[ordinal % len(SENSOR_KINDS)]}"
    if group == "airframe":
        return f"airframe: {AIRFRAMES[ordinal % len(AIRFRAMES)]}"
    return group


def draw_plan(seed: int, index: int) -> Plan:
    """Draw one flight of a campaign."""
    generator = np.random.default_rng([seed, index])
    group, ordinal, row = group_of(index), ordinal_of(index), row_of(index)
    airframe = read_yaml(CONFIGS / "quad_pallet.yaml")
    if group == "airframe":
        airframe = _other_airframe(AIRFRAMES[ordinal % len(AIRFRAMES)], generator)
    airframe.pop("recording", None)
    flight = draw_flight(generator, hover=group == "hover")
    source = SOURCES[ordinal % len(SOURCES)] if group == "temperature" else "file"
    if group == "thermometer":
        source = ("file", "mavlink")[ordinal % 2]
    air, thermometer = _air(generator, source, airframe, group in ("temperature", "thermometer"))
    scenario = {"name": "fault_campaign", "airframe": "airframe.yaml", **flight.scenario, "air": air}
    scenario |= {"thermometer": thermometer, "faults": [], "autopilot": {}}
    names = [sensor["name"] for sensor in airframe["sensors"]]
    draw = _FAULTS.get(group)
    if draw is not None:
        draw(generator, scenario, names, row, ordinal)
    facts = {
        "flight": flight.kind,
        "ground": flight.ground,
        "source": source,
        "air_c": round(air["ground_c"], 1),
        "sensors": len(names),
        "ping_interval_s": airframe.get("polling", {}).get("ping_interval_s", 0.1),
    }
    return Plan(seed, index, group, row, airframe, scenario, int(generator.integers(2**31)), facts)


def _other_airframe(name: str, generator: Generator) -> dict[str, Any]:
    """Another number of sensors at another ping interval, canted sensors, PX4, or pings seconds apart."""
    airframe: dict[str, Any] = read_yaml(CONFIGS / ("canted_pallet.yaml" if name == "canted" else "quad_pallet.yaml"))
    if name == "canted":
        return airframe
    if name == "px4":
        airframe["link"]["autopilot"] = "px4"
        return airframe
    count = int(name[0]) if name[0].isdigit() else int(generator.integers(1, 5))
    slowest_s, fastest_s = (2.0, 0.5) if name == "slow" else (0.5, 0.05)
    interval_s = fastest_s * (slowest_s / fastest_s) ** generator.random()
    sensors = airframe["sensors"]
    if count > len(sensors):
        for i, sensor in enumerate(list(sensors)):
            x, y, z = sensor["position_m"]
            middle = {"name": f"{sensor['name']}_2", "id": 11 + i, "address": 0x60 + i, "position_m": [x / 2, y / 2, z]}
            sensors.append(sensor | middle)
    airframe["sensors"] = sensors[:count]
    airframe["polling"] = {"ping_interval_s": round(interval_s, 3)}
    return airframe


def _air(
    generator: Generator, source: str, airframe: dict[str, Any], extreme: bool
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The air, and what the thermometers of this source read in it; the airframe's temperature section is set."""
    ground_c = float(generator.uniform(-20.0, 45.0) if extreme else generator.uniform(-5.0, 35.0))
    air: dict[str, Any] = {"ground_c": round(ground_c, 2)}
    if extreme and generator.random() < 0.3:
        warmer_c = round(float(generator.uniform(1.0, 5.0)), 2)
        air["warm_layer"] = {"bottom_m": -1.0, "top_m": 1.0, "warmer_by_c": warmer_c}
    error_c = float(generator.normal(0.0, 0.3))
    warmer_by_c = error_c
    temperature: dict[str, Any] = {"fixed_c": 20}
    file = {"source": "file", "path": "/sys/bus/i2c/devices/1-0044/hwmon/hwmon*/temp1_input"}
    if source == "fixed":
        fixed_c = ground_c + generator.normal(0.0, FIXED_STD_C)
        temperature = {"fixed_c": round(float(min(max(fixed_c, -20.0), 45.0)), 1)}
    elif source == "file":
        temperature["sources"] = [file]
    elif source == "file with bias":
        bias_c = float(generator.uniform(2.0, 15.0))
        warmer_by_c = bias_c + float(generator.normal(0.0, 1.0))
        temperature["sources"] = [file | {"bias_c": round(bias_c, 1)}]
    elif source == "mavlink":
        temperature["sources"] = [{"source": "mavlink", "message": "SCALED_PRESSURE", "bias_c": BAROMETER_WARMER_C}]
    airframe["temperature"] = temperature
    return air, {"warmer_by_c": round(warmer_by_c, 2)}


def _window(generator: Generator, duration_s: float) -> tuple[float, float]:
    """When a fault lasts: mostly some seconds in the middle, now and then from the start or to the end."""
    draw = generator.random()
    from_s = 0.0 if draw < 0.15 else generator.uniform(0.1, 0.6) * duration_s
    to_s = duration_s if draw > 0.75 else from_s + generator.uniform(4.0, 25.0)
    return round(float(from_s), 2), round(float(min(to_s, duration_s)), 2)


def _fault(generator: Generator, sensor: str, kind: str, window: tuple[float, float]) -> dict[str, Any]:
    from_s, to_s = window
    fault: dict[str, Any] = {"sensor": sensor, "kind": kind, "from_s": from_s, "to_s": to_s}
    if kind not in ALWAYS:
        fault["probability"] = float(generator.choice([1.0, 0.5, 0.2]))
    if kind == "locked_up":
        fault["to_s"] = round(from_s + float(generator.uniform(1.0, 10.0)), 2)
    elif kind == "power_cycle":
        fault["to_s"] = round(from_s + float(generator.uniform(0.0, 5.0)), 2)
    elif kind == "impossible":
        fault["word"] = int(generator.choice([0, 1, 10, 19, 766, 1000, 5000, 0x7FFF, 0xFFFF]))
    elif kind == "noisy":
        fault["spread_cm"] = round(30.0 * (500.0 / 30.0) ** float(generator.random()), 1)
    elif kind == "offset":
        fault["offset_cm"] = round(float(generator.choice([-1, 1]) * generator.uniform(30.0, 300.0)), 1)
    return fault


def _some(generator: Generator, names: list[str], count: int) -> list[str]:
    return [str(name) for name in generator.permutation(names)[:count]]


def _one(generator: Generator, scenario: dict[str, Any], names: list[str], row: str, ordinal: int) -> None:
    window = _window(generator, scenario["duration_s"])
    scenario["faults"] = [_fault(generator, _some(generator, names, 1)[0], row.removeprefix("one: "), window)]


def _two(generator: Generator, scenario: dict[str, Any], names: list[str], row: str, ordinal: int) -> None:
    """Two sensors with faults that do not give one common wrong height."""
    kinds = [str(kind) for kind in generator.choice(SENSOR_KINDS, 2)]
    while ALIKE.get(kinds[0], kinds[0]) == ALIKE.get(kinds[1]):
        kinds[1] = str(generator.choice(SENSOR_KINDS))
    _together(generator, scenario, _some(generator, names, 2), kinds)


def _two_common(generator: Generator, scenario: dict[str, Any], names: list[str], row: str, ordinal: int) -> None:
    """The same fault on two sensors at the same time."""
    kind = COMMON_KINDS[ordinal % len(COMMON_KINDS)]
    first = _fault(generator, "", kind, _window(generator, scenario["duration_s"]))
    scenario["faults"] = [first | {"sensor": name} for name in _some(generator, names, 2)]


def _three_or_four(generator: Generator, scenario: dict[str, Any], names: list[str], row: str, ordinal: int) -> None:
    """The same kind on all of them or one each; now and then a locked-up bus, which takes all away."""
    count = int(generator.integers(3, 5))
    kinds = list(generator.choice([*SENSOR_KINDS, "locked_up"], 1 if generator.random() < 0.6 else count))
    kinds = [str(kind) for kind in kinds] * (count // len(kinds))
    if "locked_up" in kinds:
        kinds, count = ["locked_up"], 1
    _together(generator, scenario, _some(generator, names, count), kinds)


def _together(generator: Generator, scenario: dict[str, Any], names: list[str], kinds: list[str]) -> None:
    window = _window(generator, scenario["duration_s"])
    at_once = generator.random() < 0.6
    scenario["faults"] = [
        _fault(generator, name, kind, window if at_once else _window(generator, scenario["duration_s"]))
        for name, kind in zip(names, kinds, strict=True)
    ]


def _all_at_255(generator: Generator, scenario: dict[str, Any], names: list[str], row: str, ordinal: int) -> None:
    window = _window(generator, scenario["duration_s"])
    scenario["faults"] = [
        {"sensor": name, "kind": "saturated", "from_s": window[0], "to_s": window[1]} for name in names
    ]


def _thermometer(generator: Generator, scenario: dict[str, Any], names: list[str], row: str, ordinal: int) -> None:
    from_s, to_s = _window(generator, scenario["duration_s"])
    fault: dict[str, Any] = {"kind": "freeze", "from_s": from_s, "to_s": to_s}
    if generator.random() < 0.75:
        by_c = generator.choice([-1, 1]) * generator.uniform(10.0, 60.0)
        fault |= {"kind": "jump", "by_c": round(float(by_c), 1)}
    scenario["thermometer"]["faults"] = [fault]


def _attitude(generator: Generator, scenario: dict[str, Any], names: list[str], row: str, ordinal: int) -> None:
    kind = ("roll", "huge", "not_a_number")[ordinal % 3]
    from_s, to_s = _window(generator, scenario["duration_s"])
    fault: dict[str, Any] = {"kind": kind, "from_s": from_s, "to_s": to_s}
    if kind == "roll":
        fault["roll_deg"] = round(float(generator.choice([-1, 1]) * generator.uniform(85.0, 180.0)), 1)
    scenario["autopilot"]["attitude_faults"] = [fault]


def _reboot(generator: Generator, scenario: dict[str, Any], names: list[str], row: str, ordinal: int) -> None:
    scenario["autopilot"]["reboots_at_s"] = [round(float(generator.uniform(5.0, scenario["duration_s"] - 15.0)), 2)]


def _airframe(generator: Generator, scenario: dict[str, Any], names: list[str], row: str, ordinal: int) -> None:
    """Every second flight of another airframe has a fault on one sensor."""
    if generator.random() < 0.5:
        _one(generator, scenario, names, str(generator.choice(SENSOR_KINDS)), ordinal)


_FAULTS: dict[str, Callable[[Generator, dict[str, Any], list[str], str, int], None]] = {
    "one": _one,
    "two": _two,
    "two, common height": _two_common,
    "three or four": _three_or_four,
    "all at 255": _all_at_255,
    "thermometer": _thermometer,
    "attitude": _attitude,
    "reboot": _reboot,
    "airframe": _airframe,
}
