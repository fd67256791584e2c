"""One sensor of one vehicle: scores of all numbers that the fleet is compared by, session by session.

A `Unit` and the terms that it is known to have enter; plain arrays leave. `examine` and `compare` are pure functions of
what they are given, so that another process can do them; the latest prepared readings and joint fits are kept for the
next question about the same unit, which changes how long an answer takes and nothing else.

At the joint fit of base and terms each number j has the efficient score u of each reading, which is its score less what
the other fitted numbers explain of it (as in `gap.screen`). A session's sum U_r over its expected information I_r is by
how much its own best value differs from the fitted one: one step of Fisher's scoring. So a session's estimate is
``value + U_r / I_r``, and sums over sessions give the vehicle's.

With a share b of something mixed in, a reading has the probability p (1 + b t), with t the score at b = 0. Its score is
taken at a small share c instead, ``u = t / (1 + c t)``, which is bounded. The mean of u grows linearly with b: from
what it is without the effect, by E[u t] per share, which stands for I. So U_r / I_r is unbiased, and its variance is
that of u over I squared.
"""

import pickle
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from msp_lab.fleet.rare import RareReadings
from msp_lab.fleet.terms import BASE_NUMBERS, FleetTerm, candidate_of, term_of
from msp_lab.gap import rules
from msp_lab.gap.candidates import CandidateEffect, score_of
from msp_lab.gap.intake import read_readings, with_least_weights
from msp_lab.gap.prepared import Prepared
from msp_lab.gap.problem import Problem, with_candidate
from msp_lab.gap.refit import JointFit, fit_base, inverse, refit, sums_by
from msp_lab.gap.screen import replicate
from msp_range.arrays import Array, Flags, Indices, numbered
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
REPLICATE_ROWS = 24_000
"""Expected information is from so many simulated readings at most. A session of a tenth of them is known to a few per
cent, as far as hits are concerned. More: slower."""
SMALL_SHARE = 0.01
"""Scores of shares are those at this share. At 0 single readings of a probability of 1e-6 hide all others: repeated
readings of 5 to 8 % that gain 100 to 220 nats in a refit were 1 to 3 standard errors. In 3,000 readings 10 standard
errors are shares of 1 to 8 %. Lower: few improbable readings decide; higher: those that are only less usual do."""


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
class UnitScores:
    """What a sensor's readings say of C numbers, by R sessions."""

    terms: tuple[FleetTerm, ...]
    """The numbers, (C,)."""
    sessions: tuple[str, ...]
    """Sessions that have readings, in their order."""
    readings: Indices
    """How many, (R,)."""
    value: Array
    """At the fit, (C,): 0 of what is absent."""
    fitted: Flags
    """Whether a number is fitted, as those of the base are, (C,)."""
    score: Array
    information: Array
    variance: Array
    """(R, C): sums of efficient scores, by how much they grow with the number, and the sums of their squares, expected
    or measured, whichever are larger: a sum that rests on few improbable readings varies by more than is expected."""
    untestable: tuple[tuple[str, tuple[str, ...]], ...]
    """Effects that lack a column, with the columns."""

    @property
    def factor(self) -> Array:
        """By how much sums of scores vary more than is expected, at least 1, (C,)."""
        total = self.information.sum(axis=0)
        factor: Array = np.maximum(self.variance.sum(axis=0) / np.where(total > 0.0, total, np.inf), 1.0)
        return factor


@dataclass(frozen=True)
class SimulatedScores:
    """Efficient scores of C numbers at m simulated readings."""

    weight: Array
    """Of each reading, (m, 1): its probability without the effects over that with which it was drawn."""
    scores: Array
    bounded: Array
    """(m, C): the scores, and the same with those of shares at `SMALL_SHARE`."""


@dataclass(frozen=True)
class RefittedTerm:
    """A term refitted next to what a sensor has: what it gains [nat], and its values."""

    term: FleetTerm
    gain_nats: float
    values: tuple[tuple[str, float], ...]


def examine(model: Model, task: tuple[Unit, Sequence[FleetTerm], bool]) -> UnitScores:
    """Scores of a unit's numbers.

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
    candidates = _candidates(problem, terms) if with_others else []
    numbers = (*(FleetTerm(name, "value") for name in BASE_NUMBERS), *terms, *map(term_of, candidates))
    rng = unit.rng(1)
    rows = max(rules.REPLICATE_ROWS, min(4 * len(problem.readings), REPLICATE_ROWS))
    drawn = replicate(
        problem.model, fit.base, fit.effects, problem.contexts, rng, rows, spacing_s=problem.readings.spacing_s
    )
    rare = RareReadings(drawn, fit, candidates, rng)
    expected, measured = (_scores(each, fit, candidates) for each in (rare.prepared, problem.readings))
    bases, fitted = len(BASE_NUMBERS), len(fit.names)
    of_terms = [fit.names.index(f"{k}.{term.number}") for k, term in enumerate(terms)]
    places = np.array([*range(bases), *of_terms, *range(fitted, fitted + len(candidates))])
    value = np.append(fit.values, np.zeros(len(candidates)))[places]
    weight = rare.weights(expected[:, fitted:])[:, None]
    free = np.flatnonzero(~fit.at.held)
    is_share = np.append(np.zeros(fitted, dtype=bool), np.array([each.linear for each in candidates], dtype=bool))
    bounded, bounded_here = (_bounded(each, is_share) for each in (expected, measured))
    turned = _explained(weight * expected / len(drawn), expected, bounded, places, free)
    flown = set(problem.contexts["run"].tolist())
    sessions = {name: k for k, name in enumerate(each for each in unit.sessions if each in flown)}
    here, there = (
        np.array([sessions[each] for each in columns["run"].tolist()]) for columns in (problem.contexts, drawn.scene)
    )
    explained = expected[:, free] @ turned.T
    score, information, variance = sums_over_sessions(
        SimulatedScores(weight, expected[:, places] - explained, bounded[:, places] - explained),
        there,
        bounded_here[:, places] - measured[:, free] @ turned.T,
        here,
        is_share[places],
        len(sessions),
    )
    # What the other numbers explain nearly all of says nothing.
    own_information = (weight * bounded[:, places] * expected[:, places]).mean(axis=0) * len(problem.readings)
    clear = (own_information > 0.0) & (information.sum(axis=0) > rules.COLLINEAR * own_information)
    # Odds that ended at their bound are those of a kind of reading that hardly ever came: no number to compare.
    clear[:bases] &= ~fit.at.held[:bases]
    information = np.where(clear, np.maximum(information, 0.0), 0.0)
    variance, score = (np.where(information > 0.0, each, 0.0) for each in (variance, score))
    readings, untestable = np.bincount(here, minlength=len(sessions)), problem.untestable
    return UnitScores(
        numbers, tuple(sessions), readings, value, places < fitted, score, information, variance, untestable
    )


def _candidates(problem: Problem, terms: Sequence[FleetTerm]) -> list[CandidateEffect]:
    """Effects that a unit with these terms may have as well."""
    own = {(*each.key, each.number) for each in terms if not each.sessions}
    return [
        each for each in problem.candidates if each.effect.per != "run" and (*each.key, each.parameter.name) not in own
    ]


def _scores(prepared: Prepared, fit: JointFit, candidates: Sequence[CandidateEffect]) -> Array:
    """Scores of readings at a fit, of all fitted numbers and then of the candidates."""
    again = refit(prepared, fit.effects, fit.base, rounds=0)
    return np.column_stack([again.at.scores, *(score_of(each, prepared, again.here) for each in candidates)])


def compare(model: Model, task: tuple[Unit, Sequence[FleetTerm], Sequence[FleetTerm]]) -> list[RefittedTerm]:
    """Refits of a unit with its terms and one more, each of the last ones in its turn."""
    unit, terms, tried = task
    problem, fit = _fitted(model, unit, terms)
    found = []
    for term in tried:
        best = _with_term(problem, fit, term)
        gained = best.log_likelihood - fit.log_likelihood - candidate_of(term).cost_nats
        found.append(RefittedTerm(term, float(gained), tuple(best.effects[-1].values.items())))
    return found


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
    return _with_term(problem, _fit(pickled, unit, terms[:-1]), terms[-1]) if terms else fit_base(problem.readings)


def _with_term(problem: Problem, fit: JointFit, term: FleetTerm) -> JointFit:
    """The joint fit with one more term, from where it is expected."""
    candidate = candidate_of(term)
    parameter = candidate.parameter
    small = FIRST_STEPS * parameter.step
    starts = [term.start] if abs(term.start) > parameter.step else [small, -small]
    starts = [start for start in starts if start > 0.0 or not candidate.one_sided] or [small]
    at = [float(np.clip(candidate.neutral + start, parameter.low, parameter.high)) for start in starts]
    return max((with_candidate(problem, fit, candidate, each) for each in at), key=lambda each: each.log_likelihood)


def sums_over_sessions(
    simulated: SimulatedScores,
    there: Indices,
    measured: Array,
    here: Indices,
    is_share: Flags,
    sessions: int,
) -> tuple[Array, Array, Array]:
    """Score, information and variance as in `UnitScores`, (sessions, C) each.

    Parameters
    ----------
    simulated, there
        Readings without any of the C effects, and the session of each, (m,).
    measured, here
        Bounded scores of the measured readings, (n, C), and the session of each, (n,).
    is_share
        Which of the C numbers are shares of something mixed in, (C,).
    sessions
        How many there are.
    """
    weight, scores, bounded = simulated.weight, simulated.scores, simulated.bounded
    readings = np.bincount(here, minlength=sessions)[:, None]
    drawn = np.maximum(np.bincount(there, minlength=sessions), 1)[:, None]
    # Simulated readings stand for so many measured ones.
    times = readings / drawn
    information = times * sums_by(there, weight * bounded * scores, sessions)
    # The mean of a bounded score, with the score itself, whose mean is 0, as a control variate.
    part = (weight * bounded * scores).sum(axis=0) / np.maximum((weight * scores**2).sum(axis=0), 1e-12)
    left = np.where(is_share, weight * (bounded - part * scores), 0.0)
    mean = sums_by(there, left, sessions) / drawn
    own = measured - mean[here]
    squares = times * sums_by(there, weight * (bounded - mean[there]) ** 2, sessions)
    variance = np.maximum(sums_by(here, own**2, sessions), squares)
    # That of the mean, which is taken off of each reading.
    variance += times**2 * sums_by(there, (left - mean[there]) ** 2 * is_share, sessions)
    return sums_by(here, own, sessions), information, variance


def _bounded(scores: Array, is_share: Flags) -> Array:
    """The same with the scores of shares at a share of `SMALL_SHARE`: none is larger than its inverse."""
    return np.where(is_share, scores / np.where(is_share, 1.0 + SMALL_SHARE * scores, 1.0), scores)


def _explained(weighted: Array, scores: Array, bounded: Array, places: Indices, free: Indices) -> Array:
    """(C, free numbers): what the scores of the other free numbers explain of each of C."""
    found = np.zeros((places.size, free.size))
    information = weighted[:, free].T @ scores[:, free]
    cross = bounded[:, places].T @ weighted[:, free]
    for k, place in enumerate(places.tolist()):
        others = np.flatnonzero(free != place)
        found[k, others] = cross[k, others] @ inverse(information[np.ix_(others, others)])
    return found
