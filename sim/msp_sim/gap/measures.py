"""How far readings are from a model, in cells of context: bias, spread, odds of the outliers, and nats a reading.

A model, readings with their contexts and a partition enter. In each cell the model gets five numbers of its own (a
shift of the hits, a factor of their spread, odds of short, missed and random readings), fitted by maximum likelihood;
how far they are from nothing, less what chance adds, is the gap. Its unit of chance is the run or the block of
readings that depend on each other, not the reading.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msp_sim.gap.cells import Partition
from msp_sim.model.model import Model
from msp_sim.model.rows import Rows

_Array = NDArray[np.float64]

CHANNELS = ("bias", "spread", "short", "missed", "random")
STEPS = (0.05, 0.02, 0.02, 0.02, 0.02)
"""Of the derivatives: of the bias in standard deviations of a hit, of the others as they are."""
PRIOR_SD = (50.0, 2.0, 2.5, 2.5, 2.5)
"""Weak prior in the same units: what a cell says nothing of stays where it is."""
ROUNDS = 12
MOST_BIAS_CM, MOST_BIAS_SHARE = 10.0, 0.2
"""Of the range: what is farther off is another echo, and no bias of this one."""
LOG_LEAST = np.log(1e-12)
"""Of a reading that the model cannot give: it counts as a code, and not as ever so improbable."""


@dataclass(frozen=True)
class Table:
    """Readings to hold against a model.

    Attributes
    ----------
    reading_cm
        (n,) whole centimetres, no NaN.
    contexts
        Columns of length n.
    unit
        Readings of the same number depend on each other: run or block, (n,).
    """

    reading_cm: _Array
    contexts: Mapping[str, NDArray[Any]]
    unit: NDArray[np.intp]

    def __len__(self) -> int:
        return self.reading_cm.size

    def take(self, rows: NDArray[Any]) -> "Table":
        """Some of the readings."""
        return Table(
            self.reading_cm[rows], {name: column[rows] for name, column in self.contexts.items()}, self.unit[rows]
        )


@dataclass(frozen=True)
class Scores:
    """Derivatives of each reading's log probability by the five numbers, at these values of them.

    Attributes
    ----------
    log_p
        (n,).
    scores
        (n, 5): by the bias in standard deviations, and by the four logarithms.
    """

    log_p: _Array
    scores: _Array


@dataclass(frozen=True)
class FreeFit:
    """The five numbers of each of K cells, and what they gain.

    Attributes
    ----------
    counts
        Readings a cell, (K,).
    values, errors
        (K, 5): bias [cm], logarithms of spread and odds; standard errors that know of the units.
    gain_nats, chance_nats
        In log-likelihood, and how much of it is chance, both sums over a cell, (K,).
    """

    counts: NDArray[np.intp]
    values: _Array
    errors: _Array
    gain_nats: _Array
    chance_nats: _Array

    @property
    def nats(self) -> float:
        """Gain a reading without what is chance."""
        return float((self.gain_nats - self.chance_nats).sum() / max(self.counts.sum(), 1))

    @property
    def nats_error(self) -> float:
        """Its standard error, were the gain a sum of squares of normal numbers."""
        excess = np.maximum(self.gain_nats - self.chance_nats, 0.0)
        per_number = self.chance_nats / len(CHANNELS) * 2.0
        variance = (len(CHANNELS) / 2.0) * per_number**2 + 2.0 * per_number * excess
        return float(np.sqrt(variance.sum()) / max(self.counts.sum(), 1))

    def mean_square(self, channel: str) -> tuple[float, float]:
        """Mean over the cells of a number's square, without what is chance; and its standard error."""
        i = CHANNELS.index(channel)
        values, variance = self.values[:, i], self.errors[:, i] ** 2
        known = np.isfinite(values) & (variance > 0.0)
        if channel not in ("bias", "spread"):
            known &= variance < LARGEST_VARIANCE
        if known.sum() < 0.7 * values.size:
            return 0.0, np.inf
        values, variance = values[known], variance[known]
        # Odds of rare outliers are known much better in some cells than in others.
        weight = self.counts[known].astype(float) if channel in ("bias", "spread") else 1.0 / variance
        weight = weight / weight.sum()
        square = float((weight * (values**2 - variance)).sum())
        error = float(np.sqrt((weight**2 * (2.0 * variance**2 + 4.0 * variance * values**2)).sum()))
        return square, error


def usable(model: Model, table: Table) -> NDArray[np.bool_]:
    """Readings that the model can give at all, (n,)."""
    found = np.empty(len(table), dtype=bool)
    for part, rows in model.chunks(table.contexts):
        found[part] = rows.log_prob(table.reading_cm[part]) > LOG_LEAST
    return found


def scores_of(model: Model, table: Table, numbers: _Array | None = None) -> Scores:
    """Log probabilities and their derivatives.

    Parameters
    ----------
    model, table
        All readings are ones that the model can give.
    numbers
        The five numbers of each reading (n, 5), the bias in standard deviations; None: nothing.
    """
    log_p, scores = np.empty(len(table)), np.empty((len(table), len(CHANNELS)))
    for part, rows in model.chunks(table.contexts):
        here = None if numbers is None else numbers[part]
        reading = table.reading_cm[part]
        log_p[part] = _log_prob(rows, reading, here)
        for i, step in enumerate(STEPS):
            more, less = np.zeros(len(CHANNELS)), np.zeros(len(CHANNELS))
            more[i], less[i] = step, -step
            upper = _log_prob(rows, reading, more if here is None else here + more)
            lower = _log_prob(rows, reading, less if here is None else here + less)
            with np.errstate(invalid="ignore"):
                scores[part, i] = (upper - lower) / (2.0 * step)
    return Scores(log_p, np.nan_to_num(scores, nan=0.0, posinf=0.0, neginf=0.0))


def one_step(
    scores: Scores, table: Table, partition: Partition, sigma_cm: _Array, information: _Array | None = None
) -> FreeFit:
    """The free fit by one step of Fisher's scoring from the model: right where the gap is small, and quick.

    Parameters
    ----------
    scores, table, partition, sigma_cm
        As for `free_fit`.
    information
        Of each cell (K, 5, 5), from twins; None: from these readings, which say little where outliers are few.
    """
    total, own = _sums(scores.scores, partition)
    inverse = np.linalg.inv((own if information is None else information) + _prior())
    step = np.einsum("kij,kj->ki", inverse, total)
    speaks = np.einsum("kij,kji->k", inverse, np.linalg.inv(inverse) - _prior())
    errors = np.sqrt(np.diagonal(inverse, axis1=1, axis2=2))
    scale = _scale(partition, sigma_cm)
    gain = 0.5 * np.einsum("ki,ki->k", step, total)
    return FreeFit(partition.counts, step * scale, errors * scale, gain, 0.5 * speaks)


def free_fit(model: Model, table: Table, partition: Partition, first: Scores, sigma_cm: _Array) -> FreeFit:
    """The free fit by as many steps as it needs, from a robust beginning.

    Parameters
    ----------
    model, table, partition
        Readings that the model can give, and their cells.
    first
        `scores_of` the model as it is.
    sigma_cm
        Standard deviation of each reading's hit [cm], (n,).
    """
    cell, cells = partition.cell, len(partition.labels)
    prior = _prior()
    numbers = _beginning(model, table, partition, sigma_cm)
    base = _sum_by(cell, first.log_p, cells)
    zero_is_best = _posterior(_log_sum(model, table, partition, numbers), numbers, prior) < base
    numbers[zero_is_best] = 0.0
    now = scores_of(model, table, numbers[cell])
    best = _posterior(_sum_by(cell, now.log_p, cells), numbers, prior)
    for _ in range(ROUNDS):
        total, information = _sums(now.scores, partition)
        step = np.linalg.solve(information + prior, (total - numbers @ prior)[..., None])[..., 0]
        step *= np.minimum(1.0, 2.0 / np.maximum(np.abs(step).max(axis=1, keepdims=True), 1e-12))
        trial, trial_best = numbers, best
        for shorter in (1.0, 0.3, 0.05):
            tried = numbers + shorter * step
            value = _posterior(_log_sum(model, table, partition, tried), tried, prior)
            better = value > trial_best
            trial = np.where(better[:, None], tried, trial)
            trial_best = np.where(better, value, trial_best)
            if better.mean() > 0.7:
                break
        gained = trial_best - best
        numbers, best = trial, trial_best
        now = scores_of(model, table, numbers[cell])
        if gained.max() < 0.02:
            break
    _, information = _sums(now.scores, partition)
    gain = _sum_by(cell, now.log_p, cells) - base
    return _fitted(numbers, gain, information + prior, now.scores, table, partition, sigma_cm)


def _fitted(
    numbers: _Array,
    gain: _Array,
    information: _Array,
    scores: _Array,
    table: Table,
    partition: Partition,
    sigma_cm: _Array,
) -> FreeFit:
    """With errors by units."""
    inverse = np.linalg.inv(information)
    spread = _unit_variance(scores, table.unit, partition)
    by_unit = inverse @ spread @ inverse
    # Of one or two units nothing can be known of what they share, so at least what independent readings would have.
    variance = np.maximum(np.diagonal(by_unit, axis1=1, axis2=2), np.diagonal(inverse, axis1=1, axis2=2))
    scale = _scale(partition, sigma_cm)
    # Where readings are independent, this is the number of parameters of which the data speak.
    independent = np.trace(inverse @ (information - _prior()), axis1=1, axis2=2)
    trace = np.maximum(np.trace(inverse @ spread, axis1=1, axis2=2), independent)
    return FreeFit(partition.counts, numbers * scale, np.sqrt(variance) * scale, gain, 0.5 * trace)


def _scale(partition: Partition, sigma_cm: _Array) -> _Array:
    """From standard deviations of a hit to centimetres, (K, 5)."""
    scale = np.ones((len(partition.labels), len(CHANNELS)))
    scale[:, 0] = _sum_by(partition.cell, sigma_cm, len(partition.labels)) / np.maximum(partition.counts, 1)
    return scale


def _unit_variance(scores: _Array, unit: NDArray[np.intp], partition: Partition) -> _Array:
    """Sum over units of the outer products of a cell's score sums, (K, 5, 5)."""
    cells, size = len(partition.labels), len(CHANNELS)
    of_cell, _, sums = unit_sums(scores, unit, partition)
    found = np.empty((cells, size, size))
    for i in range(size):
        for j in range(i, size):
            found[:, i, j] = found[:, j, i] = _sum_by(of_cell, sums[:, i] * sums[:, j], cells)
    groups = np.bincount(of_cell, minlength=cells)
    correction = np.where(groups > 1, groups / np.maximum(groups - 1, 1), 0.0)
    return np.asarray(found * correction[:, None, None])


def unit_sums(
    scores: _Array, unit: NDArray[np.intp], partition: Partition
) -> tuple[NDArray[np.intp], NDArray[np.intp], _Array]:
    """Sums of the scores of each unit in each cell where it has readings: cell, unit, (m, 5)."""
    units = int(unit.max()) + 1 if unit.size else 1
    key = partition.cell * units + unit
    seen = np.bincount(key, minlength=units * len(partition.labels))
    present = np.flatnonzero(seen)
    sums = np.stack([_sum_by(key, scores[:, i], seen.size)[present] for i in range(scores.shape[1])], axis=1)
    return (present // units).astype(np.intp), (present % units).astype(np.intp), sums


def _beginning(model: Model, table: Table, partition: Partition, sigma_cm: _Array) -> _Array:
    """Median and spread of what looks like hits, cell by cell: a gap of many sigma has no slope to follow."""
    numbers = np.zeros((len(partition.labels), len(CHANNELS)))
    centre = np.concatenate([rows.centre_cm for _, rows in model.chunks(table.contexts)] or [np.zeros(0)])
    maximum_cm = model.sensor.maximum_cm
    usual = (table.reading_cm < maximum_cm) & np.isfinite(centre)
    with np.errstate(invalid="ignore"):
        off = (table.reading_cm - centre) / sigma_cm
    order = np.argsort(partition.cell, kind="stable")
    ends = np.cumsum(partition.counts)
    for i, rows in enumerate(np.split(order, ends[:-1])):
        here = off[rows[usual[rows]]]
        if here.size < 10:
            continue
        low, middle, high = np.quantile(here, [0.25, 0.5, 0.75])
        scale_cm = float(np.mean(sigma_cm[rows]))
        if abs(middle) * scale_cm > MOST_BIAS_CM + MOST_BIAS_SHARE * float(np.nanmedian(centre[rows])):
            continue
        spread = max((high - low) / 1.349, 0.05)
        numbers[i, 0] = middle
        numbers[i, 1] = np.clip(np.log(spread), -2.0, 3.0)
    return numbers


def _log_prob(rows: Rows, reading_cm: _Array, numbers: _Array | None) -> _Array:
    """Log probability with the five numbers, (5,) or (n, 5); of what cannot be, the least."""
    if numbers is not None:
        shift, spread, short, missed, random = numbers.T
        logs = rows.log_weights
        rows = replace(
            rows,
            centre_cm=rows.centre_cm + shift * rows.sigma_cm,
            sigma_cm=rows.sigma_cm * np.exp(spread),
            log_weights=(logs[0], logs[1] + short, logs[2] + missed, logs[3] + random),
        )
    return np.maximum(rows.log_prob(reading_cm), LOG_LEAST)


def _log_sum(model: Model, table: Table, partition: Partition, numbers: _Array) -> _Array:
    """Log-likelihood of each cell with its numbers, (K,)."""
    found = np.empty(len(table))
    for part, rows in model.chunks(table.contexts):
        found[part] = _log_prob(rows, table.reading_cm[part], numbers[partition.cell[part]])
    return _sum_by(partition.cell, found, len(partition.labels))


def _sum_by(index: NDArray[np.intp], values: _Array, count: int) -> _Array:
    """Sums of the values of each index, (count,)."""
    sums: Any = np.bincount(index, values, count)
    return np.asarray(sums, dtype=np.float64)


def _posterior(log_sum: _Array, numbers: _Array, prior: _Array) -> _Array:
    found: _Array = log_sum - 0.5 * np.einsum("ki,ij,kj->k", numbers, prior, numbers)
    return found


def _prior() -> _Array:
    return np.diag(1.0 / np.square(PRIOR_SD))


def _sums(scores: _Array, partition: Partition) -> tuple[_Array, _Array]:
    """Of each cell the sum of the scores (K, 5) and of their outer products (K, 5, 5)."""
    cells, size = len(partition.labels), len(CHANNELS)
    total = np.stack([_sum_by(partition.cell, scores[:, i], cells) for i in range(size)], axis=1)
    products = np.empty((cells, size, size))
    for i in range(size):
        for j in range(i, size):
            products[:, i, j] = products[:, j, i] = _sum_by(partition.cell, scores[:, i] * scores[:, j], cells)
    return total, products


def sigma_of(model: Model, table: Table) -> _Array:
    """Standard deviation of each reading's hit [cm], (n,)."""
    return np.concatenate([rows.sigma_cm for _, rows in model.chunks(table.contexts)] or [np.zeros(0)])


@dataclass(frozen=True)
class Number:
    """A measure of the gap with its 95 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Measures:
    """The four measures; each is that of the partition in which it is largest.

    Attributes
    ----------
    nats, bias_cm, spread_ratio, short, missed, random
        As in `findings.Gap`.
    fits
        Free fits, by the partition's variables.
    log_score
        Mean log probability of a reading [nat].
    """

    nats: Number
    bias_cm: Number
    spread_ratio: Number
    short: Number
    missed: Number
    random: Number
    fits: Mapping[tuple[str, ...], FreeFit]
    log_score: float

    def numbers(self) -> dict[str, Number]:
        """The measures by name."""
        names = ("nats", "bias_cm", "spread_ratio", "short", "missed", "random")
        return {name: getattr(self, name) for name in names}


ITERATED = 3
"""Partitions in which the free fit goes all its way, beside the whole: those that differ most in one step."""
LARGEST_VARIANCE = 0.3
"""Of the logarithm of a class's odds in a cell, for the cell to count: about three such outliers."""


@dataclass(frozen=True)
class Twins:
    """What readings show that a model itself drew at the same contexts.

    Attributes
    ----------
    information
        Of each cell's five numbers (K, 5, 5), by the partition's variables.
    floor
        What 95 of 100 twins are below, by measure.
    """

    information: Mapping[tuple[str, ...], _Array]
    floor: Mapping[str, float]


def twins(
    model: Model, table: Table, parts: Sequence[Partition], count: int, rng: np.random.Generator, share: float = 0.95
) -> Twins:
    """Simulate the readings again and again and measure a gap that is not there.

    Parameters
    ----------
    model
        Draws the twins at the contexts of the table.
    table, parts
        As for `measure`.
    count
        How many twins.
    rng
        Source of their chance.
    share
        Of the twins that are below the floor.
    """
    sigma_cm = sigma_of(model, table)
    drawn = [replace(table, reading_cm=model.sample(table.contexts, rng)) for _ in range(count)]
    scores = [scores_of(model, twin) for twin in drawn]
    information = {
        each.variables: sum((_sums(one.scores, each)[1] for one in scores), start=np.zeros(1)) / count for each in parts
    }
    shown: dict[str, list[float]] = {}
    for twin, one in zip(drawn, scores, strict=True):
        fits = {each.variables: one_step(one, twin, each, sigma_cm, information[each.variables]) for each in parts}
        kept = _kept(fits, parts)
        for name, number in _measures({key: fits[key] for key in kept}, 0.0).numbers().items():
            shown.setdefault(name, []).append(number.value)
    return Twins(information, {name: _quantile(values, share) for name, values in shown.items()})


def _quantile(values: Sequence[float], share: float) -> float:
    known = [value for value in values if np.isfinite(value)]
    return float(np.quantile(known, share)) if known else np.nan


def measure(model: Model, table: Table, parts: Sequence[Partition], twins: Twins) -> Measures:
    """The gap between a model and readings.

    Parameters
    ----------
    model, table
        All readings are ones that the model can give.
    parts
        Partitions, the first of which is the whole.
    twins
        Of this model or one that is near it, at these contexts.
    """
    sigma_cm = sigma_of(model, table)
    first = scores_of(model, table)
    fits = {each.variables: one_step(first, table, each, sigma_cm, twins.information[each.variables]) for each in parts}
    by_name = {each.variables: each for each in parts}
    kept = {key: free_fit(model, table, by_name[key], first, sigma_cm) for key in _kept(fits, parts)}
    return _measures(kept, float(first.log_p.mean()))


def _kept(fits: Mapping[tuple[str, ...], FreeFit], parts: Sequence[Partition]) -> list[tuple[str, ...]]:
    """The whole and those partitions that differ most."""
    by_nats = sorted((each.variables for each in parts[1:]), key=lambda key: -fits[key].nats)
    return [parts[0].variables, *by_nats[:ITERATED]]


def _measures(fits: Mapping[tuple[str, ...], FreeFit], log_score: float) -> Measures:
    nats = max(fits.values(), key=lambda fit: fit.nats)
    error = 1.96 * nats.nats_error
    return Measures(
        nats=Number(max(nats.nats, 0.0), max(nats.nats - error, 0.0), max(nats.nats + error, 0.0)),
        bias_cm=_largest(fits, "bias"),
        spread_ratio=_largest(fits, "spread"),
        short=_largest(fits, "short"),
        missed=_largest(fits, "missed"),
        random=_largest(fits, "random"),
        fits=fits,
        log_score=log_score,
    )


def _largest(fits: Mapping[tuple[str, ...], FreeFit], channel: str) -> Number:
    """Root mean square of a number over the cells of the partition in which it is surest; NaN: outliers are too few."""
    squares = [fit.mean_square(channel) for fit in fits.values()]
    square, error = max(squares, key=lambda each: each[0] - each[1])
    if not np.isfinite(error):
        return Number(np.nan, np.nan, np.nan)
    ends = [float(np.sqrt(max(each, 0.0))) for each in (square, square - 1.96 * error, square + 1.96 * error)]
    return Number(*(ends if channel == "bias" else np.exp(ends).tolist()))
