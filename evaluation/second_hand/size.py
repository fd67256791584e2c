"""Sizes of effects in standard errors of the generator's own likelihood.

The information of the effects' sizes and of the free numbers of the base is the mean outer product of the scores (per
reading, by central differences) over tables drawn from the truth. An effect of z standard errors is z times the
standard error of its size with everything else free.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from evaluation.second_hand.base import Base
from evaluation.second_hand.density import Drawn, log_probability
from evaluation.second_hand.effect import Effect, law_with
from evaluation.second_hand.flights import TAPE_STD_CM
from evaluation.second_hand.rows import Floats, Rows
from evaluation.second_hand.sample import draw

NUISANCE = {
    "offset_cm": 0.02,
    "scale": 1e-4,
    "sigma_cm": 0.01,
    "growth_per_m": 0.005,
    "degrees": 0.2,
    "correlation": 0.005,
    "short": 0.02,
    "missed": 0.02,
    "random": 0.02,
    "short_rate_per_m": 0.01,
}
"""Numbers of the base that are free next to the effects, with the step of their numerical derivative."""
TABLES = 3
"""Tables over which the information is averaged: 3 leave a scatter of about 3 % of z of an effect on rare readings."""
CLOSE = 0.015
"""The search ends where z is as close to what was asked for [share of it]; far below one standard error."""
STEPS = 12
"""Most steps of the search for a size."""


def scores(rows: Rows, base: Base, effects: Sequence[Effect], sizes: Sequence[float], drawn: Drawn) -> Floats:
    """Derivatives of each reading's log probability, shape (rows, effects + free numbers of the base)."""

    def value(base: Base, sizes: Sequence[float]) -> Floats:
        return log_probability(rows, base, law_with(rows, base, effects, sizes), drawn)

    columns = []
    for index, (effect, size) in enumerate(zip(effects, sizes, strict=True)):
        step = 0.01 * max(size, 0.1 * effect.kind.start)
        up, down = list(sizes), list(sizes)
        up[index], down[index] = size + step, size - step
        columns.append((value(base, up) - value(base, down)) / (2 * step))
    for name in NUISANCE:
        step = NUISANCE[name]
        number = getattr(base, name)
        # A correlation is not below 0, nor 1 or above.
        low = max(number - step, 0.0) if name == "correlation" else number - step
        up_base, down_base = replace(base, **{name: number + step}), replace(base, **{name: low})
        columns.append((value(up_base, sizes) - value(down_base, sizes)) / (number + step - low))
    return np.column_stack(columns)


def information(
    rows: Rows, base: Base, effects: Sequence[Effect], sizes: Sequence[float], seed: int, tables: int = TABLES
) -> NDArray[np.float64]:
    """Expected information of the sizes and of the free numbers of the base, averaged over drawn tables."""
    total = np.zeros((len(effects) + len(NUISANCE), len(effects) + len(NUISANCE)))
    for table in range(tables):
        drawn = draw(rows, base, law_with(rows, base, effects, sizes), np.random.default_rng([seed, table]))
        each = scores(rows, base, effects, sizes, drawn)
        total = total + each.T @ each
    return total / tables


def standard_errors(
    rows: Rows,
    base: Base,
    effects: Sequence[Effect],
    sizes: Sequence[float],
    seed: int,
    tables: int = TABLES,
    known: Floats | None = None,
) -> Floats:
    """Standard errors of the effects' sizes with the base's numbers and the other effects free.

    ``known`` is the information of each base number from other data, as `known_from_bench` gives it.
    """
    matrix = information(rows, base, effects, sizes, seed, tables)
    if known is not None:
        matrix[np.arange(len(effects), len(matrix)), np.arange(len(effects), len(matrix))] += known
    return np.sqrt(_variances(matrix)[: len(effects)])


def known_from_bench(bench: Rows, base: Base, effects: Sequence[Effect], seed: int) -> Floats:
    """Information that the bench table has of the base numbers that are the same as an effect; 0 of the others.

    Only the bench separates a scale that the sensor always had from one that it has in the runs.
    """
    same = {name for effect in effects for name in effect.kind.same_as}
    if not same:
        return np.zeros(len(NUISANCE))
    variances = _variances(information(bench, base, [], [], seed))
    if np.any(bench.placed_cm):
        # Of the placements' errors, each once.
        placements = np.unique(bench.true_cm)
        variances[list(NUISANCE).index("scale")] += TAPE_STD_CM**2 / (placements.size * placements.var())
    return np.array([1 / variance if name in same else 0.0 for name, variance in zip(NUISANCE, variances, strict=True)])


def _variances(matrix: Floats) -> Floats:
    """Diagonal of the inverse; very large of numbers that cannot be separated."""
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-12))
    inverse = np.linalg.inv(matrix / np.outer(scale, scale) + 1e-9 * np.eye(len(matrix)))
    found: Floats = np.diag(inverse) / scale**2
    return found


def sizes_of(
    rows: Rows, bench: Rows, base: Base, effects: Sequence[Effect], asked: float, seed: int
) -> list[float] | None:
    """Sizes with which every effect has as many standard errors as asked; None where one would be impossible.

    Parameters
    ----------
    bench
        The table from which the base's numbers are known that are the same as an effect.
    asked
        Number of standard errors.
    seed
        Of the tables that the information is averaged over.
    """
    sizes = np.array([effect.kind.start for effect in effects])
    limits = np.array([effect.kind.limit for effect in effects])
    slope = np.ones(len(effects))
    known = known_from_bench(bench, base, effects, seed)
    before: tuple[Floats, Floats] | None = None
    tables = 1
    for _ in range(STEPS):
        z = sizes / standard_errors(rows, base, effects, sizes.tolist(), seed, tables, known)
        away = np.abs(z / asked - 1)
        if tables == TABLES and np.all(away < CLOSE):
            return [float(size) for size in sizes]
        if np.any((sizes >= limits) & (z < asked)):
            return None
        if before is not None and len(effects) == 1:
            moved = np.log(sizes / before[0])
            slope = np.where(np.abs(moved) > 0.05, np.log(z / before[1]) / np.where(moved == 0, 1, moved), slope)
            if np.any((slope < 0.1) & (sizes > before[0]) & (z < asked)):
                # A larger effect is not seen any better.
                return None
        if np.all(away < 0.1):
            tables = TABLES
        before = sizes, z
        sizes = np.minimum(sizes * np.clip((asked / z) ** (1 / np.clip(slope, 0.4, 2)), 0.3, 3), limits)
    return None
