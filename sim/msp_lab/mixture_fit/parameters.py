"""The parameters of the mixture: name, bounds, and the number by which the fit changes each.

A fit varies `Numbers` (logarithms and odds, which have no bounds near them); here they become the parameters of a
sensor model file, with their derivatives.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from msp_range.arrays import Array
from msp_range.reading_model.sensor_model import MixtureParameters

LEAST_LOG_ODDS = float(np.log(1e-7))
"""Log odds of a kind of reading that never occurred: less than once in the largest tables (a million readings)."""
MIN_WEIGHT = 1e-4
"""Floor of a weight in a sensor model file and in a model that the gap workflow compares with, and of the odds of
missed echoes at 3 m that depend on range. A reading of a kind with a share of 0 would decide any comparison alone.
20,000 readings without one of a kind are compatible with this share; a smaller floor lets a fit whose missed echoes are
all near move the share at 3 m to 1e-30, and the growth with it."""
MAX_GROWTH_PER_M = 10.0
"""Largest growth of the log odds of missed echoes with range [1/m]: from `MIN_WEIGHT` to certainty within 1.5 m. With a
larger one the share at one range says nothing of another, and its derivatives overflow."""

STEP = 1e-30
"""Step of the complex-step derivative: any value that is far below the rounding error of a number, and does not
underflow, gives the same."""


class Parameter(NamedTuple):
    """A parameter of the mixture."""

    name: str
    """Name in a sensor model file; of a share without its ``weights.``."""
    label: str
    """What a person calls it."""
    number: str = ""
    """The field of `Numbers` that determines it; empty: several do."""
    least: float = 0.0
    most: float = 1.0
    """Least and greatest value; 0 and 1 for a share."""
    unit: str = ""
    symbol: str = "–"
    """Symbol in Probabilistic Robotics (Thrun, Burgard & Fox 2005, section 6.3)."""
    grows: str = ""
    """What depends on range if the parameter is not 0; empty for all but the growths."""

    @property
    def is_share(self) -> bool:
        """Whether it lies between 0 and 1."""
        return self.most == 1.0


PARAMETERS = {
    parameter.name: parameter
    for parameter in (
        Parameter("hit", "hits", symbol="z_hit"),
        Parameter("short", "short readings", "log_odds_short", symbol="z_short"),
        Parameter("missed", "missed echoes", "log_odds_missed", symbol="z_max"),
        Parameter("random", "random readings", "log_odds_random", symbol="z_rand"),
        Parameter("sigma_cm", "scatter (sigma)", "log_sigma", 0.01, 100.0, "cm", "σ_hit"),
        Parameter("short_rate_per_m", "range of short readings", "rate", 1e-3, 1e3, "1/m", "λ_short"),
        Parameter("saturated_fraction", "readings of 255", "saturated"),
        Parameter(
            "sigma_growth_cm_per_m",
            "growth of scatter with range",
            "sigma_growth_2",
            0.0,
            100.0,
            "cm/m",
            grows="the spread",
        ),
        Parameter(
            "missed_growth_per_m",
            "growth of missed echoes with range",
            "missed_growth",
            -math.inf,
            math.inf,
            "1/m",
            grows="the odds of a missed echo",
        ),
    )
}
"""The parameters by name, in the order of `named`."""
KINDS = tuple(PARAMETERS)[:4]


class Numbers(NamedTuple):
    """The numbers of a fit."""

    log_sigma: Any
    """Logarithm of the hits' spread in cm."""
    log_odds_short: Any
    log_odds_missed: Any
    log_odds_random: Any
    """Log odds of the other kinds against hits; those of missed echoes at `WEIGHTS_RANGE_CM`."""
    rate: Any
    """lambda [1/m]: not its logarithm, since the rate is nearly 0 where short readings hardly get rarer with range."""
    saturated: Any
    """Share of no-echo codes that arrive as 255."""
    sigma_growth_2: Any
    """Square of the spread's growth with range [(cm/m)^2]."""
    missed_growth: Any
    """Growth of the log odds of a missed echo with range [1/m]."""


NAMES = Numbers._fields
LOWEST = Numbers(np.log(0.01), LEAST_LOG_ODDS, LEAST_LOG_ODDS, LEAST_LOG_ODDS, 1e-3, 0.0, 0.0, -MAX_GROWTH_PER_M)
HIGHEST = Numbers(np.log(100.0), -LEAST_LOG_ODDS, -LEAST_LOG_ODDS, -LEAST_LOG_ODDS, 1e3, 1.0, 1e4, MAX_GROWTH_PER_M)
"""Bounds of the numbers: the limits of a sensor model file, and practically any share of each kind of reading."""


def bounds_of(start: Numbers, moving: Sequence[str]) -> tuple[Array, Array]:
    """Bounds for a fit in which the numbers ``moving`` vary and the others keep their start. With growth, the log odds
    of missed echoes stay within those of `MIN_WEIGHT`."""
    low, high = LOWEST, HIGHEST
    if "missed_growth" in moving:
        low = low._replace(log_odds_missed=float(np.log(MIN_WEIGHT)))
        high = high._replace(log_odds_missed=-float(np.log(MIN_WEIGHT)))
    fixed = {name: getattr(start, name) for name in NAMES if name not in moving}
    return np.array(low._replace(**fixed)), np.array(high._replace(**fixed))


def named(numbers: Numbers) -> dict[str, Any]:
    """The parameters that these numbers give, by name; a kind that never occurred has the share 0. Complex numbers give
    complex parameters."""
    log_odds = np.array([0.0, numbers.log_odds_short, numbers.log_odds_missed, numbers.log_odds_random])
    odds = np.where(log_odds.real > LEAST_LOG_ODDS, np.exp(log_odds), 0.0)
    sigma = PARAMETERS["sigma_cm"]
    sigma_cm = np.clip(np.exp(numbers.log_sigma), sigma.least, sigma.most)
    others = sigma_cm, numbers.rate, numbers.saturated, np.sqrt(numbers.sigma_growth_2), numbers.missed_growth
    return dict(zip(PARAMETERS, np.array([*odds / odds.sum(), *others]).tolist(), strict=True))


def slopes_of(numbers: Numbers) -> Array:
    """Derivatives of `named` by the numbers, (9, 8), by a complex step, which is exact (Squire & Trapp 1998)."""
    steps = np.array(numbers) + STEP * 1j * np.eye(len(NAMES))
    return np.array([[value.imag / STEP for value in named(Numbers(*at)).values()] for at in steps]).T


def with_floors(parameters: MixtureParameters, saturates: bool) -> tuple[MixtureParameters, tuple[str, ...]]:
    """Return the parameters with no share below `MIN_WEIGHT`, and the names of those that were raised.

    The saturated fraction is one of them where the sensor ``saturates``: may read 255 for no echo.

    Examples
    --------
    >>> weights = {"hit": 1.0, "short": 0.0, "missed": 0.0, "random": 0.0}
    >>> given = {"weights": weights, "sigma_cm": 1.0, "short_rate_per_m": 0.5, "saturated_fraction": 0.0}
    >>> found, raised = with_floors(MixtureParameters.model_validate(given), saturates=False)
    >>> print(f"{found.weights.hit:.4f} {found.weights.random:g} {', '.join(raised)}")
    0.9997 0.0001 short, missed, random
    """
    shares = parameters.weights.model_dump()
    raised = tuple(name for name, share in shares.items() if share < MIN_WEIGHT)
    seldom = ("saturated_fraction",) if saturates and parameters.saturated_fraction < MIN_WEIGHT else ()
    if seldom:
        parameters = parameters.model_copy(update={"saturated_fraction": MIN_WEIGHT})
    if not raised:
        return parameters, seldom
    floored = {name: max(share, MIN_WEIGHT) for name, share in shares.items()}
    # The largest share pays for it.
    largest = max(shares, key=lambda name: shares[name])
    floored[largest] -= sum(floored.values()) - 1.0
    weights = parameters.weights.model_copy(update=floored)
    return parameters.model_copy(update={"weights": weights}), (*raised, *seldom)
