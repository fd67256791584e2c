"""One number over the fleet, and its change over the sessions of one vehicle.

Estimates of every sensor enter; means, spreads and logarithms of p-values leave. A session's estimate scatters by its
own error and by omega, by how much a number differs between sessions of one vehicle. omega is common to the fleet: that
of the median vehicle.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.stats import norm

from msp_lab.fleet.meta import MIN_ORDINARY, Pooled, Spread, pooled
from msp_lab.fleet.terms import FleetTerm
from msp_lab.fleet.unit import UnitEstimates
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


@dataclass(frozen=True)
class Number:
    """One number over the fleet."""

    term: FleetTerm
    """What it is."""
    units: Indices
    """Places of the units whose readings say something of it, (k,)."""
    value: Array
    error: Array
    """Estimates and standard errors, (k,)."""
    omega: float
    """Standard deviation between sessions of one unit."""
    changes: tuple[Change | None, ...]
    """The likeliest change of each unit, (k,)."""
    fleet: Pooled
    """Mean and spread, and each unit against the others."""


def number_of(estimates: Sequence[UnitEstimates], term: FleetTerm, odd: Sequence[int] = ()) -> Number | None:
    """A number over the fleet; None where no more than `MIN_ORDINARY` units have it.

    The units `odd` are compared with the others; where there are none, odd ones are found from the number itself.
    """
    places = {k: each.terms.index(term) for k, each in enumerate(estimates) if term in each.terms}
    places = {k: j for k, j in places.items() if np.isfinite(estimates[k].error[j])}
    if len(places) <= MIN_ORDINARY:
        return None
    value, error = (
        np.array([getattr(estimates[k], name)[j] for k, j in places.items()]) for name in ("value", "error")
    )
    sessions = [(estimates[k].session_value[:, j], estimates[k].session_error[:, j]) for k, j in places.items()]
    omega = between_sessions(sessions)
    changes = tuple(over_sessions(*each, omega) for each in sessions)
    units = np.array(list(places))
    fleet = pooled(value, error, np.isin(units, odd) if odd else None)
    return Number(term, units, value, error, omega, changes, fleet)


def between_sessions(sessions: Sequence[tuple[Array, Array]]) -> float:
    """Standard deviation of a number between sessions of the median unit."""
    found = [Spread.of(value, error).best_tau for value, error in sessions if value.size > 1 and np.isfinite(error[0])]
    return float(np.median(found)) if found else 0.0


def over_sessions(value: Array, error: Array, omega: float) -> Change | None:
    """The likeliest change or drift of one unit's number.

    Parameters
    ----------
    value, error
        Its estimates by session, and their standard errors, (R,).
    omega
        Standard deviation between sessions.

    Returns
    -------
    Change or None
        A change from one session on is the slope of the estimates over 0 before it and 1 after it, by weighted least
        squares; the place where it is the most standard errors is taken, and its p-value times the number of places
        (Bonferroni). A drift is the slope over the sessions' numbers. None: there are too few sessions, or a share is
        held at 0.
    """
    if value.size < MIN_SESSIONS or not np.isfinite(error).all():
        return None
    session = np.arange(value.size)
    places = np.arange(MIN_SIDE, value.size - MIN_SIDE + 1)
    shapes = np.vstack([session >= places[:, None], session / (value.size - 1.0)])
    weight = 1.0 / (error**2 + omega**2)
    about = shapes - (shapes @ weight / weight.sum())[:, None]
    information = about**2 @ weight
    size = about @ (weight * value) / information
    tries = np.append(np.full(places.size, places.size), 1)
    log_p = np.log(2.0 * tries) + norm.logsf(np.abs(size) * np.sqrt(information))
    k = int(np.argmin(log_p))
    found = float(size[k]), float(information[k] ** -0.5), min(float(log_p[k]), 0.0)
    return Change("change", int(places[k]), *found) if k < places.size else Change("drift", 0, *found)
