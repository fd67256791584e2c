"""How much later readings are than the reference, by generalised least squares, which overrule a fit of the mixture.

The effects of a fit are returned, those that are shifts in time at other values where theirs are not likely.
Neighbouring errors are alike, and a sensor that wanders for a while has a delay of any size explained by its noise. So
the hits' errors are an offset of each run, an Ornstein-Uhlenbeck process and white noise, all normal, whatever form the
mixture has: its tails are what many hits in motion are when the delay is wrong, and a fit that takes them for tails
gives them no weight. Of that noise on any times the precision is tridiagonal, so that a likelihood takes one pass (Rue
& Held 2005, Gaussian Markov Random Fields, section 2.3).
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.linalg.lapack import dpttrf, dpttrs
from scipy.optimize import minimize_scalar

from msp_lab.gap.prepared import Prepared
from msp_range.arrays import Array, Flags, Indices
from msp_range.reading_model.rows import Base
from msp_sim.effects.base import Parameter
from msp_sim.model.model import Term, history_of

SHARES = (0.1, 0.3, 0.6, 0.9)
"""Shares of the noise's variance that neighbours have in common, which are tried. Closer: slower; 19 of them, and 28
memories, move a robot's delay from 406.5 to 407.5 ms, which is a tenth of its error."""
MEMORIES = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)
"""Times in which that share forgets itself, in steps between neighbouring hits, which are tried. Longer ones are
offsets of runs."""
LONGEST_MEMORY = 0.9999
"""Correlation of neighbours at most: above, the precision has no inverse in floating point."""
REACH = 0.1
"""A value is searched so far to each side, as a share of what it may be: the height of a delay over one period of a
vehicle's motion has two tops. Farther: another top may be taken; nearer: fits go on in many steps."""
ROUNDS = 3
"""Noise and value are estimated in turn, so many times: the noise is that of errors without the delay."""
EXACT = 1e-4
"""A value is searched to this share of its reach, a hundredth of what any table knows it to."""
MOST_OFF = 6.0
"""Hits that are off by so many times the median of that are left out, four standard deviations of normal errors: those
on a box below wander with it, and no normal process jumps so. Fewer: of a wrong delay what moves fast is left out;
more: a box decides the delay."""
ENOUGH_NATS = 5.0
"""A value that explains the errors by so much better is taken, which is three standard errors. Less: which readings are
hits moves the value from one fit to the next, and small effects are lost in that; more: a mixture's value stays that
tails and correlated noise make."""
LEAST_HITS = 30
"""With fewer hits a value stays as it is: five numbers are estimated from them."""


def with_shifts(prepared: Prepared, base: Base, effects: Sequence[Term]) -> tuple[Term, ...]:
    """The effects of a fit; a shift whose value is much less likely than another one has that."""
    found = list(effects)
    for k, term in enumerate(effects):
        if term.effect.is_shift:
            shift = Shift(prepared, base, found, k)
            last, value = math.inf, shift.value
            for _ in range(ROUNDS):
                if abs(value - last) > 10.0 * EXACT * shift.reach:
                    last, value = value, shift.next_to(value)
            found[k] = shift.at(value)[k]
    return tuple(found)


@dataclass(frozen=True)
class Shift:
    """The k-th effect of a fit, which is a shift."""

    prepared: Prepared
    base: Base
    effects: Sequence[Term]
    k: int

    @property
    def parameter(self) -> Parameter:
        """Its number."""
        (found,) = self.effects[self.k].effect.parameters
        return found

    @property
    def value(self) -> float:
        """Value of its number in the fit."""
        return self.effects[self.k].values[self.parameter.name]

    @property
    def reach(self) -> float:
        """How far to each side a value is searched."""
        return REACH * (self.parameter.high - self.parameter.low)

    def at(self, value: float) -> list[Term]:
        """The effects with another value of its number."""
        changed = self.effects[self.k].having({self.parameter.name: value})
        return [*self.effects[: self.k], changed, *self.effects[self.k + 1 :]]

    def next_to(self, value: float) -> float:
        """The likeliest value near one, with hits and noise as they are there; that one if it is nearly as likely."""
        hits = Hits.of(self.prepared, self.base, self.at(value))
        if hits.order.size < LEAST_HITS:
            return value

        def moved_cm(there: float) -> Array:
            return self.prepared.bias_cm(self.at(there)[self.k])[hits.order]

        # What other effects make of the range at another time is that of the range here: they come in again next time.
        error_cm = hits.errors(self.prepared, self.base, self.at(value))
        still_cm = error_cm + moved_cm(value)
        noise = min(hits.noises(), key=lambda tried: tried.loss(error_cm))

        def loss(there: float) -> float:
            return noise.loss(still_cm - moved_cm(there))

        found = minimize_scalar(
            loss,
            bounds=(max(value - self.reach, self.parameter.low), min(value + self.reach, self.parameter.high)),
            method="bounded",
            options={"xatol": EXACT * self.reach},
        )
        return float(found.x) if loss(value) - float(found.fun) > ENOUGH_NATS else value


@dataclass(frozen=True)
class Hits:
    """Readings of the surface, series by series and in order of time."""

    order: Indices
    """Their places, (m,)."""
    starts: Flags
    """Where a series begins, (m,)."""
    steps: Array
    """Time from the one before, in medians of that, (m - 1,)."""
    sigma_cm: Array
    """Spread of each, (m,)."""

    @classmethod
    def of(cls, prepared: Prepared, base: Base, effects: Sequence[Term]) -> "Hits":
        """At a fit."""
        rows = prepared.at(base, effects)
        history = history_of(prepared.scene, 0.0, prepared.spacing_s or 1.0)
        off, found = (prepared.reading_cm - rows.centre_cm) / rows.sigma_cm, rows.are_hits(prepared.reading_cm)
        if found.any():
            middle = float(np.median(off[found]))
            found &= np.abs(off - middle) <= MOST_OFF * float(np.median(np.abs(off[found] - middle)))
        ordered = found[history.order]
        order = history.order[ordered]
        starts, steps_s = np.diff(history.series[ordered], prepend=-1) != 0, np.diff(history.time_s[ordered])
        usual_s = float(np.median(steps_s[~starts[1:]])) if np.any(~starts[1:]) else 1.0
        sigma_cm = np.broadcast_to(rows.sigma_cm, len(prepared))[order]
        return cls(order, starts, np.maximum(steps_s, 0.0) / max(usual_s, 1e-9), sigma_cm)

    def errors(self, prepared: Prepared, base: Base, effects: Sequence[Term]) -> Array:
        """Errors of the hits with these effects [cm], (m,)."""
        return (prepared.reading_cm - prepared.at(base, effects).centre_cm)[self.order]

    def noises(self) -> Iterator["Noise"]:
        """The noises that are tried."""
        first = np.flatnonzero(self.starts)
        overs = [
            np.where(self.starts[1:], 0.0, np.minimum(np.exp(-self.steps / memory), LONGEST_MEMORY))
            for memory in MEMORIES
        ]
        for share, over in product(SHARES, overs):
            left, white = 1.0 - over**2, 1.0 - share
            next_one = over / (share * left)
            precision = np.full(self.order.size, 1.0 / share)
            precision[1:] += over * next_one
            precision[:-1] += over * next_one
            factors, below, _ = dpttrf(precision + 1.0 / white, -next_one)
            # The determinant of the noise's covariance: that of the precision with the readings, over that without.
            size = float(np.log(factors).sum() + np.log(share * np.append(1.0, left)).sum())
            yield Noise(self.sigma_cm, first, white, factors, below, size)


@dataclass(frozen=True)
class Noise:
    """Noise of hits, series by series and in order of time, of which a share forgets itself in some steps."""

    sigma_cm: Array
    """Spread of each hit, (m,)."""
    first: Indices
    """Where a series begins, (series,)."""
    white: float
    """Share of the noise's variance that neighbours do not have in common."""
    factors: Array
    below: Array
    """Factors of the precision of the other share, with the readings, (m,) and (m - 1,)."""
    size: float
    """Logarithm of the determinant of the noise's covariance, but for that of the spreads."""

    def loss(self, error_cm: Array) -> float:
        """Negative log-likelihood of errors (m,), but for a constant, with the likeliest size of the noise and
        offsets."""
        sides = np.column_stack([error_cm, np.ones(error_cm.size)]) / self.sigma_cm[:, None]
        weighted = (sides - dpttrs(self.factors, self.below, sides / self.white)[0]) / self.white
        offsets, known = (np.add.reduceat(sides[:, 1] * weighted[:, i], self.first) for i in (0, 1))
        squares = float(sides[:, 0] @ weighted[:, 0] - (offsets**2 / known).sum())
        return 0.5 * (self.size + error_cm.size * float(np.log(self.white * squares / error_cm.size)))
