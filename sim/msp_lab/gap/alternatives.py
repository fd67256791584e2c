"""Other names for what was found: which one stays in a term's place, which do as well, and what would tell them apart.

Each step returns a better state, with the alternatives of each term: candidates that gain nearly as much after a refit
of their own. An experiment spreads out one context, the others as they were, until two effects' scores differ by enough
standard errors for as many readings.
"""

from collections.abc import Sequence, Set
from dataclasses import dataclass
from typing import Any

import numpy as np

from msp_lab.gap import rules
from msp_lab.gap.candidates import Key, SelectedTerm
from msp_lab.gap.evidence import lead_nats
from msp_lab.gap.labels import unit_of
from msp_lab.gap.prepared import CHANNELS, templates
from msp_lab.gap.problem import (
    CandidateFit,
    Problem,
    State,
    loss,
    screened,
    trials,
    with_candidate,
    without,
)
from msp_lab.gap.refit import JointFit
from msp_range.arrays import Array
from msp_sim.effects.base import WORD_COLUMNS, Scene
from msp_sim.model.model import Term, applies

TAILS = "heavy_tails"
SPANS = {
    "true_range_cm": (20.0, 765.0),
    "air_temperature_c": (-10.0, 45.0),
    "target_temperature_c": (-10.0, 60.0),
    "humidity_pct": (5.0, 95.0),
    "incidence_deg": (-40.0, 40.0),
    "range_rate_cm_s": (-300.0, 300.0),
    "throttle": (0.0, 1.0),
    "vibration_hz": (0.0, 200.0),
    "uptime_s": (0.0, 3600.0),
}
"""How far a context can reasonably be varied."""
SHARES = (0.05, 0.1, 0.2, 0.3, 0.5, 0.75, 1.0)
"""Shares of those spans; the smallest that is enough is suggested."""


@dataclass(frozen=True)
class AlternativeTerm:
    """Another effect in a term's place."""

    active: Term
    """The effect with its own fitted values."""
    loss_nats: float
    """How much less it gains, on the readings that are refitted [nat]."""
    correlation: float
    """Correlation of both effects' scores."""


def compete_with_tails(problem: Problem, state: State, needed_nats: float) -> State:
    """Heavier tails of the noise look like a component on one side: a component has to gain next to them too."""
    tails = next((candidate for candidate in problem.candidates if candidate.key == (TAILS, None)), None)
    components = [term for term in state.terms if term.candidate is not None and term.candidate.linear]
    for term in components:
        if tails is None or (TAILS, None) in state.keys:
            break
        k = next(i for i, other in enumerate(state.terms) if other.key == term.key)
        both_fit = with_candidate(problem, state.fit, tails, rules.TAILS_START)
        tails_term = SelectedTerm(both_fit.effects[-1], tails)
        both = state.having(both_fit, [*state.terms, tails_term])
        only_tails = without(problem, both, k)
        if loss(problem, only_tails.fit, both) - term.cost_nats >= needed_nats:
            continue
        neither = without(problem, state, k)
        gained = problem.evidence_nats(neither.fit, only_tails.fit, state.by_run)
        state = only_tails if gained - tails.cost_nats >= needed_nats else neither
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

    again = [trial.fit for trial in found if trial.term.key == term.key]
    own_fit = max([state.fit, *again], key=lambda fit: fit.log_likelihood)
    # Some gain less evidence than likelihood, as repeats before a wall that stands still; the evidence is what counts.
    others = [trial for trial in found if trial.term.key != term.key and trial.gain_nats >= enough_nats]
    last = len(less.terms)
    correlations = _correlations([(state.fit, k, term), *((other.fit, last, other.term) for other in others)])
    # On the readings that are refitted: more readings make two that are alike no more certain than they are.
    unit = problem.unit if state.by_run else None
    ahead = [lead_nats(other.fit, own_fit, unit) for other in others]

    # Offsets of runs excuse a worse name where runs differ, and no name that explains the readings much less.
    lost_nats, lost_share = rules.EXCHANGE_LOSES
    most_lost = max(lost_nats, lost_share * (own_fit.log_likelihood - less.fit.log_likelihood))
    own_is_open = problem.is_left_open(state.fit, k, state.by_run)

    def lead(other: CandidateFit, nats: float, correlation: float) -> float:
        """By how much another does better; a number of the base comes before an effect that does as well, a scale that
        the bench leaves open before its alternatives, and of two that say nearly the same that which has fewer
        numbers."""
        if abs(correlation) < rules.RELATED:
            # It explains something else: it is added, and takes nobody's place.
            return -np.inf
        if own_fit.log_likelihood - other.fit.log_likelihood > most_lost:
            return -np.inf
        nats += term.cost_nats - other.term.cost_nats
        if abs(correlation) > rules.SAME_FORM:
            nats += rules.SIMPLER_NATS * (term.numbers - other.term.numbers)
        nats += rules.ALTERNATIVE_NATS * (problem.is_left_open(other.fit, last, state.by_run) - own_is_open)
        return nats + rules.BASE_PREFERENCE_NATS * other.term.is_base

    leads = list(map(lead, others, ahead, correlations))
    if term.is_base:
        related = [other for other, nats in zip(others, leads, strict=True) if np.isfinite(nats)]
        unseen = [other for other in related if state.keys | {other.term.key} not in visited]
        return _next_to_base(problem, state, unseen, needed_nats), ()
    takes = [
        -np.inf if less.keys | {other.term.key} in visited else nats for other, nats in zip(others, leads, strict=True)
    ]
    if takes and max(takes) > 0.0:
        best = others[int(np.argmax(takes))]
        return less.having(best.fit, [*less.terms, best.term]), ()
    lost = [
        max(own - problem.evidence_nats(less.fit, other.fit, state.by_run), -nats)
        for other, nats in zip(others, ahead, strict=True)
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
            return state.having(fit, [*state.terms, SelectedTerm(fit.effects[-1], candidate)])
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
    return [float(left[0] @ other) for other in left[1:]]


def to_tell_apart(problem: Problem, base: JointFit, term: SelectedTerm, alternatives: Sequence[AlternativeTerm]) -> str:
    """A sentence for each alternative; `base` is the fit before any term."""
    return "; ".join(_sentence(problem, base, term.active, other.active) for other in alternatives)


def _sentence(problem: Problem, base: JointFit, own: Term, other: Term) -> str:
    best: tuple[float, str] | None = None
    for column in sorted((own.effect.columns | other.effect.columns) - WORD_COLUMNS):
        if column not in SPANS or column not in problem.contexts:
            continue
        low, high = SPANS[column]
        values = problem.contexts[column]
        middle = float(np.clip(np.nanmedian(values), low, high))
        for share in SHARES:
            start, end = middle - share * (middle - low), middle + share * (high - middle)
            drawn = start + (end - start) * _even(values.size)
            if _separation(problem, base, own, other, {**problem.contexts, column: drawn}) >= rules.SURE_Z:
                if best is None or share < best[0]:
                    text = f"vary {column} evenly from {start:.3g} to {end:.3g} {unit_of(column)}".rstrip()
                    now = float(np.nanmax(values) - np.nanmin(values))
                    best = share, f"{text} (by {end - start:.3g}; here by {now:.3g}) in as many readings"
                break
    text = best[1] if best else f"{own.effect.experiment}; or {other.effect.experiment}"
    return f"to tell {own.effect.name} from {other.effect.name}: {text}"


def _even(n: int) -> Array:
    """Numbers spread evenly over 0 to 1, in an order (golden ratio) that correlates with no column."""
    return np.asarray(np.mod(0.5 + np.arange(n) * 0.6180339887498949, 1.0))


def _separation(problem: Problem, base: JointFit, own: Term, other: Term, contexts: dict[str, Any]) -> float:
    """Standard errors between two effects, by their templates in the channels' units of information."""
    scene = Scene(problem.model.sensor, contexts)
    weights = np.sqrt(np.mean(base.here.by[:, : len(CHANNELS)] ** 2, axis=0))
    one, two = _templates(scene, own, weights), _templates(scene, other, weights)
    size = float(np.linalg.norm(one))
    if size == 0.0 or not np.any(two):
        return 0.0
    correlation = float((one * two).sum() / (np.linalg.norm(one) * np.linalg.norm(two)))
    return size * float(np.sqrt(max(1.0 - correlation**2, 0.0)))


def _templates(scene: Scene, term: Term, weights: Array) -> Array:
    known = applies(scene, term)
    found = np.zeros((scene.range_cm.size, len(CHANNELS)))
    if known is False:
        return found
    for i, template in templates(known, term.change(scene)).items():
        found[:, i] = weights[i] * template
    found -= found.mean(axis=0)
    return found
