"""The points of a campaign, in the order that leaves a person the least to change.

A `Campaign` becomes an ordered tuple of `Point` s: each a set-up, the columns that hold for its readings, and how many
of them. Experiments keep the order of the file. Within one, what is slow to change (sensors, air, target) varies last
and what is quick (angle, transmitter) first, alternately forwards and backwards, so that only one thing changes from
one point to the next. An experiment starts at the end at which the previous one stopped.
"""

import itertools
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, TypeVar

from msp_lab.campaigns.campaign import BenchAir, BenchTarget, Campaign, Experiment, External, Firing
from msp_range.yaml_file import ConfigError

Level = TypeVar("Level")

SETUP_S = {
    "sensors": 600.0,
    "air": 900.0,
    "target": 120.0,
    "vibration_hz": 60.0,
    "range_cm": 60.0,
    "source": 30.0,
    "angle_deg": 10.0,
    "movement": 20.0,
}
"""Time that a person needs to change each part of a set-up [s]: guesses, which decide only the estimate of the time
that is left."""


@dataclass(frozen=True)
class Transmitter:
    """A transmitter next to the bench; ``duty`` 0 is one that is switched off."""

    duty: float
    level_db: float | None = None
    distance_cm: float | None = None
    frequency_khz: float | None = None


@dataclass(frozen=True)
class Movement:
    """A target on its way; ``rate_cm_s`` is positive where it goes away, ``number`` counts repeated movements."""

    to_cm: float
    rate_cm_s: float
    number: int


@dataclass(frozen=True)
class Setup:
    """The set-up of a point; a movement starts at ``range_cm``."""

    sensors: tuple[str, ...]
    apart_cm: float | None
    air: BenchAir
    target: BenchTarget
    vibration_hz: float
    range_cm: float
    source: Transmitter | None
    angle_deg: float
    movement: Movement | None = None


@dataclass(frozen=True)
class Point:
    """One set-up and its readings."""

    name: str
    """Unique in the campaign."""
    condition: str
    """The experiment, as in the column of that name."""
    setup: Setup
    """What to set up."""
    firing: Firing
    """Order of the pings of several sensors."""
    readings: int
    """Number of readings of each sensor."""
    question: str = ""
    note: str = ""
    """Question and instructions of the experiment."""

    @property
    def columns(self) -> dict[str, float | str]:
        """Context of all its readings by column; ``true_range_cm`` is where a movement starts."""
        setup = self.setup
        at_sensor_c, at_target_c = setup.air.air_temperature_c, setup.air.target_temperature_c
        source = setup.source or Transmitter(duty=0.0)
        columns: dict[str, float | str | None] = {
            "true_range_cm": setup.range_cm,
            "condition": self.condition,
            "air_temperature_c": at_sensor_c,
            "target_temperature_c": at_sensor_c if at_target_c is None else at_target_c,
            "humidity_pct": setup.air.humidity_pct,
            "incidence_deg": setup.angle_deg,
            "range_rate_cm_s": 0.0 if setup.movement is None else setup.movement.rate_cm_s,
            "vibration_hz": setup.vibration_hz,
            "target": setup.target.material,
            "target_size_cm": None if setup.target.size_cm is None else min(setup.target.size_cm),
            "external_level_db": source.level_db,
            "external_duty": source.duty,
            "external_distance_cm": source.distance_cm,
            "external_frequency_khz": source.frequency_khz,
        }
        return {name: value for name, value in columns.items() if value is not None}


def make_plan(campaign: Campaign) -> tuple[Point, ...]:
    """Return all points of a campaign in order.

    Raises
    ------
    ConfigError
        A target that moves so fast that there is no time for a reading.
    """
    points: list[Point] = []
    for condition in campaign.conditions:
        points.extend(_points_of(campaign, condition, points[-1].setup if points else None))
    repeated = Counter[str]()
    for number, point in enumerate(points):
        repeated[point.name] += 1
        if (again := repeated[point.name]) > 1:
            points[number] = replace(point, name=f"{point.name}-again{again}")
    return tuple(points)


def reading_interval_s(campaign: Campaign, sensors: Sequence[str], firing: Firing) -> float:
    """Time from one reading of a sensor to its next one [s]."""
    interval_s = max(campaign.sensor(name).sensor_model.timing.ping_interval_s for name in sensors)
    return interval_s * (len(sensors) if firing == "sequential" else 1)


def reading_s(campaign: Campaign, point: Point) -> float:
    """Time that the readings of a point take [s]."""
    return point.readings * reading_interval_s(campaign, point.setup.sensors, point.firing)


def setup_s(before: Point | None, after: Point) -> float:
    """Time that a person may need from one point to the next [s]."""
    return sum(SETUP_S.get(key, 0.0) for key in _changed(before, after))


def _changed(before: Point | None, after: Point) -> set[str]:
    """What of the set-up differs from the point before, by its name in `Setup`; without one all does."""
    names = {field.name for field in fields(Setup)}
    if before is None:
        return names
    return {name for name in names if getattr(before.setup, name) != getattr(after.setup, name)}


def _points_of(campaign: Campaign, condition: Experiment, before: Setup | None) -> Iterator[Point]:
    sensors = condition.sensors or (campaign.sensors[0].name,)
    levels_of: dict[str, Sequence[Any]] = {
        "air": condition.air or (campaign.room,),
        "target": condition.targets,
        "vibration_hz": condition.vibrations_hz,
        "range_cm": condition.ranges_cm,
        "source": _sources(condition.external),
        "angle_deg": condition.angles_deg,
    }
    factors = {key: _from(levels, before and getattr(before, key)) for key, levels in levels_of.items()}
    varied = {key for key, levels in factors.items() if len(levels) > 1}
    readings = condition.readings or campaign.readings
    for levels in _there_and_back([*factors.values()]):
        standing = Setup(sensors=sensors, apart_cm=condition.apart_cm, **dict(zip(factors, levels, strict=True)))
        for firing in condition.firing:
            interval_s = reading_interval_s(campaign, sensors, firing)
            for setup, of_setup in _movements(condition, standing, readings, interval_s):
                word = f"_{firing}" if len(condition.firing) > 1 else ""
                name = "-".join([condition.condition + word, *_words(setup, varied)])
                yield Point(
                    name, condition.condition + word, setup, firing, of_setup, condition.question, condition.setup
                )


def _sources(external: External | None) -> list[Transmitter | None]:
    if external is None:
        return [None]
    on: list[Transmitter | None] = [
        Transmitter(duty, level_db, distance_cm, frequency_khz)
        for distance_cm, frequency_khz, level_db, duty in _there_and_back(
            [external.distances_cm, external.frequencies_khz, external.levels_db, external.duties]
        )
    ]
    return [Transmitter(duty=0.0), *on] if external.quiet else on


def _movements(condition: Experiment, standing: Setup, readings: int, interval_s: float) -> Iterator[tuple[Setup, int]]:
    """The set-up itself, or one per movement, with its number of readings."""
    if condition.moving is None:
        yield standing, readings
        return
    length_cm = condition.moving.to_cm - standing.range_cm
    for rate_cm_s in condition.moving.rates_cm_s:
        of_one = math.floor(abs(length_cm) / rate_cm_s / interval_s)
        if of_one < 1:
            raise ConfigError(
                f"condition {condition.condition}: moving: {abs(length_cm):g} cm at {rate_cm_s:g} cm/s end before "
                f"one reading, which takes {interval_s:g} s; expected a slower or longer movement"
            )
        for number in range(1, math.ceil(readings / of_one) + 1):
            movement = Movement(condition.moving.to_cm, math.copysign(rate_cm_s, length_cm), number)
            yield replace(standing, movement=movement), of_one


def _from(levels: Sequence[Level], before: Level | None) -> list[Level]:
    """The levels, in the order that starts nearest to where the previous experiment stopped."""
    ordered = list(levels)
    if before in ordered and isinstance(before, (BenchAir, BenchTarget)):
        ordered.remove(before)
        return [before, *ordered]
    first, last = ordered[0], ordered[-1]
    if isinstance(before, float) and isinstance(first, float) and isinstance(last, float):
        return ordered[::-1] if abs(last - before) < abs(first - before) else ordered
    return ordered


def _there_and_back(factors: Sequence[Sequence[Any]]) -> list[tuple[Any, ...]]:
    """Every combination, the last factor varying first; consecutive ones differ in one factor by one level."""
    if not factors:
        return [()]
    inner = _there_and_back(factors[1:])
    turns = itertools.cycle((inner, inner[::-1]))
    return [(level, *rest) for level, turn in zip(factors[0], turns, strict=False) for rest in turn]


def _words(setup: Setup, varied: set[str]) -> Iterator[str]:
    """The parts of a point's name: what varies in its experiment, and always the range."""
    if "air" in varied:
        known = [setup.air.air_temperature_c, setup.air.humidity_pct]
        yield "_".join(f"{value:g}{unit}" for value, unit in zip(known, ("C", "pct"), strict=True) if value is not None)
    if "target" in varied:
        size_cm = setup.target.size_cm
        size = "" if size_cm is None else f"_{size_cm[0]:g}x{size_cm[1]:g}cm"
        yield setup.target.material.replace(" ", "_") + size
    if "vibration_hz" in varied:
        yield f"{setup.vibration_hz:g}Hz"
    yield f"{setup.range_cm:g}cm"
    if "source" in varied and setup.source is not None:
        yield _source_word(setup.source)
    if "angle_deg" in varied:
        yield f"{setup.angle_deg:+g}deg"
    if setup.movement is not None:
        yield f"{setup.movement.rate_cm_s:+g}cm_s_{setup.movement.number}"


def _source_word(source: Transmitter) -> str:
    if source.duty == 0.0:
        return "quiet"
    return f"{source.frequency_khz:g}kHz_{source.level_db:g}dB_duty{source.duty:g}_{source.distance_cm:g}cm_off"


def changes(before: Point | None, after: Point) -> list[str]:
    """Return what to change from one point to the next, the slow things first; empty: nothing.

    Examples
    --------
    >>> from msp_lab.campaigns.campaign import load_campaign
    >>> points = make_plan(load_campaign("configs/campaigns/table_4_1.yaml"))
    >>> changes(points[0], points[1])
    ['Move the target to 60 cm (it was at 40 cm).']
    """
    old, new = before.setup if before is not None else None, after.setup
    found = [after.note] if after.note and not (before and before.note == after.note) else []
    changed = _changed(before, after)
    if changed & {"sensors", "apart_cm"}:
        found.append(_sensors_words(new))
    if "air" in changed:
        found.extend(_air_words(old.air if old is not None else None, new.air))
    if "target" in changed:
        found.append(_target_words(new.target))
    if new.vibration_hz != (old.vibration_hz if old is not None else 0.0):
        on = f"Vibrate the sensor's housing at {new.vibration_hz:g} Hz."
        found.append(on if new.vibration_hz else "Switch the vibration off.")
    if changed & {"range_cm", "target"} or (old is not None and old.movement is not None):
        found.append(_range_words(old, new))
    if "angle_deg" in changed:
        turned = "Face the target squarely" if new.angle_deg == 0.0 else f"Turn the sensor to {new.angle_deg:+g} deg"
        found.append(f"{turned}." if old is None else f"{turned} (it was at {old.angle_deg:+g} deg).")
    if new.source != (old.source if old is not None else None):
        found.append(_source_words(new.source))
    if new.movement is not None:
        found.append(
            f"Then move the target to {new.movement.to_cm:g} cm at {abs(new.movement.rate_cm_s):g} cm/s, "
            "and press Enter as it starts."
        )
    return found


def _sensors_words(setup: Setup) -> str:
    if len(setup.sensors) == 1:
        return f"Connect and mount {setup.sensors[0]} alone."
    apart = "" if setup.apart_cm is None else f", {setup.apart_cm:g} cm apart"
    return f"Connect and mount {' and '.join(setup.sensors)} side by side{apart}, facing the same target."


def _air_words(before: BenchAir | None, air: BenchAir) -> Iterator[str]:
    if before is not None and before.how:
        yield "Undo what was done to the air: fans off, boxes away."
    ends_c = (air.air_temperature_c, air.target_temperature_c)
    before_c = None if before is None else (before.air_temperature_c, before.target_temperature_c)
    if air.air_temperature_c is not None and ends_c != before_c:
        far_c = air.target_temperature_c
        far = "" if far_c in (None, air.air_temperature_c) else f", and leave {far_c:g} deg C at the target"
        yield f"Set the air at the sensor to {air.air_temperature_c:g} deg C{far}."
    if air.humidity_pct is not None and (before is None or before.humidity_pct != air.humidity_pct):
        yield f"Set the air to {air.humidity_pct:g} % relative humidity."
    if air.how:
        yield air.how


def _target_words(target: BenchTarget) -> str:
    size = "" if target.size_cm is None else f", {target.size_cm[0]:g} by {target.size_cm[1]:g} cm"
    how = f" {target.how}" if target.how else ""
    return f"Target: {target.material}{size}.{how}"


def _range_words(old: Setup | None, new: Setup) -> str:
    what, to = ("target", "to") if new.target.size_cm is not None else ("sensor", "so that the distance is")
    if old is not None and old.range_cm == new.range_cm and old.movement is None:
        return f"Check that it is at {new.range_cm:g} cm again."
    was = "" if old is None or old.movement is not None else f" (it was at {old.range_cm:g} cm)"
    return f"Move the {what} {to} {new.range_cm:g} cm{was}."


def _source_words(source: Transmitter | None) -> str:
    if source is None:
        return "Remove the transmitter."
    if source.duty == 0.0:
        return "Switch the transmitter off."
    return (
        f"Set the transmitter to {source.frequency_khz:g} kHz, {source.level_db:g} dB at 30 cm from it, "
        f"{source.duty:.0%} of the time, {source.distance_cm:g} cm from the sensor."
    )
