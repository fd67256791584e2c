"""Which selected terms stay, and which candidates do as well in their place.

Each step returns a better state, with the alternatives of each term: candidates that gain nearly as much after a refit
of their own.
"""

from collections.abc import Sequence, Set
from dataclasses import dataclass

import numpy as np

from msp_lab.gap import rules
from msp_lab.gap.candidates import Key, SelectedTerm
from msp_lab.gap.evidence import lead_nats
from msp_lab.gap.problem import CandidateFit, Problem, State, loss, screened, trials, with_candidate, without
from msp_lab.gap.refit import JointFit
from msp_sim.model.model import Term

TAILS = "heavy_tails"


@dataclass(frozen=True)
class AlternativeTerm:
    """Another effect in a term's place."""

    active: Term
    """The effect with its own fitted values."""
    loss_nats: float
    """How much less it gains, on the readings that are refitted [nat]."""
    correlation: float
    """Correlation of both effects' scores."""


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
        state = smaller[worst].logging(f"removed {state.terms[worst].label}")
    return state


def compete_with_tails(problem: Problem, state: State, needed_nats: float) -> State:
    """Heavier tails of the noise look like a component on one side: a component has to gain next to them too."""
    tails = next((each for each in problem.candidates if each.key == (TAILS, None)), None)
    components = [each for each in state.terms if each.candidate is not None and each.candidate.linear]
    for term in components:
        if tails is None or (TAILS, None) in state.keys:
            break
        k = next(i for i, each in enumerate(state.terms) if each.key == term.key)
        both_fit = with_candidate(problem, state.fit, tails, rules.TAILS_START)
        tails_term = SelectedTerm(both_fit.effects[-1], tails)
        both = state.having(both_fit, [*state.terms, tails_term])
        only_tails = without(problem, both, k)
        if loss(problem, only_tails.fit, both) - term.cost_nats >= needed_nats:
            continue
        neither = without(problem, state, k)
        gained = problem.evidence_nats(neither.fit, only_tails.fit, state.by_run)
        wanted = gained - tails.cost_nats >= needed_nats
        dropped = f"tails in place of {term.label}" if wanted else f"neither {term.label} nor tails"
        state = (only_tails if wanted else neither).logging(dropped)
    return state


def exchange(
    problem: Problem, state: State, needed_nats: float
) -> tuple[State, dict[Key, tuple[AlternativeTerm, ...]]]:
    """Try each term against all candidates until none is better; what does as well is an alternative.

    The same terms are not taken twice, so that it ends.
    """
    visited: set[frozenset[Key]] = set()
    while True:
        visited.add(state.keys)
        alternatives: dict[Key, tuple[AlternativeTerm, ...]] = {}
        for k, term in enumerate(state.terms):
            if term.candidate is None:
                continue
            problem.report(f"looking for alternatives to {term.key[0]}", 0.6)
            better, near = _in_its_place(problem, state, k, needed_nats, visited)
            if better is not None:
                problem.report(f"{better.terms[-1].key[0]} in place of {term.key[0]}", 0.65)
                state = better
                break
            alternatives[term.key] = near
        else:
            return state, alternatives


def _in_its_place(
    problem: Problem, state: State, k: int, needed_nats: float, visited: Set[frozenset[Key]]
) -> tuple[State | None, tuple[AlternativeTerm, ...]]:
    """The state with a better candidate in place of the k-th term; None and its alternatives where there is none."""
    term = state.terms[k]
    less = without(problem, state, k)
    own = loss(problem, less.fit, state)
    enough_nats = rules.EXCHANGE_KEEPS * needed_nats
    found = trials(problem, less, screened(problem, less), enough_nats)

    again = [each.fit for each in found if each.term.key == term.key]
    own_fit = max([state.fit, *again], key=lambda each: each.log_likelihood)
    # Some gain less evidence than likelihood, as repeats before a wall that stands still; the evidence is what counts.
    others = [each for each in found if each.term.key != term.key and each.gain_nats >= enough_nats]
    last = len(less.terms)
    correlations = _correlations([(state.fit, k, term), *((each.fit, last, each.term) for each in others)])
    # On the readings that are refitted: more readings make two that are alike no more certain than they are.
    unit = problem.unit if state.by_run else None
    ahead = [lead_nats(each.fit, own_fit, unit) for each in others]

    # Offsets of runs excuse a worse name where runs differ, and no name that explains the readings much less.
    lost_nats, lost_share = rules.EXCHANGE_LOSES
    most_lost = max(lost_nats, lost_share * (own_fit.log_likelihood - less.fit.log_likelihood))

    def lead(other: CandidateFit, nats: float, correlation: float) -> float:
        """By how much another does better; a number of the base comes before an effect that does as well, and of two
        that say nearly the same that which has fewer numbers."""
        if abs(correlation) < rules.RELATED:
            # It explains something else: it is added, and takes nobody's place.
            return -np.inf
        if own_fit.log_likelihood - other.fit.log_likelihood > most_lost:
            return -np.inf
        nats += term.cost_nats - other.term.cost_nats
        if abs(correlation) > rules.SAME_FORM:
            nats += rules.SIMPLER_NATS * (term.numbers - other.term.numbers)
        return nats + rules.BASE_PREFERENCE_NATS * other.term.is_base

    leads = [lead(*each) for each in zip(others, ahead, correlations, strict=True)]
    if term.is_base:
        related = [each for each, nats in zip(others, leads, strict=True) if np.isfinite(nats)]
        unseen = [each for each in related if state.keys | {each.term.key} not in visited]
        return _next_to_base(problem, state, unseen, needed_nats), ()
    takes = [
        -np.inf if less.keys | {each.term.key} in visited else nats for each, nats in zip(others, leads, strict=True)
    ]
    if takes and max(takes) > 0.0:
        best = others[int(np.argmax(takes))]
        better = less.having(best.fit, [*less.terms, best.term])
        return better.logging(f"{best.term.label} in place of {term.label}"), ()
    lost = [
        max(own - problem.evidence_nats(less.fit, each.fit, state.by_run), -nats)
        for each, nats in zip(others, ahead, strict=True)
    ]
    return None, _alternatives(term, others, lost, correlations)


def _alternatives(
    term: SelectedTerm, others: Sequence[CandidateFit], lost: Sequence[float], correlations: Sequence[float]
) -> tuple[AlternativeTerm, ...]:
    """Other effects in a term's place that lose little and say the same of the readings."""
    return tuple(
        AlternativeTerm(other.term.active, nats, correlation)
        for other, nats, correlation in zip(others, lost, correlations, strict=True)
        if nats <= rules.ALTERNATIVE_NATS
        and abs(correlation) >= rules.RELATED
        and other.term.active.effect.name != term.active.effect.name
        and not _imitates(other.term, term, correlation)
    )


def _imitates(other: SelectedTerm, term: SelectedTerm, correlation: float) -> bool:
    """Whether another effect says the same with more numbers, and over no other column."""
    same = set(other.active.effect.requires) <= set(term.active.effect.requires)
    return same and other.numbers > term.numbers and abs(correlation) > rules.IMITATES


def _next_to_base(problem: Problem, state: State, others: Sequence[CandidateFit], needed_nats: float) -> State | None:
    """The state with the first effect that gains enough next to a number of the base that says nearly the same.

    Neither takes the other's place: alone, tails of the noise explain most of a slip and a slip most of the tails. The
    screen next to one of them promises too little of the other, as both have to move.
    """
    for other in others:
        candidate = other.term.candidate
        if candidate is None or other.term.is_base:
            continue
        fit = problem.refit([*state.fit.effects, other.term.active], state.fit.base)
        gained = problem.candidate_nats(state.fit, fit, candidate, state.by_run) - candidate.cost_nats
        if gained >= needed_nats:
            added = state.having(fit, [*state.terms, SelectedTerm(fit.effects[-1], candidate)])
            return added.logging(f"added {other.term.label} next to a number of the base")
    return None


def _correlations(fits: Sequence[tuple[JointFit, int, SelectedTerm]]) -> list[float]:
    """Correlations of the first term's score with each other's, each as fitted, given the rest of the model."""
    left = []
    for fit, k, term in fits:
        assert term.candidate is not None
        others = fit.at.scores[
            :, [not (name.startswith(f"{k}.") or held) for name, held in zip(fit.names, fit.at.held, strict=True)]
        ]
        basis = np.linalg.qr(others[:, np.any(others != 0.0, axis=0)])[0]
        own = fit.at.scores[:, fit.names.index(f"{k}.{term.candidate.parameter.name}")]
        rest = own - basis @ (basis.T @ own)
        left.append(rest / max(float(np.linalg.norm(rest)), 1e-12))
    return [float(left[0] @ each) for each in left[1:]]
