"""The base mixture of n readings, each with its own parameters: probabilities, their derivatives, and draws.

From the centre, spread and weights of each row follow the probabilities of readings and their derivatives, and readings
are drawn. The kinds of reading are those of `msp_range.reading_model.kernel`. The base model (`mixture.ReadingModel`)
is these rows; the simulator's effects change their numbers and mix in more.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple, Self, TypeAlias

import numpy as np

from msp_range.arrays import Array, Indices
from msp_range.reading_model.kernel import Hit, Missed, Random, Short, is_on_grid, on_grid
from msp_range.reading_model.sensor_model import SATURATED_CM

Part: TypeAlias = Callable[[Any, Array, Array], Array]
"""A function of (rows, first, last): the probability of the readings from first to last, or that and its derivatives,
shape (m, n)."""


class Base(NamedTuple):
    """Changes that are added to the numbers of a mixture. Effects of the simulator act through the first five; the
    other three belong to the base mixture alone."""

    offset_cm: Any = 0.0
    log_sigma: Any = 0.0
    """Hits: centre, and logarithm of the spread within runs."""
    log_odds_short: Any = 0.0
    log_odds_missed: Any = 0.0
    log_odds_random: Any = 0.0
    """Logarithms of the odds against hits."""
    log_rate: Any = 0.0
    """Logarithm of the rate of short readings."""
    saturated: Any = 0.0
    """Share of no-echo codes that arrive as 255."""
    correlation: Any = 0.0
    """Correlation of neighbouring hits, where the rows have a history."""


FREE = Base._fields[:-1]
"""Numbers by which `MixtureRows.slopes` differentiates."""
MIN_PROBABILITY = 1e-12
"""Smallest probability of a reading: one that the model cannot give is treated as this improbable, so that a single
impossible reading does not make every likelihood zero. Smaller gives such readings more weight."""
ON_GRID = 1e-6
"""A reading within this share of a step counts as a multiple of it [1]: more than the rounding error of a division."""
UNDERFLOW = 1e-290
"""Smaller probabilities are computed by their logarithm: near 1e-308 floats lose their digits."""


@dataclass(frozen=True)
class ByRow:
    """Base of dataclasses whose array fields have an element for each row."""

    def take(self, rows: Any) -> Self:
        """Some of the rows."""
        return replace(self, **{column.name: take(getattr(self, column.name), rows) for column in fields(self)})


def take(values: Any, rows: Any) -> Any:
    """Some rows of a column, and of all columns in a tuple; a number stays."""
    if isinstance(values, np.ndarray):
        return values[rows]
    if isinstance(values, tuple):
        taken = [take(value, rows) for value in values]
        return type(values)(*taken) if hasattr(values, "_fields") else tuple(taken)
    return values.take(rows) if isinstance(values, ByRow) else values


def among(some: Array, rows: Indices, size: int) -> Array:
    """Parts of some rows (m, k) in their places among all, (m, size); 0 for the others."""
    parts = np.zeros((some.shape[0], size))
    parts[:, rows] = some
    return parts


def shares_of(log_weights: Sequence[Any]) -> list[Any]:
    """Shares of hit, short, missed and random by the logarithms of their weights, numbers or (n,)."""
    weights = [np.exp(log_weight) for log_weight in log_weights]
    total = sum(weights)
    return [weight / total for weight in weights]


@dataclass(frozen=True)
class MixtureRows(ByRow):
    """Distribution of n readings: hit, short, missed and random readings by their weights, as `ReadingModel` has
    them."""

    centre_cm: Array
    sigma_cm: Any
    """Centre and sigma of the hits, (n,), or one sigma for all; a centre of NaN gives no echo."""
    log_weights: tuple[Any, Any, Any, Any]
    """Logarithms of the weights of hit, short, missed, random, but for a common summand: numbers or arrays."""
    rate_per_m: float
    saturated_fraction: float
    minimum_cm: float
    maximum_cm: float
    step_cm: float
    """As in the sensor model; readings are whole multiples of the step."""

    def __len__(self) -> int:
        return self.centre_cm.size

    def wider(self, factor: Any) -> Self:
        """A copy with the spread multiplied by a factor."""
        return replace(self, sigma_cm=self.sigma_cm * factor)

    def changed(self, change: Base) -> Self:
        """A copy with its numbers changed, each by one number or by (n,)."""
        hit, short, missed, random = self.log_weights
        logs = hit, short + change.log_odds_short, missed + change.log_odds_missed, random + change.log_odds_random
        return replace(
            self.wider(np.exp(change.log_sigma)),
            centre_cm=self.centre_cm + change.offset_cm,
            log_weights=logs,
            rate_per_m=self.rate_per_m * np.exp(change.log_rate),
            saturated_fraction=float(np.clip(self.saturated_fraction + change.saturated, 0.0, 1.0)),
        )

    def scores(self, reading_cm: Array) -> tuple[Array, Array]:
        """Log probabilities and their derivatives.

        Returns
        -------
        log_p : ndarray, shape (n,)
            At least log `MIN_PROBABILITY`, where the derivatives are 0.
        by : ndarray, shape (n, 7)
            By the numbers of `FREE`.
        """
        by = np.empty((len(FREE), reading_cm.size))
        return self.scores_into(by, reading_cm), np.ascontiguousarray(by.T)

    def scores_into(self, by: Array, reading_cm: Array) -> Array:
        """As `scores`, but writes into ``by``, a row (n,) for each number: half of the time of a fit went into new
        arrays."""
        parts = self.of_readings(reading_cm, type(self).slopes)
        p = np.maximum(parts[0], MIN_PROBABILITY)
        np.divide(parts[1:], p, out=by)
        by[:, parts[0] <= MIN_PROBABILITY] = 0.0
        return np.asarray(np.log(p))

    def log_prob(self, reading_cm: Array) -> Array:
        """log of the probability of each reading; -inf for what cannot be read, such as fractions of a step and NaN."""
        p = self.of_readings(reading_cm, type(self).probability)[0]
        with np.errstate(divide="ignore"):
            log_p: Array = np.log(p)
        reportable = (reading_cm >= self.minimum_cm) & (reading_cm <= self.maximum_cm)
        tail = np.flatnonzero((p < UNDERFLOW) & reportable & is_on_grid(reading_cm, self.step_cm))
        if tail.size:
            rows, reading_cm = self.take(tail), reading_cm[tail]
            log_share = rows.log_weights[0] - np.log(sum(rows.weights()))
            with np.errstate(divide="ignore"):
                log_kept = np.where(reading_cm == self.maximum_cm, np.log(1.0 - self.saturated_fraction), 0.0)
            log_hit = log_share + log_kept + rows.kinds(reading_cm, reading_cm)[0].log_p
            log_p[tail] = np.maximum(log_p[tail], log_hit)
        return log_p

    def log_below(self, reading_cm: Array) -> Array:
        """log of the probability of all smaller readings, for the probability integral transform."""
        last = on_grid((np.ceil(reading_cm / self.step_cm - ON_GRID) - 1.0) * self.step_cm, self.step_cm)
        with np.errstate(divide="ignore"):
            log_p: Array = np.log(self.arrives(np.full_like(last, -np.inf), last, type(self).probability)[0])
        return log_p

    def of_readings(self, reading_cm: Array, part: Part) -> Array:
        """``part`` for each single reading, (m, n); 0 for a reading that is no multiple of the step."""
        code = np.where(is_on_grid(reading_cm, self.step_cm), reading_cm, -1.0)
        return self.arrives(code, code, part)

    def arrives(self, first: Array, last: Array, part: Part) -> Array:
        """``part`` for the readings that arrive: the sensor sends some of its no-echo codes M as 255.

        With q of the mixture and the saturated fraction s, p(M) = (1 - s) q(M) and p(255) = q(255) + s q(M).
        """
        first, last = np.maximum(first, self.minimum_cm), np.minimum(last, self.maximum_cm)
        outside = np.flatnonzero(~(first <= last))
        if 2 * outside.size > first.size:
            inside = np.flatnonzero(first <= last)
            some = MixtureRows.arrives(self.take(inside), first[inside], last[inside], part)
            return among(some, inside, first.size)
        # To compute a few too many takes less time than to copy all others.
        first[outside] = last[outside] = self.minimum_cm
        parts = part(self, first, last)
        has_max = last == self.maximum_cm
        moves = np.flatnonzero(has_max != ((first <= SATURATED_CM) & (last >= SATURATED_CM)))
        if moves.size:
            # What arrives as M alone has been computed.
            moved, others = -parts[:, moves], np.flatnonzero(first[moves] != self.maximum_cm)
            if others.size:
                top = np.full(others.size, float(self.maximum_cm))
                own = part(self.take(moves[others]), top, top)
                moved[:, others] = own * np.where(has_max[moves[others]], -1.0, 1.0)
            parts[:, moves] += self.saturated_fraction * moved
            if len(parts) > len(FREE):
                parts[-1, moves] = moved[0]
        parts[:, outside] = 0.0
        return parts

    def weights(self) -> list[Any]:
        """Weights of hit, short, missed and random, numbers or (n,); their sum is not 1."""
        return [np.exp(log_weight) for log_weight in self.log_weights]

    def kinds(self, first: Array, last: Array) -> tuple[Hit, Short, Missed, Random]:
        """Hit, short, missed and random readings from first to last."""
        lowest, highest, step = self.minimum_cm, self.maximum_cm, self.step_cm
        top = last == highest
        return (
            Hit(first, last, top, self.centre_cm, self.sigma_cm, lowest, step),
            Short(first, last, self.centre_cm, self.rate_per_m / 100.0, lowest, highest, step),
            Missed(top),
            Random(first, last, lowest, highest, step),
        )

    def probability(self, first: Array, last: Array) -> Array:
        """Probability q of the readings from first to last, all within the limits, before saturation, (1, n)."""
        weights = self.weights()
        kinds: Sequence[Hit | Short | Missed | Random] = self.kinds(first, last)
        q = sum(weight * kind.p for weight, kind in zip(weights, kinds, strict=True) if np.any(weight))
        return np.asarray(q / sum(weights))[None]

    def slopes(self, first: Array, last: Array) -> Array:
        """q and its derivatives in the order of `FREE`, (8, n); that by the saturated fraction is 0."""
        of_hit, of_short, of_missed, of_random = self.kinds(first, last)
        hit, short, missed, random = shares_of(self.log_weights)
        parts = np.zeros((1 + len(FREE), first.size))
        q = parts[0]
        q += hit * of_hit.p + missed * of_missed.p + random * of_random.p
        parts[1], parts[2] = hit * of_hit.by_centre, hit * of_hit.by_log_sigma
        if np.any(short):
            q += short * of_short.p
            parts[1] += short * of_short.by_end
            parts[3] = short * (of_short.p - q)
            parts[6] = short * of_short.rate * of_short.by_rate
        parts[4], parts[5] = missed * (of_missed.p - q), random * (of_random.p - q)
        return parts

    def draw(self, normal: Array, kind: Array, place: Array | None = None) -> Array:
        """Readings before saturation, from n standard normal and n uniform numbers.

        Parameters
        ----------
        normal, kind
            For the hit, and for the kind of reading; the normal numbers are used up.
        place
            Uniform numbers for where short and random readings lie; None: what is left of ``kind``.
        """
        reading_cm: Array = on_grid(Hit.draw(normal, self.centre_cm, self.sigma_cm), self.step_cm)
        # fmin and not minimum: it takes NaN, a surface that gives no echo, to the maximum.
        np.fmin(reading_cm, self.maximum_cm, out=reading_cm)
        np.maximum(reading_cm, self.minimum_cm, out=reading_cm)
        others = np.flatnonzero(kind >= self._below()[0])
        if others.size:
            reading_cm[others] = self.take(others)._draw_others(kind[others], None if place is None else place[others])
        return reading_cm

    def _below(self) -> tuple[Any, Any, Any]:
        """Cumulative weights: a uniform number below the first is a hit, then short, then missed, then random."""
        hit, short, missed, random = self.weights()
        total = hit + short + missed + random
        # The last share takes what rounding leaves, so it must be none where it has no weight.
        below_missed = np.where(random > 0.0, (hit + short + missed) / total, 1.0)
        return hit / total, (hit + short) / total, below_missed

    def _draw_others(self, kind: Array, place: Array | None) -> Array:
        """Readings of the three rarer kinds."""
        below_hit, below_short, below_missed = (np.broadcast_to(each, kind.shape) for each in self._below())
        reading_cm = np.full(kind.size, float(self.maximum_cm))
        short, random = np.flatnonzero(kind < below_short), np.flatnonzero(kind >= below_missed)

        def uniform(rows: Indices, start: Array, end: Any) -> Array:
            return place[rows] if place is not None else (kind[rows] - start[rows]) / (take(end, rows) - start[rows])

        drawn = uniform(short, below_hit, below_short)
        minimum, maximum, step = self.minimum_cm, self.maximum_cm, self.step_cm
        drawn_cm = Short.draw(drawn, self.centre_cm[short], self.rate_per_m / 100.0, minimum, maximum)
        reading_cm[short] = on_grid(drawn_cm, step)
        reading_cm[random] = Random.draw(uniform(random, below_missed, 1.0), minimum, maximum, step)
        # A share next to 1 can round up to it.
        np.minimum(reading_cm, maximum, out=reading_cm)
        return reading_cm
