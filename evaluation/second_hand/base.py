"""The numbers of one sensor before anything is hidden: its noise, its correlation and its outliers."""

from dataclasses import dataclass

import numpy as np

MINIMUM_CM = 20
"""Smallest reading of the sensor: nearer surfaces read this value (MB1242 datasheet)."""
MAXIMUM_CM = 765
"""Reading without an echo (MB1242 datasheet)."""
SATURATED_CM = 255
"""What a share of the readings without an echo arrive as: the low and the high byte of 765 OR-ed."""


@dataclass(frozen=True)
class Base:
    """Numbers that the bench table and the run table of a case share."""

    offset_cm: float = 0.0
    scale: float = 0.0
    """A hit is at ``offset_cm + (1 + scale) true range``."""
    sigma_cm: float = 1.0
    growth_per_m: float = 0.0
    """Standard deviation of a hit at range z [m]: ``sigma_cm (1 + growth_per_m z)``."""
    degrees: float = 8.0
    """Degrees of freedom of Student's t."""
    correlation: float = 0.0
    """Correlation of the (normal scores of the) noise of successive readings of a sensor."""
    correlation_time: str = "reading"
    """``reading``: the correlation is per reading. ``elapsed``: it decays with the time between them."""
    wander: float = 0.0
    wander_s: float = 20.0
    """Standard deviation of a slow wander inside a run, in sigma, and its time constant [s]; 0: none."""
    short: float = -4.0
    missed: float = -4.0
    random: float = -4.0
    """Log odds of these readings against a hit."""
    short_rate_per_m: float = 0.5
    """Short readings have an exponential distribution of this rate, cut at the target [1/m]."""
    saturated: float = 0.0
    """Share of the readings without an echo that arrive as `SATURATED_CM`."""


def draw_base(rng: np.random.Generator, correlation: float | None = None, drift: bool = False) -> Base:
    """Draw the numbers of a sensor.

    Parameters
    ----------
    rng
        Source of randomness.
    correlation
        Correlation of successive readings; None draws one: none in a quarter of the cases, else up to 0.8.
    drift
        The noise also wanders slowly inside a run.
    """
    if correlation is None:
        correlation = 0.0 if rng.random() < 0.25 else rng.uniform(0.05, 0.8)
    outliers = rng.uniform(0.01, 0.08)
    shares = rng.dirichlet([2.0, 2.0, 2.0]) * outliers
    odds = np.log(np.maximum(shares, 0.001) / (1 - outliers))
    return Base(
        offset_cm=rng.uniform(-2, 2),
        scale=rng.uniform(-0.01, 0.01),
        sigma_cm=rng.uniform(0.6, 2.0),
        growth_per_m=rng.uniform(0.0, 0.3) if rng.random() < 0.5 else 0.0,
        degrees=rng.uniform(5, 15),
        correlation=correlation,
        correlation_time="reading" if rng.random() < 0.5 else "elapsed",
        wander=rng.uniform(0.3, 0.8) if drift else 0.0,
        wander_s=rng.uniform(5, 30),
        short=odds[0],
        missed=odds[1],
        random=odds[2],
        short_rate_per_m=rng.uniform(0.2, 1.5),
        saturated=rng.uniform(0, 0.5) if rng.random() < 0.7 else 0.0,
    )
