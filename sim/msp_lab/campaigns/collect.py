"""Collect the readings of a campaign: set up a point, read it, review it, and go on to the next one.

For each point the operator (a person or a program) sets it up, the bench gives readings, and the store keeps them. A
ping without a usable answer is recorded with its status and repeated; where answers stay away, the operator is asked.
"""

import difflib
from collections import Counter
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from math import cos, radians
from pathlib import Path
from typing import Protocol

from msp_lab.campaigns.bench import Bench, rangings
from msp_lab.campaigns.campaign import Campaign, load_campaign
from msp_lab.campaigns.plan import Point, changes, make_plan
from msp_lab.campaigns.store import Attempt, Store
from msp_lab.campaigns.watch import Outlier, PointWatch
from msp_range.reading import Reading
from msp_range.yaml_file import ConfigError

TROUBLE_AFTER = 20
"""Ask the operator after this many pings in a row without a usable answer: 2 s of a sensor at 10 Hz, which no single
fault of the bus lasts. A smaller number asks about single faults, a larger one lets a person wait."""
GIVE_UP_AFTER = 5
"""Skip a point after asking this many times about it, so that an unattended collection comes to its end."""
STEADY_C = 0.05
"""Record a new air temperature where it differs by this or more [deg C]: 0.01 % of a range. A smaller value writes the
thermometer's noise into every reading."""


class Decision(Enum):
    """The operator's decision."""

    GO = "go"
    SKIP = "skip"
    AGAIN = "again"
    STOP = "stop"


@dataclass(frozen=True)
class Arranged:
    """A set-up as it is; ``measured`` holds the columns that differ from the plan."""

    decision: Decision
    measured: Mapping[str, float] = field(default_factory=dict)


class Operator(Protocol):
    """A person, or a program, who sets up points and reviews readings."""

    def arrange(self, point: Point, to_change: Sequence[str], place: "Place") -> Arranged:
        """Set a point up. AGAIN reads the point before once more, SKIP leaves this one for later."""

    def on_reading(
        self, point: Point, watches: Mapping[str, PointWatch], reading: Reading, outlier: Outlier | None
    ) -> Decision:
        """Receive each reading when it arrives; STOP ends the session, everything else continues."""

    def review(self, point: Point, watches: Mapping[str, PointWatch]) -> Decision:
        """Review a point that has been read; AGAIN reads it once more, STOP ends the session."""

    def on_trouble(self, text: str) -> Decision:
        """Receive a report on a silent sensor; GO tries again, SKIP leaves the point, STOP ends the session."""


@dataclass(frozen=True)
class Place:
    """Position in the campaign."""

    number: int
    of: int
    """Number of this point, and of all."""
    had: int
    """Readings of this point that are recorded already, of its first sensor."""


@dataclass(frozen=True)
class Collection:
    """A campaign, and which of its points are to be read."""

    campaign: Campaign
    points: tuple[Point, ...]
    """The plan of the campaign."""
    wanted: Container[str]
    """Names of the points that are to be read, unless they are recorded."""
    again: Container[str] = ()
    """Names of points that are to be read although they are done."""

    def store(self, folder: Path, bench: Bench) -> Store:
        """The folder for the readings of this campaign at a bench; raises as `Store`."""
        return Store(folder, self.points, bench.description, bench.clock, self.campaign.files)

    def todo(self, store: Store) -> list[Point]:
        """The points that are to be read, in the order of the plan."""
        return [
            point
            for point in self.points
            if point.name in self.again or (point.name in self.wanted and not store.is_done(point))
        ]

    def left(self, store: Store) -> str:
        """Text with the number of points that are not read yet."""
        return f"{sum(not store.is_done(point) for point in self.points)} of {len(self.points)} points are left"


def load_collection(campaign_file: Path, only: Sequence[str], repeat: Sequence[str]) -> Collection:
    """The campaign, and the points that a command's options select.

    Raises
    ------
    ConfigError
        The campaign file cannot be used, or no point has such a name.
    """
    campaign = load_campaign(campaign_file)
    points = make_plan(campaign)
    again = chosen(points, repeat, "--repeat")
    # --repeat alone reads nothing else.
    return Collection(campaign, points, chosen(points, only or ([] if repeat else [""]), "--only"), again)


def collect_readings(collection: Collection, bench: Bench, store: Store, operator: Operator) -> None:
    """Read the points that are to be read, in the order of the plan; skipped ones come again at the end.

    Parameters
    ----------
    collection
        The campaign, and its points to be read.
    bench
        The bench with the sensors.
    store
        The folder in which readings are recorded.
    operator
        The person or program that sets points up.
    """
    _Session(collection, bench, store, operator).go_through(collection.todo(store))


def chosen(points: Sequence[Point], beginnings: Sequence[str], option: str) -> frozenset[str]:
    """Return the names of the points that begin with one of ``beginnings``.

    Raises
    ------
    ConfigError
        No point begins with one of them.
    """
    found: set[str] = set()
    for beginning in beginnings:
        names = [point.name for point in points if point.name.startswith(beginning)]
        if not names:
            near = difflib.get_close_matches(beginning, [point.name for point in points], n=1, cutoff=0.0)
            raise ConfigError(f"{option} {beginning}: no point's name begins so; one is {near[0]} (see --plan)")
        found.update(names)
    return frozenset(found)


@dataclass
class _Session:
    """One session at the bench."""

    collection: Collection
    bench: Bench
    store: Store
    operator: Operator
    before: Point | None = None
    """The point that was set up last; None: none in this session."""

    def go_through(self, todo: Sequence[Point]) -> None:
        skipped: list[Point] = []
        for last_round in (False, True):
            for point in skipped if last_round else todo:
                decision = self._visit(point, anew=point.name in self.collection.again)
                if decision is Decision.STOP:
                    return
                if decision is Decision.SKIP and not last_round:
                    skipped.append(point)

    def _visit(self, point: Point, *, anew: bool) -> Decision:
        """Set up and read a point until it is kept."""
        while True:
            attempt = self.store.next_attempt(point, again=anew)
            number, of = self.collection.points.index(point) + 1, len(self.collection.points)
            place = Place(number, of, had=attempt.readings[point.setup.sensors[0]])
            arranged = self.operator.arrange(point, changes(self.before, point), place)
            if arranged.decision is Decision.AGAIN:
                # Before the first point of a session there is none to read again.
                if self.before is not None and self._visit(self.before, anew=True) is Decision.STOP:
                    return Decision.STOP
                continue
            if arranged.decision is not Decision.GO:
                return arranged.decision
            self.before = point
            decision, watches = self._read(point, attempt, {**point.columns, **arranged.measured})
            if decision is Decision.GO:
                decision = self.operator.review(point, watches)
            if decision is not Decision.AGAIN:
                return decision
            anew = True

    def _read(
        self, point: Point, attempt: Attempt, columns: dict[str, float | str]
    ) -> tuple[Decision, dict[str, PointWatch]]:
        bus, passed_over = self.bench.begin(point, attempt.number, columns, attempt.rangings)
        self.store.begin(point, attempt, resumed=passed_over > 0)
        nearest_cm = float(columns["true_range_cm"])
        slant_cm = nearest_cm / cos(radians(float(columns["incidence_deg"])))
        watches = {name: PointWatch(name, (nearest_cm, slant_cm)) for name in point.setup.sensors}
        clock = self.bench.clock
        end_s = self._end_s(point, nearest_cm)
        silent, reports = Counter[str](), 0
        fresh = dict(columns)
        self._update_air(fresh, clock.now())
        for number, known in enumerate(rangings(self.collection.campaign, point, fresh, bus, clock)):
            reading = known.ranging.reading
            if reading.time_s > end_s:
                break
            if number >= passed_over:
                self.store.keep(attempt, known)
                outlier = watches[reading.sensor].update(reading)
                if self.operator.on_reading(point, watches, reading, outlier) is Decision.STOP:
                    return Decision.STOP, watches
            enough = all(attempt.readings[name] >= point.readings for name in point.setup.sensors)
            if enough and point.setup.movement is None:
                break
            silent[reading.sensor] = silent[reading.sensor] + 1 if reading.status.is_fault else 0
            if silent[reading.sensor] >= TROUBLE_AFTER:
                reports += 1
                silent.clear()
                decision = self.operator.on_trouble(
                    f"{reading.sensor}: no usable answer to {TROUBLE_AFTER} pings: "
                    f"{known.ranging.error or reading.status.value}"
                )
                if decision is not Decision.GO or reports >= GIVE_UP_AFTER:
                    return Decision.SKIP if decision is Decision.GO else decision, watches
            self._update_air(fresh, clock.now())
        self.store.done(point, attempt)
        return Decision.GO, watches

    def _end_s(self, point: Point, start_cm: float) -> float:
        """Time at which a movement that begins now ends [s]; infinite for a target at rest, which is read until it has
        its readings."""
        movement = point.setup.movement
        if movement is None:
            return float("inf")
        return self.bench.clock.now() + abs((movement.to_cm - start_cm) / movement.rate_cm_s)

    def _update_air(self, columns: dict[str, float | str], now_s: float) -> None:
        """Update the air temperature from the thermometer, at both ends where the plan has the same for both."""
        air_c = self.bench.air_c(now_s)
        if air_c is None:
            return
        before = columns.get("air_temperature_c")
        if isinstance(before, float) and abs(before - air_c) < STEADY_C:
            return
        if columns.get("target_temperature_c") == before:
            columns["target_temperature_c"] = round(air_c, 2)
        columns["air_temperature_c"] = round(air_c, 2)
