"""Further components of the mixture: where readings lie that are neither hits nor the base's outliers.

Each kind draws and scores one distribution, in whole centimetres clipped to the sensor's limits as hits are.
"""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from msp_range.reading_model.mixture import log_hit, log_unexpected

_Array = NDArray[np.float64]
ROOT_2_PI = float(np.sqrt(2.0 * np.pi))


@dataclass(frozen=True)
class Hits:
    """Centre and standard deviation of n hits [cm], with all effects; and the sensor's limits."""

    centre_cm: _Array
    sigma_cm: _Array
    minimum_cm: int
    maximum_cm: int


class Component(Protocol):
    """One more component of the mixture."""

    def log_prob(self, first_cm: _Array, last_cm: _Array, hits: Hits) -> _Array:
        """log of the probability of the codes from first to last, for n readings."""
        ...

    def prob(self, first_cm: _Array, last_cm: _Array, hits: Hits) -> _Array:
        """That probability itself, 0 where it is too small for a float."""
        ...

    def slopes(self, first_cm: _Array, last_cm: _Array, hits: Hits) -> _Array:
        """That probability, and its derivatives by the hits' centre [1/cm] and the log of their spread, (3, n)."""
        ...

    def sample(self, rng: np.random.Generator, hits: Hits) -> _Array:
        """n readings [cm]."""
        ...

    def take(self, rows: Any) -> "Component":
        """The same for some of the n readings."""
        ...


def take(values: Any, rows: Any) -> Any:
    """Some rows of a column; a number stays."""
    return values[rows] if isinstance(values, np.ndarray) else values


def hit_prob(
    first_cm: _Array, last_cm: _Array, centre_cm: _Array, sigma_cm: float | _Array, minimum_cm: int, maximum_cm: int
) -> _Array:
    """Probability of the codes from first to last of a normal, (n,).

    As `log_hit`, which is exact where the probability is too small for a float and this is 0; and four times as fast.
    """
    a, b, unheard = _ends(first_cm, last_cm, centre_cm, sigma_cm, minimum_cm, maximum_cm)
    return np.where(unheard, last_cm == maximum_cm, _between(a, b))


def _ends(
    first_cm: _Array, last_cm: _Array, centre_cm: _Array, sigma_cm: float | _Array, minimum_cm: int, maximum_cm: int
) -> tuple[_Array, _Array, NDArray[np.bool_]]:
    """Ends of the codes' intervals in standard deviations, and where nothing is heard."""
    unheard = ~(centre_cm < np.inf)
    centre_cm = np.where(unheard, maximum_cm, centre_cm)
    a = (np.where(first_cm == minimum_cm, -np.inf, first_cm - 0.5) - centre_cm) / sigma_cm
    b = (np.where(last_cm == maximum_cm, np.inf, last_cm + 0.5) - centre_cm) / sigma_cm
    return a, b, unheard


def _between(a: _Array, b: _Array) -> _Array:
    # Phi(b) - Phi(a) = Phi(-a) - Phi(-b): on the left side of the bell both terms are small, and nothing cancels.
    right = a > 0.0
    return np.asarray(ndtr(np.where(right, -a, b)) - ndtr(np.where(right, -b, a)), dtype=np.float64)


def hit_slopes(
    first_cm: _Array, last_cm: _Array, centre_cm: _Array, sigma_cm: float | _Array, minimum_cm: int, maximum_cm: int
) -> _Array:
    """The probability of `hit_prob`, and its derivatives by the centre and by the log of the spread, (3, n)."""
    a, b, unheard = _ends(first_cm, last_cm, centre_cm, sigma_cm, minimum_cm, maximum_cm)
    found = np.empty((3, first_cm.size))
    found[0] = _between(a, b)
    at_a, at_b = np.exp(-0.5 * a**2) / ROOT_2_PI, np.exp(-0.5 * b**2) / ROOT_2_PI
    found[1] = (at_a - at_b) / sigma_cm
    found[2] = np.where(np.isinf(a), 0.0, a) * at_a - np.where(np.isinf(b), 0.0, b) * at_b
    found[:, unheard] = 0.0
    found[0, unheard] = last_cm[unheard] == maximum_cm
    return found


def unexpected_slopes(
    first_cm: _Array, last_cm: _Array, centre_cm: _Array, rate_per_m: Any, minimum_cm: int, maximum_cm: int
) -> _Array:
    """Probability of `log_unexpected`, and its derivatives by the centre of the hit and the log of the rate, (3, n)."""
    rate = rate_per_m / 100.0
    end = np.fmin(centre_cm, maximum_cm)
    lower = np.maximum(first_cm - 0.5, minimum_cm)
    width = np.maximum(np.minimum(last_cm + 0.5, end) - lower, 0.0)
    length = np.maximum(end - minimum_cm, 1e-9)
    share, whole = -np.expm1(-rate * width), -np.expm1(-rate * length)
    before = np.exp(rate * (minimum_cm - lower)) / whole
    beyond = rate * (1.0 - whole) / whole
    found = np.empty((3, first_cm.size))
    p = found[0] = before * share
    # Where the interval holds the end, a farther end is more of it; and of everything the share becomes less.
    at_end = rate * before * (1.0 - share)
    found[1] = np.where((end > lower) & (end < last_cm + 0.5), at_end, 0.0) - p * beyond
    found[1][~(centre_cm < maximum_cm)] = 0.0
    found[2] = p * (rate * (minimum_cm - lower) - length * beyond) + at_end * width
    nothing = end <= minimum_cm
    found[:, nothing] = 0.0
    found[0, nothing] = first_cm[nothing] == minimum_cm
    return found


@dataclass(frozen=True)
class Normal:
    """Normal about a place.

    Attributes
    ----------
    location_cm
        The place [cm], or its distance from the hit where ``from_hit``.
    sigma_cm
        Standard deviation [cm]; None: that of the hits, times ``wider``.
    """

    location_cm: Any
    sigma_cm: float | None = None
    from_hit: bool = False
    wider: float = 1.0

    def log_prob(self, first_cm: _Array, last_cm: _Array, hits: Hits) -> _Array:
        centre_cm, sigma_cm = self._place(hits)
        return log_hit(first_cm, centre_cm, sigma_cm, hits.minimum_cm, hits.maximum_cm, last_cm)

    def prob(self, first_cm: _Array, last_cm: _Array, hits: Hits) -> _Array:
        centre_cm, sigma_cm = self._place(hits)
        return hit_prob(first_cm, last_cm, centre_cm, sigma_cm, hits.minimum_cm, hits.maximum_cm)

    def slopes(self, first_cm: _Array, last_cm: _Array, hits: Hits) -> _Array:
        centre_cm, sigma_cm = self._place(hits)
        found = hit_slopes(first_cm, last_cm, centre_cm, sigma_cm, hits.minimum_cm, hits.maximum_cm)
        # What does not move with the hits does not change with them.
        found[1] *= self.from_hit
        found[2] *= self.sigma_cm is None
        return found

    def sample(self, rng: np.random.Generator, hits: Hits) -> _Array:
        centre_cm, sigma_cm = self._place(hits)
        reading_cm = np.rint(centre_cm + sigma_cm * rng.standard_normal(centre_cm.size))
        return np.maximum(np.fmin(reading_cm, hits.maximum_cm), hits.minimum_cm)

    def take(self, rows: Any) -> "Normal":
        return Normal(take(self.location_cm, rows), self.sigma_cm, self.from_hit, self.wider)

    def _place(self, hits: Hits) -> tuple[_Array, float | _Array]:
        origin_cm = hits.centre_cm if self.from_hit else 0.0
        centre_cm = np.broadcast_to(np.asarray(origin_cm + self.location_cm, dtype=float), hits.centre_cm.shape)
        return centre_cm, hits.sigma_cm * self.wider if self.sigma_cm is None else self.sigma_cm


@dataclass(frozen=True)
class FirstBefore:
    """The first of events that come at a constant rate, given that one comes before the hit: exponential, cut there.

    Attributes
    ----------
    rate_per_m
        Events per metre of range that the sensor listens [1/m]; above 0 where the component has a share.
    """

    rate_per_m: Any

    def log_prob(self, first_cm: _Array, last_cm: _Array, hits: Hits) -> _Array:
        rate = np.maximum(self.rate_per_m, 1e-12)
        return log_unexpected(first_cm, hits.centre_cm, rate, hits.minimum_cm, hits.maximum_cm, last_cm)

    def prob(self, first_cm: _Array, last_cm: _Array, hits: Hits) -> _Array:
        p: _Array = self.slopes(first_cm, last_cm, hits)[0]
        return p

    def slopes(self, first_cm: _Array, last_cm: _Array, hits: Hits) -> _Array:
        rate = np.maximum(self.rate_per_m, 1e-12)
        found = unexpected_slopes(first_cm, last_cm, hits.centre_cm, rate, hits.minimum_cm, hits.maximum_cm)
        found[2] = 0.0
        return found

    def sample(self, rng: np.random.Generator, hits: Hits) -> _Array:
        rate_per_cm = np.maximum(self.rate_per_m, 1e-12) / 100.0
        length_cm = np.maximum(np.fmin(hits.centre_cm, hits.maximum_cm) - hits.minimum_cm, 0.0)
        share = rng.random(length_cm.size)
        heard_cm = hits.minimum_cm - np.log1p(share * np.expm1(-rate_per_cm * length_cm)) / rate_per_cm
        reading_cm: _Array = np.minimum(np.rint(heard_cm), hits.maximum_cm)
        return reading_cm

    def take(self, rows: Any) -> "FirstBefore":
        return FirstBefore(take(self.rate_per_m, rows))


@dataclass(frozen=True)
class Code:
    """One code [cm]: a number for all readings, or one for each."""

    code_cm: Any

    def log_prob(self, first_cm: _Array, last_cm: _Array, hits: Hits) -> _Array:
        return np.where((self.code_cm >= first_cm) & (self.code_cm <= last_cm), 0.0, -np.inf)

    def prob(self, first_cm: _Array, last_cm: _Array, hits: Hits) -> _Array:
        p: _Array = self.slopes(first_cm, last_cm, hits)[0]
        return p

    def slopes(self, first_cm: _Array, last_cm: _Array, hits: Hits) -> _Array:
        found = np.zeros((3, first_cm.size))
        found[0] = (self.code_cm >= first_cm) & (self.code_cm <= last_cm)
        return found

    def sample(self, rng: np.random.Generator, hits: Hits) -> _Array:
        return np.broadcast_to(np.asarray(self.code_cm, dtype=float), hits.centre_cm.shape)

    def take(self, rows: Any) -> "Code":
        return Code(take(self.code_cm, rows))
