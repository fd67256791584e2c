"""Refits of a state with one more candidate, each from the start that suits it.

A problem, a state and its screen enter; the candidates that gain most leave, each with its joint fit. A likelihood has
many local maxima along a shape, and none near what the base has taken: a fit ends where it starts.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from msp_lab.gap import rules
from msp_lab.gap.candidates import CandidateEffect, SelectedTerm, score_of
from msp_lab.gap.prepared import BASE
from msp_lab.gap.problem import Problem, State, bias_cm
from msp_lab.gap.refit import JointFit
from msp_lab.gap.screen import Screen
from msp_sim.effects.component import Normal
from msp_sim.model.model import Term

_Array = NDArray[np.float64]


@dataclass(frozen=True)
class CandidateFit:
    """A state refitted with one more candidate, the last of its terms.

    Attributes
    ----------
    gain_nats
        Evidence of all readings, less the cost of the search.
    term, fit
        The new term, and the joint fit with it.
    """

    gain_nats: float
    term: SelectedTerm
    fit: JointFit


def trials(problem: Problem, state: State, seen: Screen, within_nats: float, least_nats: float) -> list[CandidateFit]:
    """Refits of the candidates that gain most, the best first.

    Parameters
    ----------
    problem, state
        To which one candidate at a time is added.
    seen
        The screen at this state.
    within_nats, least_nats
        A candidate is refitted if its screened gain is within so much of the best, and at least so much. One that
        moves part of the hits is always: offset and spread take most of it, and leave it no slope.
    """
    best: dict[tuple[str, str | None], int] = {}
    for j, candidate in enumerate(problem.candidates):
        if candidate.key not in state.keys and seen.gain[j] > seen.gain[best.get(candidate.key, j)] - 1e-12:
            best[candidate.key] = j
    order = sorted(best.values(), key=lambda j: -seen.gain[j])
    found: list[CandidateFit] = []
    top = 0.0
    for i, j in enumerate(order):
        candidate = problem.candidates[j]
        if not candidate.effect.moves:
            near = top - max(within_nats, rules.REFIT_WITHIN_SHARE * top)
            if i >= rules.REFITS_PER_STEP or seen.gain[j] < least_nats or (found and seen.gain[j] < near):
                continue
        fit = with_candidate(problem, state.fit, candidate, _start(candidate, seen, j))
        if candidate.linear and (_replaces_base(problem, fit, candidate) or _moves_little(problem, fit)):
            continue
        if _has_its_form(problem, fit):
            continue
        gained = problem.candidate_nats(state.fit, fit, candidate, state.by_run)
        found.append(CandidateFit(gained - candidate.cost_nats, SelectedTerm(fit.effects[-1], candidate), fit))
        # A screen may promise too much, and of what is large it promises too little, of one as of the other.
        top = max(top, min(found[-1].gain_nats, float(seen.gain[j])))
    return sorted(found, key=lambda each: -each.gain_nats)


def _replaces_base(problem: Problem, fit: JointFit, candidate: CandidateEffect) -> bool:
    """Whether nearly all readings have the last effect of a fit, and it is none of what they are: a component has
    replaced the base, or a fault leaves most hits as they are."""
    if fit.effects[-1].values[candidate.parameter.name] <= rules.MAX_COMPONENT_SHARE:
        return False
    fault = fit.effects[-1].change(problem.some.scene).fault
    if fault is None:
        return True
    hit_cm = np.rint(np.nan_to_num(problem.some.rows.centre_cm))
    return float(np.mean(fault.arrives(hit_cm) != hit_cm)) < 0.5


def _moves_little(problem: Problem, fit: JointFit) -> bool:
    """Whether the last effect of a fit moves hits by less than their own scatter: that is a form of the noise."""
    component = fit.effects[-1].change(problem.some.scene).component
    if not (fit.effects[-1].effect.moves and isinstance(component, Normal)):
        return False
    sigma_cm = float(np.median(fit.here.rows.sigma_cm))
    return float(np.mean(component.location_cm)) < rules.MOVED_LEAST_SIGMAS * sigma_cm


def _has_its_form(problem: Problem, fit: JointFit) -> bool:
    """Whether an earlier effect of a fit shifts these hits as the last one does: a threshold that is late in proportion
    to the range is a scale. Together they fit what is neither, and neither number is known."""
    *others, last = fit.effects
    if last.effect.channels != ("bias",):
        return False
    own_cm = bias_cm(problem, last)
    named = [each for each in others if each.shape is None and each.effect.channels == ("bias",)]
    return any(abs(_correlation(own_cm, bias_cm(problem, each))) > rules.SAME_FORM for each in named)


def _correlation(one: _Array, other: _Array) -> float:
    spread = one.std() * other.std()
    return float(np.mean((one - one.mean()) * (other - other.mean())) / spread) if spread > 0.0 else 0.0


def _start(candidate: CandidateEffect, seen: Screen, j: int) -> float:
    """The value at which a candidate's refit starts."""
    parameter, neutral = candidate.parameter, candidate.neutral
    if np.isfinite(seen.best[j]) and seen.best[j] != 0.0:
        return float(np.clip(neutral + seen.best[j], parameter.low, parameter.high))
    size = max(abs(seen.z[j] * seen.deviation[j]), parameter.step) ** (1.0 / parameter.power)
    return float(np.clip(neutral + np.sign(seen.z[j]) * size, parameter.low, parameter.high))


def with_candidate(problem: Problem, fit: JointFit, candidate: CandidateEffect, start: float) -> JointFit:
    """A joint fit with one more effect, from the best of some values and shapes."""
    bases = (fit.base, *_less_correlated(problem, candidate, fit))
    starts = [(_best_start(problem, fit, candidate, start, base), base) for base in bases]
    if _lines(candidate) and not candidate.linear:
        starts.append((_best_by_score(problem, fit, candidate), fit.base))
    if candidate.effect.moves:
        starts.append(max(_moved_hits(problem, candidate, fit), key=lambda each: _height(problem, fit, *each)))
    fits = (problem.refit([*fit.effects, term], base) for term, base in starts)
    return max(fits, key=lambda each: each.log_likelihood)


def _height(problem: Problem, fit: JointFit, term: Term, base: _Array) -> float:
    """Log likelihood of a fit with one more effect and another base, before any refit."""
    return float(problem.some.log_prob(base, [*fit.effects, term]).sum())


def _best_start(problem: Problem, fit: JointFit, candidate: CandidateEffect, start: float, base: _Array) -> Term:
    """The effect at the best of some values: its shape's first number next to all grids of the others, then each."""
    parameter, lines = candidate.parameter, _lines(candidate)
    here = candidate.at(start)

    def best(*changes: Mapping[str, float]) -> Term:
        terms = [here, *(replace(here, values={**here.values, **each}) for each in changes)]
        return max(terms, key=lambda each: _height(problem, fit, each, base))

    here = best(*_places(candidate))
    stronger = [np.clip(here.values[parameter.name] * each, parameter.low, parameter.high) for each in (0.25, 4.0)]
    here = best(*({parameter.name: float(each)} for each in stronger))
    for name in list(lines)[1:]:
        here = best(*({name: place} for place in lines[name]))
    return here


def _best_by_score(problem: Problem, fit: JointFit, candidate: CandidateEffect) -> Term:
    """The effect at the place where it gains most by one step of Newton, in which the fit's own numbers move too.

    A bend turns what is beyond it, and most of that is the scale's and the offset's to take back.
    """
    some, here, parameter = problem.some, fit.here, candidate.parameter
    placed = [replace(candidate, shape=tuple(each.items())) for each in _places(candidate)]
    scores = np.column_stack([score_of(each, here.rows, some.scene, some.reading_cm, here) for each in placed])
    own = fit.scores[:, ~fit.held]
    left = scores - own @ np.linalg.lstsq(own, scores, rcond=1e-8)[0]
    information = np.maximum((left**2).sum(axis=0), 1e-12)
    steps = scores.sum(axis=0) / information
    if candidate.one_sided:
        steps = np.maximum(steps, 0.0)
    best = int(np.argmax(steps**2 * information))
    size = np.sign(steps[best]) * max(abs(float(steps[best])), parameter.step) ** (1.0 / parameter.power)
    return placed[best].at(float(np.clip(candidate.neutral + size, parameter.low, parameter.high)))


def _moved_hits(problem: Problem, candidate: CandidateEffect, fit: JointFit) -> Iterator[tuple[Term, _Array]]:
    """Starts at which a part of the hits is moved, and mean and variance of all of them are those of the fit.

    Offset and spread have taken both, and from there no small share of moved hits is any better.
    """
    rows = fit.here.rows
    sigma_cm = float(np.median(rows.sigma_cm))
    for share in rules.MOVED_SHARES:
        for sigmas in rules.MOVED_SIGMAS:
            moved_cm, left = sigmas * sigma_cm, 1.0 - share * (1.0 - share) * sigmas**2
            base = fit.base.copy()
            base[BASE.index("offset_cm")] -= share * moved_cm
            base[BASE.index("log_sigma")] += 0.5 * float(np.log(left))
            yield candidate.moved_by(moved_cm, problem.some.scene).at(share), base


def _less_correlated(problem: Problem, candidate: CandidateEffect, fit: JointFit) -> Iterator[_Array]:
    """A second start where noise follows the errors so closely that it stands in for an effect on the bias.

    A late reading errs as the one before it: correlated noise explains that as well, one reading at a time, and from
    there no small step leads to the effect. With half the correlation and the same scatter from one reading to the
    next, what is slow is the effect's to explain.
    """
    history = problem.some.rows.history
    if history is None or "bias" not in candidate.effect.channels:
        return
    now = history.correlation + float(fit.base[BASE.index("correlation")])
    if now > rules.RESTART_CORRELATION:
        base = fit.base.copy()
        base[BASE.index("correlation")] -= now / 2.0
        base[BASE.index("log_sigma")] += 0.5 * float(np.log((1.0 - now**2) / (1.0 - (now / 2.0) ** 2)))
        yield base


def _places(candidate: CandidateEffect) -> list[dict[str, float]]:
    """Values of its shape: of the first number that is searched, next to all grids of the others."""
    lines = _lines(candidate)
    numbers = [each for each in candidate.effect.parameters if each.name in lines]
    values = [lines[each.name] if i == 0 else each.grid for i, each in enumerate(numbers)]
    return [dict(zip(lines, each, strict=True)) for each in product(*values)] if numbers else []


def _lines(candidate: CandidateEffect) -> dict[str, Sequence[float]]:
    """Values of each searched number of its shape, between and beyond those on its grid."""
    lines: dict[str, Sequence[float]] = {}
    for parameter in candidate.effect.parameters:
        if parameter.neutral is not None or len(parameter.grid) < 2:
            continue
        low, high = min(parameter.grid), max(parameter.grid)
        beyond = (high - low) / 2.0
        places = np.linspace(max(low - beyond, parameter.low), min(high + beyond, parameter.high), rules.SHAPE_STARTS)
        lines[parameter.name] = parameter.grid if parameter.jumps else [float(f"{place:.4g}") for place in places]
    return lines
