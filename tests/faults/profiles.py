"""What the vehicle of a campaign's flight does, and over which ground.

A numpy Generator enters; a flight's sections of a scenario leave: altitude profile, track, attitude, ground and
duration. Every flight lasts about 40 to 75 s and ends on the ground.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.random import Generator

from msp_sim.surfaces import Ground
from msp_sim.vehicle import Flight, Vehicle
from msp_sim.world import Air, World

Segments = list[dict[str, Any]]

HOVER_S = 300.0
"""Length of a flight of the group 'hover', which counts false objects [s]: most of it is hover."""
CRUISE_S = 30.0
"""Time over the ground in a cruise [s]."""
LOWEST_OVER_OBSTACLES_M = 3.0
"""Lowest cruise over steps and boxes, which are up to 1.6 m high together [m]."""
SHORTEST_S, LONGEST_S = 40.0, 70.0
"""A flight that would be shorter hovers longer [s]."""


@dataclass(frozen=True)
class Flown:
    """A flight's part of a scenario, and the names of profile and ground."""

    kind: str
    ground: str
    scenario: dict[str, Any]


def draw_flight(generator: Generator, *, hover: bool = False) -> Flown:
    """Draw a profile and the ground below it; with ``hover`` a long hover over level ground."""
    kind = "hover" if hover else str(generator.choice(list(_PROFILES)))
    segments = _PROFILES[kind](generator)
    ground_name = "flat"
    if kind in ("cruise", "high"):
        ground_name = str(generator.choice(["flat", "slope", "rough", "steps", "boxes"], p=[0.2, 0.2, 0.2, 0.2, 0.2]))
    elif generator.random() < 0.3:
        ground_name = str(generator.choice(["slope", "rough"]))
    ground = _ground(generator, ground_name)
    moving = kind in ("cruise", "high")
    if kind == "cruise":
        height_m = _rounded(generator.uniform(LOWEST_OVER_OBSTACLES_M, 6.0))
        segments = [_climb(height_m, generator.uniform(0.7, 1.5)), _hold(2.0)]
        follow = {"kind": "terrain", "height_m": height_m, "duration_s": CRUISE_S}
        segments.append(follow if ground_name == "slope" or generator.random() < 0.3 else _hold(CRUISE_S))
    before_s = _lasts_s(segments[:1], ground)
    spare_s = (HOVER_S if hover else generator.uniform(SHORTEST_S, LONGEST_S)) - _lasts_s(segments, ground) - 10.0
    segments.append(_hold(max(spare_s, 3.0)))
    segments.append({"kind": "land", "speed_m_s": _rounded(generator.uniform(0.4, 0.8))})
    legs: list[dict[str, Any]] = []
    if moving:
        speed_m_s = _rounded(generator.uniform(0.4, 0.8 if ground_name == "slope" else 1.5))
        legs = [
            {"duration_s": _rounded(before_s + 1.0)},
            {"duration_s": CRUISE_S - 8.0, "speed_m_s": speed_m_s, "heading_deg": 0.0},
        ]
    sway_deg = _rounded(generator.uniform(0.0, 1.5))
    attitude: dict[str, Any] = {"yaw_deg": _rounded(generator.uniform(-180.0, 180.0))}
    if sway_deg > 0.2:
        attitude["sway"] = {"roll_rms_deg": sway_deg, "pitch_rms_deg": sway_deg, "period_s": 2.5}
    flight = {"altitude": segments, "track": {"legs": legs}, "attitude": attitude}
    duration_s = _rounded(_lasts_s(segments, ground, legs) + 1.5)
    return Flown(kind, ground_name, {"duration_s": duration_s, "flight": flight, "ground": ground})


def _rounded(value: float) -> float:
    return round(float(value), 2)


def _climb(to_m: float, speed_m_s: float, acceleration_m_s2: float = 1.0) -> dict[str, Any]:
    return {
        "kind": "climb",
        "to_m": _rounded(to_m),
        "speed_m_s": _rounded(speed_m_s),
        "acceleration_m_s2": _rounded(acceleration_m_s2),
    }


def _hold(duration_s: float) -> dict[str, Any]:
    return {"kind": "hold", "duration_s": _rounded(duration_s)}


def _hover(generator: Generator) -> Segments:
    return [_hold(2.0), _climb(generator.uniform(1.0, 7.0), generator.uniform(0.5, 1.5))]


def _levels(generator: Generator) -> Segments:
    """Several heights, at the speeds of everyday flying."""
    segments = [_hold(2.0)]
    for _ in range(3):
        segments += [_climb(generator.uniform(0.8, 7.0), generator.uniform(0.5, 1.5)), _hold(generator.uniform(3, 8))]
    return segments


def _fast(generator: Generator) -> Segments:
    """Climbs of up to 5 m/s and descents of 2 to 3 m/s."""
    segments = [_climb(generator.uniform(0.8, 2.0), 1.0), _hold(3.0)]
    for _ in range(2):
        up = _climb(generator.uniform(5.0, 7.0), generator.uniform(2.0, 5.0), generator.uniform(2.0, 4.0))
        down = _climb(generator.uniform(0.8, 2.0), generator.uniform(2.0, 3.0), generator.uniform(2.0, 3.0))
        segments += [up, _hold(generator.uniform(2.0, 6.0)), down, _hold(generator.uniform(2.0, 6.0))]
    return segments


def _high(generator: Generator) -> Segments:
    """Above what the sensors can measure, and back."""
    up = _climb(generator.uniform(8.5, 12.0), generator.uniform(1.0, 3.0), 2.0)
    down = _climb(generator.uniform(2.5, 5.0), generator.uniform(0.8, 3.0), 2.0)
    return [up, _hold(generator.uniform(8.0, 20.0)), down, _hold(CRUISE_S - 15.0)]


def _restart(generator: Generator) -> Segments:
    """The bridge starts in the air: at rest, in a descent or in a climb, within the sensors' range or above it."""
    draw = generator.random()
    if draw < 0.25:
        from_m, moves = generator.uniform(8.5, 12.0), [_hold(generator.uniform(5.0, 10.0))]
        moves.append(_climb(generator.uniform(2.0, 5.0), generator.uniform(1.0, 3.0), 2.0))
    elif draw < 0.5:
        from_m, to_m = generator.uniform(5.5, 7.0), generator.uniform(1.0, 2.0)
        moves = [{"kind": "ramp", "to_m": _rounded(to_m), "duration_s": _rounded((from_m - to_m) / 2.0)}]
    elif draw < 0.6:
        from_m, to_m = generator.uniform(1.0, 2.0), generator.uniform(5.0, 7.0)
        moves = [{"kind": "ramp", "to_m": _rounded(to_m), "duration_s": _rounded((to_m - from_m) / 2.0)}]
    else:
        from_m, moves = generator.uniform(1.0, 7.0), []
    then = _climb(generator.uniform(1.0, 6.0), 1.0)
    return [{"kind": "step", "to_m": _rounded(from_m)}, *moves, _hold(generator.uniform(8.0, 15.0)), then]


_PROFILES: dict[str, Callable[[Generator], Segments]] = {
    "hover": _hover,
    "levels": _levels,
    "fast": _fast,
    "high": _high,
    "cruise": lambda generator: [],
    "restart": _restart,
}


def _ground(generator: Generator, name: str) -> dict[str, Any]:
    """Level, sloped, rough, stepped or boxed ground; the way leads north."""
    if name == "slope":
        return {
            "slope_deg": _rounded(generator.uniform(1.0, 6.0)),
            "uphill_deg": _rounded(generator.uniform(-180.0, 180.0)),
        }
    if name == "rough":
        return {"rough": {"grass": {"rms_m": round(float(generator.uniform(0.01, 0.03)), 3)}}}
    if name == "steps":
        rises_m = generator.permutation([0.3, 0.5, -0.8, 0.4, -0.4]) * generator.uniform(0.7, 1.3)
        return {"steps": [{"at_m": 3.0 + 4.0 * i, "rise_m": _rounded(rise)} for i, rise in enumerate(rises_m)]}
    if name == "boxes":
        boxes = [
            {
                "centre_m": [4.0 + 4.0 * i, _rounded(generator.uniform(-0.6, 0.6))],
                "size_m": [_rounded(generator.uniform(0.4, 2.0)), _rounded(generator.uniform(0.3, 1.5))],
                "height_m": _rounded(generator.uniform(0.3, 1.5)),
            }
            for i in range(5)
        ]
        return {"boxes": boxes}
    return {}


def _lasts_s(segments: Segments, ground: dict[str, Any], legs: Sequence[dict[str, Any]] = ()) -> float:
    """How long segments take, at rest over the start where there are no legs."""
    if not segments:
        return 0.0
    flight = Flight.model_validate({"altitude": segments, "track": {"legs": legs}})
    return Vehicle(flight, World(Ground.model_validate(ground), Air()).elevation_m, np.random.default_rng(0)).duration_s
