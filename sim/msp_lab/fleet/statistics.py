"""Estimates of every vehicle from the scores of its sessions, and the tests that are made of them.

Scores by unit and session enter; estimates with standard errors, and logarithms of p-values leave. A session's estimate
scatters by its own error and by omega, by how much a number differs between sessions of one vehicle. omega is common to
the fleet: the value at which the median vehicle's sessions scatter as much as expected.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from scipy.stats import chi2, norm

from msp_lab.fleet.meta import MIN_ORDINARY, Pooled, left_out, pooled, where_one
from msp_lab.fleet.terms import FleetTerm, candidate_of
from msp_lab.fleet.unit import UnitScores
from msp_range.arrays import Array, Indices

MIN_SESSIONS = 4
"""A change is asked of vehicles with so many sessions: two on each side. Fewer: a single flight is a change."""
MIN_SIDE = 2
"""Sessions before and after a change. One flight that differs is no change of the vehicle."""


@dataclass(frozen=True)
class Change:
    """The likeliest change of a number, or its drift, over the sessions of one unit."""

    kind: Literal["change", "drift"]
    """``change`` or ``drift``."""
    first: int
    """Place of the first session after a change."""
    size: float
    error: float
    """By how much the number is larger after it, or a drift's rise from the first session to the last."""
    log_p: float
    """Logarithm of its p-value, with the search for the place counted."""

    @property
    def nats(self) -> float:
        """By how much the likelihood of its sessions grows [nat]."""
        return 0.5 * (self.size / self.error) ** 2


class Deviation(NamedTuple):
    """How one number of a unit deviates from the others', or that of the fleet from nothing."""

    log_p: float
    """Logarithm of its p-value."""
    term: FleetTerm
    """The number."""
    unit: int
    """Place of the unit."""
    value: float
    """Its estimate."""


@dataclass(frozen=True)
class Number:
    """One number over the fleet."""

    term: FleetTerm
    """What it is."""
    units: Indices
    """Places of the units that have it, (k,)."""
    value: Array
    error: Array
    """Estimates and standard errors, (k,)."""
    omega: float
    """Standard deviation between sessions of one unit."""
    fleet: Pooled
    """Mean and spread."""
    log_p: Array
    """Logarithms of the p-values of each unit's deviation from the others, (k,)."""

    @property
    def deviations(self) -> list[Deviation]:
        """That of each unit."""
        of_units = zip(self.log_p.tolist(), self.units.tolist(), self.value.tolist(), strict=True)
        return [Deviation(log_p, self.term, unit, value) for log_p, unit, value in of_units]

    @property
    def shared_log_p(self) -> float:
        """Of a mean of 0; less than nothing of a share is random variation."""
        return 0.0 if _one_sided(self.term) and self.fleet.mean < 0.0 else self.fleet.log_p


@dataclass(frozen=True)
class NumberOverSessions:
    """One number of several units, by session: of each unit the sums of scores, their information and variance."""

    term: FleetTerm
    units: tuple[int, ...]
    value: Array
    score: tuple[Array, ...]
    information: tuple[Array, ...]
    variance: tuple[Array, ...]


def series_of(scores: Sequence[UnitScores], fitted: bool = False) -> list[NumberOverSessions]:
    """Every number with the units that say something of it; or only those that are fitted."""
    places: dict[FleetTerm, list[tuple[int, int]]] = {}
    for k, each in enumerate(scores):
        total = each.information.sum(axis=0)
        for j, term in enumerate(each.terms):
            if total[j] > 0.0 and (each.fitted[j] or not fitted):
                places.setdefault(replace(term, start=0.0), []).append((k, j))
    return [
        NumberOverSessions(
            term,
            tuple(k for k, _ in where),
            np.array([scores[k].value[j] for k, j in where]),
            tuple(scores[k].score[:, j] for k, j in where),
            tuple(scores[k].information[:, j] for k, j in where),
            tuple(scores[k].variance[:, j] for k, j in where),
        )
        for term, where in places.items()
    ]


def numbers_of(scores: Sequence[UnitScores]) -> list[Number]:
    """Every number that more than `MIN_ORDINARY` units have."""
    return [_number(each) for each in series_of(scores) if len(each.units) > MIN_ORDINARY]


def changes_of(scores: Sequence[UnitScores]) -> list[tuple[FleetTerm, int, Change]]:
    """Changes and drifts of the numbers of the base and of the effects that a unit was found to have."""
    found = []
    for each in series_of(scores, fitted=True):
        if each.term.sessions:
            continue
        omega2 = between_sessions(each)
        for unit, score, information, variance in zip(
            each.units, each.score, each.information, each.variance, strict=True
        ):
            change = over_sessions(score, information, variance, omega2)
            if change is not None:
                found.append((each.term, unit, change))
    return found


def _one_sided(term: FleetTerm) -> bool:
    return not term.is_base and candidate_of(term).one_sided


def _number(series: NumberOverSessions) -> Number:
    omega2 = between_sessions(series)
    total = np.array([each.sum() for each in series.information])
    value = series.value + np.array([each.sum() for each in series.score]) / total
    variance = np.array([(v + omega2 * i**2).sum() for v, i in zip(series.variance, series.information, strict=True)])
    error = np.sqrt(variance) / total
    fleet = pooled(value, error)
    deviation, log_p = left_out(value, error, fleet, series.term.is_base)
    if _one_sided(series.term) and fleet.mean < 2.0 * fleet.error:
        # Of what the fleet does not have, more than the fleet's is more than nothing; and less than nothing is random.
        deviation = np.clip(value / error, 0.0, np.maximum(deviation, 0.0))
        log_p = np.where(deviation > 0.0, np.maximum(log_p, norm.logsf(deviation)), 0.0)
    units = np.array(series.units)
    return Number(series.term, units, value, error, float(np.sqrt(omega2)), fleet, log_p)


def between_sessions(series: NumberOverSessions) -> float:
    """Variance of a number between sessions of one unit, common to the fleet."""
    groups = [
        (s - i * s.sum() / i.sum(), i, v)
        for s, i, v in zip(series.score, series.information, series.variance, strict=True)
        if (i > 0.0).sum() >= 2
    ]
    if not groups:
        return 0.0
    usual = np.array([chi2.median((i > 0.0).sum() - 1) for _, i, _ in groups])

    def ratio(omega2: float) -> float:
        sums = [float((left[i > 0.0] ** 2 / (v + omega2 * i**2)[i > 0.0]).sum()) for left, i, v in groups]
        return float(np.median(np.array(sums) / usual))

    return where_one(ratio, max(float((left[i > 0.0] ** 2 / i[i > 0.0] ** 2).max()) for left, i, _ in groups))


def over_sessions(score: Array, information: Array, variance: Array, omega2: float) -> Change | None:
    """The likeliest change or drift of one unit's number.

    Parameters
    ----------
    score, information, variance
        Of its sessions, (R,).
    omega2
        Variance between sessions.

    Returns
    -------
    Change or None
        A change from one session on makes the scores' sum after it differ from its share of the whole: with h the share
        of the information after it, ``D = sum_after U - h sum U`` has the variance ``(1 - h)^2 V_after + h^2 V_before``
        (a CUSUM; Page 1955, Biometrika 42:523). The place where D is the most standard errors is taken, and its p-value
        times the number of places (Bonferroni). A drift is the same with the sessions' numbers in place of 0 and 1.
        None: there are too few sessions.
    """
    known = np.flatnonzero(information > 0.0)
    if known.size < MIN_SESSIONS:
        return None
    score, information = score[known], information[known]
    spread = variance[known] + omega2 * information**2
    places = np.arange(MIN_SIDE, known.size - MIN_SIDE + 1)
    shapes = [(np.arange(known.size) >= place).astype(float) for place in places]
    shapes.append(np.arange(known.size) / (known.size - 1.0))
    size, error = np.zeros(len(shapes)), np.ones(len(shapes))
    for k, shape in enumerate(shapes):
        about = shape - float(information @ shape) / information.sum()
        gained = float(information @ about**2)
        size[k], error[k] = float(about @ score) / gained, np.sqrt(float(about**2 @ spread)) / gained
    z = np.abs(size / error)
    log_p = np.log(2.0) + norm.logsf(z) + np.log(np.append(np.full(places.size, places.size), 1.0))
    k = int(np.argmin(log_p))
    found = float(size[k]), float(error[k]), min(float(log_p[k]), 0.0)
    return Change("change", int(known[places[k]]), *found) if k < places.size else Change("drift", 0, *found)
