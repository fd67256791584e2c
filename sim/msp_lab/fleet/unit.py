"""One sensor of one vehicle: estimates of all numbers that the fleet is compared by, and what one more effect gains.

A `Unit` and the terms that it is known to have enter; plain arrays leave. `examine` and `compare` are pure functions of
what they are given, so that another process can do them; the latest prepared readings and joint fits are kept for the
next question about the same unit, which changes how long an answer takes and nothing else.

Everything is asked of the gap workflow: the joint fit of base and terms, the screen of all other effects next to it,
with the session as the unit of evidence, and refits with one effect more.
"""

import pickle
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from msp_lab.fleet.terms import BASE_NUMBERS, FleetTerm, candidate_of, term_of
from msp_lab.gap.candidates import SelectedTerm
from msp_lab.gap.intake import read_readings, with_least_weights
from msp_lab.gap.problem import Problem, State, screened, with_candidate
from msp_lab.gap.refit import JointFit, sums_by
from msp_range.arrays import Array, Indices, numbered
from msp_range.errors import UserError
from msp_sim.model.model import Model

KEPT_UNITS = 32
"""Units of which a process keeps readings and a fit: 6 MB each for 20,000 readings. Fewer than the fleet has: files are
read, and fits made, again for each question."""
MIN_READINGS = 200
"""A sensor with fewer readings is left out, with the reason. Its base has seven numbers, of which three are odds of a
few per cent. Fewer: numbers that rest on single readings."""
FIRST_STEPS = 30.0
"""A fit of a number of which nothing is known starts so many of its numeric steps from its neutral value: 0.03 of its
unit. Smaller: the first slope of a share is rounding."""
MAX_SHARE_LEFT_OUT = 0.5
"""A sensor is left out where the model cannot give a larger share of its readings: it is another kind of sensor, or its
unit is wrong. Higher: fits to what is left of them."""


@dataclass(frozen=True)
class Unit:
    """A sensor of a vehicle, and where its readings are."""

    dataset: Path
    """Folder of the dataset."""
    vehicle: str
    sensor: str
    """Names."""
    sessions: tuple[str, ...]
    """Its runs, in their order."""
    seed: int
    """Random seed."""
    version: str = ""
    """Of the dataset's files: what is kept of its readings is not taken for those of another one in the same folder."""

    @property
    def name(self) -> str:
        """For a person."""
        return f"{self.vehicle} {self.sensor}"

    def rng(self, *stream: int) -> np.random.Generator:
        """Random numbers of its own, the same ones each time."""
        return np.random.default_rng([self.seed, zlib.crc32(self.name.encode()), *stream])


class UnusableError(UserError):
    """A sensor's readings cannot be compared; the message says why."""


class Sessions(NamedTuple):
    """One fitted number by session, (R,) each: estimates, their variances, and shares of the readings."""

    value: Array
    variance: Array
    share: Array


@dataclass(frozen=True)
class UnitNumbers:
    """What a sensor's readings say of C numbers, the first F of which are fitted, and of these by R sessions."""

    terms: tuple[FleetTerm, ...]
    """The numbers, (C,): of the base, of the unit's terms, and of all other effects."""
    value: Array
    error: Array
    """Estimates and standard errors, (C,): of the fit, and of other effects by the screen. Of a number whose error is
    infinite the readings say nothing."""
    sessions: tuple[str, ...]
    """Sessions that have readings, in their order."""
    readings: Indices
    """How many, (R,)."""
    by_session: Array
    variance: Array
    """Of the fitted numbers by session, (R, F): one step from the fit by the session's scores; and its variance,
    expected or measured, whichever is larger: a sum of few improbable readings varies by more than is expected."""
    untestable: tuple[tuple[str, tuple[str, ...]], ...]
    """Effects that lack a column, with the columns."""

    def over_sessions(self) -> list[tuple[FleetTerm, Sessions]]:
        """The fitted numbers of which the readings say something."""
        share = self.readings / self.readings.sum()
        columns = zip(self.terms, self.error.tolist(), self.by_session.T, self.variance.T, strict=False)
        return [(term, Sessions(value, variance, share)) for term, error, value, variance in columns if error < np.inf]


@dataclass(frozen=True)
class RefittedTerm:
    """A term refitted next to what a sensor has: what it gains [nat], and its values."""

    gain_nats: float
    values: tuple[tuple[str, float], ...]


def examine(model: Model, task: tuple[Unit, Sequence[FleetTerm], bool]) -> UnitNumbers:
    """Estimates of a unit's numbers.

    Parameters
    ----------
    model
        Sensor model.
    task
        The unit, its terms, and whether all other effects are asked next to them.

    Raises
    ------
    UserError
        As `_fitted`.
    """
    unit, terms, with_others = task
    problem, fit = _fitted(model, unit, terms)
    run = problem.contexts["run"].tolist()
    sessions = [session for session in unit.sessions if session in set(run)]
    here = np.array([sessions.index(name) for name in run])
    readings = np.bincount(here)
    of_terms = [fit.names.index(f"{k}.{term.number}") for k, term in enumerate(terms)]
    places = [*range(len(BASE_NUMBERS)), *of_terms]
    # Odds that ended at their bound are those of a kind of reading that hardly ever came: no number to compare. A share
    # that did is as near to it as the slope there says.
    at_bound = [place for place in of_terms if fit.at.held[place]]
    covariance = fit.covariance()
    covariance[at_bound, at_bound] = 1.0 / np.maximum(np.diag(fit.at.information), fit.at.gradient**2)[at_bound]
    moved = fit.at.scores @ covariance[:, places]
    share = readings[:, None] / len(here)
    by_session = fit.values[places] + sums_by(here, moved) / share
    variance = np.maximum(sums_by(here, moved**2) / share**2, np.diag(covariance)[places] / share)
    total = (share**2 * variance).sum(axis=0)
    error = np.where(total > 0.0, np.sqrt(total), np.inf)
    # With random numbers of its own each time, so that the answer is the same wherever it was asked before.
    asked = replace(problem, rng=unit.rng(1))
    others, of_others = _others(asked, fit, terms) if with_others else ((), np.zeros((2, 0)))
    return UnitNumbers(
        (*(FleetTerm(name, "value") for name in BASE_NUMBERS), *terms, *others),
        np.append((share * by_session).sum(axis=0), of_others[0]),
        np.append(error, of_others[1]),
        tuple(sessions),
        readings,
        by_session,
        variance,
        problem.untestable,
    )


def _others(problem: Problem, fit: JointFit, terms: Sequence[FleetTerm]) -> tuple[tuple[FleetTerm, ...], Array]:
    """Effects that a unit with these terms may have as well; estimates and errors by the screen, (2, effects)."""
    accepted = tuple(
        SelectedTerm(active, None if term.sessions else candidate_of(term))
        for active, term in zip(fit.effects, terms, strict=True)
    )
    seen = screened(problem, State(fit, accepted, problem.information(fit), False))
    own = {(*term.key, term.number) for term in terms if not term.sessions}
    asked = [
        j
        for j, candidate in enumerate(problem.candidates)
        if candidate.effect.per != "run"
        and (*candidate.key, candidate.parameter.name) not in own
        and np.isfinite(seen.deviation[j])
    ]
    deviation = seen.deviation[asked]
    return tuple(term_of(problem.candidates[j]) for j in asked), np.stack([seen.z[asked] * deviation, deviation])


def compare(model: Model, task: tuple[Unit, Sequence[FleetTerm], Sequence[FleetTerm]]) -> list[RefittedTerm]:
    """Refits of a unit with its terms and one more, each of the last ones in its turn."""
    unit, terms, tried = task
    problem, fit = _fitted(model, unit, terms)
    found = []
    for term in tried:
        best = _with_term(problem, fit, term)
        candidate = candidate_of(term)
        gained = problem.candidate_nats(fit, best, candidate, problem.depends(fit)) - candidate.cost_nats
        found.append(RefittedTerm(gained, tuple(best.effects[-1].values.items())))
    return found


def held(model: Model, task: tuple[Unit, Sequence[FleetTerm], int, float]) -> float:
    """What a unit's fit loses if the number of one of its terms is held at a value [nat].

    A fitted number need not be as far off as its standard error says: a share of tails a little wider than the hits may
    be a half as well as a tenth.
    """
    unit, terms, k, value = task
    problem, fit = _fitted(model, unit, terms)
    effects = list(fit.effects)
    values = {**effects[k].values, terms[k].number: value}
    effects[k] = replace(effects[k], effect=replace(effects[k].effect, parameters=()), values=values)
    return fit.log_likelihood - problem.refit(effects, fit.base).log_likelihood


def _fitted(model: Model, unit: Unit, terms: Sequence[FleetTerm]) -> tuple[Problem, JointFit]:
    """The readings of a unit, ready for fits, and the joint fit of base and terms, which are added one after another.

    Raises
    ------
    RecordingError
        A file is damaged, or its readings cannot be compared.
    UnusableError
        There are too few readings.
    """
    pickled = pickle.dumps(model)
    return _problem(pickled, unit), _fit(pickled, unit, tuple(terms))


@lru_cache(maxsize=KEPT_UNITS)
def _problem(pickled: bytes, unit: Unit) -> Problem:
    model, _ = with_least_weights(pickle.loads(pickled))
    readings = read_readings([unit.dataset], model, sensors=(unit.sensor,), runs=unit.sessions)
    model = readings.in_step(model)
    count = len(readings.data)
    if count < MIN_READINGS:
        raise UnusableError(f"{count} readings with a true range, and at least {MIN_READINGS} are needed")
    columns = dict(readings.data.columns)
    reading_cm = columns.pop("reading_cm")
    possible = np.isfinite(model.log_prob(reading_cm, columns))
    if possible.mean() < 1.0 - MAX_SHARE_LEFT_OUT:
        raise UnusableError(f"the model cannot give {100.0 * (1.0 - possible.mean()):.0f} % of the readings")
    return Problem.of(model, columns, reading_cm, numbered(columns["run"]), unit.rng())


@lru_cache(maxsize=KEPT_UNITS)
def _fit(pickled: bytes, unit: Unit, terms: tuple[FleetTerm, ...]) -> JointFit:
    problem = _problem(pickled, unit)
    return _with_term(problem, _fit(pickled, unit, terms[:-1]), terms[-1]) if terms else problem.base


def _with_term(problem: Problem, fit: JointFit, term: FleetTerm) -> JointFit:
    """The joint fit with one more term, from where it is expected."""
    candidate = candidate_of(term)
    parameter = candidate.parameter
    small = FIRST_STEPS * parameter.step
    starts = [term.start] if abs(term.start) > parameter.step else [small, -small]
    starts = [start for start in starts if start > 0.0 or not candidate.one_sided] or [small]
    at = [float(np.clip(candidate.neutral + start, parameter.low, parameter.high)) for start in starts]
    return max(
        (with_candidate(problem, fit, candidate, start) for start in at), key=lambda fitted: fitted.log_likelihood
    )
