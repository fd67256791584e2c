"""Joint maximum-likelihood refits of the base's numbers and of effects, within their bounds.

For prepared readings and effects it finds the values, their information and the log-likelihood. The maximiser is that
of the mixture's fit, with the outer product of the scores as information.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from msp_lab.gap import rules
from msp_lab.gap.prepared import BASE, ODDS_CHANNELS, ChannelSlopes, Prepared
from msp_lab.gap.shift_value import with_shifts
from msp_lab.mixture_fit.maximise import ROUNDS, held_numbers, maximise
from msp_range.arrays import Array, Flags, Indices
from msp_range.reading_model.rows import Base
from msp_sim.effects.base import Parameter
from msp_sim.model.history import MAX_CORRELATION
from msp_sim.model.model import Term
from msp_sim.model.rows import ModelRows

ENOUGH_NATS = 0.03
"""A fit that gains less in a step is done: a hundredth of what any decision asks."""
LEAST_SATURATED = 1e-4
"""The saturated share stays so far from 0 and 1, where its score is infinite."""


FIRST_CORRELATION = 0.2
"""A fit of correlated readings starts here: at 0 the slope by readings farther apart than the spacing is 0."""


class NumberSlopes(NamedTuple):
    """Derivatives by all numbers of a fit."""

    scores: Array
    """Score of each reading, (n, numbers), for errors by runs."""
    gradient: Array
    """Their sum, with that of the priors."""
    information: Array
    """From the scores and the priors."""
    held: Flags
    """Numbers that are at a bound, or of which the readings say nothing."""


@dataclass(frozen=True)
class JointFit:
    """A joint fit of base and effects."""

    base: Base
    """Change of the base's numbers."""
    effects: tuple[Term, ...]
    """Effects with their values."""
    log_likelihood: float
    """Sum over the readings, less what the priors take [nat]."""
    names: tuple[str, ...]
    values: Array
    bounds: tuple[Array, Array]
    """Names and values of the numbers that were free, and their bounds: ``base.offset_cm``, or ``k.parameter`` of the
    k-th effect."""
    here: ChannelSlopes
    """Slopes by channel at the fit."""
    slopes: Callable[[], NumberSlopes]
    """Computes the slopes by the numbers at the fit: most fits are compared by their likelihood alone."""

    @cached_property
    def at(self) -> NumberSlopes:
        """Slopes by the numbers at the fit."""
        return self.slopes()

    @property
    def offset_slope(self) -> Array:
        """Derivative of each reading's log probability by the base's offset, (n,)."""
        return self.here.by[:, 0]

    def covariance(self, unit: Indices | None = None) -> Array:
        """Covariance of the numbers; with units, from sums over whole units (sandwich)."""
        at, free = self.at, ~self.at.held
        covariance = np.zeros_like(at.information)
        of_free = np.linalg.pinv(at.information[np.ix_(free, free)], hermitian=True)
        if unit is not None:
            sums = sums_by(unit, at.scores[:, free])
            units = max(sums.shape[0], 2)
            of_free = of_free @ (sums.T @ sums * units / (units - 1)) @ of_free
        covariance[np.ix_(free, free)] = of_free
        return covariance


def inverse(information: Array) -> Array:
    """Inverse of an information matrix, its numbers first scaled alike; 0 for what the readings say nothing of."""
    scale = np.sqrt(np.maximum(np.diag(information), 1e-12))
    scales = np.outer(scale, scale)
    found: Array = np.linalg.pinv(information / scales, rcond=1e-8, hermitian=True) / scales
    return found


def sums_by(unit: Indices, scores: Array, units: int | None = None) -> Array:
    """Sums of the scores over units, shape (units, numbers); there are as many units as are numbered, unless given."""
    count = units or (int(unit.max()) + 1 if unit.size else 0)
    return np.stack([np.bincount(unit, column, count) for column in scores.T], axis=1)


def free_numbers(effects: Sequence[Term]) -> list[tuple[int, Parameter]]:
    """Numbers of these effects that a fit may move."""
    return [(k, parameter) for k, term in enumerate(effects) for parameter in term.effect.parameters]


def with_values(effects: Sequence[Term], numbers: Sequence[tuple[int, Parameter]], values: Array) -> tuple[Term, ...]:
    """Effects with these values of their numbers, which are as from `free_numbers`."""
    placed: list[dict[str, float]] = [{} for _ in effects]
    for (k, parameter), value in zip(numbers, values.tolist(), strict=True):
        placed[k][parameter.name] = value
    return tuple(map(Term.having, effects, placed))


def fit_base(prepared: Prepared) -> JointFit:
    """Refit the base alone, from the given model or from the readings' own median and spread, whichever ends better.

    At the given model the likelihood is flat where a reading is so far from its hit that it counts as random. With the
    readings' own spread hits are hits, and an effect can be found by its slope; the spread shrinks again in later fits
    once what widened it is named.
    """
    given = refit(prepared, [])
    start = _own_spread(prepared)
    if start is None:
        return given
    other = refit(prepared, [], start)
    return other if other.log_likelihood > given.log_likelihood else given


def _own_spread(prepared: Prepared) -> Base | None:
    """Offset and log spread of what looks like hits; None where they are near the model's."""
    rows, reading = prepared.rows, prepared.reading_cm
    window_cm, window_share = rules.HIT_WINDOW
    with np.errstate(invalid="ignore"):
        usual = has_range(rows, reading)
        usual &= np.abs(reading - rows.centre_cm) < window_cm + window_share * rows.centre_cm
    if usual.sum() < rules.MIN_HIT_SHARE * reading.size:
        return None
    off_cm = (reading - rows.centre_cm)[usual]
    sigma_cm = np.broadcast_to(rows.sigma_cm, reading.shape)[usual]
    middle_cm = float(np.median(off_cm))
    # Whole centimetres have a deviation of 0.3 cm, which is no spread.
    spread = 1.4826 * float(np.median(np.abs(off_cm - middle_cm) / np.maximum(sigma_cm, 0.3)))
    log_spread = np.log(max(spread, 1e-3))
    if not log_spread > rules.WIDE_LOG_SPREAD and abs(middle_cm) < 2.0 * float(np.median(sigma_cm)):
        return None
    return Base(middle_cm, max(log_spread, 0.0))


def has_range(rows: ModelRows, reading_cm: Array) -> Flags:
    """Readings within the sensor's limits that have a hit to be compared with, (n,)."""
    return (reading_cm > rows.minimum_cm) & (reading_cm < rows.maximum_cm) & np.isfinite(rows.centre_cm)


def refit(
    prepared: Prepared,
    effects: Sequence[Term],
    start: Base | None = None,
    rounds: int = ROUNDS,
    reported: bool = False,
) -> JointFit:
    """Fit base and effects together.

    Parameters
    ----------
    prepared
        Readings.
    effects
        Effects with the values where the search starts.
    start
        Of the base; the given model's unless given.
    rounds
        At most.
    reported
        Whether the fit is the one that is reported. In the search a spread far from the model's is something to
        explain, and a normal prior holds it; that of a reported one, ``log(1 + x^2 / (2 d^2))``, hardly holds it there.
    """
    effects = [_off_neutral(term) for term in effects]
    numbers = free_numbers(effects)
    nb = len(BASE)
    low, high = _bounds(prepared, numbers)
    if start is None:
        correlated = prepared.spacing_s is not None
        start = Base(correlation=max(FIRST_CORRELATION - _correlation(prepared), 0.0) if correlated else 0.0)
    of_numbers = np.array([rules.CURVE_PRECISION if _is_open_ended(effects[k], p) else 0.0 for k, p in numbers])
    spread = BASE.index("log_sigma")

    def placed(at: Array) -> tuple[Base, tuple[Term, ...]]:
        return Base(*at[:nb].tolist()), with_values(effects, numbers, at[nb:])

    def total(at: Array) -> tuple[float, ChannelSlopes]:
        here = prepared.slopes(*placed(at))
        taken = 0.5 * np.square(at[:nb] / np.array(rules.BASE_DEVIATION))
        if reported:
            taken[spread] = np.log1p(taken[spread])
        return float(here.log_p.sum() - taken.sum() - 0.5 * of_numbers @ at[nb:] ** 2), here

    def slopes(at: Array, here: ChannelSlopes) -> NumberSlopes:
        base, terms = placed(at)
        scores = np.column_stack([here.by, prepared.slopes_of(base, terms, here).T])
        variance = np.square(rules.BASE_DEVIATION)
        if reported:
            variance[spread] += 0.5 * base.log_sigma**2
        precision = np.concatenate([1.0 / variance, of_numbers])
        gradient = scores.sum(axis=0) - precision * at
        information = scores.T @ scores + np.diag(precision)
        return NumberSlopes(scores, gradient, information, held_numbers(at, gradient, information, low, high))

    shifts = np.array([False] * nb + [effects[k].effect.is_shift for k, _ in numbers])
    theta = np.concatenate([start, [effects[k].values[p.name] for k, p in numbers]])
    bounds = low, high
    climb = partial(maximise, total, lambda *given: slopes(*given)[1:3])
    at, best, here = climb(theta, bounds, ENOUGH_NATS, rounds)
    if rounds and shifts.any():
        own = with_shifts(prepared, *placed(at))
        theta = np.concatenate([at[:nb], [own[k].values[p.name] for k, p in numbers]])
        if np.any(theta != at):
            bounds = np.where(shifts, theta, low), np.where(shifts, theta, high)
            at, best, here = climb(theta, bounds, ENOUGH_NATS, rounds)
    names = tuple([f"base.{name}" for name in BASE] + [f"{k}.{p.name}" for k, p in numbers])
    return JointFit(*placed(at), best, names, at, bounds, here, partial(slopes, at, here))


def _correlation(prepared: Prepared) -> float:
    """Correlation of neighbouring hits, by the given model."""
    return 0.0 if prepared.rows.history is None else prepared.rows.history.correlation


def _bounds(prepared: Prepared, numbers: Sequence[tuple[int, Parameter]]) -> tuple[Array, Array]:
    """Bounds of the base's changes and of effects' numbers."""
    saturated, known = prepared.rows.saturated_fraction, _correlation(prepared)
    # A sensor that never reads 255 for no echo does not start to.
    of_codes = np.array([min(LEAST_SATURATED - saturated, 0.0), max(1.0 - LEAST_SATURATED - saturated, 0.0)])
    of_noise = np.array([-known, MAX_CORRELATION - known])
    widest = np.array(rules.BASE_BOUND)
    ends = np.stack([-widest, widest])
    ends[:, BASE.index("saturated")] = of_codes if saturated > 0.0 else 0.0
    ends[:, BASE.index("correlation")] = of_noise if prepared.spacing_s is not None else 0.0
    low, high = np.hstack([ends, np.array([[p.low, p.high] for _, p in numbers]).reshape(-1, 2).T])
    return low, high


def _is_open_ended(term: Term, number: Parameter) -> bool:
    """Whether no reading may hold a number: the value of a curve, and log odds where all readings are of one kind.

    Log odds of all readings alike are a number of the base, which has a prior of its own.
    """
    of_some = number.name == "log_odds" and set(term.effect.channels) <= set(ODDS_CHANNELS) and term.effect.base is None
    return term.shape is not None or of_some


def _off_neutral(term: Term) -> Term:
    """A share of exactly nothing has no shape: start a little away from it."""
    numbers = term.effect.parameters if term.shape is None else ()
    return term.having(
        {p.name: p.neutral + p.step for p in numbers if p.neutral is not None and term.values[p.name] == p.neutral}
    )
