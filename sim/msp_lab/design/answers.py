"""The answers to a question as models, fitted to the readings that could not decide it.

For each answer the folder of a gap run gives a whole model, which the simulator can draw from.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from msp_lab.design.questions import Answer, OpenQuestion
from msp_lab.gap import rules
from msp_lab.gap.candidates import CandidateEffect, candidates_of
from msp_lab.gap.extended_model import extended
from msp_lab.gap.findings_file import read_named
from msp_lab.gap.intake import Comparison
from msp_lab.gap.prepared import Prepared
from msp_lab.gap.refit import JointFit, refit
from msp_lab.gap.runs import sample, taken
from msp_lab.gap.steps import Steps
from msp_range.arrays import Array
from msp_range.reading_model.rows import Base
from msp_sim.effects.base import Effect, Parameter
from msp_sim.model.model import Model, Term

FITTED_ROWS = 6_000
"""The answers are fitted to a sample of at most so many readings. Errors of a strength are then those of 6,000
readings, which `cautious` takes off. More: slower."""
STARTS = np.array([1e-4, 3e-4, 1e-3, 3e-3, 0.01, 0.03, 0.1, 0.3])
"""Strengths at which a fit may start, as shares of what the parameter may be; the likeliest is taken."""
LARGEST_DOUBT = 0.5
"""A strength is planned with one standard error smaller than fitted, at most by this share: where a number of the model
does as well, its error is larger than itself. Where the error is larger than this share the strength is that which
explains the number. Larger: longer sessions that keep their promise more often."""
SHOWN_NATS = 2.0
"""If the readings prefer an effect to none by less, its fitted strength means nothing, and that which matters is taken
(`MATTERS_NATS`). Two nats are those of two standard errors."""
MATTERS_NATS = rules.CLOSED_MAX_NATS
"""An effect that the readings say nothing about is planned with the strength at which it changes a reading of the
session by so many nats on average: the smallest gap that never counts as closed, whatever the noise floor."""


@dataclass(frozen=True)
class FittedAnswer:
    """An answer with its numbers."""

    answer: Answer
    """What it stands for."""
    terms: tuple[Term, ...]
    """Effects of the model in all, that of the answer last."""
    base: Base
    """Change of the base's numbers."""
    log_likelihood: float | None
    """Log-likelihood of the readings that were fitted [nat]; None: they lack its columns."""
    model: Model
    """The whole model, to draw readings from."""
    assumed: bool = False
    """The strength is not fitted, but the one that matters."""


@dataclass(frozen=True)
class OldReadings:
    """The readings of a gap run, its model, and what it named."""

    comparison: Comparison
    """Readings and model."""
    terms: tuple[Term, ...]
    """What was added to the model."""

    @classmethod
    def load(cls, steps: Steps) -> "OldReadings":
        """Read what a gap run read.

        Raises
        ------
        ConfigError
            The run did not come to names, or its files are gone or have changed.
        """
        models, findings = read_named(steps.folder)
        given = len(models.path[0].model.effects)
        return cls(steps.same_comparison(findings, "name"), models.final_fit.effects[given:])

    @property
    def model(self) -> Model:
        """The given model."""
        return self.comparison.model

    @property
    def run_offset_cm(self) -> float:
        """Standard deviation of offsets between runs, of the model and as found [cm]."""
        found = [
            term.values["deviation_cm"]
            for term in (*self.model.effects, *self.terms)
            if term.effect.name == "run_offsets"
        ]
        return float(np.hypot.reduce([0.0, *found]))

    @property
    def runs(self) -> int:
        """How many runs they are of."""
        return np.unique(self.columns["run"]).size

    @property
    def columns(self) -> Mapping[str, Any]:
        """All columns, the readings among them."""
        return self.comparison.data

    @cached_property
    def prepared(self) -> Prepared:
        """A sample of the readings."""
        rng = np.random.default_rng(self.comparison.settings.seed)
        some = sample(self.columns, np.arange(self.columns["reading_cm"].size), FITTED_ROWS, rng)
        columns = taken(self.columns, some)
        return Prepared.of(self.model, columns, columns.pop("reading_cm"))

    @cached_property
    def candidates(self) -> tuple[CandidateEffect, ...]:
        """What these readings can show."""
        return candidates_of(
            self.model, {name: self.prepared.scene[name] for name in self.columns if name in self.prepared.scene}
        )[0]


def fit_answers(old: OldReadings, question: OpenQuestion) -> list[FittedAnswer]:
    """Each answer of a question, fitted to the old readings with all else that was found."""
    own = {(answer.name, answer.of) for answer in question.answers}
    others = [term for term in old.terms if (term.effect.name, term.of) not in own]
    without = refit(old.prepared, others)
    return [_fitted(old, answer, without) for answer in question.answers]


def _fitted(old: OldReadings, answer: Answer, without: JointFit) -> FittedAnswer:
    def as_answer(terms: Sequence[Term], base: Base, fitted: JointFit | None) -> FittedAnswer:
        likelihood = None if fitted is None else fitted.log_likelihood
        model = extended(old.model, base, terms, old.prepared.spacing_s)
        return FittedAnswer(answer, tuple(terms), base, likelihood, model, fitted is None)

    if answer.effect is None:
        return as_answer(without.effects, without.base, without)
    candidates = [candidate for candidate in old.candidates if candidate.key == (answer.name, answer.of)]
    starts = [candidate.at(value) for candidate in candidates for value in _starts(candidate.parameter)]
    if not starts:
        term = Term(answer.effect, answer.effect.neutral_values(), answer.of)
        return as_answer([*without.effects, term], without.base, None)
    fit = _best_fit(old, without.effects, starts, without.base)
    is_shown = fit.log_likelihood - without.log_likelihood >= SHOWN_NATS
    fitted = as_answer([*fit.effects[:-1], _cautious(fit)], fit.base, fit)
    if is_shown and _doubt(fit) <= LARGEST_DOUBT:
        return fitted
    # The model's own numbers do as well. Then it may be the effect that has changed them: without it they are as given.
    given = Base()
    instead = _best_fit(old, without.effects, starts, given)
    unexplained = old.prepared.log_likelihood(given, without.effects)
    if instead.log_likelihood - max(without.log_likelihood - SHOWN_NATS, unexplained + SHOWN_NATS) >= 0.0:
        return as_answer([*instead.effects[:-1], _cautious(instead, alone=True)], instead.base, instead)
    return fitted if is_shown else as_answer([*without.effects, fit.effects[-1]], without.base, None)


def _best_fit(old: OldReadings, others: Sequence[Term], starts: Sequence[Term], base: Base) -> JointFit:
    start = max(starts, key=lambda term: old.prepared.log_likelihood(base, [*others, term]))
    return refit(old.prepared, [*others, start], base)


def _starts(parameter: Parameter) -> Array:
    neutral = parameter.neutral or 0.0
    span = STARTS * (parameter.high - parameter.low)
    values = neutral + np.concatenate([-span[::-1], span])
    return values[(values >= parameter.low) & (values <= parameter.high)]


def strength_of(effect: Effect) -> Parameter:
    """The parameter that is neutral where the effect is absent."""
    return next(parameter for parameter in effect.parameters if parameter.neutral is not None)


def _doubt(fit: JointFit, alone: bool = False) -> float:
    """Standard error of the last effect's strength over the strength itself; `alone`: other numbers are known."""
    term = fit.effects[-1]
    strength = strength_of(term.effect)
    place = fit.names.index(f"{len(fit.effects) - 1}.{strength.name}")
    covariance = fit.covariance()
    known = np.linalg.pinv(covariance)[place, place]
    variance = (1.0 / known if known > 0.0 else np.inf) if alone else covariance[place, place]
    size = term.values[strength.name] - (strength.neutral or 0.0)
    return float(np.sqrt(max(variance, 0.0))) / max(abs(size), 1e-12)


def _cautious(fit: JointFit, alone: bool = False) -> Term:
    """The last effect with its strength one standard error nearer to nothing."""
    term = fit.effects[-1]
    strength = strength_of(term.effect)
    neutral = strength.neutral or 0.0
    left = 1.0 - min(_doubt(fit, alone), LARGEST_DOUBT)
    return term.having({strength.name: neutral + left * (term.values[strength.name] - neutral)})


def with_strength(
    answer: FittedAnswer, given: Model, contexts: Mapping[str, Any], rng: np.random.Generator
) -> FittedAnswer:
    """An answer of unknown strength with the smallest one that matters in these contexts; others as they are."""
    if not answer.assumed or answer.answer.effect is None:
        return answer
    term = answer.terms[-1]
    strength = strength_of(term.effect)
    neutral = strength.neutral or 0.0
    without = extended(given, answer.base, answer.terms[:-1], None)
    for share in np.geomspace(1e-5, 1.0, 41):
        value = min(neutral + share * (strength.high - strength.low), strength.high)
        stronger = term.having({strength.name: float(value)})
        model = extended(given, answer.base, [*answer.terms[:-1], stronger], None)
        drawn = model.sample(contexts, rng)
        gained = np.maximum(model.log_prob(drawn, contexts), -30.0) - np.maximum(
            without.log_prob(drawn, contexts), -30.0
        )
        if gained.mean() >= MATTERS_NATS:
            break
    return replace(answer, terms=(*answer.terms[:-1], stronger), model=model)
