"""Random draws of the campaign, in the plain Python values that a YAML file holds."""

from collections.abc import Sequence
from typing import TypeVar

from numpy.random import Generator, default_rng

T = TypeVar("T")


class Dice:
    """Draws for one flight; numbers are rounded to hundredths, so that a scenario file shows all of them."""

    def __init__(self, seed: int, index: int) -> None:
        self._generator: Generator = default_rng([seed, index])

    def between(self, low: float, high: float) -> float:
        """Uniform."""
        return round(float(self._generator.uniform(low, high)), 2)

    def magnitude(self, low: float, high: float) -> float:
        """Log-uniform: each factor is as likely as any other."""
        return round(float(low * (high / low) ** self._generator.random()), 2)

    def around(self, mean: float, std: float) -> float:
        """Normal."""
        return round(float(self._generator.normal(mean, std)), 2)

    def happens(self, probability: float) -> bool:
        """True with a probability."""
        return bool(self._generator.random() < probability)

    def one_of(self, choices: Sequence[T]) -> T:
        """Each with the same probability."""
        return choices[int(self._generator.integers(len(choices)))]

    def some_of(self, choices: Sequence[T], count: int) -> list[T]:
        """So many different ones, in any order."""
        return [choices[i] for i in self._generator.permutation(len(choices))[:count]]

    def seed(self) -> int:
        """For the flight's own random numbers."""
        return int(self._generator.integers(2**31))
