"""Readings with known parameters, drawn the plain way: one at a time, by the words of the report's section 5.2.1.

True ranges enter, readings leave. It shares no code with msp_range, so that what a fit is tested on is not its own
idea of the mixture.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from random import Random


@dataclass(frozen=True)
class PlainSensor:
    """A range finder with known parameters; `math.inf` is a range at which nothing is heard."""

    hit: float
    short: float
    missed: float
    random: float
    sigma_cm: float
    short_rate_per_m: float
    second_share: float = 0.0
    sigma_growth_cm_per_m: float = 0.0
    missed_growth_per_m: float = 0.0
    offset_cm: float = 0.0
    scale: float = 1.0
    minimum_cm: float = 20.0
    maximum_cm: float = 765.0
    step_cm: float = 1.0
    no_echo_cm: float = 765.0
    second_cm: float = 255.0

    def readings(self, true_cm: Sequence[float], seed: int) -> list[float]:
        """One reading for each true range."""
        chance = Random(seed)
        return [self.reading(each, chance) for each in true_cm]

    def reading(self, true_cm: float, chance: Random) -> float:
        """One reading."""
        reach_cm = min(max(true_cm, 0.0), self.maximum_cm)
        missed_odds = (
            self.missed
            / (1.0 - self.missed)
            * math.exp(self.missed_growth_per_m * (reach_cm - min(300.0, self.maximum_cm)) / 100.0)
        )
        if chance.random() < missed_odds / (1.0 + missed_odds):
            return self._no_echo(chance)
        kind = chance.choices(("hit", "short", "random"), (self.hit, self.short, self.random))[0]
        if kind == "hit":
            if true_cm == math.inf:
                return self._no_echo(chance)
            sigma_cm = math.sqrt(self.sigma_cm**2 + (self.sigma_growth_cm_per_m * reach_cm / 100.0) ** 2)
            heard_cm = chance.gauss(self.offset_cm + self.scale * true_cm, sigma_cm)
        elif kind == "short":
            heard_cm = self._short_cm(min(true_cm, self.maximum_cm), chance)
        else:
            steps = round((self.maximum_cm - self.minimum_cm) / self.step_cm)
            heard_cm = self.minimum_cm + self.step_cm * chance.randint(0, steps)
        reading_cm = self.minimum_cm + self.step_cm * round((heard_cm - self.minimum_cm) / self.step_cm)
        if reading_cm <= self.minimum_cm:
            return self.minimum_cm
        if reading_cm > self.maximum_cm or reading_cm == self.no_echo_cm:
            return self._no_echo(chance)
        return reading_cm

    def _short_cm(self, end_cm: float, chance: Random) -> float:
        """An exponential from the shortest reading on; what lies beyond the expected range is drawn again."""
        if end_cm <= self.minimum_cm:
            return self.minimum_cm
        while True:
            heard_cm = self.minimum_cm + chance.expovariate(self.short_rate_per_m / 100.0)
            if heard_cm <= end_cm:
                return heard_cm

    def _no_echo(self, chance: Random) -> float:
        return self.second_cm if chance.random() < self.second_share else self.no_echo_cm
