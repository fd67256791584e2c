"""Which effects the fleet shares, which units are odd ones out, and which have changed: one finding after the other.

The plainest question is whether a number that every unit has (offset, scatter, share of a kind of outlier) is odd in
one. These tests share half of the false-discovery rate; all others (the mean of each effect over the fleet, each unit's
deviation from the others in it, changes and drifts) share the other half, for they are ten times as many. In either
family the smallest p-value is a finding if it is at most ``fdr / 2 (found + 1) / tests``: the limits of Benjamini &
Hochberg (1995, J. R. Stat. Soc. B 57:289), one step at a time from the smallest. After each finding its effect enters
the fits of the units that have it, so that what only looked like it is not found in its wake.

Which effect a unit has is decided by refits: that which gains most over all units that are odd in the same way. Effects
that gain nearly as much are its alternatives.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from msp_lab.fleet.findings import Kind
from msp_lab.fleet.statistics import Change, Number, changes_of, numbers_of
from msp_lab.fleet.terms import FleetTerm, candidate_of, effect_of
from msp_lab.fleet.unit import RefittedTerm, Unit, UnitScores, compare, examine
from msp_lab.gap import rules
from msp_range.recording.error import RecordingError
from msp_sim.model.model import Model
from msp_sim.workers import ItemOutcome

Key = tuple[str, str | None]
Map = Callable[[Callable[[Model, Any], Any], Sequence[Any]], Iterable[ItemOutcome[Any]]]
"""Calls a function with the model and each item of a list; other processes may do it."""

MAX_FINDINGS = 40
"""The search ends after so many: what is then left has a common cause that nobody has named."""
SHARED_NATS = 8.0
"""An effect that the fleet shares gains so much in the mean sensor [nat], 4 standard errors. Twenty vehicles show less
for certain, but half of it is what the bench leaves open of the model: 3.8 in a drawn fleet without any effect. Lower:
shared effects that are the bench's error; higher: weak ones are missed."""
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
    """Places of the units."""
    log_p: tuple[float, ...]
    """Logarithms of their p-values, or the one of the fleet's mean."""
    alternatives: tuple[tuple[FleetTerm, float], ...] = ()
    """Other effects that explain it as well, with how much less they gain [nat]."""
    change: Change | None = None
    """Of one unit."""


@dataclass
class Search:
    """The state of the search: what each unit is known to have, and what was found."""

    units: Sequence[Unit]
    """Those that can be used."""
    scores: list[UnitScores]
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
        self.before_change: dict[int, UnitScores] = {}
        """Of a unit that changed, its scores before the change was known."""
        self._without: set[tuple[int, Key]] = set()
        """Units, or -1 for the fleet, and effects that did not gain what their scores promised."""
        self._plain_first: dict[tuple[FleetTerm, int], float] = {}
        """Logarithms of p-values of the numbers that every unit has, at the first fit."""

    def search(self) -> None:
        """Find until nothing is left that random variation does not explain."""
        self._plain_first = {
            (each.term, unit): log_p
            for each in numbers_of(self.scores)
            if each.term.is_base
            for unit, log_p in zip(each.units.tolist(), each.log_p.tolist(), strict=True)
        }
        while len(self.found) < MAX_FINDINGS:
            numbers, changes = numbers_of(self.scores), changes_of(self.scores)
            plain = sum(each.units.size for each in numbers if each.term.is_base)
            # A mean for each effect, a deviation for each unit, and its changes and drifts.
            others = sum(each.units.size + 1 for each in numbers if not each.term.is_base) + 2 * len(changes)
            self.plain_tests, self.other_tests = max(self.plain_tests, plain), max(self.other_tests, others)
            if not (self._shared(numbers) or self._of_units(numbers, changes) or self._of_base(numbers)):
                break

    @property
    def tests(self) -> int:
        """Number of hypotheses."""
        return self.plain_tests + self.other_tests

    @property
    def _log_level(self) -> float:
        """Logarithm of the p-value that the next finding may have, unless it is a number that every unit has."""
        return self._level(self.other_tests)

    @property
    def _plain_log_level(self) -> float:
        """The same of a number that every unit has."""
        return self._level(self.plain_tests)

    def _level(self, tests: int) -> float:
        count = sum(len(each.log_p) for each in self.found)
        return float(np.log(0.5 * self.fdr * (count + 1) / max(tests, 1)))

    @property
    def _of_all(self) -> set[Key]:
        """Effects that all units are known to have."""
        return {each.term.key for each in self.found if each.kind in ("shared", "calibration")}

    def _has(self, unit: int, key: Key) -> bool:
        kinds = [each for each in self.found if each.term.key == key and each.kind == "odd"]
        return (unit, key) in self._without or any(unit in each.units for each in kinds)

    def _shared(self, numbers: Sequence[Number]) -> bool:
        """One more effect that the fleet shares."""
        of_all = self._of_all
        open_ = [
            each
            for each in numbers
            if not (each.term.is_base or each.term.sessions)
            and each.term.key not in of_all
            and (-1, each.term.key) not in self._without
            and each.fleet.ordinary.sum() > len(self.units) / 2.0
        ]
        best = _best_by_key((each.shared_log_p, each) for each in open_)
        best = [pair for pair in best if pair[0] <= self._log_level]
        if not best:
            return False
        # What every sensor has a number for, such as the tails of its noise, is calibrated before anything is named.
        numbered = [pair for pair in best if effect_of(pair[1].term.effect).base is not None]
        near = [pair for pair in best if pair[0] <= rules.REFIT_WITHIN_SHARE * best[0][0]]
        best = numbered[:1] or near[:SHARED_TRIED]
        everyone = list(range(len(self.units)))
        tried = [_tried(number, number.fleet.mean) for _, number in best]
        gains = self._gains(everyone, tried)
        total = gains.nats.sum(axis=0)
        k = int(np.argmax(total))
        calibration = effect_of(tried[k].effect).base is not None
        needed = -self._log_level if calibration else max(-self._log_level, SHARED_NATS * len(self.units))
        if total[k] < needed:
            self._without |= {(-1, each.key) for each in tried}
            return True
        term = gains.common(k, everyone)
        log_p = next(each for each, number in best if number.term.key == term.key)
        kind: Kind = "calibration" if calibration else "shared"
        self._take(FleetFinding(kind, term, tuple(everyone), (log_p,), gains.near(k, total)))
        return True

    def _of_units(self, numbers: Sequence[Number], changes: Sequence[tuple[FleetTerm, int, Change]]) -> bool:
        """Some units with one more effect, or one that changed."""
        level = self._log_level
        flagged = self._flagged(numbers, level)
        done = {each.units[0] for each in self.found if each.change is not None}
        changed = [each for each in changes if each[2].log_p <= level and each[1] not in done]
        first = min((each.log_p for each in flagged.values()), default=0.0)
        if changed and min(each[2].log_p for each in changed) <= first:
            self._take_change(*min(changed, key=lambda each: each[2].log_p), changes)
            return True
        if not flagged:
            return False
        return self._odd(flagged, level)

    def _flagged(self, numbers: Sequence[Number], level: float) -> dict[int, "_Suspect"]:
        """Units that are odd, each with the effects that may be why.

        Those are effects whose own number is odd, and where a number of the base is, all that change the same: where
        throttle hardly varies, a score says little of what grows with throttle, and a refit more.
        """
        of_base = {
            (unit, effect_of(term.effect).channels[0]): log_p
            for log_p, term, unit in self._plain(numbers)
            if log_p <= self._plain_log_level
        }
        found: dict[int, _Suspect] = {}
        for number in numbers:
            if number.term.is_base or number.term.sessions:
                continue
            channels = effect_of(number.term.effect).channels
            if "component" in channels:
                # Echoes from elsewhere count as short or random readings until they have a name.
                channels = (*channels, "short", "random")
            for j, unit in enumerate(number.units.tolist()):
                own, same = float(number.log_p[j]), [(unit, each) for each in channels]
                others = [] if self.fits(unit, number.term) else [of_base[each] for each in same if each in of_base]
                if self._has(unit, number.term.key) or (own > level and not others):
                    continue
                suspect = found.setdefault(unit, _Suspect())
                suspect.log_p = min([suspect.log_p, own, *others])
                (suspect.own if own <= level else suspect.other).append((own, number, j))
        return found

    def _plain(self, numbers: Sequence[Number]) -> list[tuple[float, FleetTerm, int]]:
        """Logarithms of p-values of the numbers that every unit has, where they are open.

        Of a unit in which nothing was found they are those of the first fit: what the whole fleet has is fitted in each
        unit too, and leaves its scatter less certain.
        """
        found = {unit for each in self.found if each.kind in ("odd", "change", "drift") for unit in each.units}
        return [
            (float(number.log_p[j]) if unit in found else self._plain_first[number.term, unit], number.term, unit)
            for number in numbers
            if number.term.is_base and not number.term.sessions
            for j, unit in enumerate(number.units.tolist())
            if not self._has(unit, number.term.key) and (unit in found or (number.term, unit) in self._plain_first)
        ]

    def _odd(self, flagged: dict[int, "_Suspect"], level: float) -> bool:
        worst = min(flagged, key=lambda unit: flagged[unit].log_p)
        # What all units have is fitted in all: a unit with more or less of it needs no refit.
        best = min(flagged[worst].own, key=lambda each: each[0], default=None)
        of_all = self._of_all
        if best is not None and best[1].term.key in of_all:
            self._take(FleetFinding("odd", best[1].term, (worst,), (best[0],)))
            return True
        tried: dict[Key, FleetTerm] = {}
        for suspect in sorted(flagged.values(), key=lambda each: each.log_p):
            for number, j in suspect.candidates():
                if number.term.key not in of_all and len(tried) < 2 * rules.REFITS_PER_STEP:
                    tried.setdefault(number.term.key, _tried(number, float(number.value[j])))
        if not tried:
            self._without |= {(worst, number.term.key) for _, number, _ in (*flagged[worst].own, *flagged[worst].other)}
            return True
        units = list(flagged)
        gains = self._gains(units, list(tried.values()))
        nats = gains.nats
        row = units.index(worst)
        k = int(np.argmax(nats[row]))

        def alike(k: int) -> list[int]:
            """Units that this effect explains as well as any other does."""
            behind = nats.max(axis=1) - nats[:, k] <= rules.ALTERNATIVE_NATS
            return [
                i
                for i in np.flatnonzero(behind & (nats[:, k] >= -level)).tolist()
                if not self._has(units[i], gains.terms[k].key)
            ]

        group = alike(k)
        if row not in group:
            self._without |= {(worst, each.key) for each in tried.values()}
            return True
        total = nats[group].sum(axis=0)
        k = int(np.argmax(total))
        term = gains.common(k, group)
        members = tuple(units[i] for i in group)
        smallest = tuple(flagged[unit].log_p for unit in members)
        self._take(FleetFinding("odd", term, members, smallest, gains.near(k, total)))
        self._prune(members)
        return True

    def _of_base(self, numbers: Sequence[Number]) -> bool:
        """A unit with another number of the base, once no effect explains it."""
        pairs = self._plain(numbers)
        log_p, term, unit = min(pairs, key=lambda each: each[0], default=(0.0, None, -1))
        if term is None or log_p > self._plain_log_level:
            return False
        same = next((k for k, each in enumerate(self.found) if each.kind == "odd" and each.term == term), None)
        if same is None:
            self._take(FleetFinding("odd", term, (unit,), (log_p,)))
        else:
            old = self.found[same]
            self.found[same] = replace(old, units=(*old.units, unit), log_p=(*old.log_p, log_p))
        return True

    def _take_change(
        self, term: FleetTerm, unit: int, change: Change, changes: Sequence[tuple[FleetTerm, int, Change]]
    ) -> None:
        """Only the clearest change of a unit, with the other numbers that it could be a change of."""
        nats = 0.5 * (change.size / change.error) ** 2
        near = []
        for other, place, each in changes:
            lost = nats - 0.5 * (each.size / each.error) ** 2
            if place == unit and other != term and lost <= rules.ALTERNATIVE_NATS:
                near.append((other, lost))
        self.found.append(FleetFinding(change.kind, term, (unit,), (change.log_p,), tuple(near), change))
        self.before_change[unit] = self.scores[unit]
        sessions = self.scores[unit].sessions
        # A drift is a change in the middle, as far as it could pass for another effect.
        later = sessions[change.first if change.kind == "change" else len(sessions) // 2 :]
        self._fit({unit: replace(term, sessions=later, start=change.size)})

    def _take(self, finding: FleetFinding) -> None:
        self.found.append(finding)
        if not finding.term.is_base:
            self._fit({unit: finding.term for unit in finding.units if not self.fits(unit, finding.term)})

    def _prune(self, units: Iterable[int]) -> None:
        """Take out effects of units that others, found later, have made needless."""
        for unit in units:
            for term in [each for each in self.terms[unit] if not each.sessions]:
                own = [k for k, each in enumerate(self.found) if each.kind == "odd" and each.term == term]
                others = tuple(each for each in self.terms[unit] if each != term)
                if not own or not others or unit not in self.found[own[0]].units:
                    continue
                ((lost,),) = values_of(self.run(compare, [(self.units[unit], others, (term,))]))
                if lost.gain_nats >= -rules.KEEP_SHARE * self._log_level:
                    continue
                self.terms[unit] = others
                (self.scores[unit],) = self.examined([unit], self.terms)
                # It is not asked again, so that effects do not take each other's place in turn.
                self._without.add((unit, term.key))
                old = self.found[own[0]]
                kept = [k for k, each in enumerate(old.units) if each != unit]
                units_left, log_p = tuple(old.units[k] for k in kept), tuple(old.log_p[k] for k in kept)
                self.found[own[0]] = replace(old, units=units_left, log_p=log_p)
        self.found = [each for each in self.found if each.units]

    def fits(self, unit: int, term: FleetTerm) -> bool:
        """Whether a unit is known to have an effect."""
        return any(each.key == term.key and not each.sessions for each in self.terms[unit])

    def _fit(self, added: dict[int, FleetTerm]) -> None:
        """Refit units with one more term."""
        for unit, term in added.items():
            self.terms[unit] = (*self.terms[unit], term)
        places = list(added)
        for k, each in zip(places, self.examined(places, self.terms), strict=True):
            self.scores[k] = each

    def examined(
        self, places: Sequence[int], terms: Sequence[tuple[FleetTerm, ...]], with_others: bool = True
    ) -> list[UnitScores]:
        """Scores of some units with these terms of all units, and of all other effects."""
        return values_of(self.run(examine, [(self.units[k], terms[k], with_others) for k in places]))

    def _gains(self, units: Sequence[int], tried: Sequence[FleetTerm]) -> "_Gains":
        """What each effect gains in each unit, as many independent readings would."""
        fits: list[list[RefittedTerm]] = values_of(
            self.run(compare, [(self.units[k], self.terms[k], tried) for k in units])
        )
        nats = np.array([[each.gain_nats for each in row] for row in fits])
        for i, unit in enumerate(units):
            scores = self.scores[unit]
            for j, term in enumerate(tried):
                if candidate_of(term).linear:
                    # No single reading gains much, and the scores at a share of 0 vary because of the effect itself.
                    continue
                same = [float(f) for f, each in zip(scores.factor, scores.terms, strict=True) if each.key == term.key]
                nats[i, j] /= max(min(same, default=1.0), 1.0)
        return _Gains(tuple(tried), fits, nats)


def values_of(outcomes: Iterable[ItemOutcome[Any]]) -> list[Any]:
    """The results; RecordingError where there is none, since the files could be read before."""
    found = []
    for each in outcomes:
        if each.error is not None:
            raise RecordingError(f"a sensor's readings could be used once, and now not: {each.error}")
        found.append(each.value)
    return found


@dataclass
class _Suspect:
    """A unit that is odd: the smallest p-value that says so, effects that do, and others that may be why."""

    log_p: float = 0.0
    own: list[tuple[float, Number, int]] = field(default_factory=list)
    other: list[tuple[float, Number, int]] = field(default_factory=list)

    def candidates(self) -> list[tuple[Number, int]]:
        """The effects to refit, the clearest first; each with its best shape."""
        own = _best_by_key((log_p, (number, j)) for log_p, number, j in self.own)
        # Not only those near the best: of what is large a score promises too little.
        own = own[: rules.REFITS_PER_STEP]
        return [each for _, each in (*own, *_best_by_key((log_p, (number, j)) for log_p, number, j in self.other))]


@dataclass(frozen=True)
class _Gains:
    """Effects refitted in several units, and what they gain, (units, effects)."""

    terms: tuple[FleetTerm, ...]
    fits: list[list[RefittedTerm]]
    nats: Any

    def near(self, k: int, total: Any) -> tuple[tuple[FleetTerm, float], ...]:
        """Alternatives to the k-th effect."""
        lost = total[k] - total
        order = [j for j in np.argsort(lost).tolist() if j != k and lost[j] <= rules.ALTERNATIVE_NATS]
        return tuple((self.terms[j], float(lost[j])) for j in order)

    def common(self, k: int, group: Sequence[int]) -> FleetTerm:
        """The effect with one shape for all of these units: the median of their own, by what they gain."""
        term = self.terms[k]
        rows = sorted(group, key=lambda i: -self.nats[i, k])
        some = [dict(self.fits[i][k].values) for i in rows[: max(1, len(rows) // 2)]]
        shape = tuple((name, float(f"{np.median([each[name] for each in some]):.4g}")) for name, _ in term.shape)
        return replace(
            term, shape=shape, shape_fitted=False, start=float(np.median([each[term.number] for each in some]))
        )


def _best_by_key(pairs: Iterable[tuple[float, Any]]) -> list[tuple[float, Any]]:
    """For each effect the shape with the smallest p-value, the smallest first."""
    best: dict[Key, tuple[float, Any]] = {}
    for log_p, each in pairs:
        number = each if isinstance(each, Number) else each[0]
        key = number.term.key
        if key not in best or log_p < best[key][0]:
            best[key] = log_p, each
    return sorted(best.values(), key=lambda each: each[0])


def _tried(number: Number, start: float) -> FleetTerm:
    return replace(number.term, shape_fitted=True, start=start)
