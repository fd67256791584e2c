"""The four kinds of reading, one class each, with probability, derivatives, and random draws.

All code that draws or fits readings or computes their likelihood uses these: `Hit`, `Short`, `Missed` and `Random`,
with Thrun's weights z_hit, z_short, z_max and z_rand (Thrun, Burgard & Fox 2005, Probabilistic Robotics, section 6.3;
report eq 9 to 12). A reading is a whole step between the sensor's limits, so its probability is that of an interval of
half a step to either side; `first` and `last` select the readings from one to another. All lengths have the same unit,
and rates are per that unit. By erratum 6 of the report the probabilities of each kind sum to 1 over all possible
readings.

The bridge's changepoint filter uses this file too, so scipy is imported only for intervals of the normal distribution.
"""

from functools import cached_property
from typing import Any

import numpy as np

from msp_range.arrays import Array

FAR = 1e15
"""Stands for infinity as the edge of an interval; finite, so that its product with a density of zero is zero."""
NO_ECHO_CENTRE = 1e12
"""Centre of the hits if there is no echo: beyond every sensor's range, and far below `FAR`."""
ROOT_2_PI = float(np.sqrt(2.0 * np.pi))


def on_grid(reading: Any, step: float) -> Any:
    """Readings rounded to whole multiples of a step, halves to the even one: a number or an array.

    A step below 1 has a whole number of steps in 1, and multiples are the floats nearest to their decimals, so that
    readings can be compared for equality.

    Examples
    --------
    >>> print(on_grid(np.array([12.34, 12.36]), 0.1), on_grid(12.34, 5.0))
    [12.3 12.4] 10.0
    """
    if step >= 1.0:
        return np.rint(reading / step) * step
    steps = round(1.0 / step)
    return np.rint(reading * steps) / steps


def is_on_grid(reading: Any, step: float) -> Any:
    """Which readings are whole multiples of a step: a bool or an array; NaN is none."""
    return on_grid(reading, step) == reading


class Hit:
    """A reading of the surface (z_hit, report eq 9): normal about the expected range.

    ``p = Phi((b - z) / sigma) - Phi((a - z) / sigma)``. Below the minimum the reading is the minimum, so a = -inf
    there; beyond the maximum it is the code for no echo, so b = +inf there.

    Parameters
    ----------
    first, last
        Readings, (n,).
    top
        Whether ``last`` is the no-echo code, one bool or (n,).
    centre
        Expected range, (n,); NaN or infinite without an echo: then every hit reads as no echo.
    sigma
        Standard deviation before rounding, a number or (n,).
    minimum
        Shortest reading.
    step
        Step of the readings.
    """

    def __init__(self, first: Array, last: Array, top: Any, centre: Array, sigma: Any, minimum: float, step: float):
        lower = np.where(first == minimum, -FAR, first - 0.5 * step)
        upper = np.where(top, FAR, last + 0.5 * step)
        # fmin, unlike minimum, replaces NaN (no echo) by a centre out of range.
        centre = np.fmin(centre, NO_ECHO_CENTRE)
        self.sigma = sigma
        self.a, self.b = (lower - centre) / sigma, (upper - centre) / sigma

    @cached_property
    def p(self) -> Array:
        """Probability, (n,); 0 if too small for a float."""
        from scipy.special import ndtr

        # Phi(b) - Phi(a) = Phi(-a) - Phi(-b): in the left tail both terms are small, and no digits cancel.
        right = self.a > 0.0
        found: Array = ndtr(np.where(right, -self.a, self.b)) - ndtr(np.where(right, -self.b, self.a))
        return found

    @property
    def log_p(self) -> Array:
        """Logarithm of the probability, exact in the tails; several times slower than `p`."""
        from scipy.special import log_ndtr

        right = self.a > 0.0
        low, high = log_ndtr(np.where(right, -self.b, self.a)), log_ndtr(np.where(right, -self.a, self.b))
        with np.errstate(divide="ignore"):
            found: Array = high + np.log(-np.expm1(low - high))
        return found

    @cached_property
    def at_ends(self) -> tuple[Array, Array]:
        """Standard normal density at both ends of the interval."""
        return np.exp(-0.5 * self.a * self.a) / ROOT_2_PI, np.exp(-0.5 * self.b * self.b) / ROOT_2_PI

    @cached_property
    def by_centre(self) -> Array:
        """Derivative of `p` by the centre."""
        at_a, at_b = self.at_ends
        found: Array = (at_a - at_b) / self.sigma
        return found

    @cached_property
    def by_log_sigma(self) -> Array:
        """Derivative of `p` by the logarithm of sigma; by the variance it is this / (2 sigma^2)."""
        at_a, at_b = self.at_ends
        found: Array = self.a * at_a - self.b * at_b
        return found

    @staticmethod
    def draw(normal: Any, centre: Any, sigma: Any) -> Any:
        """Draw a range before rounding from standard normal numbers; an array of them is overwritten."""
        normal *= sigma
        normal += centre
        return normal

    @staticmethod
    def density(squared: Any, variance: Any) -> Any:
        """Density at a squared distance from the centre."""
        return np.exp(-0.5 * squared / variance) / np.sqrt(variance) / ROOT_2_PI


class Short:
    """A reading of something in front of the surface (z_short, report eq 10): exponential, truncated at the surface.

    By distances from the minimum, with the end at ``length`` and the part of the readings' interval before it from
    ``near`` to ``far``: ``p = (exp(-lambda near) - exp(-lambda far)) / (1 - exp(-lambda length))``. If the surface
    is not beyond the minimum, all readings are the minimum.

    Parameters
    ----------
    first, last
        Readings, (n,).
    end
        Expected range, (n,); NaN or beyond the maximum: it ends at the maximum.
    rate
        lambda, a number or (n,).
    minimum, maximum, step
        Shortest and longest reading, and the step of the readings.
    """

    def __init__(self, first: Array, last: Array, end: Array, rate: Any, minimum: float, maximum: float, step: float):
        length = np.maximum(np.fmin(end, maximum) - minimum, 0.0)
        near = np.minimum(np.maximum(first - (minimum + 0.5 * step), 0.0), length)
        far = np.minimum(np.maximum(last - (minimum - 0.5 * step), near), length)
        self.end_moves = end < maximum
        # With zero length all probability is in the first reading, like a steep exponential with a distant end.
        none = length == 0.0
        if none.any():
            near[none] = np.where(first[none] == minimum, 0.0, FAR)
            far[none] = length[none] = FAR
        self.near, self.far, self.length, self.rate = near, far, length, rate

    @cached_property
    def _parts(self) -> tuple[Array, Array, Array]:
        """exp(-lambda near), the share of the interval after it, and the norm."""
        rate = self.rate
        return (
            np.exp(-rate * self.near),
            -np.expm1(rate * (self.near - self.far)),
            -np.expm1(-rate * self.length),
        )

    @cached_property
    def p(self) -> Array:
        """Probability, (n,)."""
        at_near, share, norm = self._parts
        found: Array = at_near * share / norm
        return found

    @cached_property
    def by_rate(self) -> Array:
        """Derivative of `p` by the rate."""
        at_near, share, norm = self._parts
        at_far = at_near * (1.0 - share)
        found: Array = (self.far * at_far - self.near * at_near - self.p * self.length * (1.0 - norm)) / norm
        return found

    @property
    def by_end(self) -> Array:
        """Derivative of `p` by the expected range, at which it ends: positive at the end, negative elsewhere."""
        at_near, share, norm = self._parts
        at_end = np.where((self.near < self.far) & (self.far == self.length), at_near * (1.0 - share), 0.0)
        found: Array = np.where(self.end_moves, self.rate * (at_end - self.p * (1.0 - norm)) / norm, 0.0)
        return found

    @staticmethod
    def draw(uniform: Any, end: Any, rate: Any, minimum: float, maximum: float) -> Any:
        """Draw a range before rounding from uniform numbers below 1."""
        length = np.maximum(np.fmin(end, maximum) - minimum, 0.0)
        return minimum - np.log1p(uniform * np.expm1(-rate * length)) / rate

    @staticmethod
    def density(distance: Any, length: Any, rate: float) -> Any:
        """Density at a distance from the minimum, before the end at ``length`` from it."""
        return rate * np.exp(-rate * distance) / -np.expm1(-rate * length)


class Missed:
    """A missed echo (z_max, report eq 11): the reading is the code for no echo, ``p = [last is the code]``."""

    def __init__(self, top: Any):
        self.p = np.asarray(top, dtype=np.float64)


class Random:
    """A random reading (z_rand, report eq 12): uniform over all possible readings.

    Parameters
    ----------
    first, last
        Readings, (n,).
    minimum, maximum, step
        Shortest and longest reading, and the step of the readings.
    """

    def __init__(self, first: Array, last: Array, minimum: float, maximum: float, step: float):
        self.p = (last - first + step) / (maximum - minimum + step)

    @staticmethod
    def draw(uniform: Any, minimum: float, maximum: float, step: float) -> Any:
        """Draw a rounded reading from uniform numbers below 1."""
        return on_grid(minimum + step * np.floor(uniform * ((maximum - minimum) / step + 1.0)), step)
