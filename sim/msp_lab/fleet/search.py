"""Which effects the fleet shares, which units are odd ones out, and which have changed: the plainest explanation first.

1. A unit's own numbers that changed over its sessions, where no effect is clearer.
2. Effects of the catalogue: what the gap workflow's search names in single units. Each is then estimated in every unit,
   where those that do not have it show how much of it is nothing.
3. The six plain numbers (the base's five, and the scale), next to the effects that were found.

Plain numbers are free in every fit, so that an effect is named only where they do not explain the readings. They have a
part of the false-discovery rate for themselves: they are few, and next to the tests of effects they would be missed.
Changes, and for each unit what its search names (which counts its own candidates), are one family: a p-value is a
finding if it is at most ``rate (found + 1) / tests``, the limits of Benjamini & Hochberg (1995, J. R. Stat. Soc. B
57:289), one step at a time.
"""

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from msp_lab.fleet.findings import Kind
from msp_lab.fleet.statistics import Change, Number, number_of
from msp_lab.fleet.terms import BASE_NUMBERS, SCALE, FleetTerm
from msp_lab.fleet.unit import MIN_READINGS, NamedTerm, Unit, UnitEstimates, estimate, search
from msp_range.recording.error import RecordingError
from msp_sim.model.model import Model
from msp_sim.workers import ItemOutcome

Map = Callable[[Callable[[Model, Any], Any], Sequence[Any]], Iterable[ItemOutcome[Any]]]
"""Calls a function with the model and each item of a list; other processes may do it."""
PLAIN = tuple(FleetTerm(name, "value") for name in BASE_NUMBERS)
"""Numbers that every fit has."""

PLAIN_SHARE = 0.2
"""Share of the false-discovery rate that is the probability of any false finding among the plain numbers (Bonferroni).
A vehicle that is 7 spreads from 19 others is found in 93 % at 0.2 and a rate of 0.05, and 1 of 100 fleets without one
has a false alarm; at 0.1 it is 89 % and 1 of 200, at 0.4 96 % and 1 of 50. The rest is for effects and changes."""


@dataclass(frozen=True)
class FleetFinding:
    """Something that was found."""

    kind: Kind
    """``shared``: the fleet has it; ``calibration``: that too, and it is a number of the sensor model; ``odd``: some
    units do, or have more or less of it; ``change`` or ``drift``: one unit's became another one."""
    number: Number
    """The number in every unit."""
    units: tuple[int, ...] = ()
    """Places of the units; of what the fleet shares none."""
    alternatives: tuple[tuple[str, float], ...] = ()
    """Other effects that explain it as well, with how much less they gain [nat]."""
    change: Change | None = None
    """Of one unit."""
    before_change: UnitEstimates | None = None
    """Its estimates, before the change was known."""


@dataclass
class Search:
    """The state of the search: what each unit is known to have, and what was found."""

    units: list[Unit]
    """Those that can be used; of one that changed, from then on its sessions before it."""
    estimates: list[UnitEstimates]
    """Of each unit."""
    fdr: float
    """False-discovery rate."""
    run: Map
    """Calls functions for several units."""
    found: list[FleetFinding] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.terms: list[tuple[FleetTerm, ...]] = [() for _ in self.units]
        """What each unit is known to have."""
        self.plain_tests = (len(PLAIN) + 1) * len(self.units)
        self.other_tests = self.plain_tests
        """Number of hypotheses: the plain numbers, and as many changes with, for each unit, what its search names."""

    def search(self) -> None:
        """Find what there is, in the order of the module's description."""
        named = dict(enumerate(self._searched(range(len(self.units)))))
        # An effect of what differs between sessions looks like a change, and a change like an effect.
        clear = {k: max((each.deviations for each in own if not each.is_base), default=0.0) for k, own in named.items()}
        changed = self._changes(PLAIN, clear)
        named |= zip(changed, self._searched(changed), strict=True)
        self._effects(named)
        self._changes([*PLAIN, *(each.number.term for each in self.found if each.change is None)], {})
        self._plain(named)

    def _searched(self, places: Sequence[int]) -> list[tuple[NamedTerm, ...]]:
        """What the search names in some units; it counts its candidates itself."""
        alpha = (1.0 - PLAIN_SHARE) * self.fdr / len(self.units)
        return self._asked(search, [(self.units[k], alpha) for k in places])

    @property
    def _log_level(self) -> float:
        """Logarithm of the p-value that the next finding may have, other than of a plain number."""
        count = 1 + sum(max(len(each.units), 1) for each in self.found)
        return float(np.log((1.0 - PLAIN_SHARE) * self.fdr * count / self.other_tests))

    def _asked(self, question: Callable[..., Any], items: Sequence[Any]) -> list[Any]:
        """Answers of some units; RecordingError where there is none, since the files could be read before."""
        outcomes = list(self.run(question, items))
        for each in outcomes:
            if each.error is not None:
                raise RecordingError(f"a sensor's readings could be used once, and now not: {each.error}")
        return [each.value for each in outcomes]

    def _estimated(self, places: Sequence[int], *more: FleetTerm) -> dict[int, UnitEstimates]:
        """Estimates of some units with what they are known to have and more."""
        tasks = [(self.units[k], (*self.terms[k], *more)) for k in places]
        return dict(zip(places, self._asked(estimate, tasks), strict=True))

    def _learn(self, term: FleetTerm, places: Sequence[int]) -> None:
        """Some units are known to have one more term."""
        for k, each in self._estimated(places, term).items():
            self.terms[k], self.estimates[k] = (*self.terms[k], term), each

    def number(self, term: FleetTerm, odd: Sequence[int] = ()) -> Number | None:
        """A number in every unit, next to what else each is known to have; `odd` is as in `number_of`."""
        plain = replace(term, start=0.0)
        again = self._estimated([k for k, each in enumerate(self.estimates) if plain not in each.terms], term)
        return number_of([again.get(k, each) for k, each in enumerate(self.estimates)], plain, odd)

    def _changes(self, terms: Sequence[FleetTerm], clear: Mapping[int, float]) -> list[int]:
        """The clearest change of each unit, as long as random variation does not explain it; which units changed.

        It is no finding yet where it is fewer standard errors than `clear` says of an effect.
        """
        changed = []
        known = {each.units[0] for each in self.found if each.change is not None}
        clearest: dict[int, tuple[Change, Number]] = {}
        for number in filter(None, (number_of(self.estimates, each) for each in terms)):
            for k, change in zip(number.units.tolist(), number.changes, strict=True):
                if change and k not in known and (k not in clearest or change.log_p < clearest[k][0].log_p):
                    clearest[k] = change, number
        for k, (change, number) in sorted(clearest.items(), key=lambda each: each[1][0].log_p):
            if change.log_p > self._log_level:
                break
            if abs(change.size) < clear.get(k, 0.0) * change.error:
                continue
            changed.append(k)
            self.found.append(FleetFinding(change.kind, number, (k,), (), change, self.estimates[k]))
            # What follows is asked of the vehicle as it was, which for a drift is in its first half.
            last = change.first or len(self.estimates[k].sessions) // 2
            if self.estimates[k].readings[:last].sum() >= MIN_READINGS:
                self.units[k] = replace(self.units[k], sessions=self.estimates[k].sessions[:last])
                self.estimates[k] = self._estimated([k])[k]
        return changed

    def _effects(self, named: Mapping[int, Sequence[NamedTerm]]) -> None:
        """Effects that were named in some units: those of most units first, then the clearest."""
        by_key: dict[Any, dict[int, NamedTerm]] = defaultdict(dict)
        for k, terms in named.items():
            for each in terms:
                by_key[each.term.key][k] = each
        by_key.pop(SCALE.key, None)
        half = len(self.units) / 2.0
        for members in sorted(
            by_key.values(), key=lambda each: (len(each) <= half, -max(one.deviations for one in each.values()))
        ):
            clearest = max(members.values(), key=lambda each: each.deviations)
            term, others = clearest.term, clearest.alternatives
            number = self.number(term, () if len(members) > half else list(members))
            if number is None:
                continue
            is_shared = len(members) > half and number.fleet.log_p_of_mean <= self._log_level
            if is_shared:
                kind: Kind = "calibration" if clearest.is_base else "shared"
                self.found.append(FleetFinding(kind, number, (), others))
                self._learn(term, range(len(self.units)))
            # Of what is no effect of the fleet, more than the others have is asked only of units that it was named in.
            suspects = {k: float(p) for k, p in zip(number.units.tolist(), number.fleet.log_p, strict=True)}
            odd = self._odd({k: p for k, p in suspects.items() if is_shared or k in members})
            if odd:
                self.found.append(FleetFinding("odd", number, tuple(odd), others))
                if not is_shared:
                    self._learn(term, odd)

    def _odd(self, log_p: dict[int, float]) -> list[int]:
        """Units that random variation does not explain, the clearest first."""
        odd: list[int] = []
        for k in sorted(log_p, key=lambda k: log_p[k]):
            if log_p[k] > self._log_level + np.log1p(len(odd)):
                break
            odd.append(k)
        return odd

    def _plain(self, named: Mapping[int, Sequence[NamedTerm]]) -> None:
        """Units with another number of the base, or another scale, next to what effects explain."""
        level = float(np.log(PLAIN_SHARE * self.fdr / self.plain_tests))
        for term in (SCALE, *PLAIN):
            number = self.number(term)
            if number is None:
                continue
            odd = tuple(number.units[number.fleet.log_p <= level].tolist())
            if not odd:
                continue
            others = [each.alternatives for k in odd for each in named[k] if each.term.key == term.key]
            self.found.append(FleetFinding("odd", number, odd, others[0] if others else ()))
            if term == SCALE:
                self._learn(term, odd)
