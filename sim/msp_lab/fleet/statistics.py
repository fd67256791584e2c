"""Estimates of every vehicle, and the tests that are made of them.

Numbers by unit and session enter; estimates with standard errors, and logarithms of p-values leave. A session's
estimate scatters by its own error and by omega, by how much a number differs between sessions of one vehicle. omega is
common to the fleet: the value at which the median vehicle's sessions scatter as much as expected.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

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
    mean: float
    """That of the fleet."""


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

    @property
    def deviations(self) -> list[Deviation]:
        """That of each unit."""
        of_units = zip(self.fleet.deviation_log_p.tolist(), self.units.tolist(), self.value.tolist(), strict=True)
        return [Deviation(log_p, self.term, unit, value, self.fleet.mean) for log_p, unit, value in of_units]


def series_of(units: Sequence[UnitNumbers]) -> dict[FleetTerm, list[tuple[int, Sessions]]]:
    """Every number that is fitted, by session, with the places of the units in which it is."""
    found: dict[FleetTerm, list[tuple[int, Sessions]]] = {}
    for k, unit in enumerate(units):
        for term, sessions in unit.over_sessions():
            found.setdefault(replace(term, start=0.0), []).append((k, sessions))
    return found


def _one_sided(term: FleetTerm) -> bool:
    return not term.is_base and candidate_of(term).one_sided


def numbers_of(units: Sequence[UnitNumbers]) -> list[Number]:
    """Every number that more than `MIN_ORDINARY` units have."""
    places: dict[FleetTerm, list[tuple[int, int]]] = {}
    for k, unit in enumerate(units):
        for j in np.flatnonzero(np.isfinite(unit.error)).tolist():
            places.setdefault(replace(unit.terms[j], start=0.0), []).append((k, j))
    series = series_of(units)
    found = []
    for term, where in places.items():
        if len(where) <= MIN_ORDINARY:
            continue
        fitted = dict(series.get(term, ()))
        omega2 = between_sessions(list(fitted.values()))
        shares = [float((fitted[k].share ** 2).sum()) if k in fitted else 0.0 for k, _ in where]
        value = np.array([units[k].value[j] for k, j in where])
        error = np.sqrt([units[k].error[j] ** 2 + omega2 * share for (k, j), share in zip(where, shares, strict=True)])
        if fitted and _one_sided(term):
            # The variance of a share is in proportion to it: a small one is known no better than the others' would be.
            error *= np.sqrt(np.maximum(np.median(value) / np.maximum(value, error), 1.0))
        fleet = pooled(value, error)
        found.append(Number(term, np.array([k for k, _ in where]), value, error, float(np.sqrt(omega2)), fleet))
    return found


def changes_of(units: Sequence[UnitNumbers]) -> list[tuple[FleetTerm, int, Change]]:
    """Changes and drifts of the numbers of the base and of the effects that a unit was found to have."""
    found = []
    for term, of_units in series_of(units).items():
        if term.sessions:
            continue
        omega2 = between_sessions([sessions for _, sessions in of_units])
        for unit, sessions in of_units:
            change = over_sessions(sessions.value, sessions.variance + omega2)
            if change is not None:
                found.append((term, unit, change))
    return found


def between_sessions(series: Sequence[Sessions]) -> float:
    """Variance of a number between sessions of one unit, common to the fleet."""
    several = [sessions for sessions in series if sessions.value.size >= 2]
    if not several:
        return 0.0
    usual = np.array([chi2.median(sessions.value.size - 1) for sessions in several])

    def ratio(omega2: float) -> float:
        return float(np.median([_squares(sessions.value, sessions.variance + omega2) for sessions in several] / usual))

    return where_one(ratio, max(float(np.ptp(sessions.value)) ** 2 for sessions in several))


def _squares(value: Array, variance: Array) -> float:
    """Sum of squares about the weighted mean, over the variances."""
    mean = np.average(value, weights=1.0 / variance)
    return float(((value - mean) ** 2 / variance).sum())


def over_sessions(value: Array, variance: Array) -> Change | None:
    """The likeliest change or drift of one unit's number.

    Parameters
    ----------
    value, variance
        Of its sessions, (R,).

    Returns
    -------
    Change or None
        By weighted least squares, a step between two sessions for each place where one could be, and a straight line
        over the sessions' numbers. The place of the step that is the most standard errors is taken, and its p-value
        times the number of places (Bonferroni). None: there are too few sessions.
    """
    if value.size < MIN_SESSIONS:
        return None
    places = np.arange(MIN_SIDE, value.size - MIN_SIDE + 1)
    shapes = np.vstack([np.arange(value.size) >= places[:, None], np.arange(value.size) / (value.size - 1.0)])
    weight = 1.0 / variance
    about = shapes - (shapes @ weight / weight.sum())[:, None]
    gained = about**2 @ weight
    size, error = about @ (weight * value) / gained, gained**-0.5
    log_p = np.log(2.0) + norm.logsf(np.abs(size / error)) + np.log(np.append(np.full(places.size, places.size), 1.0))
    k = int(np.argmin(log_p))
    found = float(size[k]), float(error[k]), min(float(log_p[k]), 0.0)
    return Change("change", int(places[k]), *found) if k < places.size else Change("drift", 0, *found)
