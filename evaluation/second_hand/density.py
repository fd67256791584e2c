"""What a reading may be, and how probable each value is: the generator's own likelihood.

A reading is a hit, short, missed or random. A hit has Student-t noise whose normal scores follow a first-order
autoregression. An effect changes the columns of a `Law`; `log_probability` and `sample.draw` read the same columns.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from evaluation.second_hand.base import MAXIMUM_CM, MINIMUM_CM, SATURATED_CM, Base
from evaluation.second_hand.rows import Floats, Rows

SMALLEST = 1e-300
"""Probability of a reading that cannot be: its logarithm stays a number."""


@dataclass
class Component:
    """A share of the hits that is somewhere else, normally distributed, or exactly at the place where the scatter is 0.

    ``slip_cm`` moves a hit with its noise instead.
    """

    share: Floats
    place_cm: Floats
    scatter_cm: float = 0.0
    slip_cm: float = 0.0


@dataclass
class Law:
    """The distribution of each reading before correlation; effects change it in place."""

    centre_cm: Floats
    sigma_cm: Floats
    """Place and standard deviation of a hit."""
    odds: Floats
    """Log odds against a hit of short, missed and random readings, shape (3, rows)."""
    components: list[Component] = field(default_factory=list)
    """What takes a share of the hits."""
    repeated: float = 0.0
    """Share of the readings that are the sensor's previous one once more."""
    coarse: float = 0.0
    coarse_step_cm: float = 1.0
    """Share of the hits that are rounded to a step."""


class Drawn(NamedTuple):
    """Readings with what the generator knows of them.

    ``exact_cm`` is a hit before rounding; ``history`` is the index of the last hit of the block before each row (-1:
    none) and ``link`` the correlation of the noise of the two.
    """

    reading_cm: Floats
    exact_cm: Floats
    kind: NDArray[np.int64]
    history: NDArray[np.int64]
    link_steps: Floats
    previous_cm: Floats


def base_law(rows: Rows, base: Base) -> Law:
    """The distribution without any hidden effect."""
    z = rows.true_cm
    ones = np.ones(len(rows))
    return Law(
        centre_cm=base.offset_cm + (1 + base.scale) * z,
        sigma_cm=base.sigma_cm * np.maximum(1 + base.growth_per_m * z / 100, 0.05),
        odds=np.array([base.short * ones, base.missed * ones, base.random * ones]),
    )


def steps_between(rows: Rows, base: Base, earlier: NDArray[np.int64], position: NDArray[np.int64]) -> Floats:
    """Exponent of the correlation between each row and an earlier one: readings, or time in mean spacings."""
    safe = np.maximum(earlier, 0)
    if base.correlation_time == "reading":
        return np.asarray(np.maximum(position - position[safe], 0), dtype=float)
    return np.maximum((rows.time_s - rows.time_s[safe]) / rows.spacing_s, 0.0)


def t_unit(degrees: float) -> float:
    """Factor that gives Student's t the standard deviation 1."""
    return float(np.sqrt((degrees - 2) / degrees))


def normal_score(noise: Floats, degrees: float) -> Floats:
    """Normal score of a Student-t noise of standard deviation 1 (the same probability), by a table of 8,001 points."""
    places, values = _score_table(degrees)
    return np.interp(np.arcsinh(noise), places, values)


@lru_cache(maxsize=8)
def _score_table(degrees: float) -> tuple[Floats, Floats]:
    """Normal scores over the inverse hyperbolic sine of the noise: to 1e-6, far out in the tails too."""
    places = np.linspace(-np.arcsinh(2000.0), np.arcsinh(2000.0), 8001)
    t = np.sinh(places) / t_unit(degrees)
    tail = special.ndtri(np.maximum(special.stdtr(degrees, -np.abs(t)), SMALLEST))
    return places, np.where(t > 0, -tail, tail)


def _between(low: Floats, high: Floats) -> Floats:
    """Normal probability between two scores, exact in both tails."""
    flip = low > 0
    a, b = np.where(flip, -high, low), np.where(flip, -low, high)
    found: Floats = special.ndtr(b) - special.ndtr(a)
    return found


def _normal_cell(k: Floats, place: Floats, scatter: Floats | float) -> Floats:
    cell = _between((k - 0.5 - place) / scatter, (k + 0.5 - place) / scatter)
    return np.where(k == MINIMUM_CM, special.ndtr((k + 0.5 - place) / scatter), cell)


def log_probability(rows: Rows, base: Base, law: Law, drawn: Drawn) -> Floats:
    """Log probability of each reading, given the readings before it and which of them were hits.

    Readings before enter as they were before rounding: a bound on the information of the rounded ones that is close
    where the noise is not far below 1 cm.
    """
    k = drawn.reading_cm
    first = drawn.history < 0
    last = np.maximum(drawn.history, 0)
    score_before = normal_score((drawn.exact_cm[last] - law.centre_cm[last]) / law.sigma_cm[last], base.degrees)
    link = np.where(first, 0.0, np.power(max(base.correlation, 0.0), drawn.link_steps))
    mean = np.where(first, 0.0, link * score_before)
    deviation = np.sqrt(1 - link**2)

    def hit_below(edge: Floats) -> Floats:
        found: Floats = (normal_score((edge - law.centre_cm) / law.sigma_cm, base.degrees) - mean) / deviation
        return found

    def hit_cell(low: Floats, high: Floats) -> Floats:
        return _between(hit_below(low), hit_below(high))

    hit = np.where(
        k == MINIMUM_CM,
        special.ndtr(hit_below(k + 0.5)),
        np.where(k >= MAXIMUM_CM, special.ndtr(-hit_below(k - 0.5)), hit_cell(k - 0.5, k + 0.5)),
    )
    if law.coarse:
        hit = (1 - law.coarse) * hit + law.coarse * _coarse_cell(k, law.coarse_step_cm, hit_cell)
    left = np.ones(len(rows))
    mixed = np.zeros(len(rows))
    for part in law.components:
        left = left - part.share
        if part.slip_cm:
            slipped = hit_cell(k - 0.5 - part.slip_cm, k + 0.5 - part.slip_cm)
            mixed += part.share * slipped
        elif part.scatter_cm:
            mixed += part.share * _normal_cell(k, part.place_cm, part.scatter_cm)
        else:
            mixed += part.share * (k == np.rint(part.place_cm))
    hit = np.maximum(left, 0) * hit + mixed
    weights = np.exp(law.odds)
    total = 1 + weights.sum(axis=0)
    fresh = (
        hit
        + weights[0] * short_cell(k, rows.true_cm, base.short_rate_per_m)
        + weights[1] * ((1 - base.saturated) * (k == MAXIMUM_CM) + base.saturated * (k == SATURATED_CM))
        + weights[2] * ((k >= MINIMUM_CM) & (k <= MAXIMUM_CM)) / (MAXIMUM_CM - MINIMUM_CM + 1)
    ) / total
    if law.repeated:
        has_previous = np.isfinite(drawn.previous_cm)
        share = np.where(has_previous, law.repeated, 0.0)
        fresh = (1 - share) * fresh + share * (k == drawn.previous_cm)
    found: Floats = np.log(np.maximum(fresh, SMALLEST))
    return found


def short_cell(k: Floats, true_cm: Floats, rate_per_m: float) -> Floats:
    """Probability of a short reading in whole centimetres: exponential from the minimum to the target."""
    length = np.maximum(np.floor(true_cm) - MINIMUM_CM, 1.0)
    factor = np.exp(-rate_per_m / 100)
    cell = factor ** (k - MINIMUM_CM) * (1 - factor) / (1 - factor**length)
    return np.where((k >= MINIMUM_CM) & (k < MINIMUM_CM + length), cell, 0.0)


def _coarse_cell(k: Floats, step: float, hit_cell: Callable[[Floats, Floats], Floats]) -> Floats:
    """Probability of a hit whose nearest multiple of the step is, in whole centimetres, this reading."""
    multiple = np.rint(k / step)
    total = np.zeros(len(k))
    for shift in (-1, 0, 1):
        place = (multiple + shift) * step
        cell = hit_cell(place - step / 2, place + step / 2)
        total += np.where(np.rint(place) == k, cell, 0.0)
    return total
