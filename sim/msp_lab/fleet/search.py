"""Which effects the fleet shares, which units are odd ones out, and which have changed: the simplest explanation first.

Each sensor is asked by the search of the gap workflow what the model lacks. What it names is fitted in all sensors, and
what the ordinary ones have too is the fleet's: it enters the fits of all, and each is asked again what it has next to
that. What is then named in one sensor and by its number does not belong to the others' is odd. A number of the base
that does not belong is odd where no effect explains it, and a number that becomes another one from some session on, or
grows over all of them, is a change or a drift.

False findings have two budgets, half of the rate each. A number's p-values count the vehicles that are compared in it
and the five numbers of the base. What is searched, effects by what they gain in their sensor, and changes, counts all
that was asked of all sensors (Bonferroni); an effect that is found by that need not pay for the search again in the
comparison with the others.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from msp_lab.fleet.findings import Kind
from msp_lab.fleet.statistics import Change, Number, groups_of, numbers_of
from msp_lab.fleet.terms import BASE, FleetTerm
from msp_lab.fleet.unit import Names, OwnEffects, Unit, UnitNumbers, examine, search
from msp_lab.gap import rules
from msp_lab.gap.candidates import Key
from msp_range.recording.error import RecordingError
from msp_sim.model.model import Model
from msp_sim.workers import ItemOutcome

Map = Callable[[Callable[[Model, Any], Any], Sequence[Any]], Iterable[ItemOutcome[Any]]]
"""Calls a function with the model and each item of a list; other processes may do it."""

COMPARED_SHARE = 0.5
"""Share of the rate of false findings that the comparison of the numbers has, a fifth of it for each of the base's."""
SHARED_NATS = 8.0
"""An effect counts as shared by the fleet if it gains at least this much in the mean ordinary sensor [nat], 4 standard
errors. Twenty vehicles show less for certain, but half of it is what the bench leaves open of the model: 3.8 in a drawn
fleet without any effect. Lower: shared effects that are the bench's error; higher: weak ones are missed."""


@dataclass(frozen=True)
class FleetFinding:
    """Something that was found."""

    kind: Kind
    """``shared``: the whole fleet has it; ``calibration``: so too, and it is a number of the sensor model; ``odd``:
    some units have it, or more or less of it; ``group``: so have those that a column tells from the others; ``change``
    or ``drift``: it changed in one unit between sessions."""
    number: Number
    """The number that it is about, over the fleet."""
    units: frozenset[int] = frozenset()
    """Indices of the units that have it; empty for what the whole fleet has."""
    alternatives: tuple[tuple[FleetTerm, float], ...] = ()
    """Other effects that explain it as well, with how much less they gain [nat]."""
    change: Change | None = None
    """The change between sessions of one unit; None for other kinds."""


class Named(NamedTuple):
    """An effect that the searches in single units name, or give as an alternative."""

    term: FleetTerm
    """The effect with one shape for all these units: the median of theirs."""
    units: tuple[int, ...]
    lost_nats: float
    """How much less it gains in these units than the effect that each search named first [nat]."""


@dataclass
class FleetSearch:
    """State of the search: the terms that each unit is known to have, and what was found."""

    units: Sequence[Unit]
    """The units whose readings can be used."""
    first: Sequence[UnitNumbers]
    """The numbers of each unit, fitted before anything was found."""
    fdr: float
    """False-discovery rate."""
    run: Map
    """Calls functions for several units."""
    found: list[FleetFinding] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.terms: list[tuple[FleetTerm, ...]] = [() for _ in self.units]
        self.numbers = list(self.first)
        self.vehicles = [unit.vehicle for unit in self.units]
        self.groups = groups_of(self.first, self.vehicles)
        # Of each unit and group the numbers of the base; of each unit whether it has an effect, or a number changed.
        compared = len(BASE) * (len(self.units) + len(self.groups))
        changes, asked = len(BASE) * len(self.units), sum(unit.asked for unit in self.first)
        self.tests = compared + changes + asked
        self.number_level = float(np.log(COMPARED_SHARE * self.fdr / compared))
        self.search_level = float(np.log((1.0 - COMPARED_SHARE) * self.fdr / (changes + asked)))

    def all(self) -> list[FleetFinding]:
        """All findings, the simplest explanation first."""
        everyone = range(len(self.units))
        own = self._own(everyone)
        while self._take_shared(named_by([own_search.effects for own_search in own])):
            own = self._own(everyone)
        self._take_changes(own)
        self._take_odd(own)
        self._take_plain()
        return self.found

    def compared(self, units: Sequence[UnitNumbers]) -> dict[FleetTerm, Number]:
        """Every number of these units, each compared with that of the others."""
        return numbers_of(units, self.number_level, self.vehicles, self.groups)

    def _own(self, places: Iterable[int]) -> list[OwnEffects]:
        """Searches of the gap workflow in these units, each for effects in addition to its terms."""
        return values_of(self.run(search, [(self.units[k], self.terms[k], -self.search_level) for k in places]))

    def _with(self, term: FleetTerm) -> tuple[list[UnitNumbers], Number | None]:
        """The numbers of all units after one more term is added, and that of the term itself; None if too few units
        have it."""
        tasks = [(unit, (*own, term)) for unit, own in zip(self.units, self.terms, strict=True)]
        numbers: list[UnitNumbers] = values_of(self.run(examine, tasks))
        return numbers, self.compared(numbers).get(term.anywhere)

    def _take_shared(self, names: Sequence[Named]) -> bool:
        """Add one more effect that the ordinary units have, if there is one; a calibration comes first, since it is no
        fault."""
        for name in sorted(names, key=lambda named: not named.term.calibrates):
            numbers, number = self._with(name.term)
            if number is None or number.fleet.log_p > self.search_level:
                continue
            # What a few odd ones gain is no reason to give it to all.
            ordinary = [numbers[k].gain_nats for k in number.units.tolist() if k not in number.odd]
            calibrates = name.term.calibrates
            needed_nats = max(-self.search_level / len(self.units), 0.0 if calibrates else SHARED_NATS)
            if 2 * len(ordinary) > len(self.units) and np.mean(ordinary) >= needed_nats:
                kind: Kind = "calibration" if calibrates else "shared"
                self.found.append(FleetFinding(kind, number, alternatives=near(name, names)))
                self.terms = [(*terms, name.term) for terms in self.terms]
                self.numbers = numbers
                return True
        return False

    def _take_changes(self, own: list[OwnEffects]) -> None:
        """Add the clearest change of each unit, unless the effects of its own search gain more."""
        of_unit: dict[int, list[tuple[Number, Change]]] = {}
        for number in self.compared(self.numbers).values():
            for unit, change in number.changes().items():
                of_unit.setdefault(unit, []).append((number, change))
        for unit, changes in of_unit.items():
            (number, change), *others = sorted(changes, key=lambda pair: pair[1].log_p)
            if change.log_p <= self.search_level and change.nats >= own[unit].gain_nats:
                lost = [(other.term, change.nats - less.nats) for other, less in others]
                alternatives = tuple(alternative for alternative in lost if alternative[1] <= rules.ALTERNATIVE_NATS)
                self.found.append(FleetFinding(change.kind, number, frozenset({unit}), alternatives, change))
                own[unit] = OwnEffects((), 0.0)

    def _take_odd(self, own: Sequence[OwnEffects]) -> None:
        """Add effects that the searches in some units found, and that the others do not have, or have less of."""
        left = [list(own_search.effects) for own_search in own]
        while names := named_by(left):
            best = names[0]
            _, number = self._with(best.term)
            apart = None if number is None else number.apart
            if number is not None and apart is not None and apart.group.units.intersection(best.units):
                self.found.append(FleetFinding("group", number, apart.group.units, near(best, names)))
                self._fit(apart.group.units, best.term)
            if number is not None and (odd := number.odd.intersection(best.units)):
                self.found.append(FleetFinding("odd", number, odd, near(best, names)))
                self._fit(odd, best.term)
                for unit, change in number.changes().items():
                    if unit in odd and change.log_p <= self.search_level:
                        self.found.append(FleetFinding(change.kind, number, frozenset({unit}), change=change))
            for k in best.units:
                left[k] = [names for names in left[k] if best.term.key not in {term.key for term, _ in names}]

    def _fit(self, places: Iterable[int], term: FleetTerm) -> None:
        """Add a term to units."""
        for k in places:
            self.terms[k] = (*self.terms[k], term)
            (self.numbers[k],) = values_of(self.run(examine, [(self.units[k], self.terms[k])]))

    def _take_plain(self) -> None:
        """Units with another number than the others, of the base or of what all have, which no effect explains.

        Of a unit in which nothing was found numbers of the base are those of the first fit: what the whole fleet has is
        fitted in each unit too, and leaves its scatter less certain.
        """
        known = frozenset[int]().union(*(finding.units for finding in self.found))
        changed = frozenset[int]().union(*(finding.units for finding in self.found if finding.change is not None))
        first, last = self.compared(self.first), self.compared(self.numbers)
        for term, number in last.items():
            before = first.get(term, number)
            for one, explained in ((before, False), (number, True)):
                if one.apart is not None and (one.apart.group.units - changed <= known) == explained:
                    self.found.append(FleetFinding("group", one, one.apart.group.units))
                    break
            odd = ((before.odd - known) | (number.odd & known)) - changed
            if odd:
                self.found.append(FleetFinding("odd", number if odd <= known else before, odd))


def named_by(effects: Sequence[Iterable[Names]]) -> list[Named]:
    """What the effects of each unit may be: what most of them have by name first, and of these what gains most."""
    found: dict[Key, dict[int, tuple[FleetTerm, float]]] = {}
    for k, own in enumerate(effects):
        for names in own:
            for term, lost in names:
                found.setdefault(term.key, {}).setdefault(k, (term, lost))
    named = [
        Named(common([term for term, _ in units.values()]), tuple(units), sum(lost for _, lost in units.values()))
        for units in found.values()
    ]
    return sorted(named, key=lambda name: (-len(name.units), name.lost_nats))


def near(name: Named, names: Iterable[Named]) -> tuple[tuple[FleetTerm, float], ...]:
    """Alternatives in the same units, with how much less they gain [nat]."""
    lost = [(other.term, other.lost_nats - name.lost_nats) for other in names if set(other.units) >= set(name.units)]
    return tuple(other for other in lost if other[0] != name.term and other[1] <= rules.ALTERNATIVE_NATS)


def common(terms: Sequence[FleetTerm]) -> FleetTerm:
    """The effect with one shape: the median of these."""
    terms = [term for term in terms if term.number == terms[0].number]
    shapes = np.median([[value for _, value in term.shape] for term in terms], axis=0)
    shape = tuple((name, float(f"{value:.4g}")) for (name, _), value in zip(terms[0].shape, shapes, strict=True))
    return replace(terms[0], shape=shape, start=float(np.median([term.start for term in terms])))


def values_of(outcomes: Iterable[ItemOutcome[Any]]) -> list[Any]:
    """The results; RecordingError where there is none, since the files could be read before."""
    found = []
    for outcome in outcomes:
        if outcome.error is not None:
            raise RecordingError(f"a sensor's readings could be used once, and now not: {outcome.error}")
        found.append(outcome.value)
    return found
