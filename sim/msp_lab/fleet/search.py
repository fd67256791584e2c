"""Which effects the fleet shares, which units are odd ones out, and which have changed: one finding after the other.

The plainest question is whether a number that every unit has (offset, scatter, share of a kind of outlier) is odd in
one. These tests have a share of the false-discovery rate of their own; all others (the mean of each effect over the
fleet, each unit's deviation from the others in it, changes and drifts) share the rest, for they are ten times as many.
In either family the smallest p-value is a finding if it is at most ``share fdr (found + 1) / tests``: the limits of
Benjamini & Hochberg (1995, J. R. Stat. Soc. B 57:289), one step at a time from the smallest. After each finding its
effect enters the fits of the units that have it, so that what only looked like it is not found in its wake.

Which effect a unit has is decided by refits: that which gains most over all units that are odd in the same way. Effects
that gain nearly as much are its alternatives.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from msp_lab.fleet.findings import Kind
from msp_lab.fleet.statistics import Change, Deviation, Number, changes_of, numbers_of
from msp_lab.fleet.terms import FleetTerm, candidate_of, effect_of
from msp_lab.fleet.unit import RefittedTerm, Unit, UnitNumbers, compare, examine, held
from msp_lab.gap import rules
from msp_range.arrays import Array
from msp_range.recording.error import RecordingError
from msp_sim.model.model import Model
from msp_sim.workers import ItemOutcome

Key = tuple[str, str | None]
Map = Callable[[Callable[[Model, Any], Any], Sequence[Any]], Iterable[ItemOutcome[Any]]]
"""Calls a function with the model and each item of a list; other processes may do it."""

PLAIN_SHARE = 0.5
"""Share of the false-discovery rate that the plain numbers have. Of 85 drawn vehicles, one of 20 in its fleet and 7
spreads off in one number, 69, 76 and 82 are found at a tenth, a quarter and a half of a rate of 0.05; of these fleets
and 64 without odd vehicles 1, 2 and 5 have a false one (1 of the 64 each). Higher: more of both."""
MAX_FINDINGS = 40
"""The search ends after so many: what is then left has a common cause that nobody has named."""
SHARED_NATS = 8.0
"""An effect that the fleet shares gains so much in the mean ordinary sensor [nat], 4 standard errors. Twenty vehicles
show less for certain, but half of it is what the bench leaves open of the model: 3.8 in a drawn fleet without any
effect. Lower: shared effects that are the bench's error; higher: weak ones are missed."""
FLEET = -1
"""Stands for the place of a unit where the whole fleet is meant."""
SHARED_TRIED = 6
"""So many effects are refitted in all units when the fleet shares one. More: slower."""


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
    alternatives: tuple[tuple[FleetTerm, float], ...] = ()
    """Other effects that explain it as well, with how much less they gain [nat]."""
    change: Change | None = None
    """Of one unit."""

    @property
    def count(self) -> int:
        """As how many findings it counts."""
        return max(len(self.units), 1)


@dataclass
class Search:
    """The state of the search: what each unit is known to have, and what was found."""

    units: Sequence[Unit]
    """Those that can be used."""
    scores: list[UnitNumbers]
    """Of each unit."""
    fdr: float
    """False-discovery rate."""
    run: Map
    """Calls functions for several units."""
    found: list[FleetFinding] = field(default_factory=list)
    plain_tests: int = 0
    other_tests: int = 0
    """Number of hypotheses of either family."""

    def __post_init__(self) -> None:
        self.terms: list[tuple[FleetTerm, ...]] = [() for _ in self.units]
        """What each unit is known to have."""
        self.before_change: dict[int, UnitNumbers] = {}
        """Of a unit that changed, its scores before the change was known."""
        self._without: set[tuple[int, Key]] = set()
        """Units, or `FLEET`, and effects that did not gain what their scores promised."""
        self.first: list[Number] = []
        """The numbers that every unit has, at the first fit."""

    def search(self) -> None:
        """Find until nothing is left that random variation does not explain."""
        self.first = [number for number in numbers_of(self.scores) if number.term.is_base]
        while len(self.found) < MAX_FINDINGS:
            numbers, changes = numbers_of(self.scores), changes_of(self.scores)
            plain = sum(number.units.size for number in numbers if number.term.is_base)
            # A mean for each effect, a deviation for each unit, and its changes and drifts.
            others = sum(number.units.size + 1 for number in numbers if not number.term.is_base) + 2 * len(changes)
            self.plain_tests, self.other_tests = max(self.plain_tests, plain), max(self.other_tests, others)
            if not (self._shared(numbers) or self._of_units(numbers, changes) or self._of_base(numbers)):
                break

    @property
    def tests(self) -> int:
        """Number of hypotheses."""
        return self.plain_tests + self.other_tests

    @property
    def plain_level(self) -> float:
        """Logarithm of the p-value that the next finding of a plain number may have."""
        return self._level(PLAIN_SHARE, self.plain_tests)

    @property
    def level(self) -> float:
        """The same of all others."""
        return self._level(1.0 - PLAIN_SHARE, self.other_tests)

    def _level(self, share: float, tests: int) -> float:
        # A calibration says of nothing that it is wrong.
        count = sum(finding.count for finding in self.found if finding.kind != "calibration")
        return float(np.log(share * self.fdr * (count + 1) / max(tests, 1)))

    @property
    def _of_all(self) -> set[Key]:
        """Effects that all units are known to have."""
        return {finding.term.key for finding in self.found if finding.kind in ("shared", "calibration")}

    def _has(self, unit: int, key: Key) -> bool:
        kinds = [finding for finding in self.found if finding.term.key == key and finding.kind == "odd"]
        return (unit, key) in self._without or any(unit in finding.units for finding in kinds)

    def _shared(self, numbers: Sequence[Number]) -> bool:
        """One more effect that the fleet shares."""
        level, of_all = self.level, self._of_all
        open_ = {
            number.term: number
            for number in numbers
            if not (number.term.is_base or number.term.sessions)
            and number.term.key not in of_all
            and (FLEET, number.term.key) not in self._without
            and number.fleet.ordinary.sum() > len(self.units) / 2.0
        }
        means = [
            Deviation(number.fleet.log_p, term, FLEET, number.fleet.mean, number.fleet.mean)
            for term, number in open_.items()
        ]
        ranked = _best_by_key(means)
        # What every sensor has a number for, such as the tails of its noise, is calibrated before anything is named,
        # also where it is less certain: nothing is wrong with it.
        numbered = [
            deviation
            for deviation in ranked
            if effect_of(deviation.term.effect).base is not None and deviation.log_p <= rules.REFIT_WITHIN_SHARE * level
        ]
        near = [
            deviation
            for deviation in ranked
            if deviation.log_p <= min(level, rules.REFIT_WITHIN_SHARE * ranked[0].log_p)
        ]
        best = numbered[:1] or near[:SHARED_TRIED]
        if not best:
            return False
        everyone = range(len(self.units))
        gains = self._gains(everyone, [_tried(deviation) for deviation in best])
        total = len(self.units) * mean_nats(gains.nats, [open_[deviation.term] for deviation in best])
        k = int(np.argmax(total))
        needed = -level if numbered else max(-level, SHARED_NATS * len(self.units))
        if total[k] < needed:
            self._without |= {(FLEET, deviation.term.key) for deviation in best}
            return True
        term = gains.common(k, everyone)
        self.found.append(FleetFinding("calibration" if numbered else "shared", term, (), gains.near(k, total)))
        self._fit(everyone, term)
        return True

    def _of_units(self, numbers: Sequence[Number], changes: Sequence[tuple[FleetTerm, int, Change]]) -> bool:
        """Some units with one more effect, or one that changed."""
        level = self.level
        flagged = self._flagged(numbers, level)
        done = {finding.units[0] for finding in self.found if finding.change is not None}
        changed = [(term, unit, change) for term, unit, change in changes if change.log_p <= level and unit not in done]
        first = min((suspect.log_p for suspect in flagged.values()), default=0.0)
        if changed and min(change.log_p for *_, change in changed) <= first:
            self._take_change(*min(changed, key=lambda place: place[2].log_p), changes)
            return True
        if flagged:
            self._odd(flagged, level)
        return bool(flagged)

    def _flagged(self, numbers: Sequence[Number], level: float) -> dict[int, "_Suspect"]:
        """Units that are odd, each with the effects that may be why.

        Those are effects whose own number is odd, and where a number of the base is, all that change the same: where
        throttle hardly varies, a score says little of what grows with throttle, and a refit more.
        """
        of_base = {
            (deviation.unit, effect_of(deviation.term.effect).channels[0]): deviation.log_p
            for deviation in self._plain(numbers)
            if deviation.log_p <= self.plain_level
        }
        found: dict[int, _Suspect] = {}
        for number in numbers:
            if number.term.is_base or number.term.sessions:
                continue
            channels = effect_of(number.term.effect).channels
            if "component" in channels:
                # Echoes from elsewhere count as short or random readings until they have a name.
                channels = (*channels, "short", "random")
            for deviation in number.deviations:
                same = [(deviation.unit, channel) for channel in channels]
                others = (
                    []
                    if self.fits(deviation.unit, deviation.term)
                    else [of_base[one] for one in same if one in of_base]
                )
                if self._has(deviation.unit, deviation.term.key) or (deviation.log_p > level and not others):
                    continue
                suspect = found.setdefault(deviation.unit, _Suspect())
                suspect.log_p = min([suspect.log_p, deviation.log_p, *others])
                (suspect.own if deviation.log_p <= level else suspect.other).append(deviation)
        return found

    def _plain(self, numbers: Sequence[Number]) -> list[Deviation]:
        """Deviations in the numbers that every unit has, where they are open.

        Of a unit in which nothing was found they are those of the first fit: what the whole fleet has is fitted in each
        unit too, and leaves its scatter less certain.
        """
        found = {unit for finding in self.found for unit in finding.units}
        now = [
            deviation
            for number in numbers
            if number.term.is_base and not number.term.sessions
            for deviation in number.deviations
            if deviation.unit in found
        ]
        first = [deviation for number in self.first for deviation in number.deviations if deviation.unit not in found]
        return [deviation for deviation in (*now, *first) if not self._has(deviation.unit, deviation.term.key)]

    def _odd(self, flagged: Mapping[int, "_Suspect"], level: float) -> None:
        """Name what the clearest of the odd units has, and all that have the same."""
        units = list(flagged)
        worst = min(units, key=lambda unit: flagged[unit].log_p)
        # What all units have is fitted in all: of a unit with more or less of it that number is held at the fleet's.
        best = min(flagged[worst].own, key=lambda deviation: deviation.log_p, default=None)
        of_all = self._of_all
        if best is not None and best.term.key in of_all:
            k = next(k for k, term in enumerate(self.terms[worst]) if term.key == best.term.key and not term.sessions)
            (lost,) = values_of(self.run(held, [(self.units[worst], self.terms[worst], k, best.mean)]))
            if lost >= -level:
                self._take_odd(best.term, (worst,))
            else:
                self._without.add((worst, best.term.key))
            return
        tried: dict[Key, FleetTerm] = {}
        for suspect in sorted(flagged.values(), key=lambda suspect: suspect.log_p):
            for deviation in suspect.candidates():
                if deviation.term.key not in of_all and len(tried) < 2 * rules.REFITS_PER_STEP:
                    tried.setdefault(deviation.term.key, _tried(deviation))
        if not tried:
            self._without |= {(worst, deviation.term.key) for deviation in (*flagged[worst].own, *flagged[worst].other)}
            return
        gains = self._gains(units, list(tried.values()))
        row = units.index(worst)
        k = int(np.argmax(gains.nats[row]))
        group = [i for i in gains.explained(k, -level) if not self._has(units[i], gains.terms[k].key)]
        if row not in group:
            self._without |= {(worst, key) for key in tried}
            return
        total = gains.nats[group].sum(axis=0)
        k = int(np.argmax(total))
        members = tuple(units[i] for i in group)
        self._take_odd(gains.common(k, group), members, gains.near(k, total))
        self._prune(members)

    def _of_base(self, numbers: Sequence[Number]) -> bool:
        """A unit with another number of the base, once no effect explains it."""
        best = min(self._plain(numbers), key=lambda deviation: deviation.log_p, default=None)
        if best is None or best.log_p > self.plain_level:
            return False
        self._take_odd(best.term, (best.unit,))
        return True

    def _take_change(
        self, term: FleetTerm, unit: int, change: Change, changes: Sequence[tuple[FleetTerm, int, Change]]
    ) -> None:
        """Only the clearest change of a unit, with the other numbers that it could be a change of."""
        near = []
        for other, place, possible in changes:
            lost = change.nats - possible.nats
            if place == unit and other != term and lost <= rules.ALTERNATIVE_NATS:
                near.append((other, lost))
        self.found.append(FleetFinding(change.kind, term, (unit,), tuple(near), change))
        self.before_change[unit] = self.scores[unit]
        sessions = self.scores[unit].sessions
        # A drift is a change in the middle, as far as it could pass for another effect.
        later = sessions[change.first if change.kind == "change" else len(sessions) // 2 :]
        self._fit([unit], replace(term, sessions=later, start=change.size))

    def _take_odd(
        self, term: FleetTerm, units: tuple[int, ...], alternatives: tuple[tuple[FleetTerm, float], ...] = ()
    ) -> None:
        """Units that are odd in a number, with those that were found to be before."""
        same = self._odd_in(term)
        if same:
            self._replace(same[0], (*same[0].units, *units))
        else:
            self.found.append(FleetFinding("odd", term, units, alternatives))
        if not term.is_base:
            self._fit(units, term)

    def _odd_in(self, term: FleetTerm) -> list[FleetFinding]:
        return [finding for finding in self.found if finding.kind == "odd" and finding.term.identity == term.identity]

    def _replace(self, finding: FleetFinding, units: tuple[int, ...]) -> None:
        """The finding with other units in its place; with none it is no finding."""
        place = self.found.index(finding)
        self.found[place : place + 1] = [replace(finding, units=units)] if units else []

    def _prune(self, units: Iterable[int]) -> None:
        """Take out effects of units that others, found later, have made needless."""
        for unit in units:
            for term in self.terms[unit]:
                others = tuple(other for other in self.terms[unit] if other != term)
                own = [finding for finding in self._odd_in(term) if unit in finding.units]
                if not own or not others:
                    continue
                ((lost,),) = values_of(self.run(compare, [(self.units[unit], others, (term,))]))
                if lost.gain_nats >= -rules.KEEP_SHARE * self.level:
                    continue
                self.terms[unit] = others
                (self.scores[unit],) = self.examined([unit], self.terms)
                # It is not asked again, so that effects do not take each other's place in turn.
                self._without.add((unit, term.key))
                self._replace(own[0], tuple(other for other in own[0].units if other != unit))

    def fits(self, unit: int, term: FleetTerm) -> bool:
        """Whether a unit is known to have an effect."""
        return any(own.key == term.key and not own.sessions for own in self.terms[unit])

    def _fit(self, units: Sequence[int], term: FleetTerm) -> None:
        """Refit units with one more term; those that have it already, as what an odd one shares with all, are left."""
        units = [unit for unit in units if term.sessions or not self.fits(unit, term)]
        for unit in units:
            self.terms[unit] = (*self.terms[unit], term)
        for unit, numbers in zip(units, self.examined(units, self.terms), strict=True):
            self.scores[unit] = numbers

    def examined(
        self, places: Sequence[int], terms: Sequence[tuple[FleetTerm, ...]], with_others: bool = True
    ) -> list[UnitNumbers]:
        """Scores of some units with these terms of all units, and of all other effects."""
        return values_of(self.run(examine, [(self.units[k], terms[k], with_others) for k in places]))

    def _gains(self, units: Sequence[int], tried: Sequence[FleetTerm]) -> "_Gains":
        """What each effect gains in each unit, as many independent readings would."""
        fits: list[list[RefittedTerm]] = values_of(
            self.run(compare, [(self.units[k], self.terms[k], tried) for k in units])
        )
        nats = np.array([[refitted.gain_nats for refitted in row] for row in fits])
        return _Gains(tuple(tried), fits, nats)


def values_of(outcomes: Iterable[ItemOutcome[Any]]) -> list[Any]:
    """The results; RecordingError where there is none, since the files could be read before."""
    found = []
    for outcome in outcomes:
        if outcome.error is not None:
            raise RecordingError(f"a sensor's readings could be used once, and now not: {outcome.error}")
        found.append(outcome.value)
    return found


@dataclass
class _Suspect:
    """A unit that is odd: the smallest p-value that says so, effects that do, and others that may be why."""

    log_p: float = 0.0
    own: list[Deviation] = field(default_factory=list)
    other: list[Deviation] = field(default_factory=list)

    def candidates(self) -> list[Deviation]:
        """The effects to refit, the clearest first; each with its best shape."""
        # Not only those near the best: of what is large a score promises too little.
        return [*_best_by_key(self.own)[: rules.REFITS_PER_STEP], *_best_by_key(self.other)]


@dataclass(frozen=True)
class _Gains:
    """Effects refitted in several units, and what they gain, (units, effects)."""

    terms: tuple[FleetTerm, ...]
    fits: list[list[RefittedTerm]]
    nats: Array

    def explained(self, k: int, least_nats: float) -> list[int]:
        """Places of the units that the k-th effect explains, and as well as any other does."""
        behind = self.nats.max(axis=1) - self.nats[:, k]
        return np.flatnonzero((behind <= rules.ALTERNATIVE_NATS) & (self.nats[:, k] >= least_nats)).tolist()

    def near(self, k: int, total: Array) -> tuple[tuple[FleetTerm, float], ...]:
        """Alternatives to the k-th effect."""
        lost = total[k] - total
        order = [j for j in np.argsort(lost).tolist() if j != k and lost[j] <= rules.ALTERNATIVE_NATS]
        return tuple((self.terms[j], float(lost[j])) for j in order)

    def common(self, k: int, group: Sequence[int]) -> FleetTerm:
        """The effect with one shape for all of these units: the median of their own, by what they gain."""
        term = self.terms[k]
        rows = sorted(group, key=lambda i: -self.nats[i, k])
        some = [dict(self.fits[i][k].values) for i in rows[: max(1, len(rows) // 2)]]
        shape = tuple((name, float(f"{np.median([values[name] for values in some]):.4g}")) for name, _ in term.shape)
        return replace(
            term, shape=shape, shape_fitted=False, start=float(np.median([values[term.number] for values in some]))
        )


def mean_nats(nats: Array, numbers: Sequence[Number]) -> Array:
    """What each number gains in the mean unit that is ordinary in it: a few odd ones are no reason to give it to all.

    Parameters
    ----------
    nats
        What each unit gains by each number, (units, numbers).
    numbers
        Over the fleet.
    """
    return np.array([nats[number.units[number.fleet.ordinary], j].mean() for j, number in enumerate(numbers)])


def _best_by_key(deviations: Iterable[Deviation]) -> list[Deviation]:
    """For each effect the shape with the smallest p-value, the smallest first."""
    best: dict[Key, Deviation] = {}
    for deviation in sorted(deviations, key=lambda deviation: deviation.log_p):
        best.setdefault(deviation.term.key, deviation)
    return list(best.values())


def _tried(deviation: Deviation) -> FleetTerm:
    # What rests on few improbable readings has another size than its score says: nothing is known of where it is.
    start = 0.0 if candidate_of(deviation.term).is_rare else deviation.value
    return replace(deviation.term, shape_fitted=True, start=start)
