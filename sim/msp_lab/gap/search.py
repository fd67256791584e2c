"""Which effects of the catalogue are missing: forward selection with joint refits, then curves, exchange, elimination.

The result is the selected terms of a problem with their alternatives, and the first screen. A candidate is taken when
its gain passes what the best of all candidates gains by random variation. Where an effect is added, is decided in
`_next_term`.
"""

from collections.abc import Set
from dataclasses import dataclass, replace

import numpy as np

from msp_lab.gap import rules
from msp_lab.gap.alternatives import AlternativeTerm, compete_with_tails, exchange
from msp_lab.gap.candidates import Key
from msp_lab.gap.curves import name_curves, next_curve
from msp_lab.gap.problem import (
    CandidateFit,
    Problem,
    State,
    first_state,
    loss,
    reinformed,
    screened,
    trials,
    without,
)
from msp_lab.gap.run_offsets import run_offset_cm
from msp_lab.gap.screen import Screen


def eliminate(problem: Problem, state: State, needed_nats: float) -> State:
    """Take out terms that the others have made needless."""
    while len(state.terms) > 1:
        smaller = [without(problem, state, k) for k in range(len(state.terms))]
        spare = []
        for term, less in zip(state.terms, smaller, strict=True):
            numbers = len(term.active.values) if term.active.shape is not None else 1
            needed = rules.KEEP_SHARE * needed_nats + (0.5 * numbers if numbers > 1 else 0.0)
            spare.append(loss(problem, less.fit, state) - needed)
        worst = int(np.argmin(spare))
        if spare[worst] >= 0.0:
            break
        state = smaller[worst]
    return state


@dataclass(frozen=True)
class Selection:
    """The end of the search."""

    base: State
    """The state before any term."""
    state: State
    """The state with all selected terms."""
    first: Screen
    """The first screen."""
    alternatives: dict[Key, tuple[AlternativeTerm, ...]]
    """Alternatives to each term, by its key."""
    needed_nats: float
    """What a term has to gain."""
    run_offset_cm: float = 0.0
    """Standard deviation of offsets between runs that the model lacks [cm]."""
    is_full: bool = False
    """The search ended since as many terms were found as may be."""


def select(problem: Problem, max_terms: int) -> Selection:
    """Search the terms that are missing from the model."""
    state = base = first_state(problem)
    # Runs count in the evidence after a refit; the screen and what it asks for are those of independent readings.
    seen = screened(problem, state)
    first = screened(problem, state, by_run=True) if state.by_run else seen
    state = _search(problem, state, seen, seen.needed_nats, max_terms)
    is_full = 0 < max_terms <= len(state.terms)
    return settled(problem, Selection(base, state, first, {}, seen.needed_nats, is_full=is_full))


def _search(problem: Problem, state: State, seen: Screen, needed_nats: float, max_terms: int) -> State:
    """Add effects, and curves for what they leave, twice: a curve may show an effect that it hid."""
    first = add_effects(problem, state, seen, needed_nats, max_terms)
    state = add_curves(problem, first, needed_nats, max_terms)
    if state is first or len(state.terms) >= max_terms:
        return state
    again = reinformed(problem, state)
    more = add_effects(problem, again, screened(problem, again), needed_nats, max_terms)
    # Next to the same fit no other curve is found, unless those before were as many as are added in one go.
    if more is again and len(again.terms) - len(first.terms) < rules.MAX_CURVES:
        return more
    return add_curves(problem, more, needed_nats, max_terms)


def select_more(problem: Problem, selection: Selection, without: Set[Key], max_terms: int) -> Selection:
    """Go on where the search had ended for want of room, without these effects, which did not hold."""
    problem = replace(problem, candidates=tuple(each for each in problem.candidates if each.key not in without))
    state = reinformed(problem, selection.state)
    state = _search(problem, state, screened(problem, state), selection.needed_nats, max_terms)
    is_full = max_terms <= len(state.terms)
    return settled(problem, replace(selection, state=state, is_full=is_full))


def settled(problem: Problem, selection: Selection) -> Selection:
    """Each term against all candidates in its place, without needless terms, and what runs differ by in addition."""
    needed = selection.needed_nats
    state = name_curves(problem, compete_with_tails(problem, selection.state, needed), needed)
    state, alternatives = exchange(problem, state, needed)
    state = eliminate(problem, state, needed)
    return replace(
        selection,
        state=state,
        alternatives={term.key: alternatives.get(term.key, ()) for term in state.terms},
        run_offset_cm=run_offset_cm(problem, state.fit) if "run" in problem.contexts else 0.0,
    )


def add_effects(problem: Problem, state: State, seen: Screen, needed_nats: float, max_terms: int) -> State:
    """Forward selection: the candidate that gains most, until none gains enough; needless terms go at each step."""
    visited: set[frozenset[Key]] = set()
    while len(state.terms) < max_terms:
        trial = _next_term(problem, state, seen, needed_nats)
        if trial is None:
            break
        problem.report(f"found {trial.term.key[0]}", 0.1 + 0.1 * len(state.terms))
        before = state
        state = eliminate(problem, state.having(trial.fit, [*state.terms, trial.term]), needed_nats)
        if state.keys in visited:
            # Terms that take each other's place in turn: none of them is better than what was there.
            return before
        visited.add(state.keys)
        # An effect that changes slowly looks like dependence until it is named.
        state = replace(state, by_run=problem.depends(state.fit))
        state = reinformed(problem, state)
        seen = screened(problem, state)
    return state


def add_curves(problem: Problem, state: State, needed_nats: float, most: int) -> State:
    """Add curves for what no effect explains, up to so many terms; the same state is returned where nothing changes.

    One that makes another term needless takes its place, and so it is asked where there is no room for one more, too.
    """
    problem.report("searching what no effect explains", 0.5)
    for _ in range(min(most, rules.MAX_CURVES)):
        found = next_curve(problem, state)
        if found is None:
            break
        found = eliminate(problem, found, needed_nats)
        if len(found.terms) > most:
            break
        state = found
    return state


def _next_term(problem: Problem, state: State, seen: Screen, needed_nats: float) -> CandidateFit | None:
    """The candidate that gains most after its refit, if it gains enough."""
    nothing_seen = seen.largest < seen.critical and not state.by_run
    least_nats = np.inf if nothing_seen else rules.KEEP_SHARE * needed_nats
    found = trials(problem, state, seen, least_nats)
    return found[0] if found and found[0].gain_nats >= needed_nats else None
