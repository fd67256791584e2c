"""Additional components of the mixture: distributions of readings that are neither hits nor the base model's outliers.

Each kind can draw readings and give their probabilities, in the sensor's steps and within its limits.
"""

from dataclasses import dataclass
from typing import Any, Protocol, Self

import numpy as np

from msp_range.arrays import Array
from msp_range.reading_model.kernel import Hit, Short, on_grid
from msp_range.reading_model.rows import ByRow


@dataclass(frozen=True)
class Hits:
    """Centre and standard deviation of n hits [cm], all effects included, and the sensor's limits and step."""

    centre_cm: Array
    sigma_cm: Array
    minimum_cm: float
    maximum_cm: float
    step_cm: float


class Component(Protocol):
    """An additional component of the mixture."""

    def prob(self, first_cm: Array, last_cm: Array, hits: Hits, slopes: bool = False) -> Array:
        """Probability of the codes from first to last, for n readings, (1, n).

        With ``slopes`` also its derivatives by the hits' centre [1/cm] and by the log of their spread, (3, n).
        """

    def sample(self, rng: np.random.Generator, hits: Hits) -> Array:
        """Draw n readings [cm]."""

    def take(self, rows: Any) -> Self:
        """The component for a selection of the n readings."""


@dataclass(frozen=True)
class Normal(ByRow):
    """Normal distribution about a fixed range, or about a distance from the hit."""

    location_cm: Any
    """The centre [cm], or with ``from_hit`` its distance from the hits' centre."""
    sigma_cm: float | None = None
    """Standard deviation [cm]; None: that of the hits, times ``wider``."""
    from_hit: bool = False
    wider: float = 1.0

    def prob(self, first_cm: Array, last_cm: Array, hits: Hits, slopes: bool = False) -> Array:
        hit = Hit(first_cm, last_cm, last_cm == hits.maximum_cm, *self._place(hits), hits.minimum_cm, hits.step_cm)
        if not slopes:
            return hit.p[None]
        # Derivatives are zero unless location or spread is that of the hits.
        return np.stack([hit.p, hit.by_centre * self.from_hit, hit.by_log_sigma * (self.sigma_cm is None)])

    def sample(self, rng: np.random.Generator, hits: Hits) -> Array:
        centre_cm, sigma_cm = self._place(hits)
        reading_cm: Array = on_grid(Hit.draw(rng.standard_normal(centre_cm.size), centre_cm, sigma_cm), hits.step_cm)
        return np.maximum(np.fmin(reading_cm, hits.maximum_cm), hits.minimum_cm)

    def _place(self, hits: Hits) -> tuple[Array, float | Array]:
        origin_cm = hits.centre_cm if self.from_hit else 0.0
        centre_cm = np.broadcast_to(origin_cm + self.location_cm, hits.centre_cm.shape)
        return centre_cm, hits.sigma_cm * self.wider if self.sigma_cm is None else self.sigma_cm


@dataclass(frozen=True)
class FirstBefore(ByRow):
    """The first event of a Poisson process, if there is one before the hit: exponential, truncated at the hit."""

    rate_per_m: Any
    """Events per metre of range [1/m]; above 0 if the component has a share."""

    def prob(self, first_cm: Array, last_cm: Array, hits: Hits, slopes: bool = False) -> Array:
        lowest, highest = hits.minimum_cm, hits.maximum_cm
        short = Short(first_cm, last_cm, hits.centre_cm, self._rate_per_cm, lowest, highest, hits.step_cm)
        return np.stack([short.p, short.by_end, np.zeros(first_cm.size)]) if slopes else short.p[None]

    def sample(self, rng: np.random.Generator, hits: Hits) -> Array:
        share, lowest, highest = rng.random(hits.centre_cm.size), hits.minimum_cm, hits.maximum_cm
        drawn_cm = Short.draw(share, hits.centre_cm, self._rate_per_cm, lowest, highest)
        reading_cm: Array = np.minimum(on_grid(drawn_cm, hits.step_cm), hits.maximum_cm)
        return reading_cm

    @property
    def _rate_per_cm(self) -> Any:
        return np.maximum(self.rate_per_m, 1e-12) / 100.0


@dataclass(frozen=True)
class Code(ByRow):
    """A fixed code [cm], the same for all readings or one for each."""

    code_cm: Any

    def prob(self, first_cm: Array, last_cm: Array, hits: Hits, slopes: bool = False) -> Array:
        found = np.zeros((3 if slopes else 1, first_cm.size))
        found[0] = (self.code_cm >= first_cm) & (self.code_cm <= last_cm)
        return found

    def sample(self, rng: np.random.Generator, hits: Hits) -> Array:
        return np.broadcast_to(np.asarray(self.code_cm, dtype=float), hits.centre_cm.shape)
