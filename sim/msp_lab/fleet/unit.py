"""One sensor of one vehicle: estimates of the numbers that the fleet is compared by, and what else it has.

`examine` and `search` are pure functions of a `Unit` and the terms that it is known to have, and return plain data, so
that another process can call them; the latest prepared readings and joint fits are kept for the next question about the
same unit, which changes how long an answer takes and nothing else.

Everything is asked of the gap workflow: the joint fit of base and terms, and its own search for what else is missing.
"""

import pickle
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from msp_lab.fleet.terms import BASE, FleetTerm, candidate_of, term_of
from msp_lab.gap.candidates import CandidateEffect, SelectedTerm
from msp_lab.gap.intake import read_readings, with_least_weights
from msp_lab.gap.prepared import CHANNELS, ODDS_CHANNELS
from msp_lab.gap.problem import Problem, State, screened, with_candidate
from msp_lab.gap.refit import JointFit, inverse, sums_by
from msp_lab.gap.search import Selection, add_effects, settled
from msp_range.arrays import Array, Column, numbered
from msp_range.errors import UserError
from msp_sim.model.model import Model

KEPT_UNITS = 32
"""Units of which a process keeps readings and a fit: 6 MB each for 20,000 readings. Fewer than the fleet has: files are
read, and fits made, again for each question."""
MIN_READINGS = 200
"""A sensor with fewer readings is left out, with the reason. Its base has seven numbers, of which three are odds of a
few per cent. Fewer: numbers that rest on single readings."""
MAX_EFFECTS = 4
"""At most this many effects that the fleet does not share are searched for in a sensor, as with `msp-lab gap
--max-effects`: of a sensor with more nobody could say what each of them is. More: slower."""
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
    """Names of the vehicle and of its sensor."""
    sessions: tuple[str, ...]
    """Its runs, in their order."""
    seed: int
    """Random seed."""
    version: str = ""
    """Hash of the dataset's files: readings that a process keeps are not mistaken for those of another dataset in the
    same folder."""

    def rng(self, *stream: int) -> np.random.Generator:
        """Random numbers of its own, the same ones each time."""
        return np.random.default_rng([self.seed, zlib.crc32(f"{self.vehicle} {self.sensor}".encode()), *stream])


class Sessions(NamedTuple):
    """One number of a sensor by session, (R,) each: estimates, their variances, and shares of the readings."""

    value: Array
    variance: Array
    share: Array

    def estimate(self, omega2: float) -> tuple[float, float]:
        """Estimate over all sessions, and its standard error if sessions differ with the variance ``omega2``."""
        variance = (self.share**2 * (self.variance + omega2)).sum()
        return float((self.share * self.value).sum()), float(np.sqrt(variance))


@dataclass(frozen=True)
class UnitNumbers:
    """Estimates of a sensor's numbers of the base and of its terms."""

    numbers: tuple[tuple[FleetTerm, Sessions], ...]
    """Numbers that the readings determine, by session. A session's estimate is one scoring step from the fit of all;
    its variance is the expected or the measured one, whichever is larger: a sum of few improbable readings varies by
    more than expected."""
    sessions: tuple[str, ...]
    """Sessions that have readings, in their order."""
    readings: int
    """Number of readings."""
    gain_nats: float
    """Log likelihood that the last of the terms gains in addition to the others [nat]."""
    asked: int
    """Number of effects that the readings can show."""
    untestable: tuple[tuple[str, tuple[str, ...]], ...]
    """Effects that lack a column, with the columns."""
    words: tuple[tuple[str, str], ...] = ()
    """Columns of words that are one word in all readings, such as a batch, with the word."""


Names = tuple[tuple[FleetTerm, float], ...]
"""An effect that a sensor has, and others that explain it as well, each with how much less it gains [nat]: 0 first."""


class OwnEffects(NamedTuple):
    """Effects that a sensor has in addition to its known terms, and their gain together [nat]."""

    effects: tuple[Names, ...]
    gain_nats: float


def examine(model: Model, task: tuple[Unit, tuple[FleetTerm, ...]]) -> UnitNumbers:
    """Estimates of a unit's numbers.

    Parameters
    ----------
    model
        Sensor model.
    task
        The unit and its terms.

    Raises
    ------
    UserError
        As `_fitted`.
    """
    unit, terms = task
    problem, fit = _fitted(model, unit, terms)
    run = problem.contexts["run"].tolist()
    sessions = [session for session in unit.sessions if session in set(run)]
    here = np.array([sessions.index(name) for name in run])
    readings = np.bincount(here)
    of_terms = [fit.names.index(f"{k}.{term.number}") for k, term in enumerate(terms)]
    places = [*range(len(BASE)), *of_terms]
    covariance, expected = _covariance(
        fit, [(place, candidate_of(term)) for place, term in zip(of_terms, terms, strict=True)]
    )
    moved = fit.at.scores @ covariance[:, places]
    share = readings / len(here)
    value = fit.values[places] + sums_by(here, moved) / share[:, None]
    variance = np.maximum(sums_by(here, moved**2) / share[:, None] ** 2, expected[places] / share[:, None])
    of_all = (*(FleetTerm(name, "value") for name in BASE), *terms)
    numbers = [
        (term, Sessions(*own, share)) for term, own in zip(of_all, zip(value.T, variance.T, strict=True), strict=True)
    ]
    gain_nats = 0.0
    if terms:
        smaller = _fitted(model, unit, terms[:-1])[1]
        gain_nats = problem.candidate_nats(smaller, fit, candidate_of(terms[-1]), problem.depends(smaller))
    return UnitNumbers(
        tuple((term, own) for term, own in numbers if own.variance.max() > 0.0),
        tuple(sessions),
        len(here),
        gain_nats,
        len({(*candidate.key, candidate.parameter.name) for candidate in _asked(problem)}),
        problem.untestable,
        tuple((name, str(column[0])) for name, column in problem.contexts.items() if _is_one_word(name, column)),
    )


def _is_one_word(name: str, column: Column) -> bool:
    """Whether a column has the same known word in all readings, and not by being of one sensor."""
    words = np.unique(column).tolist() if column.dtype.kind == "U" and name not in ("run", "sensor") else []
    return len(words) == 1 and words[0] != ""


def _covariance(fit: JointFit, of_terms: Sequence[tuple[int, CandidateEffect]]) -> tuple[Array, Array]:
    """Covariance of a fit's numbers by which a step is taken, and their variances.

    Both are 0 for numbers of the base that are held, and for those that no reading depends on.

    A term that ended at its bound is free: one step goes on beyond it, where the number is no share. With the bound as
    their estimate, and what is left on this side of it as their error, half of the vehicles would be equal and certain,
    and what the others scatter would be odd.
    """
    information, held = fit.at.information.copy(), fit.at.held.copy()
    first_odds = CHANNELS.index(ODDS_CHANNELS[0])
    odds = [(place, place) for place in range(first_odds, len(CHANNELS))]
    for place, candidate in of_terms:
        if held[place] and candidate.linear:
            # No reading is likelier with less than none of a kind: the share is as near to 0 as the slope there says.
            own = max(information[place, place], fit.at.gradient[place] ** 2)
            information[place] = information[:, place] = 0.0
            information[place, place] = own
        held[place] = False
        if candidate.odds is not None:
            odds.append((place, first_odds + candidate.odds - 1))
    least = np.zeros(len(held))
    for place, channel in odds:
        # Readings that the fit expects and that did not come have no scores to square: each is worth its probability.
        # What came n times is known as of n and a half of them.
        by, share = fit.here.by[:, channel], fit.here.shares[:, channel - first_odds]
        template = np.divide(fit.at.scores[:, place], by, out=np.zeros_like(by), where=by != 0.0)
        information[place, place] += max(-float(template**2 @ by), 0.0)
        least[place] = 1.0 / (float(template**2 @ (share + by)) + 0.5)
    covariance = inverse(information * np.outer(~held, ~held))
    return covariance, np.maximum(np.diag(covariance), least * (np.diag(covariance) > 0.0))


def _asked(problem: Problem) -> tuple[CandidateEffect, ...]:
    """Effects that vehicles are asked for; what sessions differ by is compared over the fleet."""
    return tuple(candidate for candidate in problem.candidates if candidate.effect.per != "run")


def search(model: Model, task: tuple[Unit, tuple[FleetTerm, ...], float]) -> OwnEffects:
    """What a unit has next to its terms, by the search of the gap workflow.

    Parameters
    ----------
    model
        Sensor model.
    task
        The unit, its terms, and what an effect has to gain [nat].
    """
    unit, terms, needed_nats = task
    problem, fit = _fitted(model, unit, terms)
    # With random numbers and a memory of its own, so that the answer is the same wherever and whenever it was asked.
    problem = replace(problem, candidates=_asked(problem), rng=unit.rng(1), kept={})
    known = tuple(SelectedTerm(active, candidate_of(term)) for active, term in zip(fit.effects, terms, strict=True))
    begun = State(fit, known, problem.information(fit), problem.depends(fit))
    seen = screened(problem, begun)
    state = add_effects(problem, begun, seen, needed_nats, len(terms) + MAX_EFFECTS)
    if state is begun:
        return OwnEffects((), 0.0)
    found = settled(problem, Selection(begun, state, seen, {}, needed_nats))
    own = [term for term in found.state.terms if term.candidate is not None and term.key not in begun.keys]
    names = (
        (
            (term_of(term.active, term.candidate), 0.0),
            *((term_of(other.active), other.loss_nats) for other in found.alternatives.get(term.key, ())),
        )
        for term in own
    )
    return OwnEffects(tuple(names), found.state.fit.log_likelihood - fit.log_likelihood)


def _fitted(model: Model, unit: Unit, terms: tuple[FleetTerm, ...]) -> tuple[Problem, JointFit]:
    """The readings of a unit, ready for fits, and the joint fit of base and terms, which are added one after another.

    Raises
    ------
    RecordingError
        A file is damaged, or its readings cannot be compared.
    UserError
        There are too few readings, or the model cannot give most of them.
    """
    pickled = pickle.dumps(model)
    return _problem(pickled, unit), _fit(pickled, unit, terms)


@lru_cache(maxsize=KEPT_UNITS)
def _problem(pickled: bytes, unit: Unit) -> Problem:
    model, _ = with_least_weights(pickle.loads(pickled))
    readings = read_readings([unit.dataset], model, sensors=(unit.sensor,), runs=unit.sessions)
    model = readings.in_step(model)
    count = len(readings.data)
    if count < MIN_READINGS:
        raise UserError(f"{count} readings with a true range, and at least {MIN_READINGS} are needed")
    columns = dict(readings.data.columns)
    reading_cm = columns.pop("reading_cm")
    possible = np.isfinite(model.log_prob(reading_cm, columns))
    if possible.mean() < 1.0 - MAX_SHARE_LEFT_OUT:
        raise UserError(f"the model cannot give {100.0 * (1.0 - possible.mean()):.0f} % of the readings")
    return Problem.of(model, columns, reading_cm, numbered(columns["run"]), unit.rng())


@lru_cache(maxsize=KEPT_UNITS)
def _fit(pickled: bytes, unit: Unit, terms: tuple[FleetTerm, ...]) -> JointFit:
    problem = _problem(pickled, unit)
    if not terms:
        return problem.base
    candidate = candidate_of(terms[-1])
    return with_candidate(problem, _fit(pickled, unit, terms[:-1]), candidate, candidate.from_neutral(terms[-1].start))
