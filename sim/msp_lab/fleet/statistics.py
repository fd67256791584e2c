"""Estimates of every vehicle, and the tests that are made of them.

Numbers by unit and session enter; estimates with standard errors, and logarithms of p-values leave. A session's
estimate scatters by its own error and by omega, by how much a number differs between sessions of one vehicle. omega is
common to the fleet: the value at which the median vehicle's sessions scatter as much as expected.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.stats import chi2, norm

from msp_lab.fleet.meta import MIN_ORDINARY, Pooled, pooled, where_one
from msp_lab.fleet.terms import FleetTerm, candidate_of
from msp_lab.fleet.unit import Sessions, UnitNumbers
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
    series: Sessions
    """Of which it is one."""

    @property
    def nats(self) -> float:
        """By how much the likelihood of its sessions grows [nat]."""
        return 0.5 * (self.size / self.error) ** 2


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
    """Mean, spread, and how far each unit is off."""

    def p_of(self, unit: int) -> float:
        """Logarithm of the p-value of a unit's deviation from the others; 0 if it has no such number."""
        return float(self.fleet.deviation_log_p[self.units == unit].min(initial=0.0))


def _series(units: Sequence[UnitNumbers]) -> dict[FleetTerm, dict[int, Sessions]]:
    """Every number by session, by the places of the units that have it."""
    found: dict[FleetTerm, dict[int, Sessions]] = {}
    for k, unit in enumerate(units):
        for term, sessions in unit.numbers:
            found.setdefault(term.anywhere, {})[k] = sessions
    return found


def numbers_of(units: Sequence[UnitNumbers]) -> dict[FleetTerm, Number]:
    """Every number that more than `MIN_ORDINARY` units have; a term starts nowhere here."""
    found = {}
    for term, of_units in _series(units).items():
        if len(of_units) <= MIN_ORDINARY:
            continue
        omega2 = between_sessions(list(of_units.values()))
        value, error = np.array([sessions.estimate(omega2) for sessions in of_units.values()]).T
        if not term.is_base and candidate_of(term).one_sided:
            # The variance of a share is in proportion to it: a small one is known no better than the others' would be.
            error *= np.sqrt(np.maximum(np.median(value) / np.maximum(value, error), 1.0))
        found[term] = Number(term, np.array(list(of_units)), value, error, float(np.sqrt(omega2)), pooled(value, error))
    return found


def changes_of(units: Sequence[UnitNumbers]) -> list[tuple[FleetTerm, int, Change]]:
    """Changes and drifts of the numbers of the base and of the effects that a unit was found to have."""
    found = []
    for term, of_units in _series(units).items():
        omega2 = between_sessions(list(of_units.values()))
        for unit, sessions in of_units.items():
            change = over_sessions(sessions, omega2)
            if change is not None and not term.sessions:
                found.append((term, unit, change))
    return found


def between_sessions(series: Sequence[Sessions]) -> float:
    """Variance of a number between sessions of one unit, common to the fleet."""
    several = [sessions for sessions in series if sessions.value.size >= 2]

    def ratio(omega2: float) -> float:
        each = [_squares(own.value, own.variance + omega2) / chi2.median(own.value.size - 1) for own in several]
        return float(np.median(each))

    return where_one(ratio, max(float(np.ptp(own.value)) ** 2 for own in several)) if several else 0.0


def _squares(value: Array, variance: Array) -> float:
    """Sum of squares about the weighted mean, over the variances."""
    mean = np.average(value, weights=1.0 / variance)
    return float(((value - mean) ** 2 / variance).sum())


def over_sessions(series: Sessions, omega2: float) -> Change | None:
    """The likeliest change or drift of one unit's number.

    Parameters
    ----------
    series
        Of its sessions, (R,).
    omega2
        Variance between sessions of one unit.

    Returns
    -------
    Change or None
        By weighted least squares, a step between two sessions for each place where one could be, and a straight line
        over the sessions' numbers. The place of the step that is the most standard errors is taken, and its p-value
        times the number of places (Bonferroni). None: there are too few sessions.
    """
    value = series.value
    if value.size < MIN_SESSIONS:
        return None
    places = np.arange(MIN_SIDE, value.size - MIN_SIDE + 1)
    shapes = np.vstack([np.arange(value.size) >= places[:, None], np.arange(value.size) / (value.size - 1.0)])
    weight = 1.0 / (series.variance + omega2)
    about = shapes - (shapes @ weight / weight.sum())[:, None]
    gained = about**2 @ weight
    size, error = about @ (weight * value) / gained, gained**-0.5
    log_p = np.log(2.0) + norm.logsf(np.abs(size / error)) + np.log(np.append(np.full(places.size, places.size), 1.0))
    k = int(np.argmin(log_p))
    found = float(size[k]), float(error[k]), min(float(log_p[k]), 0.0), series
    return Change("change", int(places[k]), *found) if k < places.size else Change("drift", 0, *found)
