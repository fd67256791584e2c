"""What naming works on: the readings, prepared once, and the state that each step hands to the next.

`Problem` is made of a model and readings, and never changes. A `State` is a joint fit with its terms; what can be asked
of both is a function here: a screen of all candidates, and refits with one more term or one less. The search
(`search.py`), curves (`curves.py`) and what takes a term's place (`alternatives.py`) are functions from State to State.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from msp_lab.gap import rules
from msp_lab.gap.candidate_starts import gathered_cm, shapes_of, starts_of
from msp_lab.gap.candidates import CandidateEffect, SelectedTerm, candidates_of
from msp_lab.gap.curve_test import Asked, asked_of
from msp_lab.gap.evidence import clumping, evidence_nats, of_one_run, wanders
from msp_lab.gap.prepared import BASE, Prepared
from msp_lab.gap.refit import JointFit, fit_base, refit
from msp_lab.gap.runs import Dependence, dependence, previous, sample, share_between, spacing_s, taken
from msp_lab.gap.screen import Screen, best_by_score, information_of, replicate, score_sums, screen
from msp_lab.readings.intake import PREVIOUS
from msp_range.arrays import Array, Indices, numbered
from msp_range.reading_model.rows import Base
from msp_sim.effects.base import REFERENCE, TRUE_RANGE, Effect
from msp_sim.effects.codes import Coarser
from msp_sim.effects.component import Normal
from msp_sim.effects.path import with_path
from msp_sim.effects.range_scale import RANGE_SCALE
from msp_sim.model.model import Model, Term
from msp_sim.model.rows import log_prob

Progress = Callable[[str, float], None]
"""Reports what is being done, and which share of the whole is done."""


def forward_only(report: Progress) -> Progress:
    """Reports progress that never goes back: a search that begins again says what it does, and stays where it was."""
    furthest = 0.0

    def forward(what: str, share: float) -> None:
        nonlocal furthest
        furthest = max(furthest, share)
        report(what, furthest)

    return forward


@dataclass(frozen=True)
class Problem:
    """The readings with all that the steps of naming ask of them; it never changes."""

    model: Model
    """The given model."""
    contexts: Mapping[str, Any]
    unit: Indices
    """Contexts of a sample of at most `rules.READINGS` readings, and the number of each one's run."""
    readings: Prepared
    """These readings, prepared."""
    moved_cm: Array
    """How far each one's true range is from that of the reading before it, of all readings [cm], (n,)."""
    base: JointFit
    """The base alone, refitted."""
    candidates: tuple[CandidateEffect, ...]
    """Effects that these contexts can show."""
    untestable: tuple[tuple[str, tuple[str, ...]], ...]
    """Effects that they cannot, with the columns that are missing."""
    rng: np.random.Generator
    """Source of the replicates and of the screen's null."""
    alpha: float = 0.01
    """Probability of any false name."""
    report: Progress = lambda what, share: None
    """Reports progress."""
    kept: dict[Any, JointFit] = field(default_factory=dict)
    """Fits of some of a state's terms: elimination, exchange and validation ask for the same ones."""

    @classmethod
    def of(
        cls,
        model: Model,
        contexts: Mapping[str, Any],
        reading_cm: Array,
        unit: Indices,
        rng: np.random.Generator,
    ) -> "Problem":
        """Prepare a sample of these readings; the parameters are as the attributes."""
        rows = sample(contexts, np.arange(reading_cm.size), rules.READINGS, rng)
        whole = with_path(contexts)
        contexts = taken(whole, rows)
        reading_cm, unit = reading_cm[rows], unit[rows]
        readings = Prepared.of(model, contexts, reading_cm)
        base = fit_base(readings)
        if readings.spacing_s is None:
            neighbours = dependence(base.offset_slope, unit, contexts.get("time_s"))
            # Neighbouring readings have the error of the other sensors in common.
            if neighbours.lag_z > rules.DEPENDENT_LAG_Z or REFERENCE in contexts:
                readings = Prepared.of(model, contexts, reading_cm, spacing_s(whole))
                base = fit_base(readings)
        candidates, untestable = candidates_of(model, contexts, gathered_cm(readings, base))
        moved_cm = np.abs(whole[TRUE_RANGE] - previous(whole, whole[TRUE_RANGE]))[rows]
        return cls(model, contexts, unit, readings, moved_cm, base, candidates, untestable, rng)

    @cached_property
    def curves_asked(self) -> tuple[list[Asked], list[Asked]]:
        """Columns over which curves can be asked for, and pairs of them."""
        return asked_of(self.contexts)

    @cached_property
    def asked_of_runs(self) -> list[Asked]:
        """Columns that hardly vary inside runs, such as a surface or a battery.

        Blocks of one run are no runs: what changes slowly is nearly the same all over each.
        """
        values = {names: numbered(self.contexts[names[0]]).astype(float) for names, _ in self.curves_asked[0]}
        constant = {names for names, own in values.items() if share_between(own, self.run) >= rules.BETWEEN_RUNS_SHARE}
        return [asked for asked in self.curves_asked[0] if asked[0] in constant]

    @cached_property
    def run(self) -> Indices:
        """Number of each reading's own run, (n,), also where blocks stand in for runs."""
        return numbered(self.contexts["run"]) if "run" in self.contexts else np.zeros(len(self.readings), dtype=np.intp)

    @cached_property
    def runs(self) -> int:
        """How many runs there are, or blocks that stand in for them."""
        return np.unique(self.unit).size

    @cached_property
    def of_blocks(self) -> bool:
        """Whether blocks of readings stand in for runs."""
        return np.unique(self.run).size < self.runs

    @property
    def prior(self) -> Array:
        """Precision of the base's prior for each reading that is refitted, (8,)."""
        return 1.0 / (np.square(rules.BASE_DEVIATION) * len(self.readings))

    def information(self, fit: JointFit) -> Array:
        """Information per reading at a fit, from simulated readings and the base's prior."""
        drawn = replicate(self.model, fit.base, fit.effects, self.contexts, self.rng, spacing_s=self.readings.spacing_s)
        information = information_of(drawn, fit.base, fit.effects, self.candidates)
        information[: len(BASE), : len(BASE)] += np.diag(self.prior)
        return information

    def dependence(self, fit: JointFit) -> Dependence:
        """Dependence of the readings inside runs at a fit."""
        return dependence(fit.offset_slope, self.unit, self.contexts.get("time_s"))

    def depends(self, fit: JointFit) -> bool:
        """Whether readings of a run depend on each other at a fit, so that the run is the unit of evidence."""
        return self.dependence(fit).dependent or wanders(fit, self.unit)

    def evidence_nats(self, smaller: JointFit, larger: JointFit, by_run: bool) -> float:
        """Gain of the larger fit over the smaller one [nat]; by runs, where readings of a run depend on each other."""
        if not by_run:
            return evidence_nats(smaller, larger, None)
        left = self.dependence(larger)
        follow = left.lag_correlation if left.lag_z > rules.DEPENDENT_LAG_Z else 0.0
        gained = evidence_nats(self.at_correlation(smaller, larger.base), larger, self.unit, self.of_blocks)
        return gained * (1.0 - follow) / (1.0 + follow)

    def at_correlation(self, fit: JointFit, base: Base) -> JointFit:
        """A fit at another base's correlation of neighbours, in which it would have offsets of runs as well.

        What explains some of the offsets would else gain what the correlation within runs is nearer to the truth.
        """
        if fit.base.correlation == base.correlation:
            return fit
        base = fit.base._replace(correlation=base.correlation)
        here = self.readings.slopes(base, fit.effects)
        changed = float((here.log_p - fit.here.log_p).sum())
        return replace(fit, base=base, here=here, log_likelihood=fit.log_likelihood + changed)

    def gain_where_truth_moves(self, smaller: JointFit, larger: JointFit) -> float:
        """Gain of readings at which the true range is a sigma or more from that of the one before [nat].

        A sensor before a wall that stands still repeats itself, whether it reports old readings or not. A reading
        counts for `rules.ROW_NATS` at most: where the truth jumps by an error of its own, one would decide.
        """
        with np.errstate(invalid="ignore"):
            moves = self.moved_cm >= self.readings.rows.sigma_cm
        gained = np.clip(larger.here.log_p - smaller.here.log_p, -rules.ROW_NATS, rules.ROW_NATS)
        return float(gained[moves].sum())

    def candidate_nats(self, smaller: JointFit, larger: JointFit, candidate: CandidateEffect, by_run: bool) -> float:
        """Evidence for a candidate, the last effect of the larger fit [nat], without the cost of the search."""
        is_of_one_run = candidate.effect.per == "run"
        gained = self.evidence_nats(smaller, larger, by_run and not is_of_one_run)
        if PREVIOUS in candidate.effect.requires:
            gained = min(gained, self.gain_where_truth_moves(smaller, larger))
        if is_of_one_run:
            gained = of_one_run(gained, larger, self.unit, self.contexts["run"] == candidate.of)
        share = larger.effects[-1].values[candidate.parameter.name]
        # What changes most readings shows by those that it leaves, and these are too few to say how they come.
        if candidate.linear and not candidate.is_base and share < rules.CLUMP_MAX_SHARE:
            slope = larger.at.scores[:, larger.names.index(f"{len(larger.effects) - 1}.{candidate.parameter.name}")]
            if share * slope[slope > 0.0].sum() < rules.FEW_READINGS:
                return 0.0
            gained /= self._clumping(larger, slope)
        return gained - self._gain_between_steps(smaller, larger)

    def _gain_between_steps(self, smaller: JointFit, larger: JointFit) -> float:
        """What rounding, the last effect of the larger fit, gains most at values between its steps, at least 0 [nat].

        Nothing rounds to them. Where values come again for another reason, some of them are multiples of any step.
        """
        fault = larger.effects[-1].change(self.readings.scene).fault
        if not isinstance(fault, Coarser):
            return 0.0
        rows, most = larger.here.rows, 0.0
        for other in fault.between():
            faults = tuple(each._replace(fault=other) if each.fault == fault else each for each in rows.faults)
            log_p = log_prob(replace(rows, faults=faults), self.readings.reading_cm)
            most = max(most, float((log_p - smaller.here.log_p).sum()))
        return most

    def _clumping(self, fit: JointFit, slope: Array) -> float:
        """How far the readings come in clumps that the last effect of a fit explains, by their slopes by its share."""
        fault, alike = fit.effects[-1].change(self.readings.scene).fault, None
        if fault is not None:
            received = fault.arrives(self.readings.reading_cm)
            if np.array_equal(fault.arrives(received), received):
                alike = received
        return clumping(slope, self.run, alike)

    def bench_error(self, effect: Effect) -> float | None:
        """Standard error of what the bench says of an effect's number; None: it says nothing, or counts as exact."""
        if effect is RANGE_SCALE:
            return self.model.sensor.calibration_scale_std_pct
        return rules.BENCH_ERROR.get(effect.base or "")

    def is_left_open(self, fit: JointFit, k: int, by_run: bool) -> bool:
        """Whether the k-th effect of a fit is a scale that the bench leaves open: the calibration's own error."""
        term = fit.effects[k]
        bench_error = self.bench_error(term.effect) if term.effect is RANGE_SCALE else None
        if bench_error is None:
            return False
        (name,) = term.values
        place = fit.names.index(f"{k}.{name}")
        variance = float(fit.covariance(self.unit if by_run else None)[place, place])
        return abs(term.values[name]) < rules.SURE_Z * float(np.hypot(bench_error, np.sqrt(variance)))

    def refit(self, terms: Sequence[Term], base: Base) -> JointFit:
        """A joint fit of these terms."""
        return refit(self.readings, terms, base)


@dataclass(frozen=True)
class State:
    """A joint fit with its terms, as one step of naming hands it to the next."""

    fit: JointFit
    """The fit of base and terms."""
    terms: tuple[SelectedTerm, ...]
    """In order of their acceptance; their values are those of the fit."""
    information: Array
    """Information per reading, at the fit at which it was last computed."""
    by_run: bool
    """Whether readings depend on each other, so that the unit of evidence is the run."""

    def having(self, fit: JointFit, terms: Sequence[SelectedTerm]) -> "State":
        """The state with another fit; its terms get the values of the fit."""
        placed = tuple(replace(term, active=fitted) for term, fitted in zip(terms, fit.effects, strict=True))
        return replace(self, fit=fit, terms=placed)

    @property
    def keys(self) -> frozenset[tuple[str, str | None]]:
        """Which terms it has."""
        return frozenset(term.key for term in self.terms)


def first_state(problem: Problem) -> State:
    """The base alone, refitted."""
    fit = problem.base
    return State(fit, (), problem.information(fit), problem.depends(fit))


def reinformed(problem: Problem, state: State) -> State:
    """With information at the present fit: what a large effect hid before it was named, it hides no more."""
    return replace(state, information=problem.information(state.fit))


def screened(problem: Problem, state: State, by_run: bool = False) -> Screen:
    """Every candidate at this state, with its terms as nuisance: readings propose, runs count after a refit."""
    fit, candidates, information = state.fit, problem.candidates, state.information
    accepted = [nearest_candidate(problem, term) for term in state.terms if term.candidate is not None]
    nuisance = np.array([*np.flatnonzero(~fit.at.held[: len(BASE)]), *(len(BASE) + j for j in accepted)])
    sums = score_sums(problem.readings, fit.base, fit.here, candidates, problem.unit, information, problem.prior)
    return screen(sums, information, candidates, nuisance, by_run, problem.alpha, problem.rng)


def nearest_candidate(problem: Problem, term: SelectedTerm) -> int:
    """Place of the candidate whose shape is nearest to a term's."""
    same = [j for j, candidate in enumerate(problem.candidates) if candidate.key == term.key]
    return min(
        same,
        key=lambda j: sum(
            abs(np.log(max(abs(value), 1e-3) / max(abs(term.active.values[name]), 1e-3)))
            for name, value in problem.candidates[j].shape
        ),
    )


@dataclass(frozen=True)
class CandidateFit:
    """A state refitted with one more candidate, the last of its terms."""

    gain_nats: float
    """Evidence, less the cost of the search."""
    term: SelectedTerm
    fit: JointFit
    """The new term, and the joint fit with it."""


def trials(problem: Problem, state: State, seen: Screen, least_nats: float) -> list[CandidateFit]:
    """Refits of the candidates that gain most, the best first.

    Parameters
    ----------
    problem, state
        To which one candidate at a time is added.
    seen
        The screen at this state.
    least_nats
        A candidate is refitted if its screened gain is near the best, and at least so much. One that moves part of the
        hits is always: offset and spread take most of it, and leave it no slope.
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
            near = top - max(rules.REFIT_WITHIN_NATS, rules.REFIT_WITHIN_SHARE * top)
            if i >= rules.REFITS_PER_STEP or seen.gain[j] < least_nats or (found and seen.gain[j] < near):
                continue
        fit = with_candidate(problem, state.fit, candidate, _start(candidate, seen, j))
        if _moves_little(problem, fit) or _has_its_form(problem, fit):
            continue
        gained = problem.candidate_nats(state.fit, fit, candidate, state.by_run)
        found.append(CandidateFit(gained - candidate.cost_nats, SelectedTerm(fit.effects[-1], candidate), fit))
        # A screen may promise too much, and of what is large it promises too little, of one as of the other.
        top = max(top, min(found[-1].gain_nats, float(seen.gain[j])))
    return sorted(found, key=lambda trial: -trial.gain_nats)


def _moves_little(problem: Problem, fit: JointFit) -> bool:
    """Whether the last effect of a fit moves hits by less than their own scatter: that is a form of the noise."""
    component = fit.effects[-1].change(problem.readings.scene).component
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
    own_cm = problem.readings.bias_cm(last)
    named = [term for term in others if term.shape is None and term.effect.channels == ("bias",)]
    with np.errstate(invalid="ignore"):  # One that adds nothing is like no other.
        return any(abs(np.corrcoef(own_cm, problem.readings.bias_cm(term))[0, 1]) > rules.SAME_FORM for term in named)


def _start(candidate: CandidateEffect, seen: Screen, j: int) -> float:
    """The value at which a candidate's refit starts."""
    if np.isfinite(seen.best[j]) and seen.best[j] != 0.0:
        return candidate.from_neutral(seen.best[j])
    return candidate.from_score(seen.z[j] * seen.deviation[j])


def with_candidate(problem: Problem, fit: JointFit, candidate: CandidateEffect, start: float) -> JointFit:
    """A joint fit with one more effect, from the best of some values and shapes."""
    starts = starts_of(problem.readings, fit, candidate, start)
    shapes = shapes_of(candidate)
    if shapes and not candidate.linear:
        placed = [replace(candidate, shape=tuple(shape.items())) for shape in shapes]
        starts.append((best_by_score(problem.readings, fit, placed), fit.base))
    fits = [problem.refit([*fit.effects, term], base) for term, base in starts]
    if shapes and not candidate.linear:
        fits = [_to_the_end(problem, trial) for trial in fits]
    return max(fits, key=lambda trial: trial.log_likelihood)


def _to_the_end(problem: Problem, fit: JointFit) -> JointFit:
    """A fit that goes on until it gains no more: along a shape the way is long."""
    again = problem.refit(fit.effects, fit.base)
    return again if again.log_likelihood < fit.log_likelihood + 1.0 else _to_the_end(problem, again)


def without(problem: Problem, state: State, k: int) -> State:
    """The state with its k-th term taken out."""
    return with_terms(problem, state, [term for i, term in enumerate(state.terms) if i != k])


def with_terms(problem: Problem, state: State, terms: Sequence[SelectedTerm]) -> State:
    """The state with some of its terms alone.

    Next to a strong effect the spread is small, and without it most hits would be random readings, from which no small
    step leads back: the fit starts at the base that is better, the state's or that without any term.
    """
    active = [term.active for term in terms]
    bases = (state.fit.base, problem.base.base)
    key = (state.fit.base, *((term.stream, term.shape, *term.values.values()) for term in active))
    if key not in problem.kept:
        start = max(bases, key=lambda base: problem.readings.log_likelihood(base, active))
        problem.kept[key] = problem.refit(active, start)
    return state.having(problem.kept[key], terms)


def loss(problem: Problem, smaller: JointFit, state: State) -> float:
    """Evidence that a smaller fit loses [nat]."""
    return problem.evidence_nats(smaller, state.fit, state.by_run)
