"""Hostile families: flights in which the ground, the vehicle or a common cause deceives the sensors.

Each family draws its flight and what goes wrong in it. Their flights have indices of their own, from `FIRST` on, so
that those of the groups stay what they are; docs/faults.md says what each family is for.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from evaluation.faults.dice import Dice
from evaluation.faults.faults import (
    ATTITUDE_KINDS,
    SENSOR_KINDS,
    Content,
    attitude_fault,
    sensor_fault,
    thermometer_fault,
)
from evaluation.faults.profiles import Flown, Segments, climb, draw_flight, flown, hold, lasts_s

FIRST = 1_000_000
"""Index of the first hostile flight: beyond any campaign of the groups."""
NUMBERS = ["1 sensor", "2 sensors", "3 sensors", "8 sensors"]
"""Other airframes than the quad with four."""
SENSORS_DOWN_M = 0.05
"""How far below the body's origin the sensors are [m]."""
SATURATED_M = 2.7
"""Sensors that saturate at 255 cm are wrong above this height [m]."""
NEW_KINDS = ["drift", "constant", "previous_ping", "fixed_object", "dust"]
PAIR_KINDS = [*SENSOR_KINDS, *NEW_KINDS, "thermometer", "attitude"]
FOLLOW_FROM_S = 4.0
"""A vehicle that follows a slope waits for so long first [s]."""
GRASS = {"breakaway": [{"range_cm": 50, "half_angle_deg": 35.0}, {"range_cm": 400, "half_angle_deg": 30.0}]}
"""Breakaway angles over ground that scatters the sound, in the form of a sensor model [deg]: a wall's of 11 deg, which
the model has, would leave no echo of a slope of 20 %."""


def _fly_low(dice: Dice, turn: str) -> Flown:
    """Hover, several heights, cruise or fast climbs."""
    return draw_flight(dice, ["hover", "levels", "cruise", "fast"])


def _add_fixed(dice: Dice, scenario: Content, names: list[str], turn: str) -> None:
    """Payload, strap, gear or ice in the beams of all sensors, or of all but one."""
    duration_s = scenario["duration_s"]
    from_s = 0.0 if dice.happens(0.5) else dice.between(8.0, 25.0)
    to_s = duration_s if dice.happens(0.6) else min(round(from_s + dice.between(8.0, 25.0), 2), duration_s)
    if turn == "three of four":
        names = dice.some_of(names, 3)
    common_cm, one_thing = dice.between(20.0, 60.0), dice.happens(0.7)
    fault = {"kind": "fixed_object", "from_s": from_s, "to_s": to_s, "jitter_cm": dice.between(0.0, 1.5)}
    if dice.happens(0.4):
        fault |= {"swing_cm": dice.between(2.0, 5.0), "swing_period_s": dice.between(1.0, 4.0)}
    scenario["faults"] = [
        {
            "sensor": name,
            **fault,
            "object_cm": round(common_cm + dice.between(-3.0, 3.0), 2) if one_thing else dice.between(20.0, 60.0),
        }
        for name in names
    ]


def _fly_follow(dice: Dice, turn: str) -> Flown:
    """60 s up and down a slope at a constant height above it, from a start of the bridge in the air on."""
    # One sensor at a corner does not know the slope: at 3 m, a slope of 30 % would be 20 cm of the distance below.
    height_m = dice.between(0.8, 1.8 if turn == "1 sensor" else 4.0)
    segments = [{"kind": "step", "to_m": height_m}, hold(FOLLOW_FROM_S)]
    segments.append({"kind": "terrain", "height_m": height_m, "duration_s": 60.0})
    uphill_deg, speed_m_s = dice.between(-180.0, 180.0), dice.between(0.3, 1.0)
    slope_deg = round(math.degrees(math.atan(dice.between(0.05, 0.30))), 2)
    ground = {"slope_deg": slope_deg, "uphill_deg": uphill_deg}
    legs: Segments = [
        {"duration_s": FOLLOW_FROM_S},
        {"duration_s": 30.0, "speed_m_s": speed_m_s, "heading_deg": uphill_deg},
        {"duration_s": 28.0, "speed_m_s": speed_m_s, "heading_deg": uphill_deg + 180.0},
    ]
    flight = flown(dice, "follow", "slope", segments, ground, legs)
    flight.scenario["flight"]["heave"] = {"rms_m": dice.between(0.02, 0.15), "period_s": dice.between(1.5, 4.0)}
    return flight


def _add_nothing(dice: Dice, scenario: Content, names: list[str], turn: str) -> None:
    """No fault."""


def _add_drift(dice: Dice, scenario: Content, names: list[str], turn: str) -> None:
    """One sensor becomes slowly longer or shorter than the others."""
    from_s = dice.between(3.0, 20.0)
    to_s = min(round(from_s + dice.between(10.0, 40.0), 2), scenario["duration_s"])
    rate_cm_s = dice.between(1.5, 3.0) * (1 if turn == "longer" else -1)
    fault = {"sensor": dice.one_of(names), "kind": "drift", "from_s": from_s, "to_s": to_s, "rate_cm_s": rate_cm_s}
    scenario["faults"] = [fault]


def _fly_common(dice: Dice, turn: str) -> Flown:
    """What the common cause needs to be wrong: climbs for late answers, heights over 2.55 m for saturated ones."""
    if turn == "previous ping":
        segments = [hold(2.0)]
        for _ in range(3):
            segments += [climb(dice.between(4.0, 6.5), dice.between(0.5, 2.0)), hold(dice.between(1.0, 3.0))]
            segments += [climb(dice.between(0.8, 2.0), dice.between(0.5, 2.0)), hold(dice.between(1.0, 3.0))]
        segments.append({"kind": "land", "speed_m_s": dice.between(0.5, 1.0)})
        return flown(dice, "climbs", "flat", segments, {}, [])
    if turn == "saturated":
        while True:
            flight = draw_flight(dice, ["hover", "cruise", "cruise"], ["flat", "slope", "boxes", "boxes"])
            if max(each.get("to_m", 0.0) for each in flight.scenario["flight"]["altitude"]) > SATURATED_M:
                return flight
    if turn == "dust":
        segments = [hold(2.0), climb(dice.between(0.7, 3.0), dice.between(0.3, 1.0)), hold(dice.between(20.0, 40.0))]
        segments += [{"kind": "land", "speed_m_s": dice.between(0.3, 0.8)}, hold(3.0)]
        return flown(dice, "hover", "flat", segments, {}, [])
    return _fly_low(dice, turn)


def _add_common(dice: Dice, scenario: Content, names: list[str], turn: str) -> None:
    duration_s = scenario["duration_s"]
    from_s = dice.between(6.0, 20.0)
    to_s = duration_s if dice.happens(0.4) else min(round(from_s + dice.between(8.0, 25.0), 2), duration_s)
    when: Content = {"from_s": from_s, "to_s": to_s}
    faults: list[Content] = []
    if turn == "constant":
        if dice.happens(0.5):
            brown_out = {"kind": "power_cycle", "from_s": from_s, "to_s": round(from_s + dice.between(0.0, 1.0), 2)}
            faults.append(brown_out)
        faults.append({"kind": "constant", **when, "constant_cm": round(dice.between(20.0, 700.0))})
    elif turn == "previous ping":
        faults.append({"kind": "previous_ping", **({"from_s": 0.0, "to_s": duration_s} if dice.happens(0.5) else when)})
    elif turn == "saturated":
        faults.append({"kind": "saturated", **when})
        names = names if dice.happens(0.6) or len(names) < 4 else dice.some_of(names, 3)
    else:
        when = {"from_s": 0.0, "to_s": duration_s} if dice.happens(0.5) else when
        share, dust_cm, spread_cm = dice.between(0.2, 0.9), dice.between(50.0, 250.0), dice.between(5.0, 40.0)
        faults.append({"kind": "dust", **when, "probability": share, "dust_cm": dust_cm})
        faults.append({"kind": "noisy", **when, "probability": 0.3, "spread_cm": spread_cm})
    scenario["faults"] = [{"sensor": name, **fault} for fault in faults for name in names]


def _fly_minimum(dice: Dice, turn: str) -> Flown:
    """Sensors so low that they read their minimum while the vehicle stands, before and after a flight."""
    ground: Content = {}
    if turn == "slope":
        ground = {"slope_deg": dice.between(2.0, 8.0), "uphill_deg": dice.between(-180.0, 180.0)}
    segments = [hold(dice.between(5.0, 20.0)), climb(dice.between(1.0, 3.0), dice.between(0.3, 1.0))]
    segments += [hold(dice.between(4.0, 10.0)), climb(dice.between(0.3, 0.6), dice.between(0.3, 0.8)), hold(4.0)]
    segments.append({"kind": "land", "speed_m_s": dice.between(0.2, 0.8)})
    if turn == "bounces":
        for size in (1.0, 0.4):
            swing_m = round(size * dice.between(0.15, 0.4), 2)
            segments.append({"kind": "sinusoid", "swing_m": swing_m, "period_s": 0.8, "cycles": 1})
    segments.append(hold(dice.between(20.0, 60.0)))
    flight = flown(dice, "minimum", turn, segments, ground, [])
    flight.scenario["flight"]["standing_height_m"] = round(SENSORS_DOWN_M + dice.between(0.08, 0.18), 2)
    return flight


def _fly_banked(dice: Dice, turn: str) -> Flown:
    """Lean by 15 to 25 deg, in wind or a turn, in a climb through 5.5 to 9 m and in the descent after it."""
    before = [hold(2.0), climb(dice.between(3.0, 5.0), 1.0), hold(3.0)]
    leaning = [climb(dice.between(7.0, 10.0), dice.between(0.5, 2.0)), hold(dice.between(3.0, 10.0))]
    if dice.happens(0.5):
        leaning += [climb(dice.between(2.0, 5.0), dice.between(0.5, 1.5))]
    segments = [*before, *leaning, hold(3.0), climb(3.0, 1.0), {"kind": "land", "speed_m_s": dice.between(0.5, 0.8)}]
    flight = flown(dice, "banked", "flat", segments, {}, [])
    axis = dice.one_of(["roll_deg", "pitch_deg"])
    lean = {"from_s": round(lasts_s(before, {}) - 1.0, 2), "to_s": round(lasts_s([*before, *leaning], {}) + 1.0, 2)}
    flight.scenario["flight"]["attitude"]["leans"] = [lean | {axis: dice.one_of([-1, 1]) * dice.between(15.0, 25.0)}]
    return flight


def _fly_edge(dice: Dice, turn: str) -> Flown:
    """Over one to three edges at a constant height, or following the ground."""
    height_m, speed_m_s = dice.between(2.0, 4.0), dice.magnitude(0.1, 2.0)
    first_m, apart_m = 1.5, 4.0
    count = 1 if speed_m_s < 0.3 else 3
    steps, elevation_m = [], 0.0
    for i in range(count):
        sign = 1 if elevation_m < 0.0 else -1 if elevation_m > 0.0 else dice.one_of([-1, 1])
        rise_m = sign * min(dice.between(0.3, 2.0), height_m - 1.0)
        elevation_m += rise_m
        steps.append({"at_m": round(first_m + i * apart_m, 2), "rise_m": round(rise_m, 2)})
    way_s = round((first_m + (count - 1) * apart_m + 1.5) / speed_m_s + 2.0, 2)
    segments = [climb(height_m, 1.0), hold(2.0)]
    legs: Segments = [
        {"duration_s": round(lasts_s(segments, {}), 2)},
        {"duration_s": way_s, "speed_m_s": speed_m_s},
    ]
    follows = dice.happens(0.3)
    over = {"kind": "terrain", "height_m": height_m, "duration_s": way_s + 3.0} if follows else hold(way_s + 3.0)
    segments += [over, {"kind": "land", "speed_m_s": 0.6}]
    flight = flown(dice, "terrain" if follows else "level", "edges", segments, {"steps": steps}, legs)
    if dice.happens(0.7):
        # Two sensors over the edge before the other two, as a vehicle that flies where its nose points.
        heading_deg = dice.one_of([0.0, 90.0, 180.0, -90.0]) + dice.around(0.0, 2.0)
        flight.scenario["flight"]["attitude"]["yaw_deg"] = heading_deg
    return flight


def _add_edge(dice: Dice, scenario: Content, names: list[str], turn: str) -> None:
    if turn == "one dead":
        fault = {"sensor": dice.one_of(names), "kind": "silent", "from_s": 0.0, "to_s": scenario["duration_s"]}
        scenario["faults"] = [fault]


def _fly_boxes(dice: Dice, turn: str) -> Flown:
    """Over two boxes, each below the two sensors of one side: the ground below the middle stays the ground.

    The vehicle is so low over them, and they end so far from the middle, that the beams of the other two miss them.
    """
    boxes: list[Content] = []
    north_m, top_m = 2.0, 0.0
    for _ in range(2):
        length_m, inner_m, outer_m = dice.between(0.4, 1.5), dice.between(0.18, 0.24), dice.between(0.5, 0.9)
        centre_m = [round(north_m + length_m / 2, 2), round(dice.one_of([-1, 1]) * (inner_m + outer_m) / 2, 3)]
        box_m = round(top_m + dice.between(-0.1, 0.1), 2) if boxes else dice.between(0.4, 1.0)
        boxes.append({"centre_m": centre_m, "size_m": [length_m, round(outer_m - inner_m, 2)], "height_m": box_m})
        north_m, top_m = round(north_m + length_m + dice.between(0.5, 3.0), 2), max(top_m, box_m)
    height_m, speed_m_s = round(top_m + dice.between(0.6, 1.0), 2), dice.magnitude(0.2, 1.5)
    way_s = round((north_m + 1.0) / speed_m_s + 2.0, 2)
    segments = [climb(height_m, 1.0), hold(2.0), hold(way_s + 3.0), {"kind": "land", "speed_m_s": 0.6}]
    legs: Segments = [
        {"duration_s": round(lasts_s(segments[:2], {}), 2)},
        {"duration_s": way_s, "speed_m_s": speed_m_s},
    ]
    flight = flown(dice, "level", "boxes", segments, {"boxes": boxes}, legs, 0.5)
    flight.scenario["flight"]["attitude"]["yaw_deg"] = dice.one_of([0.0, 180.0]) + dice.around(0.0, 1.0)
    return flight


def _add_thermometer(dice: Dice, scenario: Content, names: list[str], turn: str) -> None:
    """One in a housing that was indoors, or one whose two values take turns."""
    fault = {"kind": "settle", "from_s": 0.0, "to_s": scenario["duration_s"]}
    if turn == "settles":
        air_c, indoors_c = dice.between(-18.0, -12.0), dice.between(18.0, 22.0)
        if dice.happens(0.5):
            air_c, indoors_c = indoors_c, air_c
        scenario["air"]["ground_c"] = air_c
        fault |= {"by_c": round(indoors_c - air_c, 2), "time_constant_s": dice.between(60.0, 120.0)}
    else:
        by_c = dice.one_of([-1, 1]) * dice.between(5.0, 40.0)
        fault |= {"kind": "flap", "by_c": by_c, "period_s": dice.between(2.0, 4.0)}
    scenario["thermometer"]["faults"] = [fault]


def _add_pair(dice: Dice, scenario: Content, names: list[str], turn: str) -> None:
    """Two kinds at the same time, each on a sensor or two, or on the thermometer or the attitude."""
    duration_s = scenario["duration_s"]
    from_s = dice.between(2.0, 20.0)
    when = {"from_s": from_s, "to_s": min(round(from_s + dice.between(8.0, 40.0), 2), duration_s)}
    left = dice.some_of(names, len(names))
    scenario["faults"] = []
    for kind in dice.some_of(PAIR_KINDS, 2):
        if kind == "thermometer":
            scenario["thermometer"]["faults"] = [thermometer_fault(dice, when)]
        elif kind == "attitude":
            scenario["autopilot"]["attitude_faults"] = [attitude_fault(dice, dice.one_of(ATTITUDE_KINDS), when)]
        else:
            count = dice.one_of([1, 1, 2])
            fault = sensor_fault(dice, "", kind, when)
            scenario["faults"] += [fault | {"sensor": name} for name in left[:count]]
            left = left[count:]


def _quad(dice: Dice, turn: str) -> str:
    return "quad"


def _as_turn(dice: Dice, turn: str) -> str:
    """The turn's own number of sensors."""
    return turn if turn in NUMBERS else "quad"


def _mostly_quad(dice: Dice, turn: str) -> str:
    return "quad" if dice.happens(0.7) else dice.one_of(NUMBERS)


@dataclass(frozen=True)
class Family:
    """One family."""

    turns: Sequence[str]
    """Kinds that take turns, each with a row of the table."""
    fly: Callable[[Dice, str], Flown]
    add: Callable[[Dice, Content, list[str], str], None] = _add_nothing
    """Draw the flight of a turn, and add what goes wrong in it."""
    airframe: Callable[[Dice, str], str] = _quad
    """Draws the name of the airframe."""
    healthy: Sequence[str] = ()
    """Turns in which nothing is wrong: every warning in them is a false one."""
    silence_s: float | None = None
    """Longest silence that does not count [s]; None: as in the groups."""
    objects_are_objects: bool = False
    """Whether a distance to the top of an object is a wrong one: the ground below the middle of the vehicle is true."""
    sensor_model: Content = field(default_factory=dict)
    """Changes of the sensor model's file."""


EDGE_SILENCE_S = 0.3
"""Over an edge with healthy sensors nothing excuses a longer silence [s]: three turns of one of four sensors.
ArduPilot's own limit is 0.5 s."""

FAMILIES = {
    "fixed": Family(["all four", "three of four", *NUMBERS], _fly_low, _add_fixed, _as_turn),
    "follow": Family(
        ["4 sensors", "1 sensor"],
        _fly_follow,
        airframe=_as_turn,
        healthy=["4 sensors", "1 sensor"],
        sensor_model=GRASS,
    ),
    "drift": Family(["longer", "shorter"], _fly_low, _add_drift),
    "common": Family(["constant", "previous ping", "saturated", "dust"], _fly_common, _add_common, _mostly_quad),
    "minimum": Family(
        ["level", "slope", "bounces"], _fly_minimum, airframe=_mostly_quad, healthy=["level", "slope", "bounces"]
    ),
    "banked": Family(["banked"], _fly_banked, airframe=_mostly_quad),
    "edge": Family(["healthy", "one dead"], _fly_edge, _add_edge, healthy=["healthy"], silence_s=EDGE_SILENCE_S),
    "boxes": Family(["boxes"], _fly_boxes, healthy=["boxes"], silence_s=EDGE_SILENCE_S, objects_are_objects=True),
    "outside air": Family(["settles", "flaps"], _fly_low, _add_thermometer, _mostly_quad),
    "pairs": Family(["pairs"], _fly_low, _add_pair),
}
"""Name -> family. The flights of all families take turns."""


def family_of(index: int) -> str:
    """The family of a hostile flight."""
    return list(FAMILIES)[(index - FIRST) % len(FAMILIES)]


def turn_of(index: int) -> str:
    """Which of its family's kinds a hostile flight is."""
    turns = FAMILIES[family_of(index)].turns
    return turns[(index - FIRST) // len(FAMILIES) % len(turns)]


def row_of(index: int) -> str:
    """The row of the table that a hostile flight counts in."""
    family, turn = family_of(index), turn_of(index)
    return family if turn == family else f"{family}: {turn}"


def draw_barometer(dice: Dice) -> Content:
    """A barometer as vehicles have it: ground effect, gusts, and air that is not that of the standard.

    PX4 and ArduPilot allow for ground effects of 4 or 5 m; most logs have less, of either sign. Wind of 5 m/s is a
    dynamic pressure of 15 Pa, 1.2 m, of which a third reaches a barometer in its case.
    """
    return {
        "ground_effect_m": dice.one_of([-1, -1, 1]) * dice.magnitude(0.5, 3.0),
        "ground_effect_height_m": dice.between(0.4, 1.2),
        "gust_m": 0.0 if dice.happens(0.4) else dice.between(0.1, 0.5),
        "gust_s": dice.between(1.0, 5.0),
        "in_air_temperature": True,
    }
