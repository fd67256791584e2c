"""Curves for what no effect explains, and for effects whose form is not that of the data.

A state enters, a state with curves among its terms leaves. A curve is taken when a refit gains what its score promises;
an effect goes when a free curve on its channel gains clearly more than it does.
"""

from dataclasses import replace

import numpy as np
from scipy.special import chdtri

from msp_lab.gap import curve_scan, rules
from msp_lab.gap.candidates import SelectedTerm
from msp_lab.gap.curve_scan import CandidateCurve, log_p_of
from msp_lab.gap.evidence import shift_between, wanders
from msp_lab.gap.exchange import eliminate
from msp_lab.gap.far_curves import far_curves
from msp_lab.gap.prepared import CHANNELS
from msp_lab.gap.problem import Problem, State, free_curves, loss, screened, trials, with_terms
from msp_lab.gap.ripples import ripples
from msp_range.arrays import numbered
from msp_sim.effects.base import TRUE_RANGE
from msp_sim.effects.curve import CurveChannel
from msp_sim.model.model import make_curve_term


def add_curves(problem: Problem, state: State, needed_nats: float, most: int) -> State:
    """Add at most so many curves for what no effect explains, and in place of effects that do worse.

    The same state is returned where nothing changes.
    """
    problem.report("searching what no effect explains", 0.5)
    for _ in range(min(most, rules.MAX_CURVES)):
        # As for effects, runs count in the evidence after a refit: of few runs a scan over them asks more than that.
        forms = free_curves(problem, state, by_run=state.by_run and wanders(state.fit, problem.unit))
        singles = sum(len(each.variables) == 1 for each in forms)
        found = _curve_of_runs(problem, state) or _likeliest_ripple(problem, state)
        found = found or _likeliest_curve(problem, state, forms, singles)
        far = far_curves(problem, state)[: rules.FAR_REFITTED]
        found = _better(problem, state, found, _likeliest_curve(problem, state, far, singles))
        if found is None:
            break
        state = eliminate(problem, found, needed_nats)
    for channel in CHANNELS:
        state = _curve_in_place_of_effects(problem, state, channel)
    return state


def _curve_of_runs(problem: Problem, state: State) -> State | None:
    """With the likeliest curve of the bias over what is the same all over each run, such as a surface or a battery.

    It is asked before runs are said to differ at random, and among such curves only: few runs tell one of a few. What
    its scores by run promise is too little, for the runs differ by what it is about.
    """
    asked, by_run = problem.curves_of_runs, replace(state, by_run=True)
    forms = curve_scan.scan(asked, state.fit, problem.unit, ("bias",)) if asked.curves else []
    found = _likeliest_curve(problem, by_run, forms, len(forms), rules.SCREEN_KEEPS)
    return None if found is None else replace(found, by_run=state.by_run)


def _likeliest_ripple(problem: Problem, state: State) -> State | None:
    """With the likeliest ripple, if it is unlikely by random variation; no curve can describe one."""
    found = ripples(problem.contexts, state.fit.here)
    return _likeliest_curve(problem, state, found, len(found))


def _likeliest_curve(
    problem: Problem, state: State, forms: list[CandidateCurve], asked: int, share: float = 1.0
) -> State | None:
    """With the first of the likeliest curves that gains enough after a refit, and promises this share of it before."""
    for form in forms[: rules.CURVES_REFITTED]:
        # What a curve of far hits gains before a refit, at the spread that they have caused, promises too little.
        if not (form.start or _is_unlikely(form, asked, share)):
            return None
        there = _with_curve(problem, state, _placed(problem, state, form))
        if state.by_run and _is_of_runs(problem, state, there) and _has_few_places(problem, form):
            continue
        statistic = 2.0 * max(loss(problem, state.fit, there), 0.0)
        if _is_unlikely(replace(form, log_p=log_p_of(statistic, form.degrees)), asked):
            return there
    return None


def _better(problem: Problem, state: State, one: State | None, other: State | None) -> State | None:
    """Of two states with one more curve that which gains more."""
    found = [each for each in (one, other) if each is not None]
    return max(found, key=lambda each: loss(problem, state.fit, each), default=None)


def _placed(problem: Problem, state: State, form: CandidateCurve) -> CandidateCurve:
    """A step at the likeliest place between the two that were asked next to it by their scores; others as they are."""
    column = np.asarray(problem.contexts[form.variables[0]])
    if form.start or column.dtype.kind != "f" or not curve_scan.is_step(form, column):
        return form
    at = float(np.mean(column[np.isfinite(column)] <= np.mean(np.asarray(form.knots[0]))))
    near = curve_scan.steps_of(column, max(at - 1.0 / rules.STEPS, 0.0), min(at + 1.0 / rules.STEPS, 1.0))
    asked = curve_scan.weights_of(problem.contexts, [(form.variables, (each,)) for each in near])
    best = curve_scan.scan(asked, state.fit, problem.unit if state.by_run else None, (form.channel,))
    return best[0] if best and best[0].log_p < form.log_p else form


def _is_of_runs(problem: Problem, state: State, there: State) -> bool:
    """Whether a curve moves whole runs more than readings inside them."""
    return shift_between(state.fit, there.fit, problem.unit) > rules.CURVE_OF_RUNS_SHARE


def _has_few_places(problem: Problem, form: CandidateCurve) -> bool:
    """Whether there are too few runs, or runs at too few ranges, to say anything of a curve.

    Runs at one range have the error of the tape measure in common; those over one surface, or with one battery, differ
    by nothing but what the curve is about.
    """
    places = _places(problem, form) if TRUE_RANGE in form.variables else problem.runs
    return form.degrees >= places // rules.CURVE_RUNS_PER_DEGREE


def _places(problem: Problem, form: CandidateCurve) -> int:
    """At how many different places of a curve the runs are: those at one place say nothing of its form."""
    counts = np.maximum(np.bincount(problem.unit), 1)
    places = []
    for name in form.variables:
        column = np.asarray(problem.contexts[name])
        values = numbered(column) if column.dtype.kind == "U" else np.nan_to_num(column)
        means = np.bincount(problem.unit, values) / counts
        places.append(np.rint(means / max(rules.ONE_PLACE * float(np.ptp(means)), 1e-12)))
    return int(np.unique(np.column_stack(places), axis=0).shape[0])


def _curve_in_place_of_effects(problem: Problem, state: State, channel: CurveChannel) -> State:
    """With a curve in place of the effects on a channel, if it gains clearly more than they do."""
    named = [each for each in state.terms if each.candidate is not None and channel in each.active.effect.channels]
    if not named:
        return state
    rest = [each for each in state.terms if each not in named]
    less = with_terms(problem, state, rest)
    forms = free_curves(problem, less, (channel,))
    if not forms or forms[0].degrees == 0:
        return state
    form = forms[0]
    there = _with_curve(problem, less, form)
    if loss(problem, less.fit, state) > rules.FORM_SHARE * loss(problem, less.fit, there):
        return state
    numbers = sum(each.numbers for each in named)
    p_value = rules.FORM_P_FACTOR * rules.CURVE_P / len(forms)
    least = 0.5 * float(chdtri(max(form.degrees - numbers, 1), p_value)) - 0.5 * max(len(named) - 1, 0)
    better = loss(problem, state.fit, there) > form.cost_nats + least
    return there if better else state


def name_curves(problem: Problem, state: State, needed_nats: float) -> State:
    """With a name in place of each curve of which it explains nearly all.

    When the curve was added, another name stood in this one's place: a bend that begins near the nearest reading is as
    good as a scale, needs a straight line for the rest, and goes. An offset of one run is no name of what several have.
    """
    for term in [each for each in state.terms if each.active.shape is not None]:
        less = with_terms(problem, state, [each for each in state.terms if each.key != term.key])
        least = max(rules.FORM_SHARE * loss(problem, less.fit, state), needed_nats)
        found = trials(problem, less, screened(problem, less), rules.SCREEN_KEEPS * least)
        for each in found:
            assert term.active.shape is not None
            effect = each.term.active.effect
            if each.gain_nats >= least and effect.per != "run" and term.active.shape[0] in effect.channels:
                state = less.having(each.fit, [*less.terms, each.term])
                state = state.logging(f"{each.term.label} in place of {term.label}")
                break
    return state


def _is_unlikely(form: CandidateCurve, asked: int, share: float = 1.0) -> bool:
    """Whether random variation shows as much, in any of so many curves, with less than the rule's probability; or a
    share of its logarithm."""
    return form.degrees > 0 and form.log_p + form.cost_nats < share * (np.log(rules.CURVE_P) - np.log(asked))


def _with_curve(problem: Problem, state: State, form: CandidateCurve) -> State:
    """The state with a curve; a finer one over the same columns takes the place of a coarser one."""
    values = form.start or [0.0] * int(np.prod([len(each) for each in form.knots]))
    active = replace(make_curve_term(form.channel, form.variables, form.knots, values), is_added=True)
    added = SelectedTerm(active, None)
    terms = [*(each for each in state.terms if each.key != added.key), added]
    fit = problem.refit([each.active for each in terms], state.fit.base)
    return state.having(fit, terms).logging(f"added the curve {added.label}")
