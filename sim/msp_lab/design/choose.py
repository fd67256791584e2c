"""The cheapest session that decides a question, or that none does.

Of the sessions that a lab or a pilot can do, those that tell a question's fitted answers apart make a `Design`.
Sessions are tried in the order of the time for setting them up, until setting up alone takes longer than the best one
in all.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, permutations, product
from math import ceil, inf
from typing import Protocol, TypeAlias

import numpy as np

from msp_lab.design.answers import FittedAnswer, with_strength
from msp_lab.design.questions import OpenQuestion
from msp_lab.design.separation import (
    DRAWN_ROWS,
    Separation,
    needed_nats,
    power_of,
    separation,
    threshold_nats,
)
from msp_lab.design.session import PlannedSession
from msp_lab.gap import rules
from msp_lab.gap.problem import Progress
from msp_sim.model.model import Model

MOST_VARIED = 4
"""At most so many columns are varied in a session; with more its points are too many to set up."""
TRIED_READINGS = 60
"""Readings at a point, or of a sensor in a flight, with which a session is first looked at: the nats per reading hardly
depend on it."""
MARGIN = 1.1
"""A session gets so many times the readings that are needed: the nats per reading are known to about a tenth."""
MOST_READINGS = 2 * rules.READINGS
"""Readings of a session at most: over an hour of reading or flying. The gap workflow compares alternatives on half of
so many. More: longer sessions are tried, for effects that may be absent."""
VISITS = (1, 2, 4)
"""How often each placement of the target, or each group of flights, is repeated: what differs between runs becomes
certain with their number only. More: longer sessions are tried, and more pairs decided."""
CHECKED_ROWS = 12_000
"""Readings that are drawn to check the session that was chosen: 13.6 nats in 2,000 are then known to a sixth.
More: slower."""
HARD = 2.0
"""Pairs with less than so many times the nats that they need are checked. Higher: slower."""
LONGER = 1.05
"""Steps in which a session is made longer until it is long enough. Smaller: slower, and sessions shorter by that."""


class SessionPlace(Protocol):
    """Where sessions are held: a bench, or a vehicle.

    Attributes
    ----------
    instead
        Columns that cannot be varied there: why not, and what to do.
    """

    @property
    def instead(self) -> Mapping[str, str]:
        """As it says above."""

    def factors(self, columns: frozenset[str]) -> tuple[str, ...]:
        """Those of these columns that can be varied."""

    def can_record(self, columns: frozenset[str]) -> bool:
        """Whether these columns can be known."""

    def session(
        self, varied: Sequence[str], ends_only: bool, record: frozenset[str], readings: int, visits: int
    ) -> PlannedSession:
        """A session that varies some columns.

        Parameters
        ----------
        varied
            Columns.
        ends_only
            Only the first and the last of their levels.
        readings
            Of a sensor, at a point of the bench or in a flight.
        record
            Columns that have to be known, varied or not.
        visits
            How often each point, or each flight, is repeated.

        Raises
        ------
        ConfigError
            It cannot be held there.
        """


@dataclass(frozen=True)
class Same:
    """Two answers that no session here tells apart."""

    one: int
    other: int
    """Their places."""
    nats: float
    """Expected nats between them in the largest session."""

    @property
    def structural(self) -> bool:
        """Whether the largest session leaves them as near to each other as alternatives are."""
        return self.nats < rules.ALTERNATIVE_NATS


@dataclass(frozen=True)
class Design:
    """The answer to how a question is decided."""

    question: OpenQuestion
    answers: tuple[FittedAnswer, ...]
    """What is to be decided, with the strengths that were planned with."""
    session: PlannedSession | None
    """The cheapest one; None: none is allowed."""
    separations: tuple[Separation, ...] = ()
    """Separations of the pairs of answers that it tells apart."""
    same: tuple[Same, ...] = ()
    """Pairs of answers that no session here tells apart with this power."""
    classes: tuple[frozenset[int], ...] = ()
    """Places of the answers that are one as far as any session can say; what is like the same third is alike."""
    power: float = 0.0
    """Expected power for the hardest of the other pairs."""
    why: str = ""
    """Why there is no session; empty where there is one."""
    wanted: float = 0.95
    """The power that was asked for."""
    make: "Make | None" = None
    """Makes the session with another number of readings at each point, and of visits."""

    @property
    def needed_nats(self) -> float:
        """Expected nats that the hardest pair needs."""
        return max(
            needed_nats(self.wanted, threshold_nats(self.answers[each.truth], self.answers[each.alternative]))
            for each in self.separations
        )

    def longer(self, times: float) -> "Design":
        """The design with so many times the readings."""
        assert self.session is not None
        assert self.make is not None
        session = self.make(ceil(times * self.session.per_point), self.session.visits)
        return replace(self, session=session, power=_power(session, self.separations, self.answers))

    def class_of(self, place: int) -> frozenset[int]:
        """The answers that are one with this one."""
        return next((alike for alike in self.classes if place in alike), frozenset({place}))


@dataclass(frozen=True)
class Decision:
    """What a session has to decide, and what its readings have to say for it."""

    question: OpenQuestion
    answers: tuple[FittedAnswer, ...]
    """Fitted to the old readings."""
    given: Model
    """The given model."""
    power: float
    """Probability that the right answer is named, whichever it is."""
    run_offset_cm: float
    """Standard deviation of offsets between runs that the old readings have."""
    old_runs: int
    """Runs of the old readings, if they go in."""
    rng: np.random.Generator
    """Draws readings."""

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """A right answer that is an effect, and a wrong one."""
        places = permutations(range(len(self.answers)), 2)
        return [(truth, other) for truth, other in places if self.answers[truth].answer.name is not None]

    def needed(self, truth: int, alternative: int) -> float:
        """Expected nats that a pair needs."""
        return MARGIN * needed_nats(self.power, threshold_nats(self.answers[truth], self.answers[alternative]))

    def separations(self, session: PlannedSession, pairs: Iterable[tuple[int, int]], rows: int) -> list[Separation]:
        """How far a session's readings tell pairs apart, from so many that are drawn."""
        contexts = session.sampled(rows)
        offset_cm = float(np.hypot(session.offset_cm, self.run_offset_cm))
        return [
            separation(
                self.given, (self.answers[a], self.answers[b]), (a, b), contexts, offset_cm, self.rng, self.old_runs
            )
            for a, b in pairs
        ]


def cheapest(decision: Decision, places: Sequence[SessionPlace], max_minutes: float, report: Progress) -> Design:
    """The cheapest session in which each answer is found with the wanted power where it is true.

    Parameters
    ----------
    decision
        What it has to decide.
    places
        Where sessions may be held.
    max_minutes
        No session may take longer.
    report
        Progress.
    """
    question, record = decision.question, decision.question.columns
    usable = [place for place in places if place.can_record(record) and place.factors(record)]
    if not usable:
        return Design(question, decision.answers, None, why=_why_not(record, places))
    # What is largest at the ends of its range is seen best without the middle.
    richest = [
        place.session(place.factors(record)[:MOST_VARIED], ends_only, record, TRIED_READINGS, VISITS[0])
        for place, ends_only in product(usable, (False, True))
    ]
    contexts = richest[0].sampled(DRAWN_ROWS)
    answers = [with_strength(answer, decision.given, contexts, decision.rng) for answer in decision.answers]
    decision = replace(decision, answers=tuple(answers))
    report(f"what could tell {question.label} apart", 0.1)
    reach = dict.fromkeys(decision.pairs, 0.0)
    for most in richest:
        for each in decision.separations(most, decision.pairs, DRAWN_ROWS):
            reach[each.pair] = max(reach[each.pair], each.nats(MOST_READINGS, VISITS[-1] * most.runs))
    same: list[Same] = []
    for one, other in combinations(range(len(answers)), 2):
        short = [nats for pair, nats in reach.items() if {*pair} == {one, other} and nats < decision.needed(*pair)]
        same += [Same(one, other, min(short))] if short else []
    trials = sorted(_trials(record, usable), key=lambda trial: trial[1].minutes)
    known: dict[int, list[Separation]] = {}
    why = "no session that can be held here tells them apart"
    while True:
        classes = _classes(len(answers), same)
        left = [pair for pair in decision.pairs if not any({*pair} <= alike for alike in classes)]
        if not left:
            return Design(question, decision.answers, None, same=tuple(same), classes=classes, why=why)
        best = _quickest(decision, left, trials, known, max_minutes, report)
        why = best.why or why
        if best.session is not None:
            best = _checked(best, decision)
        if best.session is not None:
            if best.session.minutes <= max_minutes:
                return replace(best, same=tuple(same), classes=classes)
            why = f"the shortest session takes {best.session.minutes:.0f} minutes; allow it with --max-minutes"
        # What is hardest to tell apart is given up first: the rest may be decided by a shorter session.
        hardest = min(left, key=lambda pair: reach[pair] / decision.needed(*pair))
        same.append(Same(min(hardest), max(hardest), reach[hardest]))


def _quickest(
    decision: Decision,
    left: Sequence[tuple[int, int]],
    trials: Sequence[tuple["Make", PlannedSession]],
    known: dict[int, list[Separation]],
    max_minutes: float,
    report: Progress,
) -> Design:
    """The quickest session that tells these pairs apart, or none.

    `known` keeps the separations of each trial, by its place, for the time when fewer pairs are left.
    """
    best = Design(decision.question, decision.answers, None)
    quickest = inf
    for number, (make, shortest) in enumerate(trials):
        if shortest.minutes >= quickest:
            break
        if shortest.minutes > max_minutes and best.session is None and number:
            why = f"no session of {max_minutes:.0f} minutes tells them apart; allow longer ones with --max-minutes"
            return replace(best, why=why)
        report(f"trying sessions for {decision.question.label}", 0.2 + 0.8 * number / len(trials))
        if number not in known:
            known[number] = decision.separations(shortest, left, DRAWN_ROWS)
        found = [each for each in known[number] if each.pair in left]
        session = _long_enough(make, shortest, found, decision.needed)
        if session is not None and session.minutes < quickest:
            quickest, power = session.minutes, _power(session, found, decision.answers)
            best = replace(
                best, session=session, separations=tuple(found), power=power, wanted=decision.power, make=make
            )
    return best


def _why_not(columns: frozenset[str], places: Sequence[SessionPlace]) -> str:
    """Why no session can be held, and what a person can do instead."""
    reasons = [
        f"{name}: {place.instead[name]}" for place in places for name in sorted(columns) if name in place.instead
    ]
    why = f"no session here can vary and record {', '.join(sorted(columns))}"
    return ". ".join([why, *dict.fromkeys(reasons)])


Make: TypeAlias = Callable[[int, int], PlannedSession]
"""A session with so many readings at each point, and so many visits."""


def _trials(record: frozenset[str], places: Sequence[SessionPlace]) -> Iterator[tuple[Make, PlannedSession]]:
    """Every session that varies some of the columns, in its shortest form."""
    for place in places:
        factors = place.factors(record)
        for count in range(1, min(len(factors), MOST_VARIED) + 1):
            for varied, ends_only in product(combinations(factors, count), (True, False)):
                make = partial(place.session, varied, ends_only, record)
                yield make, make(1, VISITS[0])


def _classes(answers: int, same: Sequence[Same]) -> tuple[frozenset[int], ...]:
    classes = [frozenset({place}) for place in range(answers)]
    for pair in same:
        joined = [group for group in classes if group & {pair.one, pair.other}]
        classes = [frozenset().union(*joined), *(group for group in classes if group not in joined)]
    return tuple(sorted(classes, key=min))


def _long_enough(
    make: Make,
    shortest: PlannedSession,
    found: Sequence[Separation],
    needed: Callable[[int, int], float],
) -> PlannedSession | None:
    """The quickest session with as many readings and visits as every pair needs; None: no number is enough."""
    best: PlannedSession | None = None
    for visits in VISITS:
        session = shortest if visits == shortest.visits else make(shortest.per_point, visits)
        while session.readings <= MOST_READINGS and (best is None or session.minutes < best.minutes):
            readings = _readings_needed(session, found, needed)
            if readings <= session.readings:
                best = session
            if readings <= session.readings or readings > MOST_READINGS:
                break
            # What a flight or a point takes in any case does not grow with the readings asked for, so that once is not
            # always enough.
            longer = make(ceil(session.per_point * readings / session.readings), visits)
            if longer.readings <= session.readings:
                break
            session = longer
    return best


def _readings_needed(
    session: PlannedSession, found: Sequence[Separation], needed: Callable[[int, int], float]
) -> float:
    """Readings with which every pair has enough nats in as many runs; above `MOST_READINGS` where none are enough."""
    readings = float(session.readings)
    while readings <= MOST_READINGS and any(
        each.nats(int(readings), session.runs) < needed(*each.pair) for each in found
    ):
        readings *= LONGER
    return readings


def _checked(design: Design, decision: Decision) -> Design:
    """The design with its hardest pairs computed anew from more readings, and as long as these need.

    The shortest of many sessions is one of those whose nats were drawn too large.
    """
    session, make = design.session, design.make
    assert session is not None
    assert make is not None

    def is_hard(each: Separation) -> bool:
        return each.nats(session.readings, session.runs) < HARD * decision.needed(*each.pair)

    hard = [each.pair for each in design.separations if is_hard(each)]
    easy = [each for each in design.separations if not is_hard(each)]
    found = [*easy, *decision.separations(session, hard, CHECKED_ROWS)]
    longer = _long_enough(make, session, found, decision.needed)
    if longer is None:
        return replace(design, session=None)
    return replace(design, session=longer, separations=tuple(found), power=_power(longer, found, design.answers))


def _power(session: PlannedSession, found: Sequence[Separation], answers: Sequence[FittedAnswer]) -> float:
    """Power for the hardest pair."""
    return min(
        power_of(
            each.nats(session.readings, session.runs), threshold_nats(answers[each.truth], answers[each.alternative])
        )
        for each in found
    )
