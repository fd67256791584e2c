"""How far readings are from a model, in cells of context: bias, spread, odds of the outliers, and nats a reading.

A model, readings with their contexts and partitions enter. How far the five numbers of each cell (`free_fit`) are from
nothing, less what chance adds, is the gap; what simulated twins show of it is its floor.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msp_lab.gap.cells import Partition, Stack
from msp_lab.gap.chance import drawn_sums, unit_sums, unit_variance
from msp_lab.gap.free_fit import FreeFit, apart, free_fit, one_step, products, scores_of
from msp_lab.gap.units import dependence
from msp_sim.model.model import Model
from msp_sim.model.rows import Rows
from msp_sim.model.slopes import LEAST
from msp_sim.model.streams import Streams

_Array = NDArray[np.float64]


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


def usable(model: Model, table: Table) -> NDArray[np.bool_]:
    """Readings that the model can give at all, (n,)."""
    found = np.empty(len(table), dtype=bool)
    for part, rows in model.chunks(table.contexts):
        found[part] = rows.log_prob(table.reading_cm[part]) > np.log(LEAST)
    return found


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


MOST_WIDENED = 10.0
BY_UNIT = 2
"""Draws of the units' chance, for each twin."""
ITERATED = 3
"""Partitions in which the free fit goes all its way, beside the whole: those that differ most in one step."""


@dataclass(frozen=True)
class Twins:
    """What readings show that a model itself drew at the same contexts.

    Attributes
    ----------
    information
        Of each cell's five numbers (K, 5, 5), the partitions' cells one after another.
    floor
        What 95 of 100 twins are below, by measure; where readings depend on each other, at least what the score sums
        of whole units show by chance.
    """

    information: _Array
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
    rows, stack = model.rows(table.contexts), Stack.of(parts)
    totals, variances, information = [], [], np.zeros(1)
    for _ in range(count):
        _, scores = scores_of(rows, rows.sample(Streams(rng)))
        total, outer = apart(stack.sums(products(scores)))
        totals.append(total)
        information = information + outer / count
        # What the model itself lets runs share, its twins show.
        shared = unit_variance(scores[stack.readings], table.unit, stack, scores) if rows.run_offsets else None
        variances.append(shared)

    def fits(totals: Iterable[_Array], variances: Iterable[_Array | None]) -> list[FreeFit]:
        pairs = zip(totals, variances, strict=True)
        return [one_step(total, information, stack, rows.sigma_cm, by_unit) for total, by_unit in pairs]

    floor = _floor(fits(totals, variances), stack, share)
    _, scores = scores_of(rows, table.reading_cm)
    if dependence(scores[:, 0], table.unit, table.contexts.get("time_s")).dependent:
        _, about_mean, there = unit_sums(scores[stack.readings], table.unit, stack)
        drawn = _floor(fits(*drawn_sums(about_mean, there, BY_UNIT * count, rng)), stack, share)
        floor = {name: _widened(name, floor[name], value) for name, value in drawn.items()}
    return Twins(information, floor)


def _widened(name: str, plain: float, dependent: float) -> float:
    """The floor of dependent readings; sums of few runs may show anything, so at most so many times that of twins."""
    nothing = 0.0 if name in ("nats", "bias_cm") else 1.0
    return float(np.fmax(plain, np.fmin(dependent, nothing + MOST_WIDENED * (plain - nothing))))


def _floor(fits: Sequence[FreeFit], stack: Stack, share: float) -> dict[str, float]:
    """What this share of the fits are below, by measure."""
    shown: dict[str, list[float]] = {}
    for fit in fits:
        by_variables = _by_variables(fit, stack)
        kept = {key: by_variables[key] for key in _kept(by_variables)}
        for name, number in _measures(kept, 0.0).numbers().items():
            shown.setdefault(name, []).append(number.value)
    return {name: _quantile(values, share) for name, values in shown.items()}


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
    rows, stack = model.rows(table.contexts), Stack.of(parts)
    log_p, scores = scores_of(rows, table.reading_cm)
    step = one_step(stack.sums(scores), twins.information, stack, rows.sigma_cm)
    kept = set(_kept(_by_variables(step, stack)))
    fits = free_fits(rows, table, [each for each in parts if each.variables in kept])
    return _measures(fits, float(log_p.mean()))


def free_fits(rows: Rows, table: Table, parts: Sequence[Partition]) -> dict[tuple[str, ...], FreeFit]:
    """The free fit of each partition, by its variables."""
    stack = Stack.of(parts)
    return _by_variables(free_fit(rows, table.reading_cm, table.unit, stack), stack)


def _by_variables(fit: FreeFit, stack: Stack) -> dict[tuple[str, ...], FreeFit]:
    return {part.variables: fit.take(cells) for part, cells in stack.each()}


def _kept(fits: Mapping[tuple[str, ...], FreeFit]) -> list[tuple[str, ...]]:
    """The whole, which is the first, and those partitions that differ most."""
    whole, *others = fits
    return [whole, *sorted(others, key=lambda key: -fits[key].nats)[:ITERATED]]


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
