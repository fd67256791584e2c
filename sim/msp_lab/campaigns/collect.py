"""Going through a campaign: set up, read, look, and on to the next point.

Points, a bench, a store and a person enter; the person may be a program. The readings leave through the store. A ping
without a usable answer is recorded as what it is and asked again; where answers stay away, the person is told.
"""

import difflib
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from math import cos, radians
from typing import Protocol

from msp_lab.campaigns.bench import Bench, rangings
from msp_lab.campaigns.campaign import Campaign
from msp_lab.campaigns.plan import Point, changes
from msp_lab.campaigns.store import Store
from msp_lab.campaigns.watch import Outlier, Watch
from msp_range.reading import Reading
from msp_range.yaml_file import ConfigError

TROUBLE_AFTER = 20
"""So many pings in a row without a usable answer are more than bad luck."""
GIVE_UP_AFTER = 5
"""So many times is a person, or a program in their place, told of it at one point."""
STEADY_C = 0.05
"""A smaller change of the thermometer is not written down [deg C]."""


class Say(Enum):
    """What a person wants next."""

    GO = "go"
    SKIP = "skip"
    AGAIN = "again"
    STOP = "stop"


@dataclass(frozen=True)
class Arranged:
    """A set-up as it really is; ``measured`` are columns that differ from the plan."""

    say: Say
    measured: Mapping[str, float] = field(default_factory=dict)


class Person(Protocol):
    """Who sets up and looks."""

    def arrange(self, point: Point, to_change: Sequence[str], place: "Place") -> Arranged:
        """Set a point up. AGAIN reads the point before once more, SKIP leaves this one for later."""
        ...

    def look(self, point: Point, watches: Mapping[str, Watch], reading: Reading, outlier: Outlier | None) -> Say:
        """Look at a reading as it comes in; STOP ends the sitting, everything else goes on."""
        ...

    def judge(self, point: Point, watches: Mapping[str, Watch]) -> Say:
        """Look at a point that has been read; AGAIN reads it once more, STOP ends the sitting."""
        ...

    def trouble(self, text: str) -> Say:
        """Hear that a sensor does not answer; GO tries on, SKIP leaves the point, STOP ends the sitting."""
        ...


@dataclass(frozen=True)
class Place:
    """Where in the campaign a person is.

    Attributes
    ----------
    number, of
        Of this point, among all.
    had
        Readings of this point that are there already, of its first sensor.
    """

    number: int
    of: int
    had: int


def collect_readings(
    campaign: Campaign,
    points: Sequence[Point],
    bench: Bench,
    store: Store,
    person: Person,
    wanted: Collection[str],
    again: Collection[str] = (),
) -> None:
    """Read what is wanted and not there yet, in the order of the plan; what is skipped comes once more at the end.

    Parameters
    ----------
    campaign, points
        What is to be measured, and the plan of it.
    bench
        Where the sensors are.
    store
        Where readings go; what it already has is not read again.
    person
        Who sets up.
    wanted
        Names of the points that are to be read.
    again
        Names of points that are to be read although they are done.
    """
    todo = [point for point in points if point.name in again or (point.name in wanted and not store.is_done(point))]
    _Sitting(campaign, points, bench, store, person).go_through(todo, again)


def chosen(points: Sequence[Point], beginnings: Sequence[str], option: str) -> frozenset[str]:
    """Names of the points that begin as one of ``beginnings`` says.

    Raises
    ------
    ConfigError
        None begins so.
    """
    found: set[str] = set()
    for beginning in beginnings:
        names = [point.name for point in points if point.name.startswith(beginning)]
        if not names:
            near = difflib.get_close_matches(beginning, [point.name for point in points], n=1, cutoff=0.0)
            raise ConfigError(f"{option} {beginning}: no point begins so; one is named {near[0]} (see --plan)")
        found.update(names)
    return frozenset(found)


class _Sitting:
    """One sitting at the bench."""

    def __init__(self, campaign: Campaign, points: Sequence[Point], bench: Bench, store: Store, person: Person) -> None:
        self._campaign = campaign
        self._numbers = {point.name: number for number, point in enumerate(points, start=1)}
        self._bench = bench
        self._store = store
        self._person = person
        self._before: Point | None = None

    def go_through(self, todo: Sequence[Point], again: Collection[str]) -> None:
        skipped: list[Point] = []
        for last_round in (False, True):
            for point in skipped if last_round else todo:
                say = self._visit(point, anew=point.name in again)
                if say is Say.STOP:
                    return
                if say is Say.SKIP and not last_round:
                    skipped.append(point)

    def _visit(self, point: Point, *, anew: bool) -> Say:
        """Set up and read a point until it is kept."""
        while True:
            attempt = self._store.next_attempt(point, again=anew)
            had = attempt.readings[point.setup.sensors[0]]
            place = Place(self._numbers[point.name], len(self._numbers), had)
            arranged = self._person.arrange(point, changes(self._before, point), place)
            if arranged.say is Say.AGAIN:
                # Before the first point of a sitting there is none to read again.
                if self._before is not None and self._visit(self._before, anew=True) is Say.STOP:
                    return Say.STOP
                continue
            if arranged.say in (Say.SKIP, Say.STOP):
                return arranged.say
            self._before = point
            say, watches = self._read(point, {**point.columns, **arranged.measured}, anew=anew)
            if say is Say.GO:
                say = self._person.judge(point, watches)
            if say is not Say.AGAIN:
                return say
            anew = True

    def _read(self, point: Point, columns: dict[str, float | str], *, anew: bool) -> tuple[Say, dict[str, Watch]]:
        attempt = self._store.next_attempt(point, again=anew)
        bus, passed_over = self._bench.begin(point, attempt.number, columns, attempt.rangings)
        self._store.begin(point, attempt, goes_on=passed_over > 0)
        nearest_cm = float(columns["true_range_cm"])
        slant_cm = nearest_cm / cos(radians(float(columns["incidence_deg"])))
        watches = {name: Watch(name, (nearest_cm, slant_cm)) for name in point.setup.sensors}
        clock = self._bench.clock
        end_s = self._end_s(point, nearest_cm)
        silent, told = Counter[str](), 0
        fresh = dict(columns)
        self._note_air(fresh, clock.now())
        for number, known in enumerate(rangings(self._campaign, point, fresh, bus, clock)):
            reading = known.ranging.reading
            if reading.time_s > end_s:
                break
            if number >= passed_over:
                self._store.keep(known)
                outlier = watches[reading.sensor].take(reading)
                if self._person.look(point, watches, reading, outlier) is Say.STOP:
                    return Say.STOP, watches
            enough = all(attempt.readings[name] >= point.readings for name in point.setup.sensors)
            if enough and point.setup.movement is None:
                break
            silent[reading.sensor] = silent[reading.sensor] + 1 if reading.status.is_fault else 0
            if silent[reading.sensor] >= TROUBLE_AFTER:
                told += 1
                silent.clear()
                say = self._person.trouble(
                    f"{reading.sensor}: no usable answer to {TROUBLE_AFTER} pings: "
                    f"{known.ranging.error or reading.status.value}"
                )
                if say is not Say.GO or told >= GIVE_UP_AFTER:
                    return Say.SKIP if say is Say.GO else say, watches
            self._note_air(fresh, clock.now())
        self._store.done(point)
        return Say.GO, watches

    def _end_s(self, point: Point, start_cm: float) -> float:
        """When a movement that begins now has arrived [s]; a target at rest is read for as long as it takes."""
        movement = point.setup.movement
        if movement is None:
            return float("inf")
        return self._bench.clock.now() + abs((movement.to_cm - start_cm) / movement.rate_cm_s)

    def _note_air(self, columns: dict[str, float | str], now_s: float) -> None:
        """Take the thermometer's value where it has one; with even air it is that of the far end too."""
        air_c = self._bench.air_c(now_s)
        if air_c is None:
            return
        before = columns.get("air_temperature_c")
        if isinstance(before, float) and abs(before - air_c) < STEADY_C:
            return
        if columns.get("target_temperature_c") == before:
            columns["target_temperature_c"] = round(air_c, 2)
        columns["air_temperature_c"] = round(air_c, 2)
