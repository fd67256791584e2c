"""Numbers over a fleet: their mean and spread, which vehicles are odd in them, and which changed between sessions.

A session's estimate scatters by its own error and by omega, the standard deviation of a number between sessions of one
vehicle, which is common to the fleet.

Over the fleet ``b_u ~ N(mean, tau^2 + s_u^2)``, random-effects meta-analysis: s_u is the standard error of one
vehicle's estimate, tau the true standard deviation between vehicles, by Paule and Mandel. A vehicle is compared with
the others by Student's t, with a mean and tau that are computed without it; where errors are 0 that is the
leave-one-out t test. So that odd vehicles do not hide each other, the farthest is set aside, then the next one, and so
on; all are odd down to the last one that the remaining ones do not explain (generalized ESD; Rosner 1983, Technometrics
25:165).
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from msp_lab.estimates import PointsFit, fit_points
from msp_lab.fleet.terms import FleetTerm, candidate_of
from msp_lab.fleet.unit import Sessions, UnitNumbers
from msp_range.arrays import Array, Flags, Indices

MIN_OTHERS = 3
"""Mean and spread are computed from at least this many vehicles: of two nobody could say which is the odd one."""
ASIDE_LOG_P = float(np.log(0.0005))
"""Vehicles down to the last one that the others predict with this probability or less are left out of mean and spread.
Lower: of three vehicles that differ, one that just misses the limit widens the spread until none is odd; in a simulated
fleet its p-value was 0.0003, and the limit 0.00025. Higher: ordinary vehicles are left out, and the spread is too
small."""
MIN_SESSIONS = 4
"""Changes are looked for in vehicles with at least this many sessions: two before and two after. Fewer: a single flight
is a change."""
MIN_SIDE = 2
"""Sessions before and after a change. One flight that differs is no change of the vehicle."""
MIN_GROUP = 2
"""Vehicles inside and outside of a group. One alone is compared as a vehicle."""
WITHOUT_ONE_LOG_P = float(np.log(0.01))
"""A group differs with this probability or less without any one of its vehicles too. Higher: of a group of two the one
that is odd makes both differ. Lower: groups of three are missed."""


class Group(NamedTuple):
    """Vehicles of which a column has the same word all over, which others do not have."""

    name: str
    """Columns and words: of several that say the same, all of them."""
    units: frozenset[int]
    """Indices of the units."""


@dataclass(frozen=True)
class Apart:
    """How far a group is from the others in a number."""

    group: Group
    size: float
    """Mean of the group less that of the others."""
    log_p: float
    """Logarithm of its two-sided p-value."""


@dataclass(frozen=True)
class Pooled:
    """A fleet's estimate of one number."""

    mean: float
    error: float
    """Mean of the ordinary vehicles, and its standard error."""
    tau: float
    """Standard deviation between the ordinary vehicles."""
    i2: float
    """Share of the scatter of their estimates that is not the estimates' own error (Higgins & Thompson 2002)."""
    log_p: float
    """Logarithm of the two-sided p-value of a mean of 0."""
    odd: Flags
    """Which vehicles are odd, (units,)."""
    deviation_log_p: Array
    """Logarithms of the two-sided p-values of each vehicle's deviation from the ordinary others, (units,)."""


@dataclass(frozen=True)
class Change:
    """The likeliest change of a number, or its drift, over the sessions of one unit."""

    kind: Literal["change", "drift"]
    """``change`` or ``drift``."""
    first: int
    """Place of the first session after a change."""
    size: float
    error: float
    """Size of the change with its standard error: after minus before; for a drift last session minus first."""
    log_p: float
    """Logarithm of its p-value, with the search for the place counted."""

    @property
    def nats(self) -> float:
        """By how much the likelihood of its sessions grows [nat]."""
        return 0.5 * (self.size / self.error) ** 2


@dataclass(frozen=True)
class Number:
    """One number over the fleet."""

    term: FleetTerm
    """The effect and parameter, or number of the base, that it is."""
    units: Indices
    """Indices of the units that have it, (k,)."""
    series: tuple[Sessions, ...]
    """Estimates by session of each of these units."""
    value: Array
    error: Array
    """Estimates and standard errors, (k,)."""
    omega: float
    """Standard deviation between sessions of one unit."""
    fleet: Pooled
    """Mean, spread, and how far each unit is off; of a group that is apart, from what the others and that predict."""
    apart: Apart | None = None
    """The group that is apart; None: none."""

    @property
    def odd(self) -> frozenset[int]:
        """Indices of the odd units."""
        return frozenset(self.units[self.fleet.odd].tolist())

    @property
    def shift(self) -> Array:
        """By how much each unit is apart with its group, (k,)."""
        return shift_of(self.apart, self.units)

    def changes(self) -> dict[int, Change]:
        """The likeliest change or drift of each unit that has sessions enough."""
        found = {
            unit: over_sessions(sessions, self.omega**2)
            for unit, sessions in zip(self.units.tolist(), self.series, strict=True)
        }
        return {unit: change for unit, change in found.items() if change is not None}


def groups_of(units: Sequence[UnitNumbers], vehicles: Sequence[str]) -> tuple[Group, ...]:
    """Groups of vehicles by the columns that have one word in all readings of each vehicle.

    Parameters
    ----------
    units, vehicles
        Numbers and vehicle of each unit.
    """
    words = [dict(unit.words) for unit in units]
    names: dict[frozenset[int], list[str]] = {}
    for column in sorted(set.intersection(*map(set, words))):
        own = [word[column] for word in words]
        by_vehicle = dict(zip(vehicles, own, strict=True))
        if any(by_vehicle[vehicle] != word for vehicle, word in zip(vehicles, own, strict=True)):
            continue
        counts = Counter(by_vehicle.values())
        # Of two words both say the same: the one of fewer vehicles.
        for word in sorted(counts, key=counts.__getitem__)[: 1 if len(counts) == 2 else None]:
            if MIN_GROUP <= counts[word] <= len(by_vehicle) - MIN_GROUP:
                inside = frozenset(k for k, each in enumerate(own) if each == word)
                names.setdefault(inside, []).append(f"{column} {word}")
    return tuple(Group(" or ".join(name), inside) for inside, name in names.items())


def shift_of(apart: Apart | None, units: Indices) -> Array:
    """By how much units are apart with their group, (k,)."""
    size, inside = (0.0, frozenset[int]()) if apart is None else (apart.size, apart.group.units)
    return np.where(np.isin(units, list(inside)), size, 0.0)


def numbers_of(
    units: Sequence[UnitNumbers], level: float, vehicles: Sequence[str] = (), groups: Sequence[Group] = ()
) -> dict[FleetTerm, Number]:
    """Every number that more than `MIN_OTHERS` units have. Terms that differ only in where their fits start are one.

    Parameters
    ----------
    units
        Their numbers.
    level
        Logarithm of the p-value that an odd unit, or a group, has at most.
    vehicles
        Of each unit; needed with groups.
    groups
        Of these vehicles.
    """
    series: dict[FleetTerm, dict[int, Sessions]] = {}
    for k, unit in enumerate(units):
        for term, sessions in unit.numbers:
            series.setdefault(term.anywhere, {})[k] = sessions
    return {term: _number(term, of, level, vehicles, groups) for term, of in series.items() if len(of) > MIN_OTHERS}


def _number(
    term: FleetTerm, of_units: dict[int, Sessions], level: float, vehicles: Sequence[str], groups: Sequence[Group]
) -> Number:
    series = tuple(of_units.values())
    omega2 = between_sessions(series)
    value, error = np.array([sessions.estimate(omega2) for sessions in series]).T
    if not term.is_base and candidate_of(term).linear:
        # The variance of a share is in proportion to it: a small one is known no better than the others' would be.
        error *= np.sqrt(np.maximum(np.median(value) / np.maximum(value, error), 1.0))
    units = np.array(list(of_units))
    own = [vehicles[k] for k in units] if groups else []
    every = (apart_of(value, error, units, own, group, level) for group in groups)
    apart = min((one for one in every if one.log_p <= level), key=lambda one: one.log_p, default=None)
    fleet = pooled(value - shift_of(apart, units), error, level)
    return Number(term, units, series, value, error, float(np.sqrt(omega2)), fleet, apart)


def apart_of(
    values: Array, errors: Array, units: Indices, vehicles: Sequence[str], group: Group, level: float
) -> Apart:
    """How far a group is from the others, by Student's t over vehicles, with the spread that both have.

    Vehicles that are odd next to their group's median are left out.

    Parameters
    ----------
    values, errors, units, vehicles
        Of the units that have the number, (k,).
    group
        Vehicles.
    level
        Logarithm of the p-value that an odd unit has at most.
    """
    _, of = np.unique(vehicles, return_inverse=True)
    count = np.bincount(of)
    value, error = np.bincount(of, values) / count, np.sqrt(np.bincount(of, errors**2)) / count
    inside = np.bincount(of, np.isin(units, list(group.units))) > 0.0
    if not _has_both(inside):
        return Apart(group, 0.0, 0.0)
    middle = np.where(inside, np.median(value[inside]), np.median(value[~inside]))
    ordinary = ~pooled(value - middle, error, level).odd
    value, error, inside = value[ordinary], error[ordinary], inside[ordinary]
    if not _has_both(inside):
        return Apart(group, 0.0, 0.0)
    size, log_p = _difference(value, error, inside)
    others = (np.arange(value.size) != k for k in np.flatnonzero(inside))
    sure = max(_difference(value[k], error[k], inside[k])[1] for k in others) <= WITHOUT_ONE_LOG_P
    return Apart(group, size, log_p if sure else 0.0)


def _has_both(inside: Flags) -> bool:
    """Whether enough vehicles are inside and outside."""
    return bool(min(inside.sum(), (~inside).sum()) >= MIN_GROUP)


def _difference(values: Array, errors: Array, inside: Flags) -> tuple[float, float]:
    """Difference of the means inside and outside, and the logarithm of its p-value."""
    fit = _fit(values, errors, np.column_stack([np.ones(values.size), inside]))
    return float(fit.coefficients[1]), _log_p(fit.coefficients[1] / np.sqrt(fit.covariance[1, 1]), fit.freedom)


def pooled(values: Array, errors: Array, level: float) -> Pooled:
    """Mean and spread of the ordinary vehicles, and how far each vehicle is off.

    Parameters
    ----------
    values, errors
        (units,), all known; four or more.
    level
        Logarithm of the p-value that an odd vehicle has at most. Less than half of them can be odd.
    """
    left = ordinary = np.arange(values.size)
    while 2 * (left.size - 1) > values.size and left.size > MIN_OTHERS:
        fit = _fit(values[left], errors[left])
        off = np.abs(values[left] - fit.coefficients[0]) / np.sqrt(errors[left] ** 2 + fit.between)
        far = left[off.argmax()]
        left = left[left != far]
        if left_out(values, errors, left, far) <= max(level, ASIDE_LOG_P):
            ordinary = left
    # One that is far off with a large error may be set aside before those that are odd, and belong.
    deviation_log_p = np.array([left_out(values, errors, ordinary, k) for k in range(values.size)])
    values, errors = values[ordinary], errors[ordinary]
    fit = _fit(values, errors)
    mean, error = float(fit.coefficients[0]), float(np.sqrt(fit.covariance[0, 0]))
    q = float((((values - np.average(values, weights=errors**-2)) / errors) ** 2).sum())
    i2 = max(0.0, 1.0 - fit.freedom / q) if q > 0.0 else 0.0
    log_p = _log_p(mean / error, fit.freedom)
    return Pooled(mean, error, float(np.sqrt(fit.between)), i2, log_p, deviation_log_p <= level, deviation_log_p)


def left_out(values: Array, errors: Array, others: Indices, k: int) -> float:
    """Logarithm of the two-sided p-value of a vehicle's deviation from what the others, without it, predict.

    The prediction's variance is the vehicle's own, that between vehicles, and that of the mean.
    """
    others = others[others != k]
    fit = _fit(values[others], errors[others])
    error = np.sqrt(errors[k] ** 2 + fit.between + fit.covariance[0, 0])
    return _log_p((values[k] - fit.coefficients[0]) / error, fit.freedom)


def _log_p(t: float, freedom: int) -> float:
    """Logarithm of the two-sided p-value of Student's t."""
    return min(float(np.log(2.0) + student.logsf(abs(t), freedom)), 0.0)


def _fit(values: Array, errors: Array, design: Array | None = None) -> PointsFit:
    """Mean, or what else the design says, and variance between vehicles, fitted in units of the scatter, since numbers
    of effects may be of any magnitude."""
    size = max(float(np.std(values)), float(np.median(errors)))
    fit = fit_points(np.ones((values.size, 1)) if design is None else design, values / size, (errors / size) ** 2)
    return PointsFit(fit.coefficients * size, fit.covariance * size**2, fit.between * size**2, fit.freedom)


def shrunk(values: Array, errors: Array, fleet: Pooled) -> tuple[Array, Array]:
    """Each vehicle's estimate drawn towards the fleet's mean, and its standard error (empirical Bayes).

    An ordinary vehicle is worth ``(b / s^2 + mean / tau^2) / (1 / s^2 + 1 / tau^2)``. The uncertainty of the mean is
    counted (Morris 1983, J. Am. Stat. Assoc. 78:47). An odd vehicle keeps its own estimate.
    """
    own = np.where(fleet.odd, 1.0, fleet.tau**2 / (fleet.tau**2 + errors**2))
    error = np.sqrt(own * errors**2 + (1.0 - own) ** 2 * fleet.error**2)
    return own * values + (1.0 - own) * fleet.mean, error


def between_sessions(series: Sequence[Sessions]) -> float:
    """Variance of a number between sessions of one unit, common to the fleet: that of the median unit, if any has two.

    It is not moved by a few that changed.
    """
    several = [_fit(own.value, np.sqrt(own.variance)).between for own in series if own.value.size >= 2]
    return float(np.median(several)) if several else 0.0


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
    found = float(size[k]), float(error[k]), min(float(log_p[k]), 0.0)
    return Change("change", int(places[k]), *found) if k < places.size else Change("drift", 0, *found)
