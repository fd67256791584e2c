"""Curves for what no effect explains.

A curve is added to the terms of a state when a refit gains what its score promises, and removed when an effect gains
nearly as much.
"""

from dataclasses import replace
from itertools import product

import numpy as np

from msp_lab.gap import rules
from msp_lab.gap.candidates import SelectedTerm
from msp_lab.gap.curve_test import (
    STEP_PLACES,
    CandidateCurve,
    degrees_of,
    log_p_of,
    ripples,
    scan,
    step_of,
    values_in,
)
from msp_lab.gap.evidence import between_share, offsets_of
from msp_lab.gap.findings import Alternative
from msp_lab.gap.prepared import CHANNELS
from msp_lab.gap.problem import Problem, State, loss, screened, trials, with_terms
from msp_lab.gap.refit import has_range
from msp_sim.effects.base import TRUE_RANGE
from msp_sim.effects.curve import MAX_VALUE, Knots, Ripple, hats
from msp_sim.model.model import make_curve_term


def next_curve(problem: Problem, state: State) -> State | None:
    """The state with one more curve for what it leaves; None where there is none."""
    contexts, (singles, pairs) = problem.contexts, problem.curves_asked
    return _curve_of_runs(problem, state) or _likeliest_curve(
        problem,
        state,
        scan(contexts, singles, state.fit),
        scan(contexts, pairs, state.fit),
        far_curves(problem, state),
        ripples(contexts, state.fit.here),
    )


def _curve_of_runs(problem: Problem, state: State) -> State | None:
    """With the likeliest curve of the bias over what is the same all over each run, such as a surface or a battery.

    It is asked before runs are said to differ at random, by runs, and among such curves only: few tell one of a few.
    """
    forms = scan(problem.contexts, problem.asked_of_runs, state.fit, ("bias",))
    found = _likeliest_curve(problem, replace(state, by_run=True), *([form] for form in forms))
    return None if found is None else replace(found, by_run=state.by_run)


def far_curves(problem: Problem, state: State) -> list[CandidateCurve]:
    """Curves of the bias for hits so far off that the model takes them for outliers, the least likely first.

    Where most readings of a place are far from their hits, as over a box on the floor, the likelihood of each is flat:
    no score says that they would all be hits of a surface elsewhere. So curves over one column start at the medians of
    the readings nearest to each knot, 0 where there are few or it is beyond any curve's, if those of one are far off.
    """
    rows, reading_cm = problem.readings.at(state.fit.base, state.fit.effects), problem.readings.reading_cm
    usual = has_range(rows, reading_cm)
    off_cm = (reading_cm - rows.centre_cm)[usual]
    far = np.abs(off_cm) > rules.FAR_SIGMAS * np.broadcast_to(rows.sigma_cm, reading_cm.shape)[usual]
    now, found = float(state.fit.here.log_p.sum()), []
    singles = [(variables, form) for variables, forms in problem.curves_asked[0] for form in forms]
    for variables, form in singles if far.sum() >= rules.CELL_MIN_HITS else []:
        weights = hats({"column": problem.contexts[variables[0]][usual]}, ["column"], form)
        nearest = np.where(weights.max(axis=1) > 0.0, weights.argmax(axis=1), -1)
        start_cm, is_far = np.zeros(weights.shape[1]), False
        for k in range(start_cm.size):
            own = nearest == k
            median_cm = float(np.median(off_cm[own])) if own.sum() >= rules.CELL_MIN_HITS else np.inf
            if abs(median_cm) < MAX_VALUE["bias"]:
                start_cm[k] = median_cm
                is_far |= bool(far[own].mean() > 0.5)
        if not is_far:
            continue
        start = tuple(start_cm.tolist())
        term = replace(make_curve_term("bias", variables, form, start), is_added=True)
        gain = problem.readings.log_likelihood(state.fit.base, [*state.fit.effects, term]) - now
        if gain > 0.0:
            log_p = log_p_of(2.0 * gain, len(start))
            found.append(CandidateCurve("bias", variables, (form,), log_p, np.log(len(singles)), start))
    return sorted(found, key=lambda curve: curve.log_p)


def _likeliest_curve(problem: Problem, state: State, *asked: list[CandidateCurve]) -> State | None:
    """With that of the curves that were asked in some ways which gains most after its refit; pairs need more.

    Of each way and channel it is the first of the likeliest that gains enough, and promises as much by its score: what
    offsets of runs promise of the bias says nothing of the others. Readings propose, and runs count after the refit, as
    for effects. A ripple is one of many periods, and has no cause: a curve over another column comes before it that
    random variation makes less often, as any column does that alternates at even times.
    """
    least, found = np.log(rules.CURVE_P), {}
    for forms, channel in product(asked, CHANNELS):
        of_channel = [form for form in forms if form.channel == channel]
        for form in of_channel[: rules.CURVES_REFITTED]:
            # What a curve of far hits gains before a refit, at the spread that they have caused, promises too little.
            if form.corrected > least and not form.start:
                break
            there, log_p = _refitted(problem, state, form)
            cost_nats, share = (rules.PAIR_COST_NATS, rules.FORM_SHARE) if len(form.variables) > 1 else (0.0, 1.0)
            corrected = log_p + form.log_asked + cost_nats
            if corrected < least:
                gain = loss(problem, state.fit, there)
                found[form] = min(gain - cost_nats, share * gain), corrected, there
                break
    if not found:
        return None
    best = max(found, key=lambda form: found[form][0])
    if isinstance(best.forms[0][0], Ripple):
        others = [form for form in found if form.variables != best.variables and found[form][1] < found[best][1]]
        best = max(others, key=lambda form: found[form][0], default=best)
    return found[best][2]


def _refitted(problem: Problem, state: State, form: CandidateCurve) -> tuple[State, float]:
    """The state with a curve in the least likely of its forms, and the log of that probability; 0 where there are too
    few runs for it. A step has a place as well."""
    forms, first = [(knots, 0.0) for knots in form.forms], form.forms[0][0]
    if not (form.start or len(form.variables) > 1 or isinstance(first, Ripple) or isinstance(first[0], str)):
        step = step_of(problem.contexts, form.variables[0], form.channel, state.fit)
        forms.append(((step,), float(np.log(STEP_PLACES))))
    best = state, 0.0
    for knots, cost_nats in forms:
        there = _with_curve(problem, state, form, knots)
        degrees = degrees_of(knots)
        if _is_of_few_runs(problem, state, there, degrees):
            continue
        log_p = log_p_of(2.0 * max(loss(problem, state.fit, there), 0.0), degrees) + cost_nats
        if log_p < best[1]:
            best = there, log_p
    return best


def _is_of_few_runs(problem: Problem, state: State, there: State, degrees: int) -> bool:
    """Whether the last curve moves whole runs more than readings inside them, and any curve would go through these.

    Runs at one range have the error of the tape measure in common; those over one surface, or with one battery, differ
    by nothing but what the curve is about.
    """
    places, (active, unit) = problem.runs, (there.terms[-1].active, problem.unit)
    of_runs = any(active.shape is not None and names == active.shape[1] for names, _ in problem.asked_of_runs)
    inside = not of_runs and between_share(state.fit, there.fit, unit) <= rules.CURVE_OF_RUNS_SHARE
    if inside or not state.by_run:
        return False
    if active.shape is not None and TRUE_RANGE in active.shape[1]:
        true_cm = np.bincount(unit, problem.contexts[TRUE_RANGE]) / np.maximum(np.bincount(unit), 1)
        places = np.unique(np.rint(true_cm / max(rules.ONE_PLACE * float(np.ptp(true_cm)), 1e-12))).size
    return bool(degrees >= places // rules.CURVE_RUNS_PER_DEGREE)


def instead_of_offsets(problem: Problem, state: State, needed_nats: float) -> tuple[Alternative, ...]:
    """Columns that explain nearly as well what runs differ by as offsets at random do, such as a surface or a battery.

    Too few runs tell such a column from random variation, or its curve would be in the state. Each is fitted alone,
    with a value for two runs at most, and compared with offsets of the best deviation, which are integrated out.
    """
    found: dict[str, float] = {}
    by_run = replace(state, by_run=True)
    with_offsets = state.fit.log_likelihood + offsets_of(state.fit, problem.unit).nats
    for form in scan(problem.contexts, problem.asked_of_runs, state.fit, ("bias",)):
        for knots in form.forms:
            degrees = degrees_of(knots)
            if 2 * (degrees + 1) > problem.runs:
                continue
            there = _with_curve(problem, by_run, form, knots)
            lost_nats = with_offsets - there.fit.log_likelihood + 0.5 * (degrees - 1)
            gained = loss(problem, state.fit, there)
            if gained >= rules.EXCHANGE_KEEPS * needed_nats and lost_nats <= rules.ALTERNATIVE_NATS:
                (name,) = form.variables
                found[name] = min(lost_nats, found.get(name, np.inf))
    return tuple(Alternative(name, found[name]) for name in sorted(found, key=found.__getitem__))


def name_curves(problem: Problem, state: State, needed_nats: float) -> State:
    """With a name in place of each curve of which it explains nearly all.

    When the curve was added, another name stood in this one's place: a bend that begins near the nearest reading is as
    good as a scale, needs a straight line for the rest, and goes. An offset of one run is no name of what several have.
    """
    for term in [term for term in state.terms if term.active.shape is not None]:
        less = with_terms(problem, state, [other for other in state.terms if other.key != term.key])
        least = max(rules.FORM_SHARE * loss(problem, less.fit, state), needed_nats)
        found = trials(problem, less, screened(problem, less), rules.KEEP_SHARE * least)
        for trial in found:
            assert term.active.shape is not None
            effect = trial.term.active.effect
            if trial.gain_nats >= least and effect.per != "run" and term.active.shape[0] in effect.channels:
                state = less.having(trial.fit, [*less.terms, trial.term])
                break
    return state


def _with_curve(problem: Problem, state: State, form: CandidateCurve, knots: tuple[Knots, ...]) -> State:
    """The state with a curve; a finer one over the same columns takes the place of a coarser one."""
    values = form.start or [0.0] * values_in(knots)
    active = replace(make_curve_term(form.channel, form.variables, knots, values), is_added=True)
    added = SelectedTerm(active, None)
    terms = [*(term for term in state.terms if term.key != added.key), added]
    fit = problem.refit([term.active for term in terms], state.fit.base)
    return state.having(fit, terms)
