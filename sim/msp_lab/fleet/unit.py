"""One sensor of one vehicle: what the gap workflow's own fits and its search say of its readings.

A `Unit` and the terms that it is known to have enter; plain arrays leave. `estimate` and `search` are pure functions of
what they are given, so that another process can do them; the latest prepared readings and joint fits are kept for the
next question about the same unit, which changes how long an answer takes and nothing else.

The estimates are those of the joint fit of base and terms, with the errors of sums over whole sessions (a sandwich), or
of independent readings where these are larger. With C the fit's covariance and s the scores of a reading, C s is by how
much the reading moves the numbers; a session's sum of it, times all readings over its own, is by how much the session's
own best numbers differ from the fitted ones.
"""

import pickle
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from msp_lab.fleet.terms import BASE_NUMBERS, FleetTerm, candidate_of, term_of
from msp_lab.gap import rules
from msp_lab.gap.intake import read_readings, with_least_weights
from msp_lab.gap.problem import Problem, with_candidate
from msp_lab.gap.refit import JointFit, sums_by
from msp_lab.gap.selection import select
from msp_range.arrays import Array, Indices, numbered
from msp_range.errors import UserError
from msp_sim.effects.base import Effect
from msp_sim.model.model import Model

KEPT_UNITS = 32
"""Units of which a process keeps readings and fits: 6 MB each for 20,000 readings. Fewer than the fleet has: files are
read, and fits made, again for each question."""
MIN_READINGS = 200
"""A sensor with fewer readings is left out, with the reason. Its base has seven numbers, of which three are odds of a
few per cent. Fewer: numbers that rest on single readings."""
MAX_SHARE_LEFT_OUT = 0.5
"""A sensor is left out where the model cannot give a larger share of its readings: it is another kind of sensor, or its
unit is wrong. Higher: fits to what is left of them."""
MAX_TERMS = 6
"""Effects that the search names in one sensor at most, as many as `msp-lab gap` does."""


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


@dataclass(frozen=True)
class UnitEstimates:
    """What a sensor's readings say of C numbers, by R sessions."""

    terms: tuple[FleetTerm, ...]
    """The numbers, (C,): those of the base, then the terms that were asked for."""
    value: Array
    error: Array
    """Estimates and standard errors, (C,); the error is infinite of what the readings say nothing of."""
    sessions: tuple[str, ...]
    """Sessions that have readings, in their order."""
    readings: Indices
    """How many, (R,)."""
    session_value: Array
    session_error: Array
    """Of each session, (R, C)."""
    untestable: tuple[tuple[str, tuple[str, ...]], ...]
    """Effects that lack a column, with the columns."""


@dataclass(frozen=True)
class NamedTerm:
    """An effect that the search named in one sensor."""

    term: FleetTerm
    deviations: float
    """How many standard errors its number is from nothing."""
    is_base: bool
    """It is a number that the sensor model has."""
    alternatives: tuple[tuple[str, float], ...]
    """Effects that explain it as well, and how much less they gain [nat]."""


def estimate(model: Model, task: tuple[Unit, Sequence[FleetTerm]]) -> UnitEstimates:
    """Estimates of a unit's numbers, with those of terms that it is known to have.

    Raises
    ------
    UserError
        As `problem_of`.
    """
    unit, terms = task
    problem, fit = problem_of(model, unit), fit_of(model, unit, terms)
    names = [f"{k}.{each.number}" for k, each in enumerate(terms)]
    places = np.array([*range(len(BASE_NUMBERS)), *map(fit.names.index, names)], dtype=int)
    covariance = fit.covariance()
    flown = set(problem.contexts["run"].tolist())
    sessions = tuple(each for each in unit.sessions if each in flown)
    session = np.array([sessions.index(each) for each in problem.contexts["run"].tolist()])
    moved = fit.at.scores @ covariance[:, places]
    sums, squares = sums_by(session, moved), sums_by(session, moved**2)
    plain = np.diag(covariance)[places]
    own = np.diag(fit.at.information)[places]
    # What the other numbers explain nearly all of says nothing.
    known = (plain > 0.0) & (rules.COLLINEAR * own * plain < 1.0)
    error = np.where(known, np.sqrt(np.maximum(plain, (sums**2).sum(axis=0))), np.inf)
    # A share that is held at 0: the likelihood falls from there as an exponential does, which has this deviation.
    gradient = np.abs(fit.at.gradient[places])
    at_bound = fit.at.held[places] & (gradient > 0.0) & (places >= len(fit.base))
    error = np.where(at_bound, 1.0 / np.where(at_bound, gradient, 1.0), error)
    readings = np.bincount(session, minlength=len(sessions))
    times = (readings.sum() / readings)[:, None]
    value = fit.values[places]
    return UnitEstimates(
        (*(FleetTerm(name, "value") for name in BASE_NUMBERS), *(replace(each, start=0.0) for each in terms)),
        value,
        error,
        sessions,
        readings,
        value + times * sums,
        np.where(known, np.sqrt(np.maximum(times**2 * squares, times * plain)), np.inf),
        problem.untestable,
    )


def search(model: Model, task: tuple[Unit, float]) -> tuple[NamedTerm, ...]:
    """What the gap workflow's search names in a unit, where it names anything false with so small a probability."""
    unit, alpha = task
    selection = select(replace(problem_of(model, unit), rng=unit.rng(1), kept={}, alpha=alpha), MAX_TERMS)
    fit, found = selection.state.fit, []
    errors = np.sqrt(np.diag(fit.covariance()))
    for k, each in enumerate(selection.state.terms):
        if each.candidate is None:
            continue
        term = term_of(each, each.candidate)
        error = errors[fit.names.index(f"{k}.{term.number}")]
        others = selection.alternatives.get(each.key, ())
        names = tuple((other.active.effect.name, other.loss_nats) for other in others)
        deviations = abs(term.start) / error if error > 0.0 else 0.0
        found.append(NamedTerm(term, float(deviations), each.candidate.is_base, names))
    return tuple(found)


def problem_of(model: Model, unit: Unit) -> Problem:
    """The readings of a unit, ready for fits.

    Raises
    ------
    RecordingError
        A file is damaged, or its readings cannot be compared.
    UnusableError
        There are too few readings.
    """
    return _problem(pickle.dumps(model), unit)


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
    problem = Problem.of(model, columns, reading_cm, numbered(columns["run"]), unit.rng())
    return replace(problem, candidates=tuple(each for each in problem.candidates if not _is_plain(each.effect)))


def _is_plain(effect: Effect) -> bool:
    """Whether an effect is asked as a plain number: a share of the base, or an offset of one session, as a change."""
    return effect.per == "run" or (effect.base or "").startswith("reading_model.weights.")


def fit_of(model: Model, unit: Unit, terms: Sequence[FleetTerm]) -> JointFit:
    """The joint fit of base and terms, which are added one after another."""
    return _fit(pickle.dumps(model), unit, tuple(terms))


@lru_cache(maxsize=KEPT_UNITS)
def _fit(pickled: bytes, unit: Unit, terms: tuple[FleetTerm, ...]) -> JointFit:
    problem = _problem(pickled, unit)
    if not terms:
        return problem.base
    candidate = candidate_of(terms[-1])
    start = candidate.from_neutral(terms[-1].start)
    return with_candidate(problem, _fit(pickled, unit, terms[:-1]), candidate, start)
