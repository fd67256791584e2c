"""Which effects the fleet shares, which units are odd ones out, and which have changed: the simplest explanation first.

Each sensor is asked by the search of the gap workflow what the model lacks. What it names is fitted in all sensors, and
what the ordinary ones have too is the fleet's: it enters the fits of all, and each is asked again what it has next to
that. What is then named in one sensor and by its number does not belong to the others' is odd. A number of the base
that does not belong is odd where no effect explains it, and a number that becomes another one from some session on, or
grows over all of them, is a change or a drift.

The numbers of the base (offset, scatter, share of a kind of outlier) have a share of the false-discovery rate of their
own, by Holm (1979, Scand. J. Stat. 6:65), and all other tests share the rest, for they are ten times as many: of these
findings have p-values of at most ``share fdr found / tests`` (Benjamini & Hochberg 1995, J. R. Stat. Soc. B 57:289), as
many as come in together counted. An effect also has to gain as many nats in its sensor as the smallest p-value has.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from msp_lab.fleet.findings import Kind
from msp_lab.fleet.statistics import Change, Number, changes_of, numbers_of
from msp_lab.fleet.terms import FleetTerm
from msp_lab.fleet.unit import Names, OwnEffects, Unit, UnitNumbers, examine, held, search
from msp_lab.gap import rules
from msp_lab.gap.candidates import Key
from msp_range.recording.error import RecordingError
from msp_sim.model.model import Model
from msp_sim.workers import ItemOutcome

Map = Callable[[Callable[[Model, Any], Any], Sequence[Any]], Iterable[ItemOutcome[Any]]]
"""Calls a function with the model and each item of a list; other processes may do it."""

PLAIN_SHARE = 0.5
"""Share of the false-discovery rate that the numbers of the base have. Of 85 drawn vehicles, one of 20 in its fleet and
7 spreads off in one number, 69, 76 and 82 are found at a tenth, a quarter and a half of a rate of 0.05; of these fleets
and 64 without odd vehicles 1, 2 and 5 have a false one (1 of the 64 each), by Benjamini and Hochberg's limits, which
are less strict than Holm's from the second finding on. Higher: more of both."""
SHARED_NATS = 8.0
"""An effect that the fleet shares gains so much in the mean ordinary sensor [nat], 4 standard errors. Twenty vehicles
show less for certain, but half of it is what the bench leaves open of the model: 3.8 in a drawn fleet without any
effect. Lower: shared effects that are the bench's error; higher: weak ones are missed."""


@dataclass(frozen=True)
class FleetFinding:
    """Something that was found."""

    kind: Kind
    """``shared``: the fleet has it; ``calibration``: that too, and it is a number of the sensor model; ``odd``: some
    units do, or have more or less of it; ``change`` or ``drift``: one unit's became another one."""
    term: FleetTerm
    """The number."""
    units: tuple[int, ...]
    """Places of the units that have it; of what the fleet has none."""
    number: Number | None = None
    """Over the fleet; None of a change."""
    alternatives: tuple[tuple[FleetTerm, float], ...] = ()
    """Other effects that explain it as well, with how much less they gain [nat]."""
    change: Change | None = None
    """Of one unit."""

    @property
    def is_plain(self) -> bool:
        """A number of the base is odd."""
        return self.kind == "odd" and self.term.is_base


class Named(NamedTuple):
    """An effect that the own searches of some units name, or have as an alternative."""

    term: FleetTerm
    """With one shape for all: the median of theirs."""
    units: tuple[int, ...]
    lost_nats: float
    """How much less than the first name of each it gains in these units [nat]."""


@dataclass
class FleetSearch:
    """What each unit is known to have, and what was found."""

    units: Sequence[Unit]
    """Those that can be used."""
    first: Sequence[UnitNumbers]
    """The numbers of each, before anything was found."""
    fdr: float
    """False-discovery rate."""
    run: Map
    """Calls functions for several units."""
    found: list[FleetFinding] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.terms: list[tuple[FleetTerm, ...]] = [() for _ in self.units]
        self.numbers = list(self.first)
        # Of each unit a number of the base, and of other numbers whether an effect is odd and whether one changed.
        self.plain_tests = sum(len(unit.numbers) for unit in self.first)
        self.other_tests = sum(unit.asked for unit in self.first) + 2 * len(changes_of(self.first))

    @property
    def tests(self) -> int:
        """Number of hypotheses."""
        return self.plain_tests + self.other_tests

    @property
    def plain_level(self) -> float:
        """Logarithm of the p-value that the next finding of a number of the base may have."""
        found = sum(len(finding.units) for finding in self.found if finding.is_plain)
        return float(np.log(PLAIN_SHARE * self.fdr / max(self.plain_tests - found, 1)))

    def level(self, ahead: int = 0) -> float:
        """The same of all others, with so many that come in with it."""
        # A calibration says of nothing that it is wrong.
        others = [finding for finding in self.found if not (finding.is_plain or finding.kind == "calibration")]
        count = sum(max(len(finding.units), 1) for finding in others) + ahead
        return float(np.log((1.0 - PLAIN_SHARE) * self.fdr * (count + 1) / max(self.other_tests, 1)))

    def _odd_of(self, units: Iterable[int], number: Number) -> list[int]:
        """Those of some units that deviate in a number."""
        ranked = sorted(units, key=number.p_of)
        below = [k for k, unit in enumerate(ranked) if number.p_of(unit) <= self.level(k)]
        return sorted(ranked[: max(below, default=-1) + 1])

    def all(self) -> list[FleetFinding]:
        """Find everything: what the fleet shares, its calibration first, for nothing is wrong with that."""
        everyone = range(len(self.units))
        for only_calibration in (True, False):
            own = self._own(everyone, only_calibration)
            while self._take_shared(named_by([each.effects for each in own])):
                own = self._own(everyone, only_calibration)
        self._take_changes(own)
        self._take_odd(own)
        self._take_changes([OwnEffects((), 0.0)] * len(self.units))
        self._take_more_of_shared()
        self._take_plain()
        return self.found

    def _own(self, places: Sequence[int], only_calibration: bool = False) -> list[OwnEffects]:
        """What units have next to their terms."""
        tasks = [(self.units[k], self.terms[k], -self.level(), only_calibration) for k in places]
        return values_of(self.run(search, tasks))

    def _with(self, term: FleetTerm) -> tuple[list[UnitNumbers], Number | None]:
        """The numbers of all units with one more term, and the term's own; None where hardly any has it."""
        tasks = [(unit, (*own, term)) for unit, own in zip(self.units, self.terms, strict=True)]
        numbers: list[UnitNumbers] = values_of(self.run(examine, tasks))
        return numbers, numbers_of(numbers).get(term.anywhere)

    def _take_shared(self, names: Sequence[Named]) -> bool:
        """One more effect that the ordinary units have, if there is one."""
        for name in names:
            numbers, number = self._with(name.term)
            if number is None or number.fleet.log_p > self.level():
                continue
            ordinary = number.units[number.fleet.ordinary]
            # What a few odd ones gain is no reason to give it to all.
            nats = len(self.units) * float(np.mean([numbers[k].gain_nats for k in ordinary]))
            kind: Kind = "calibration" if name.term.calibrates else "shared"
            needed_nats = -self.level() if name.term.calibrates else SHARED_NATS * len(self.units)
            if ordinary.size > len(self.units) / 2.0 and nats >= max(needed_nats, -self.level()):
                self.found.append(FleetFinding(kind, number.term, (), number, near(name, names)))
                self.terms = [(*terms, name.term) for terms in self.terms]
                self.numbers = numbers
                return True
        return False

    def _take_odd(self, own: Sequence[OwnEffects]) -> None:
        """What some units have by their own searches, and the others have not."""
        left = [list(each.effects) for each in own]
        while names := named_by(left):
            best = names[0]
            _, number = self._with(best.term)
            if number is not None and (odd := self._odd_of(best.units, number)):
                self.found.append(FleetFinding("odd", best.term, tuple(odd), number, near(best, names)))
                self._fit(odd, best.term)
            for k in best.units:
                left[k] = [names for names in left[k] if best.term.key not in {term.key for term, _ in names}]

    def _take_more_of_shared(self) -> None:
        """Units with more or less of what all have, where the readings are also that unlikely with the fleet's number.

        A fitted number need not be as far off as its standard error says: a share of tails a little wider than the hits
        may be a half as well as a tenth.
        """
        numbers = numbers_of(self.numbers)
        shared = [finding.term for finding in self.found if finding.kind in ("shared", "calibration")]
        for place, term in enumerate(shared):
            number = numbers.get(term)
            if number is None:
                continue
            odd = self._odd_of(number.units.tolist(), number)
            tasks = [(self.units[k], self.terms[k], place, number.fleet.mean) for k in odd]
            lost: list[float] = values_of(self.run(held, tasks))
            units = tuple(k for k, nats in zip(odd, lost, strict=True) if nats >= -self.level())
            if units:
                self.found.append(FleetFinding("odd", term, units, number))

    def _take_changes(self, own: list[OwnEffects]) -> None:
        """The clearest change of each unit, where its own effects gain no more; they are asked again next to it."""
        of_unit: dict[int, list[tuple[FleetTerm, Change]]] = {}
        for term, unit, change in sorted(changes_of(self.numbers), key=lambda each: each[2].log_p):
            of_unit.setdefault(unit, []).append((term, change))
        changed = {finding.units[0] for finding in self.found if finding.change is not None}
        for unit, ((term, change), *others) in of_unit.items():
            if change.log_p > self.level() or unit in changed or change.nats < own[unit].gain_nats:
                continue
            lost = [(each, change.nats - other.nats) for each, other in others if each != term]
            alternatives = tuple(each for each in lost if each[1] <= rules.ALTERNATIVE_NATS)
            self.found.append(FleetFinding(change.kind, term, (unit,), None, alternatives, change))
            sessions = self.first[unit].sessions
            # A drift is a change in the middle, as far as it could pass for another effect.
            later = sessions[change.first if change.kind == "change" else len(sessions) // 2 :]
            self._fit([unit], replace(term, sessions=later, start=change.size))
            (own[unit],) = self._own([unit])

    def _fit(self, places: Sequence[int], term: FleetTerm) -> None:
        """Units have one more term from now on."""
        for k in places:
            self.terms[k] = (*self.terms[k], term)
        numbers = values_of(self.run(examine, [(self.units[k], self.terms[k]) for k in places]))
        for k, own in zip(places, numbers, strict=True):
            self.numbers[k] = own

    def _take_plain(self) -> None:
        """Units with another number of the base than the others, which no effect explains.

        Of a unit in which nothing was found they are those of the first fit: what the whole fleet has is fitted in each
        unit too, and leaves its scatter less certain.
        """
        known = {unit for finding in self.found for unit in finding.units}
        off = [
            (number.p_of(unit), unit, number)
            for units, after in ((self.first, False), (self.numbers, True))
            for number in numbers_of(units).values()
            if number.term.is_base and not number.term.sessions
            for unit in number.units.tolist()
            if (unit in known) == after
        ]
        for log_p, unit, number in sorted(off, key=lambda each: each[0]):
            if log_p > self.plain_level:
                break
            same = [k for k, each in enumerate(self.found) if (each.kind, each.term) == ("odd", number.term)]
            if same:
                before = self.found[same[0]]
                self.found[same[0]] = replace(before, units=(*before.units, unit))
            else:
                self.found.append(FleetFinding("odd", number.term, (unit,), number))


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
    return sorted(named, key=lambda each: (-len(each.units), each.lost_nats))


def near(name: Named, names: Iterable[Named]) -> tuple[tuple[FleetTerm, float], ...]:
    """Alternatives in the same units, with how much less they gain [nat]."""
    lost = [(each.term, each.lost_nats - name.lost_nats) for each in names if set(each.units) >= set(name.units)]
    return tuple(each for each in lost if each[0] != name.term and each[1] <= rules.ALTERNATIVE_NATS)


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
