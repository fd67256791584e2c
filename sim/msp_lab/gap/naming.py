"""What is missing from a model, by name: the step name of the gap workflow, and its statistics in their order.

For a model, readings with their contexts and splits of their runs, it makes a `NamedModel`. Terms are selected and
fitted on all runs, and kept only if nearly all splits agree: each part scores better for them by a fit of the others.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from msp_lab.gap import rules
from msp_lab.gap.curves import instead_of_offsets
from msp_lab.gap.estimates import FinalFit, calibrated, detectable, found_terms, with_constants
from msp_lab.gap.extended_model import extended
from msp_lab.gap.findings import CalibrationFinding, FoundEffect, GapFindings, NotTestable, RunScatter, UnknownEffect
from msp_lab.gap.intake import Comparison, KnownRows
from msp_lab.gap.prepared import Prepared
from msp_lab.gap.problem import Problem, Progress, State, forward_only
from msp_lab.gap.refit import refit
from msp_lab.gap.run_offsets import run_scatter, validated_run_offsets, with_run_offsets
from msp_lab.gap.runs import Splits, previous, sample, taken
from msp_lab.gap.search import Selection, select, select_more, settled
from msp_lab.gap.validation import Validated, validated
from msp_lab.readings.intake import PREVIOUS
from msp_lab.readings.resolution import to_step
from msp_range.arrays import Array, Flags, Indices
from msp_range.reading_model.kernel import is_on_grid
from msp_range.reading_model.rows import Base
from msp_sim.effects.path import with_path
from msp_sim.model.model import Model


@dataclass(frozen=True)
class ModelStep:
    """A model on the selection path: what was added last (empty: nothing), and the model with it."""

    added: str
    model: Model


@dataclass(frozen=True)
class ExtendedModels:
    """The given model with what is missing from it."""

    training_fit: Model
    """The model with the values of the training runs, for the gap that is left on the held-out runs."""
    final_fit: Model
    """The model with the values of all runs."""
    path: tuple[ModelStep, ...]
    """The given model, the calibrated one, and one more for each term."""


@dataclass(frozen=True)
class NamedModel:
    """What is missing from a model, and the models with it."""

    models: ExtendedModels
    """The given model with the terms that were found."""
    effects: tuple[FoundEffect, ...]
    unknown: tuple[UnknownEffect, ...]
    calibration: tuple[CalibrationFinding, ...]
    not_testable: tuple[NotTestable, ...]
    """What was found."""
    p_value: float
    """p-value of the hypothesis that nothing is missing."""
    detectable: str
    """The smallest effects that would have been found, in words."""
    dropped: tuple[tuple[str, str], ...]
    """Terms on which the splits do not agree, and why."""
    run_scatter: RunScatter | None
    """How far runs differ, or readings wander, next to what was found."""
    messages: tuple[str, ...]
    """What a reader has to know."""


def name(comparison: Comparison, findings: GapFindings, report: Progress) -> tuple[GapFindings, ExtendedModels]:
    """Name what is missing, with alternatives; splits of the runs validate it."""
    report = forward_only(report)
    known = KnownRows.of(comparison.model, comparison.data)
    named = _name_rows(comparison, known.rows, known.unasked, report)
    needed = known.needed(named.models.final_fit, comparison.data)
    if needed.rows.sum() > known.rows.sum():
        # Columns that no effect needs may be blank, so that there are more readings.
        unneeded = [*known.unasked, *(column for column in known.columns if column not in needed.columns)]
        named = replace(_name_rows(comparison, needed.rows, unneeded, report), not_testable=named.not_testable)
        needed = needed.needed(named.models.final_fit, comparison.data)
    blank = [f"{column} is blank in most readings, so nothing is asked of it." for column in known.unasked]
    findings = replace(
        findings,
        effects=named.effects,
        unknown=named.unknown,
        calibration=(*findings.calibration, *named.calibration),
        not_testable=named.not_testable,
        detectable=named.detectable,
        run_scatter=named.run_scatter,
        p_value=named.p_value,
        messages=(
            *findings.messages,
            *named.messages,
            *filter(None, (needed.message, *blank)),
            *(f"{term} was dropped: {why}." for term, why in named.dropped),
        ),
    )
    return findings, named.models


def _name_rows(comparison: Comparison, rows: Flags, without: Sequence[str], report: Progress) -> NamedModel:
    """What is missing, from some of the readings and without some of the columns."""
    settings = comparison.settings
    return name_effects(
        comparison.model,
        AllReadings(
            {key: column[rows] for key, column in comparison.data.items() if key not in ("reading_cm", *without)},
            comparison.data["reading_cm"][rows],
            comparison.splits.take(rows),
        ),
        np.random.default_rng([settings.seed, 2]),
        alpha=settings.alpha,
        max_terms=settings.max_effects,
        report=lambda what, share: report(what, 0.2 + 0.6 * share),
    )


@dataclass(frozen=True)
class AllReadings:
    """All readings with their splits by whole runs."""

    contexts: Mapping[str, Any]
    """Columns by name, (n,)."""
    reading_cm: Array
    """Readings, (n,), no NaN."""
    splits: Splits

    def sampled(self, problem: Problem, rows: Indices, most: int) -> tuple[Prepared, Indices]:
        """At most so many of some rows, and which."""
        rows = sample(self.contexts, rows, most, problem.rng)
        contexts = taken(self.contexts, rows)
        return Prepared.of(problem.model, contexts, self.reading_cm[rows], problem.readings.spacing_s), rows


def name_effects(
    model: Model,
    whole: AllReadings,
    rng: np.random.Generator,
    alpha: float = 0.01,
    max_terms: int = 6,
    report: Progress = lambda what, share: None,
) -> NamedModel:
    """Name what is missing from a model, and keep what nearly all splits of the runs agree on.

    Parameters
    ----------
    model
        The given model.
    whole
        The readings.
    rng
        Random generator.
    alpha
        Probability of any false name.
    max_terms
        At most so many effects and curves: a limit on the time, as each of them has to pass the same tests.
    report
        Reports what is being done, and which share of it is done.
    """
    contexts, reading_cm, splits = with_path(whole.contexts), whole.reading_cm, whole.splits
    if not is_on_grid(reading_cm, model.sensor.resolution_cm).all():
        reading_cm = to_step(reading_cm, model.sensor.resolution_cm)
    if PREVIOUS not in contexts:
        contexts = {PREVIOUS: previous(contexts, reading_cm), **contexts}
    report("fitting the base", 0.02)
    problem = replace(Problem.of(model, contexts, reading_cm, splits.unit, rng), alpha=alpha, report=report)
    selection = select(problem, max_terms)
    report("validating on splits of the runs", 0.85)
    selection, kept = _validated(problem, selection, splits, max_terms)
    report("fitting all runs", 0.92)
    return _named(problem, selection, kept, AllReadings(contexts, reading_cm, splits), max_terms)


def _validated(problem: Problem, selection: Selection, splits: Splits, max_terms: int) -> tuple[Selection, Validated]:
    """The terms that validate; where one does not, another may be the better name for what it stood next to.

    Where the search had ended for want of room, it goes on in the place of what was dropped.
    """

    def refitted(state: State) -> State:
        """From the base before validation, so that the order in which terms were dropped has no part in the fit."""
        fit = problem.refit([term.active for term in state.terms], selection.state.fit.base)
        return state.having(fit, state.terms)

    kept = validated(problem, selection.state, splits)
    if not kept.dropped:
        return selection, kept
    left = replace(selection, state=refitted(kept.state))
    if selection.is_full:
        selection = select_more(problem, left, {lost.term.key for lost in kept.dropped}, max_terms)
    else:
        selection = settled(problem, left)
    if selection.state.keys == kept.state.keys:
        return selection, replace(kept, state=selection.state)
    again = validated(problem, selection.state, splits)
    # One that was dropped may have come back, once another one had gone.
    dropped = tuple(lost for lost in (*kept.dropped, *again.dropped) if lost.term.key not in again.state.keys)
    return selection, replace(again, state=refitted(again.state), dropped=dropped)


def _named(problem: Problem, selection: Selection, kept: Validated, whole: AllReadings, max_terms: int) -> NamedModel:
    model, by_run, splits = problem.model, kept.state.by_run, whole.splits
    fit = kept.state.fit
    held_out, _ = whole.sampled(problem, np.flatnonzero(splits.held_out), rules.FINAL_ROWS)
    training, _ = whole.sampled(problem, np.flatnonzero(splits.training), rules.READINGS)
    of_training = refit(training, fit.effects, fit.base, reported=True)
    found = kept.state.terms or selection.run_offset_cm > 0.0
    nothing = Base()
    as_given = not found and held_out.log_likelihood(of_training.base, []) <= held_out.log_likelihood(nothing, [])
    readings, unit = problem.readings, problem.unit
    if as_given:
        # No fit starts with the numbers of the model itself: those of correlated readings start off 0.
        fit, of_training = refit(readings, [], nothing, rounds=0), refit(training, [], nothing, rounds=0)
    else:
        if len(readings) < whole.reading_cm.size:
            readings, rows = whole.sampled(problem, np.arange(whole.reading_cm.size), rules.FINAL_ROWS)
            unit = splits.unit[rows]
        fit = refit(readings, fit.effects, fit.base, reported=True)
    final = FinalFit.of(readings, fit, unit, by_run)
    fit, (of_training, _) = final.fit, with_constants(training, of_training)
    effects, unknown, calibration = found_terms(problem, selection.base.fit, kept, selection.alternatives, final)
    path = _path(problem, selection, kept.state)
    calibration = [*calibrated(problem, final, of_training), *calibration]
    of_runs, of_all = (of_training.base, of_training.effects), (fit.base, fit.effects)
    # Blocks of one run are no runs: what they differ by is a drift.
    if selection.run_offset_cm > 0.0 and not splits.of_blocks:
        near = instead_of_offsets(problem, kept.state, selection.needed_nats)
        offsets = validated_run_offsets(selection.run_offset_cm, fit, readings, unit, splits, near)
        if offsets is not None:
            effects.append(offsets[0])
            of_runs = with_run_offsets(of_training, offsets[1], training)
            of_all = with_run_offsets(fit, offsets[1], readings)
    return NamedModel(
        ExtendedModels(
            extended(model, *of_runs, problem.readings.spacing_s),
            extended(model, *of_all, problem.readings.spacing_s),
            path,
        ),
        tuple(effects),
        tuple(unknown),
        tuple(calibration),
        tuple(_not_testable(effect, absent) for effect, absent in problem.untestable),
        selection.first.p_value,
        detectable(problem, selection.first),
        tuple((lost.term.label, lost.why) for lost in kept.dropped),
        run_scatter(problem, kept.state.fit),
        tuple(_messages(problem, selection, kept.state, whole.reading_cm.size, max_terms)),
    )


def _not_testable(effect: str, absent: Sequence[str]) -> NotTestable:
    """With the columns to record: the reading before each is known where the times are."""
    columns = tuple("time_s" if column == PREVIOUS else column for column in absent)
    return NotTestable(effect, columns, f"{' and '.join(columns)} not recorded")


def _path(problem: Problem, selection: Selection, state: State) -> tuple[ModelStep, ...]:
    """The given model, the calibrated one, and one more for each term."""
    fit, model, spacing_s = selection.base.fit, problem.model, problem.readings.spacing_s
    steps = [ModelStep("", model), ModelStep("calibration", extended(model, fit.base, [], spacing_s))]
    for k, term in enumerate(state.terms):
        last = k == len(state.terms) - 1
        fit = state.fit if last else problem.refit([earlier.active for earlier in state.terms[: k + 1]], fit.base)
        steps.append(ModelStep(term.label, extended(model, fit.base, fit.effects, spacing_s)))
    return tuple(steps)


def _messages(problem: Problem, selection: Selection, kept: State, size: int, max_terms: int) -> Iterator[str]:
    if len(problem.readings) < size:
        yield (
            f"Effects were searched in {len(problem.readings):,} of {size:,} readings, stretches of neighbours from "
            f"all parts of all runs, and their values fitted to {min(size, rules.FINAL_ROWS):,}."
        )
    if selection.is_full:
        held = f", of which {len(kept.terms)} held" * (len(kept.terms) < max_terms)
        yield (
            f"The search ended with as many effects, curves and numbers of the base as may be added, {max_terms}{held}"
            f"; more may be missing (--max-effects {2 * max_terms})."
        )
    if kept.by_run:
        base = selection.base.fit
        measured, of_noise = problem.dependence(base), base.base.correlation
        noise = f"{of_noise:.2f} in the refitted noise and " * (of_noise != 0.0)
        beyond = " beyond it" * (of_noise != 0.0)
        yield (
            f"Readings of a run depend on each other (correlation of neighbours {noise}{measured.lag_correlation:.2f}"
            f"{beyond}; for a constant they count as {measured.effective_readings:.0f} independent ones): the unit of "
            "evidence is the run."
        )
