"""Random-effects meta-analysis: the mean over a fleet, the spread between its vehicles, and who does not belong.

Estimates with their standard errors enter. The model is ``b_u ~ N(mean, tau^2 + s_u^2)``: s_u is what one vehicle's
readings leave open, tau is by how much vehicles really differ. With a flat prior of the mean its likelihood in tau
alone is that of REML (Harville 1974, Biometrika 61:383), here on a grid; its largest value gives the tau that is
reported. A p-value is the mean over tau, by that likelihood and Jeffreys' prior: it knows by itself how little few
vehicles say about their spread. With estimates that have no errors it is Student's t.

Mean and spread are those of the ordinary vehicles, for a few odd ones would otherwise widen the spread until they look
ordinary themselves. These are found from the median, which half of the vehicles cannot move, and the rest is done
without the others (a one-step reweighted estimate: Rousseeuw & Leroy 1987, Robust Regression and Outlier Detection).
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp
from scipy.stats import median_abs_deviation, norm

from msp_range.arrays import Array, Flags

TAU_GRID = np.geomspace(1e-3, 1e2, 400)
"""Spreads at which the likelihood is computed, as shares of the estimates' own scatter and error. Finer: slower, and
tau is reported to less than its present 3 %; narrower: p-values of 1e-5 lose the tail that makes them."""
FIRST_DEVIATIONS = 3.3
"""Within so many deviations of the median, by the median deviation, a vehicle counts as ordinary at first. Anything
from 3 to 5 gives the same p-values where all are alike; of three odd ones among 20 that are 7 spreads off 78 % are
found, at 4.4 62 %."""
ORDINARY_P = 1e-4
"""A vehicle is ordinary if the others predict one so far off with a larger probability, 5 deviations in a fleet of 20.
In 60,000 drawn fleets of 20 without odd vehicles a p-value of 1e-4 then came 1.07 times as often as it should; at 0.003
three times, as mild ones are left out of a spread that is theirs. Lower: odd vehicles hide behind the spread that they
make."""
MIN_ORDINARY = 3
"""Mean and spread are from at least so many vehicles: of two nobody could say which is the odd one."""
TURNS = 10
"""Times at most that vehicles are sorted into ordinary and odd ones; it takes two or three."""


@dataclass(frozen=True)
class Spread:
    """What some estimates say about the spread that they come from."""

    tau: Array
    """The grid, (k,)."""
    mean: Array
    error: Array
    """Mean at each tau, and its standard error, (k,)."""
    best: int
    """Place of the likeliest tau."""
    log_weight: Array
    """Logarithm of the share of each tau in a p-value, (k,)."""

    @classmethod
    def of(cls, values: Array, errors: Array) -> "Spread":
        """Of estimates and their standard errors, two or more."""
        size = max(float(np.hypot(values.std(), np.median(errors))), 1e-12)
        tau = np.append(0.0, size * TAU_GRID) if (errors > 0.0).all() else size * TAU_GRID
        variance = errors**2 + tau[:, None] ** 2
        weight = 1.0 / variance
        total = weight.sum(axis=1)
        mean = weight @ values / total
        squares = (weight * (values - mean[:, None]) ** 2).sum(axis=1)
        log_likelihood = -0.5 * (np.log(variance).sum(axis=1) + np.log(total) + squares)
        with np.errstate(divide="ignore"):
            # Jeffreys' prior, tau times the root, with the width of each step of the grid, which is a share of tau.
            log_weight = log_likelihood + 2.0 * np.log(tau) + 0.5 * np.log((weight**2).sum(axis=1))
        return cls(tau, mean, total**-0.5, int(log_likelihood.argmax()), log_weight - logsumexp(log_weight))

    @property
    def best_tau(self) -> float:
        """The likeliest tau."""
        return float(self.tau[self.best])

    def log_p(self, value: float, deviation: Array) -> float:
        """Logarithm of the two-sided p-value of a value that has this deviation from the mean at each tau, (k,)."""
        tails = norm.logsf(np.abs(value - self.mean) / deviation)
        return float(np.log(2.0) + logsumexp(self.log_weight + tails))

    def log_p_of(self, value: float, error: float) -> float:
        """Logarithm of the two-sided p-value of another estimate."""
        return self.log_p(value, np.sqrt(error**2 + self.tau**2 + self.error**2))


@dataclass(frozen=True)
class Pooled:
    """A fleet's estimate of one number."""

    mean: float
    error: float
    """Mean of the ordinary vehicles, and its standard error."""
    tau: float
    """Standard deviation between them."""
    i2: float
    """Share of the scatter of their estimates that is not the estimates' own error (Higgins & Thompson 2002)."""
    ordinary: Flags
    """(units,): which vehicles it is from."""
    log_p_of_mean: float
    """Logarithm of the p-value of a mean of 0."""
    log_p: Array
    """Logarithms of the p-values of each vehicle against the ordinary ones other than itself, (units,)."""


def pooled(values: Array, errors: Array, odd: Flags | None = None) -> Pooled:
    """Mean and spread of the ordinary vehicles, and how far each one is from the others.

    Parameters
    ----------
    values, errors
        (units,), all known; three or more.
    odd
        Vehicles that are not ordinary, where at least `MIN_ORDINARY` are; None: they are found from the values.
    """
    if odd is not None and (~odd).sum() >= MIN_ORDINARY:
        return _pooled(values, errors, ~odd, _left_out(values, errors, ~odd))
    spread = float(median_abs_deviation(values, scale="normal"))
    deviation = np.abs(values - np.median(values)) / np.maximum(np.hypot(errors, spread), 1e-12)
    ordinary = deviation <= FIRST_DEVIATIONS
    for _ in range(TURNS):
        log_p = _left_out(values, errors, ordinary)
        now = log_p >= np.log(ORDINARY_P)
        if now.sum() < MIN_ORDINARY or (now == ordinary).all():
            break
        ordinary = now
    return _pooled(values, errors, ordinary, log_p)


def _pooled(values: Array, errors: Array, ordinary: Flags, log_p: Array) -> Pooled:
    """Mean and spread of these ordinary vehicles."""
    some, own = values[ordinary], errors[ordinary]
    fleet = Spread.of(some, own)
    weight = 1.0 / np.maximum(own, 1e-12) ** 2
    q = float(weight @ (some - weight @ some / weight.sum()) ** 2)
    i2 = max(0.0, 1.0 - (some.size - 1) / q) if q > 0.0 else 0.0
    mean, error = float(fleet.mean[fleet.best]), float(fleet.error[fleet.best])
    return Pooled(mean, error, fleet.best_tau, i2, ordinary, fleet.log_p(0.0, fleet.error), log_p)


def _left_out(values: Array, errors: Array, ordinary: Flags) -> Array:
    """Logarithms of the p-values of each vehicle against the ordinary ones other than itself, (units,)."""
    everyone = Spread.of(values[ordinary], errors[ordinary])
    found = [everyone.log_p_of(*each) for each in zip(values.tolist(), errors.tolist(), strict=True)]
    for k in np.flatnonzero(ordinary).tolist():
        others = ordinary & (np.arange(values.size) != k)
        found[k] = Spread.of(values[others], errors[others]).log_p_of(float(values[k]), float(errors[k]))
    return np.array(found)


def shrunk(values: Array, errors: Array, fleet: Pooled) -> tuple[Array, Array]:
    """Each vehicle's estimate drawn towards the fleet's mean, and its standard error (empirical Bayes).

    An ordinary vehicle is worth ``(b / s^2 + mean / tau^2) / (1 / s^2 + 1 / tau^2)``. The uncertainty of the mean is
    counted (Morris 1983, J. Am. Stat. Assoc. 78:47). A vehicle that is not ordinary keeps its own estimate.
    """
    own = fleet.tau**2 / np.maximum(fleet.tau**2 + errors**2, 1e-300)
    own = np.where(fleet.ordinary, own, 1.0)
    error = np.sqrt(own * errors**2 + (1.0 - own) ** 2 * fleet.error**2)
    return own * values + (1.0 - own) * fleet.mean, error
