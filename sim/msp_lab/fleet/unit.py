"""One sensor of one vehicle: scores of all numbers that the fleet is compared by, session by session.

A `Unit` and the terms that it is known to have enter; plain arrays leave. `examine` and `compare` are pure functions of
what they are given, so that another process can do them; only one vehicle's readings are in memory at a time.

At the joint fit of base and terms each number j has the efficient score u of each reading, which is its score less what
the other fitted numbers explain of it (as in `gap.screen`). A session's sum U_r over its expected information I_r is by
how much its own best value differs from the fitted one: one step of Fisher's scoring. So a session's estimate is
``value + U_r / I_r``, and sums over sessions give the vehicle's.
"""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from msp_lab.fleet.terms import BASE_NUMBERS, FleetTerm, candidate_of, term_of
from msp_lab.gap import rules
from msp_lab.gap.candidates import score_of
from msp_lab.gap.intake import read_readings
from msp_lab.gap.prepared import Prepared
from msp_lab.gap.problem import Problem, with_candidate
from msp_lab.gap.refit import JointFit, fit_base, refit
from msp_lab.gap.runs import numbered
from msp_lab.gap.screen import replicate
from msp_lab.gap.workflow import with_least_weights
from msp_range.errors import UserError
from msp_sim.model.model import Model

_Array = NDArray[np.float64]

MIN_READINGS = 200
"""A sensor with fewer readings is left out, with the reason. Its base has seven numbers, of which three are odds of a
few per cent. Fewer: numbers that rest on single readings."""
REPLICATE_ROWS = 24_000
"""Expected information is from so many simulated readings at most. A session of a tenth of them is known to a few per
cent, as far as hits are concerned. More: slower."""
FIRST_STEPS = 30.0
"""A fit of a number of which nothing is known starts so many of its numeric steps from its neutral value: 0.03 of its
unit. Smaller: the first slope of a share is rounding."""
MAX_SHARE_LEFT_OUT = 0.5
"""A sensor is left out where the model cannot give a larger share of its readings: it is another kind of sensor, or its
unit is wrong. Higher: fits to what is left of them."""


@dataclass(frozen=True)
class Unit:
    """A sensor of a vehicle, and where its readings are.

    Attributes
    ----------
    dataset
        Folder of the dataset.
    vehicle, sensor
        Names.
    sessions
        Its runs, in their order.
    seed
        Random seed.
    """

    dataset: Path
    vehicle: str
    sensor: str
    sessions: tuple[str, ...]
    seed: int

    @property
    def name(self) -> str:
        """For a person."""
        return f"{self.vehicle} {self.sensor}"


@dataclass(frozen=True)
class UnitScores:
    """What a sensor's readings say of C numbers, by R sessions.

    Attributes
    ----------
    terms
        The numbers, (C,).
    sessions
        Sessions that have readings, in their order.
    readings
        How many, (R,).
    value
        At the fit, (C,): 0 of what is absent.
    fitted
        Whether a number is fitted, as those of the base are, (C,).
    score, information, variance
        (R, C): sums of efficient scores, what is expected of their squares, and the larger one of that and the squares
        themselves: a sum that rests on few improbable readings varies by more than is expected.
    untestable
        Effects that lack a column, with the columns.
    messages
        What was noticed about the readings.
    """

    terms: tuple[FleetTerm, ...]
    sessions: tuple[str, ...]
    readings: NDArray[np.intp]
    value: _Array
    fitted: NDArray[np.bool_]
    score: _Array
    information: _Array
    variance: _Array
    untestable: tuple[tuple[str, tuple[str, ...]], ...]
    messages: tuple[str, ...]

    @property
    def factor(self) -> _Array:
        """By how much sums of scores vary more than is expected, at least 1, (C,)."""
        total = self.information.sum(axis=0)
        factor: _Array = np.maximum(self.variance.sum(axis=0) / np.where(total > 0.0, total, np.inf), 1.0)
        return factor


@dataclass(frozen=True)
class Comparison:
    """A term refitted next to what a sensor has: what it gains [nat], and its values."""

    term: FleetTerm
    gain_nats: float
    values: tuple[tuple[str, float], ...]


class UnusableError(UserError):
    """A sensor's readings cannot be compared; the message says why."""


def examine(model: Model, task: tuple[Unit, Sequence[FleetTerm]]) -> UnitScores:
    """Scores of all numbers of a unit next to its terms.

    Raises
    ------
    RecordingError
        A file is damaged, or its readings cannot be compared.
    UnusableError
        There are too few readings.
    """
    unit, terms = task
    problem, messages = _problem(model, unit)
    fit = _fit(problem, terms)
    own = {(*each.key, each.number) for each in terms if not each.sessions}
    candidates = [
        each for each in problem.candidates if each.effect.per != "run" and (*each.key, each.parameter.name) not in own
    ]
    columns = (
        *(FleetTerm(name, "value") for name in BASE_NUMBERS),
        *terms,
        *(term_of(each) for each in candidates),
    )

    def scores(prepared: Prepared) -> _Array:
        """Of all fitted numbers, then of the candidates."""
        at = refit(prepared, fit.effects, fit.base, rounds=0)
        here = at.here
        of_candidates = [score_of(each, here.rows, prepared.scene, prepared.reading_cm, here) for each in candidates]
        return np.column_stack([at.scores, *of_candidates])

    rng = np.random.default_rng([unit.seed, zlib.crc32(unit.name.encode()), 1])
    rows = max(rules.REPLICATE_ROWS, min(4 * len(problem.some), REPLICATE_ROWS))
    drawn = replicate(
        problem.model, fit.base, fit.effects, problem.some_contexts, rng, rows, spacing_s=problem.some.spacing_s
    )
    expected, measured = scores(drawn), scores(problem.some)
    of_numbers, values = list(range(len(BASE_NUMBERS))), list(fit.base[: len(BASE_NUMBERS)])
    for k, term in enumerate(terms):
        of_numbers.append(fit.names.index(f"{k}.{term.number}"))
        values.append(fit.effects[k].values[term.number])
    fitted = len(fit.names)
    places = np.array([*of_numbers, *range(fitted, fitted + len(candidates))])
    free = np.flatnonzero(~fit.held)
    turned = _efficient(expected.T @ expected / len(drawn), places, free)
    sessions = [each for each in unit.sessions if each in set(problem.some_contexts["run"].tolist())]
    session_of = {name: k for k, name in enumerate(sessions)}
    here = np.array([session_of[each] for each in problem.some_contexts["run"].tolist()])
    there = np.array([session_of[each] for each in drawn.scene["run"].tolist()])
    readings = np.bincount(here, minlength=len(sessions))
    efficient = measured @ turned.T
    score = _sums(here, efficient, len(sessions))
    squares = (expected @ turned.T) ** 2
    many = np.maximum(np.bincount(there, minlength=len(sessions)), 1)[:, None]
    information = _sums(there, squares, len(sessions)) / many * readings[:, None]
    # What the other numbers explain nearly all of says nothing.
    own_information = (expected[:, places] ** 2).mean(axis=0) * len(problem.some)
    total = information.sum(axis=0)
    clear = (own_information > 0.0) & (total > rules.COLLINEAR * own_information)
    # Odds that ended at their bound are those of a kind of reading that hardly ever came: no number to compare.
    clear[: len(BASE_NUMBERS)] &= ~fit.held[: len(BASE_NUMBERS)]
    information = np.where(clear, information, 0.0)
    variance = np.maximum(_sums(here, efficient**2, len(sessions)), information)
    value = np.array([*values, *np.zeros(len(candidates))])
    scale = problem.scale
    return UnitScores(
        columns,
        tuple(sessions),
        np.asarray(readings * scale, dtype=np.intp),
        value,
        places < fitted,
        score * scale,
        information * scale,
        variance * scale,
        problem.untestable,
        messages,
    )


def compare(model: Model, task: tuple[Unit, Sequence[FleetTerm], Sequence[FleetTerm]]) -> list[Comparison]:
    """Refits of a unit with its terms and one more, each of the last ones in its turn."""
    unit, terms, tried = task
    problem, _ = _problem(model, unit)
    fit = _fit(problem, terms)
    found = []
    for term in tried:
        best = _with(problem, fit, term)
        gained = (best.log_likelihood - fit.log_likelihood) * problem.scale - candidate_of(term).cost_nats
        found.append(Comparison(term, float(gained), tuple(best.effects[-1].values.items())))
    return found


def _problem(model: Model, unit: Unit) -> tuple[Problem, tuple[str, ...]]:
    model, _ = with_least_weights(model)
    readings = read_readings([unit.dataset], model, sensors=(unit.sensor,), runs=unit.sessions)
    count = len(readings.data)
    if count < MIN_READINGS:
        raise UnusableError(f"{count} readings with a true range, and at least {MIN_READINGS} are needed")
    columns = dict(readings.data.columns)
    reading_cm = columns.pop("reading_cm")
    possible = np.isfinite(model.log_prob(reading_cm, columns))
    if possible.mean() < 1.0 - MAX_SHARE_LEFT_OUT:
        raise UnusableError(f"the model cannot give {100.0 * (1.0 - possible.mean()):.0f} % of the readings")
    rng = np.random.default_rng([unit.seed, zlib.crc32(unit.name.encode())])
    return Problem.of(model, columns, reading_cm, numbered(columns["run"]), rng), readings.messages


def _fit(problem: Problem, terms: Sequence[FleetTerm]) -> JointFit:
    """The joint fit of base and terms, which are added one after another."""
    fit = fit_base(problem.some)
    for term in terms:
        fit = _with(problem, fit, term)
    return fit


def _with(problem: Problem, fit: JointFit, term: FleetTerm) -> JointFit:
    """The joint fit with one more term, from where it is expected."""
    candidate = candidate_of(term)
    parameter = candidate.parameter
    small = FIRST_STEPS * parameter.step
    starts = [term.start] if abs(term.start) > parameter.step else [small, -small]
    starts = [start for start in starts if start > 0.0 or not candidate.one_sided] or [small]
    at = [float(np.clip(candidate.neutral + start, parameter.low, parameter.high)) for start in starts]
    return max((with_candidate(problem, fit, candidate, each) for each in at), key=lambda each: each.log_likelihood)


def _efficient(information: _Array, places: NDArray[np.intp], free: NDArray[np.intp]) -> _Array:
    """(C, numbers): from the scores of all numbers, the score of each of C less what the other free ones explain."""
    turned = np.zeros((places.size, information.shape[0]))
    turned[np.arange(places.size), places] = 1.0
    scale = np.sqrt(np.maximum(np.diag(information), 1e-12))
    scaled = information / np.outer(scale, scale)
    for k, place in enumerate(places.tolist()):
        others = free[free != place]
        inner = np.linalg.pinv(scaled[np.ix_(others, others)], rcond=1e-8, hermitian=True)
        turned[k, others] = -(scaled[place, others] @ inner) * scale[place] / scale[others]
    return turned


def _sums(unit: NDArray[np.intp], values: _Array, count: int) -> _Array:
    return np.stack([np.bincount(unit, column, count) for column in values.T], axis=1)
