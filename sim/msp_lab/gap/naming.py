"""From readings to the named model: the statistics of the gap workflow, step by step.

A model, readings with their contexts and a split by runs enter; a `NamedModel` leaves. Terms are selected and fitted on
the training runs, kept only if the held-out runs score better for them, and reported with the values of those.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from msp_lab.gap import rules
from msp_lab.gap.estimates import HeldOutFit, calibrated, detectable, found_terms
from msp_lab.gap.extended_model import extended
from msp_lab.gap.findings import CalibrationFinding, FoundEffect, NotTestable, UnknownEffect
from msp_lab.gap.prepared import BASE, Prepared
from msp_lab.gap.problem import Problem, Progress, State
from msp_lab.gap.refit import ROUNDS, JointFit, refit
from msp_lab.gap.run_offsets import validated_run_offsets, with_run_offsets
from msp_lab.gap.runs import Split, numbered, previous
from msp_lab.gap.selection import Selection, select, settled
from msp_lab.gap.validation import Gain, Validated, gain, validated
from msp_lab.readings.intake import PREVIOUS
from msp_sim.model.model import Model

_Array = NDArray[np.float64]


@dataclass(frozen=True)
class ModelStep:
    """A model on the selection path: what was added last (empty: nothing), and the model with it."""

    added: str
    model: Model


@dataclass(frozen=True)
class ExtendedModels:
    """The given model with what is missing from it.

    Attributes
    ----------
    training_fit
        With the values of the training runs: what the held-out runs validated.
    held_out_fit
        With the values of the held-out runs, which selection has not made too large.
    path
        The given model, the calibrated one, and one more for each term.
    """

    training_fit: Model
    held_out_fit: Model
    path: tuple[ModelStep, ...]


@dataclass(frozen=True)
class NamedModel:
    """What is missing from a model, and the models with it.

    Attributes
    ----------
    models
        With the terms that were found.
    effects, unknown, calibration, not_testable
        What was found.
    unit
        Of evidence.
    p_value
        Of the hypothesis that nothing is missing.
    detectable
        The smallest effects that would have been found, in words.
    gain
        Of all terms together, on the held-out runs.
    dropped
        Terms that did not validate, and why.
    messages
        What a reader has to know.
    """

    models: ExtendedModels
    effects: tuple[FoundEffect, ...]
    unknown: tuple[UnknownEffect, ...]
    calibration: tuple[CalibrationFinding, ...]
    not_testable: tuple[NotTestable, ...]
    unit: Literal["reading", "run"]
    p_value: float
    detectable: str
    gain: Gain
    dropped: tuple[tuple[str, str], ...] = ()
    messages: tuple[str, ...] = ()


def name_effects(
    model: Model,
    contexts: Mapping[str, Any],
    reading_cm: _Array,
    split: Split,
    rng: np.random.Generator,
    alpha: float = 0.05,
    max_terms: int = 6,
    report: Progress = lambda what, share: None,
) -> NamedModel:
    """Name what is missing from a model, and keep what held-out runs score better for.

    Parameters
    ----------
    model
        The given model.
    contexts
        Columns by name, (n,).
    reading_cm
        Readings, (n,), no NaN.
    split
        By whole runs.
    rng
        Random generator.
    alpha
        Probability of any false name, before validation.
    max_terms
        At most so many effects and curves.
    report
        Reports what is being done, and which share of it is done.
    """
    reading_cm = np.rint(np.asarray(reading_cm, dtype=np.float64))
    columns = {PREVIOUS: previous(contexts, reading_cm), **contexts}
    report("fitting the base", 0.02)
    training = np.flatnonzero(split.training)
    problem = Problem.of(
        model, _rows(columns, training), reading_cm[training], numbered(split.runs[training]), rng, alpha, report
    )
    selection = select(problem, max_terms)
    report("validating on held-out runs", 0.85)
    some = np.flatnonzero(split.held_out)
    some = some[:: max(1, -(-some.size // rules.HELD_OUT_ROWS))]
    held_out = Prepared.of(model, _rows(columns, some), reading_cm[some], problem.some.spacing_s)
    held_out_unit = numbered(split.runs[some])
    selection, kept = _validated(problem, selection, held_out, held_out_unit)
    report("fitting the held-out runs", 0.92)
    return _named(problem, selection, kept, split, held_out, held_out_unit)


def _validated(
    problem: Problem, selection: Selection, held_out: Prepared, unit: NDArray[np.intp]
) -> tuple[Selection, Validated]:
    """The terms that validate; where one does not, another may be the better name for what it stood next to."""

    def refitted(state: State) -> State:
        """From the base before validation, so that the order in which terms were dropped has no part in the fit."""
        fit = problem.refit([each.active for each in state.terms], selection.state.fit.base)
        return state.having(fit, state.terms)

    kept = validated(problem, selection.state, held_out, unit)
    if kept.dropped:
        selection = settled(problem, replace(selection, state=refitted(kept.state)))
        again = validated(problem, selection.state, held_out, unit)
        kept = replace(again, dropped=(*kept.dropped, *again.dropped))
    return selection, replace(kept, state=refitted(kept.state))


def _named(
    problem: Problem,
    selection: Selection,
    kept: Validated,
    split: Split,
    held_out: Prepared,
    unit: NDArray[np.intp],
) -> NamedModel:
    model, by_run = problem.model, kept.state.by_run
    training, base = kept.state.fit, selection.base.fit.base
    as_given = not kept.state.terms and _score(held_out, training.base) <= _score(held_out, np.zeros(len(BASE)))
    if as_given:
        # The numbers of the model itself: a fit of correlated readings starts off 0.
        training = refit(problem.some, [], np.zeros(len(BASE)), rounds=0)
        base = training.base
    fit = refit(held_out, training.effects, training.base, rounds=0 if as_given else ROUNDS)
    of_held_out = HeldOutFit.of(held_out, fit, unit, by_run)
    effects, unknown, calibration = found_terms(problem, selection.base.fit, kept, selection.alternatives, of_held_out)
    gained = gain(held_out.log_prob(training.base, training.effects), held_out.log_prob(base, []), unit)
    path = _path(problem, selection, kept.state)
    calibration = [*calibrated(problem, kept.state, training, of_held_out), *calibration]
    of_training = training.base, training.effects
    of_fit = fit.base, fit.effects
    # Blocks of one run are no runs: what they differ by is a drift.
    if selection.run_offset_cm > 0.0 and not split.of_blocks:
        offsets = validated_run_offsets(selection.run_offset_cm, fit, held_out, unit)
        if offsets is not None:
            effects.append(offsets[0])
            of_training = with_run_offsets(training, offsets[1], held_out)
            of_fit = with_run_offsets(fit, offsets[1], held_out)
    return NamedModel(
        ExtendedModels(
            extended(model, *of_training, problem.some.spacing_s),
            extended(model, *of_fit, problem.some.spacing_s),
            path,
        ),
        tuple(effects),
        tuple(unknown),
        tuple(calibration),
        tuple(
            NotTestable(effect, absent, f"{' and '.join(absent)} not recorded") for effect, absent in problem.untestable
        ),
        "run" if by_run else "reading",
        selection.first.p_value,
        detectable(problem, selection.first),
        gained,
        kept.dropped,
        tuple(_messages(problem, selection.base.fit, by_run, split)),
    )


def _rows(columns: Mapping[str, Any], rows: NDArray[np.intp]) -> dict[str, Any]:
    return {key: np.asarray(column)[rows] for key, column in columns.items()}


def _score(prepared: Prepared, base: _Array) -> float:
    return float(prepared.log_prob(base, []).sum())


def _path(problem: Problem, selection: Selection, state: State) -> tuple[ModelStep, ...]:
    """The given model, the calibrated one, and one more for each term."""
    fit, model, spacing_s = selection.base.fit, problem.model, problem.some.spacing_s
    steps = [ModelStep("", model), ModelStep("calibration", extended(model, fit.base, [], spacing_s))]
    for k, term in enumerate(state.terms):
        last = k == len(state.terms) - 1
        fit = state.fit if last else problem.refit([each.active for each in state.terms[: k + 1]], fit.base)
        steps.append(ModelStep(term.label, extended(model, fit.base, fit.effects, spacing_s)))
    return tuple(steps)


def _messages(problem: Problem, base: JointFit, by_run: bool, split: Split) -> list[str]:
    if not by_run:
        return []
    measured = problem.dependence(base)
    found = [
        f"Readings of a run depend on each other (correlation of neighbours {measured.lag_correlation:.2f}; for a "
        f"constant they count as {measured.effective_readings:.0f} independent ones): the unit of evidence is the run."
    ]
    runs = len(split.training_runs)
    if runs < rules.WARN_TRAINING_RUNS:
        found.append(f"With {runs} training runs, what is constant within a run cannot be judged.")
    return found
