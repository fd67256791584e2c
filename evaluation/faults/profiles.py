"""What the vehicle of a campaign's flight does, and over which ground.

Dice enter; a flight's sections of a scenario leave: altitude profile, track, attitude, ground and duration. Most
flights last 40 to 75 s, and all end on the ground.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from evaluation.faults.dice import Dice
from msp_sim.world.surfaces import GroundSection
from msp_sim.world.vehicle import FlightSection, Vehicle
from msp_sim.world.world import AirSection, World

Segments = list[dict[str, Any]]

HOVER_S = 300.0
"""Length of a flight of the group 'hover', which counts false objects [s]: most of it is hover."""
SHORTEST_S, LONGEST_S = 40.0, 70.0
"""A flight that would be shorter hovers longer [s]."""
CRUISE_S = 30.0
"""Time over the ground in a cruise [s]."""
LOWEST_CRUISE_M = 3.0
"""Steps and boxes are up to 1.6 m high together [m]."""
GROUNDS = ["flat", "slope", "rough", "steps", "boxes"]


@dataclass(frozen=True)
class Flown:
    """A flight's part of a scenario, and the names of profile and ground."""

    kind: str
    ground: str
    scenario: dict[str, Any]


def draw_flight(
    dice: Dice, kinds: Sequence[str] = (), grounds: Sequence[str] = GROUNDS, *, hover: bool = False
) -> Flown:
    """Draw a profile, one of ``kinds`` or of all, and the ground below it, one of ``grounds`` where it moves; with
    ``hover`` a long hover over level ground."""
    kind = "hover" if hover else dice.one_of(kinds or list(_PROFILES))
    moving = kind in ("cruise", "high")
    name = "flat"
    if moving:
        name = dice.one_of(grounds)
    elif not hover and dice.happens(0.3):
        name = dice.one_of(["slope", "rough"])
    ground = _ground(dice, name)
    segments = _PROFILES[kind](dice)
    if kind == "cruise":
        height_m = segments[0]["to_m"]
        follow = {"kind": "terrain", "height_m": height_m, "duration_s": CRUISE_S}
        segments.append(follow if name == "slope" or dice.happens(0.3) else hold(CRUISE_S))
    legs: Segments = []
    if moving:
        speed_m_s = dice.between(0.4, 0.8 if name == "slope" else 1.5)
        wait_s = round(lasts_s(segments[:1], ground) + 1.0, 2)
        legs = [{"duration_s": wait_s}, {"duration_s": CRUISE_S - 8.0, "speed_m_s": speed_m_s}]
    wanted_s = HOVER_S if hover else dice.between(SHORTEST_S, LONGEST_S)
    segments.append(hold(max(wanted_s - lasts_s(segments, ground) - 10.0, 3.0)))
    segments.append({"kind": "land", "speed_m_s": dice.between(0.4, 0.8)})
    return flown(dice, kind, name, segments, ground, legs)


def flown(
    dice: Dice, kind: str, name: str, segments: Segments, ground: dict[str, Any], legs: Segments, most_deg: float = 1.5
) -> Flown:
    """A flight of these segments over a ground, with a drawn heading and a sway of up to ``most_deg`` rms."""
    sway_deg = dice.between(0.0, most_deg)
    sway = {"roll_rms_deg": sway_deg, "pitch_rms_deg": sway_deg, "period_s": 2.5}
    attitude = {"yaw_deg": dice.between(-180.0, 180.0), "sway": sway}
    flight = {"altitude": segments, "track": {"legs": legs}, "attitude": attitude}
    duration_s = round(lasts_s(segments, ground, legs) + 1.5, 2)
    return Flown(kind, name, {"duration_s": duration_s, "flight": flight, "ground": ground})


def climb(to_m: float, speed_m_s: float, acceleration_m_s2: float = 1.0) -> dict[str, Any]:
    """Take off, climb or descend."""
    return {"kind": "climb", "to_m": to_m, "speed_m_s": speed_m_s, "acceleration_m_s2": acceleration_m_s2}


def hold(duration_s: float) -> dict[str, Any]:
    """Keep the height."""
    return {"kind": "hold", "duration_s": round(duration_s, 2)}


def _hover(dice: Dice) -> Segments:
    return [hold(2.0), climb(dice.between(1.0, 7.0), dice.between(0.5, 1.5))]


def _levels(dice: Dice) -> Segments:
    """Several heights, at the speeds of everyday flying."""
    segments = [hold(2.0)]
    for _ in range(3):
        segments += [climb(dice.between(0.8, 7.0), dice.between(0.5, 1.5)), hold(dice.between(3.0, 8.0))]
    return segments


def _fast(dice: Dice) -> Segments:
    """Climbs of up to 5 m/s and descents of 2 to 3 m/s."""
    segments = [climb(dice.between(0.8, 2.0), 1.0), hold(3.0)]
    for _ in range(2):
        up = climb(dice.between(5.0, 7.0), dice.between(2.0, 5.0), dice.between(2.0, 4.0))
        down = climb(dice.between(0.8, 2.0), dice.between(2.0, 3.0), dice.between(2.0, 3.0))
        segments += [up, hold(dice.between(2.0, 6.0)), down, hold(dice.between(2.0, 6.0))]
    return segments


def _high(dice: Dice) -> Segments:
    """Above what the sensors can measure, and back."""
    up = climb(dice.between(8.5, 12.0), dice.between(1.0, 3.0), 2.0)
    down = climb(dice.between(2.5, 5.0), dice.between(0.8, 3.0), 2.0)
    return [up, hold(dice.between(8.0, 20.0)), down, hold(CRUISE_S / 2)]


def _cruise(dice: Dice) -> Segments:
    return [climb(dice.between(LOWEST_CRUISE_M, 6.0), dice.between(0.7, 1.5)), hold(2.0)]


def _restart(dice: Dice) -> Segments:
    """The bridge starts in the air: above the sensors' range, in a descent or a climb of 2 m/s, or at rest."""
    start = dice.one_of(["above", "above", "descent", "descent", "climb", "rest", "rest", "rest"])
    low_m, high_m = dice.between(1.0, 2.0), dice.between(5.5, 7.0)
    ramp_s = round((high_m - low_m) / 2.0, 2)
    from_m, moves = {
        "above": (
            dice.between(8.5, 12.0),
            [hold(dice.between(5.0, 10.0)), climb(dice.between(2.0, 5.0), dice.between(1.0, 3.0), 2.0)],
        ),
        "descent": (high_m, [{"kind": "ramp", "to_m": low_m, "duration_s": ramp_s}]),
        "climb": (low_m, [{"kind": "ramp", "to_m": high_m, "duration_s": ramp_s}]),
        "rest": (dice.between(1.0, 7.0), []),
    }[start]
    then = [hold(dice.between(8.0, 15.0)), climb(dice.between(1.0, 6.0), 1.0)]
    return [{"kind": "step", "to_m": from_m}, *moves, *then]


_PROFILES: dict[str, Callable[[Dice], Segments]] = {
    "hover": _hover,
    "levels": _levels,
    "fast": _fast,
    "high": _high,
    "cruise": _cruise,
    "restart": _restart,
}


def _ground(dice: Dice, name: str) -> dict[str, Any]:
    """Level, sloped, rough, stepped or boxed ground; the way leads north."""
    if name == "slope":
        return {"slope_deg": dice.between(1.0, 6.0), "uphill_deg": dice.between(-180.0, 180.0)}
    if name == "rough":
        return {"rough": {"grass": {"rms_m": dice.between(0.01, 0.03)}}}
    if name == "steps":
        larger = dice.between(0.7, 1.3)
        rises_m = [round(each * larger, 2) for each in dice.some_of([0.3, 0.5, -0.8, 0.4, -0.4], 5)]
        return {"steps": [{"at_m": 3.0 + 4.0 * i, "rise_m": rise_m} for i, rise_m in enumerate(rises_m)]}
    if name == "boxes":
        boxes = [
            {
                "centre_m": [4.0 + 4.0 * i, dice.between(-0.6, 0.6)],
                "size_m": [dice.between(0.4, 2.0), dice.between(0.3, 1.5)],
                "height_m": dice.between(0.3, 1.5),
            }
            for i in range(5)
        ]
        return {"boxes": boxes}
    return {}


def lasts_s(segments: Segments, ground: dict[str, Any], legs: Sequence[dict[str, Any]] = ()) -> float:
    """How long segments take [s], at rest over the start where there are no legs."""
    flight = FlightSection.model_validate({"altitude": segments, "track": {"legs": legs}})
    return Vehicle(
        flight, World(GroundSection.model_validate(ground), AirSection()).elevation_m, np.random.default_rng(0)
    ).duration_s
