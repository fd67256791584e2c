"""How far readings are from a model, in cells of context: bias, spread, odds of outliers, nats per reading.

How far the five numbers of each cell (`cell_fits`) are from nothing, less what random variation adds, is the gap. What
tables that the model itself draws show of it is the noise floor.

How much an error repeats in the readings that follow is the autocorrelation of residuals: of each reading's place in
the model's distribution, given the readings before it, as a normal deviate. Where the model is right these are
independent, its own correlated noise included.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from msp_lab.gap import rules
from msp_lab.gap.cell_fits import (
    CellFits,
    drawn_sums,
    free_fit,
    one_step,
    scores_of,
    unit_sums,
    unit_variance,
)
from msp_lab.gap.cells import Partition, Stack
from msp_lab.gap.runs import dependence, reading_before, taken
from msp_range.arrays import Array, Column, Flags, Indices
from msp_range.reading_model.rows import MIN_PROBABILITY
from msp_sim.model.model import Model
from msp_sim.model.rows import ModelRows
from msp_sim.model.streams import RandomStreams

CHANNEL_OF = {
    "bias_cm": "bias",
    "spread_ratio": "spread",
    "odds_short": "short",
    "odds_missed": "missed",
    "odds_random": "random",
}
"""The channel of each measure but the nats per reading."""
BOOTSTRAPS_PER_REPLICATE = 2
"""Bootstrap draws of dependent units for each replicate: they are cheap."""
LAGS = 20
"""Readings back to which it is drawn: correlated noise and held values have decayed by then in all recordings tried."""
MIN_PAIRS = 30
"""A lag with fewer pairs of readings is left out: its band would be wider than 0.35."""
FARTHEST = 4.0
"""Residuals are cut there [standard deviations], so that a few impossible readings do not make the picture."""


@dataclass(frozen=True)
class HeldOutReadings:
    """Held-out readings, on which models are measured."""

    reading_cm: Array
    """Readings, (n,), multiples of the model's resolution, no NaN."""
    contexts: Mapping[str, Column]
    """Columns of length n."""
    unit: Indices
    """Readings of the same number depend on each other: run or block, (n,)."""

    def __len__(self) -> int:
        return self.reading_cm.size

    def take(self, rows: Column) -> "HeldOutReadings":
        """Some of the readings."""
        return HeldOutReadings(self.reading_cm[rows], taken(self.contexts, rows), self.unit[rows])


def usable(model: Model, readings: HeldOutReadings) -> Flags:
    """Readings that the model can give at all, (n,)."""
    found = np.empty(len(readings), dtype=bool)
    for part, rows in model.chunks(readings.contexts):
        found[part] = rows.log_prob(readings.reading_cm[part]) > np.log(MIN_PROBABILITY)
    return found


@dataclass(frozen=True)
class Interval:
    """A measure of the gap with its 95 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Measures:
    """What readings show of a model."""

    readings: HeldOutReadings
    """The readings."""
    rows: ModelRows
    """Distributions of the readings by the model."""
    stack: Stack
    """The cells of all partitions."""
    scores: Array
    """Derivatives of each reading's log probability by the five numbers, (n, 5)."""
    step: CellFits
    """Free fits of all cells by one step from the model."""
    fits: Mapping[tuple[str, ...], CellFits]
    """Free fits of the partitions that differ most, by their variables."""
    numbers: Mapping[str, Interval]
    """The measures by name, as in `findings.Gap`; each is that of the partition in which it is largest."""
    noise_floor: Mapping[str, float]
    """Noise floor of each measure."""
    log_score: float
    """Mean log probability of a reading [nat]."""


@dataclass(frozen=True)
class Replicates:
    """What tables show that a model itself draws at the same contexts (parametric bootstrap)."""

    information: Array
    """Information on each cell's five numbers (K, 5, 5), the partitions' cells one after another."""
    noise_floor: Mapping[str, float]
    """What most replicates stay below, by measure; where readings depend on each other, at least what the score sums of
    whole units show by random variation."""


def replicates(
    model: Model,
    readings: HeldOutReadings,
    parts: Sequence[Partition],
    count: int,
    rng: np.random.Generator,
) -> Replicates:
    """Simulate the readings again and again and measure a gap that is not there.

    Parameters
    ----------
    model
        Draws tables at the contexts of the readings.
    readings, parts
        As for `measure`.
    count
        How many tables.
    rng
        Random generator.
    """
    drawn_rows, stack = model.rows(readings.contexts), Stack.of(parts)
    rows = drawn_rows.marginal
    depends = bool(drawn_rows.run_offsets) or drawn_rows.history is not None
    totals, variances, information = [], [], np.zeros(1)
    for _ in range(count):
        _, scores = scores_of(rows, drawn_rows.sample(RandomStreams(rng)))
        totals.append(stack.sums(scores))
        information = information + stack.products(scores) / count
        # Replicates show what the model itself lets runs share.
        shared = unit_variance(scores[stack.readings], readings.unit, stack, scores)[0] if depends else None
        variances.append(shared)

    def fits(totals: Iterable[Array], variances: Iterable[Array | None]) -> list[CellFits]:
        pairs = zip(totals, variances, strict=True)
        return [one_step(total, information, stack, rows.sigma_cm, by_unit) for total, by_unit in pairs]

    floor = _noise_floor(fits(totals, variances), stack)
    _, scores = scores_of(rows, readings.reading_cm)
    if dependence(scores[:, 0], readings.unit, readings.contexts.get("time_s")).dependent:
        _, about_mean, there = unit_sums(scores[stack.readings], readings.unit, stack)
        draws = drawn_sums(about_mean, there, BOOTSTRAPS_PER_REPLICATE * count, rng)
        drawn = _noise_floor(fits(*draws), stack)
        floor = {name: _widened(name, floor[name], value) for name, value in drawn.items()}
    return Replicates(information, floor)


def _widened(name: str, plain: float, dependent: float) -> float:
    """The noise floor of dependent readings: at most so many times that of replicates."""
    nothing = 0.0 if name in ("nats_per_reading", "bias_cm") else 1.0
    return float(np.fmax(plain, np.fmin(dependent, nothing + rules.NOISE_FLOOR_MAX_WIDENING * (plain - nothing))))


def _noise_floor(fits: Sequence[CellFits], stack: Stack) -> dict[str, float]:
    """What the rule's share of the fits stay below, by measure."""
    shown: dict[str, list[float]] = {}
    for fit in fits:
        by_variables = _by_variables(fit, stack)
        kept = {key: by_variables[key] for key in _kept(by_variables)}
        for name, number in _measures(kept).items():
            shown.setdefault(name, []).append(number.value)
    known = {name: [value for value in values if np.isfinite(value)] for name, values in shown.items()}
    return {name: float(np.quantile(values or [np.nan], rules.NOISE_FLOOR_SHARE)) for name, values in known.items()}


def measure(model: Model, readings: HeldOutReadings, parts: Sequence[Partition], drawn: Replicates) -> Measures:
    """The gap between a model and readings.

    Parameters
    ----------
    model, readings
        The model can give all readings.
    parts
        Partitions, the first of which is the whole.
    drawn
        Replicates of this model or one that is near it, at these contexts.
    """
    rows, stack = model.rows(readings.contexts).marginal, Stack.of(parts)
    _, scores = scores_of(rows, readings.reading_cm)
    step = one_step(stack.sums(scores), drawn.information, stack, rows.sigma_cm)
    kept = set(_kept(_by_variables(step, stack)))
    fits = free_fits(rows, readings, [part for part in parts if part.variables in kept])
    return Measures(
        readings, rows, stack, scores, step, fits, _measures(fits), drawn.noise_floor, log_score(model, readings)
    )


def log_score(model: Model, readings: HeldOutReadings) -> float:
    """Mean log probability of a reading, each bounded below [nat]."""
    log_p = model.log_prob(readings.reading_cm, readings.contexts)
    return float(np.maximum(log_p, np.log(MIN_PROBABILITY)).mean())


def free_fits(
    rows: ModelRows, readings: HeldOutReadings, parts: Sequence[Partition]
) -> dict[tuple[str, ...], CellFits]:
    """The free fit of each partition, by its variables."""
    stack = Stack.of(parts)
    return _by_variables(free_fit(rows, readings.reading_cm, readings.unit, stack), stack)


def _by_variables(fit: CellFits, stack: Stack) -> dict[tuple[str, ...], CellFits]:
    return {part.variables: fit.take(cells) for part, cells in stack.each()}


def _kept(fits: Mapping[tuple[str, ...], CellFits]) -> list[tuple[str, ...]]:
    """The whole, which is the first, and those partitions that differ most."""
    whole, *others = fits
    return [whole, *sorted(others, key=lambda key: -fits[key].nats)[: rules.ITERATED_PARTITIONS]]


def _measures(fits: Mapping[tuple[str, ...], CellFits]) -> dict[str, Interval]:
    nats = max(fits.values(), key=lambda fit: fit.nats)
    error = 1.96 * nats.nats_error
    ends = (max(end, 0.0) for end in (nats.nats, nats.nats - error, nats.nats + error))
    return {
        "nats_per_reading": Interval(*ends),
        **{name: _largest(fits, channel) for name, channel in CHANNEL_OF.items()},
    }


def _largest(fits: Mapping[tuple[str, ...], CellFits], channel: str) -> Interval:
    """Root mean square of a number over the cells of the partition in which it is surest; NaN: outliers are too few."""
    squares = [fit.mean_square(channel) for fit in fits.values()]
    square, error = max(squares, key=lambda pair: pair[0] - pair[1])
    if not np.isfinite(error):
        return Interval(np.nan, np.nan, np.nan)
    ends = [float(np.sqrt(max(end, 0.0))) for end in (square, square - 1.96 * error, square + 1.96 * error)]
    return Interval(*(ends if channel == "bias" else np.exp(ends).tolist()))


@dataclass(frozen=True)
class Autocorrelation:
    """Autocorrelation of residuals, by lag."""

    apart: Array
    """Median time between the two readings of a pair [s], or their distance in readings, (k,)."""
    in_seconds: bool
    """Whether ``apart`` is in seconds."""
    value: Array
    """Correlation, (k,)."""
    band: Array
    """What 95 % of independent residuals stay within, (k,)."""


def residual_autocorrelation(model: Model, readings: HeldOutReadings, rng: np.random.Generator) -> Autocorrelation:
    """Correlation of each residual with that of the same sensor and run some readings before."""
    n = len(readings)
    residual = np.clip(ndtri(places(model, readings, rng)), -FARTHEST, FARTHEST)
    residual -= residual.mean()
    variance = max(float(np.mean(residual**2)), 1e-12)
    before, _ = reading_before(readings.contexts, n)
    time_s = readings.contexts.get("time_s")
    apart, value, pairs = [], [], []
    back = np.arange(n)
    for lag in range(1, LAGS + 1):
        back = np.where(back >= 0, before[back], -1)
        rows = np.flatnonzero(back >= 0)
        if rows.size < MIN_PAIRS:
            break
        apart.append(float(lag) if time_s is None else float(np.nanmedian(time_s[rows] - time_s[back[rows]])))
        value.append(float(np.mean(residual[rows] * residual[back[rows]])) / variance)
        pairs.append(rows.size)
    return Autocorrelation(np.array(apart), time_s is not None, np.array(value), 1.96 / np.sqrt(np.array(pairs)))


def places(model: Model, readings: HeldOutReadings, rng: np.random.Generator) -> Array:
    """Share of the model's readings that are smaller than each reading (randomised in its step), 0 to 1, (n,)."""
    found = np.empty(len(readings))
    for part, rows in model.chunks(readings.contexts):
        reading = readings.reading_cm[part]
        given, _ = rows.given(reading)
        found[part] = np.exp(given.log_below(reading)) + rng.random(reading.size) * np.exp(given.log_prob(reading))
    return np.clip(found, 0.0, 1.0)
