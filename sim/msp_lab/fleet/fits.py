"""Readings and joint fits of one sensor of one vehicle, the latest of which are kept for the next question about it.

A `Unit` and the terms that it is known to have enter, its prepared readings and its fit leave. What is kept changes how
long an answer takes and nothing else, since each follows from what it is asked with.
"""

import pickle
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from msp_lab.fleet.terms import FleetTerm, candidate_of
from msp_lab.gap.intake import read_readings, with_least_weights
from msp_lab.gap.problem import Problem, with_candidate
from msp_lab.gap.refit import JointFit, fit_base
from msp_range.arrays import numbered
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


class UnusableError(UserError):
    """A sensor's readings cannot be compared; the message says why."""


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
    rng = np.random.default_rng([unit.seed, zlib.crc32(unit.name.encode())])
    return Problem.of(model, columns, reading_cm, numbered(columns["run"]), rng)


def fit_of(model: Model, unit: Unit, terms: Sequence[FleetTerm]) -> JointFit:
    """The joint fit of base and terms, which are added one after another."""
    return _fit(pickle.dumps(model), unit, tuple(terms))


@lru_cache(maxsize=KEPT_UNITS)
def _fit(pickled: bytes, unit: Unit, terms: tuple[FleetTerm, ...]) -> JointFit:
    problem = _problem(pickled, unit)
    return with_term(problem, _fit(pickled, unit, terms[:-1]), terms[-1]) if terms else fit_base(problem.readings)


def with_term(problem: Problem, fit: JointFit, term: FleetTerm) -> JointFit:
    """The joint fit with one more term, from where it is expected."""
    candidate = candidate_of(term)
    parameter = candidate.parameter
    small = FIRST_STEPS * parameter.step
    starts = [term.start] if abs(term.start) > parameter.step else [small, -small]
    starts = [start for start in starts if start > 0.0 or not candidate.one_sided] or [small]
    at = [float(np.clip(candidate.neutral + start, parameter.low, parameter.high)) for start in starts]
    return max((with_candidate(problem, fit, candidate, each) for each in at), key=lambda each: each.log_likelihood)
