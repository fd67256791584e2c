"""Where readings and model disagree: slices of context, ranked by what differs, corrected for their number.

Readings, a model and partitions enter; slices leave. Each slice is asked for its five numbers (bias, spread, odds of
short, missed and random readings) by the efficient score of the model; the largest of all is judged by the step-down
maximum of their multiplier bootstrap over units (Westfall and Young 1993; Chernozhukov, Chetverikov & Kato 2013,
Annals of Statistics 41). What was fitted in the slice is shown beside it. This finds less than a catalogue of effects
does, and says where to look.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from msp_sim.gap.cells import Partition
from msp_sim.gap.findings import Slice
from msp_sim.gap.measures import CHANNELS, FreeFit, Table, Twins, free_fit, one_step, scores_of, sigma_of, unit_sums
from msp_sim.model.model import Model

_Array = NDArray[np.float64]

DRAWS = 999
MOST_UNITS = 256
"""Units of the bootstrap: more are put together, which loses nothing that matters."""
SHOWN = 40
PAIRS_SHOWN = 2
"""Pairs of variables of which slices are shown: more say the same again."""
Fits: TypeAlias = Mapping[tuple[str, ...], FreeFit]
FEWEST_UNITS = 4
"""In a slice; with fewer, nothing is known of what units share, and it is not judged."""


def ranked(
    model: Model,
    table: Table,
    parts: Sequence[Partition],
    twins: Twins,
    known: Fits,
    rng: np.random.Generator,
    shown: int = SHOWN,
) -> tuple[Slice, ...]:
    """The whole, and then the slices that differ most, the surest first.

    Parameters
    ----------
    model, table, parts, twins
        As for `measures.measure`.
    known
        Free fits that there are already, by the partition's variables.
    rng
        Source of the bootstrap's multipliers.
    shown
        At most so many slices.
    """
    scores, sigma_cm = scores_of(model, table), sigma_of(model, table)
    unit = _pooled(table.unit)
    fits = {
        each.variables: one_step(scores, table, each, sigma_cm, twins.information[each.variables]) for each in parts
    }
    z, null = [], []
    for each in parts:
        of_slice, shares = _contributions(scores.scores, unit, each, fits[each.variables], sigma_cm)
        z.append(of_slice)
        null.append(shares)
    statistic = np.abs(np.concatenate([each.ravel() for each in z]))
    shares = np.concatenate([each.reshape(-1, each.shape[-1]) for each in null])
    p_value = _step_down(statistic, shares, rng)
    places = [(i, k, j) for i, each in enumerate(z) for k in range(each.shape[0]) for j in range(each.shape[1])]
    best: dict[tuple[int, int], int] = {}
    for number in np.argsort(-statistic, kind="stable"):
        i, k, _ = places[int(number)]
        best.setdefault((i, k), int(number))
    pairs: list[int] = []
    first = [(0, 0)]
    for i, k in sorted(best, key=lambda key: -statistic[best[key]]):
        if len(parts[i].variables) > 1 and i not in pairs:
            if len(pairs) == PAIRS_SHOWN:
                continue
            pairs.append(i)
        if len(first) < shown and (i, k) != (0, 0):
            first.append((i, k))
    # What is said of a slice is its own fit, not the one step that only ranks it.
    fitted = {
        i: known.get(parts[i].variables) or free_fit(model, table, parts[i], scores, sigma_cm)
        for i in {i for i, _ in first}
    }
    found = []
    for i, k in first:
        number = best[(i, k)]
        j = places[number][2]
        found.append(_slice(parts[i], k, fitted[i], CHANNELS[j], float(z[i][k, j]), float(p_value[number])))
    return tuple(found)


def again(
    slices: Sequence[Slice], model: Model, table: Table, parts: Sequence[Partition], known: Fits
) -> tuple[Slice, ...]:
    """The same slices with what they show of another model beside it."""
    scores, sigma_cm = scores_of(model, table), sigma_of(model, table)
    wanted = {each.variables for each in slices}
    numbers: dict[str, dict[str, float | None]] = {}
    for part in parts:
        if part.variables in wanted:
            fit = known.get(part.variables) or free_fit(model, table, part, scores, sigma_cm)
            numbers |= {label: _numbers(fit, k) for k, label in enumerate(part.labels)}
    return tuple(replace(each, after=numbers.get(each.where, {})) for each in slices)


def _contributions(
    scores: _Array, unit: NDArray[np.intp], partition: Partition, fit: FreeFit, sigma_cm: _Array
) -> tuple[_Array, _Array]:
    """Of each slice and number the statistic (K, 5), and the units' shares in it (K, 5, U)."""
    cells, units = len(partition.labels), int(unit.max()) + 1
    of_cell, of_unit, sums = unit_sums(scores, unit, partition)
    per_cell = np.zeros((cells, units, len(CHANNELS)))
    per_cell[of_cell, of_unit] = sums
    size = np.zeros((cells, units))
    np.add.at(size, (partition.cell, unit), 1.0)
    size /= np.maximum(size.sum(axis=1, keepdims=True), 1.0)
    # About their mean: a gap must not look like scatter.
    about_mean = per_cell - size[:, :, None] * per_cell.sum(axis=1)[:, None, :]
    # One number at a time: its own score over its own error, so that a rare class does not blur the others.
    deviation = np.sqrt((about_mean**2).sum(axis=1))
    scale = np.zeros((cells, len(CHANNELS)))
    scale[:, 0] = np.bincount(partition.cell, sigma_cm, cells) / np.maximum(partition.counts, 1)
    expected = np.sqrt(np.maximum(_information(fit, scale), 1e-12))
    # Of a class of which nothing came the units show no spread, so at least what the model expects.
    deviation = np.maximum(deviation, expected)
    few = (size > 0.0).sum(axis=1) < FEWEST_UNITS
    deviation[few] = np.inf
    statistic = per_cell.sum(axis=1) / deviation
    return statistic, np.moveaxis(about_mean / deviation[:, None, :], 1, 2)


def _information(fit: FreeFit, scale: _Array) -> _Array:
    """About what the model expects of a score's variance, from the errors of the one step."""
    errors = fit.errors.copy()
    errors[:, 0] /= np.maximum(scale[:, 0], 1e-12)
    found: _Array = 1.0 / np.maximum(errors, 1e-12) ** 2
    return found


def _step_down(statistic: _Array, shares: _Array, rng: np.random.Generator) -> _Array:
    """Corrected p-values, (m,)."""
    order = np.argsort(-statistic, kind="stable")
    above = np.zeros(statistic.size)
    block = 100
    for start in range(0, DRAWS, block):
        signs = rng.standard_normal((shares.shape[1], min(block, DRAWS - start)))
        drawn = np.abs(shares[order] @ signs)
        largest_below = np.maximum.accumulate(drawn[::-1], axis=0)[::-1]
        above += (largest_below >= statistic[order, None]).sum(axis=1)
    p_value = np.empty(statistic.size)
    p_value[order] = np.maximum.accumulate((above + 1.0) / (DRAWS + 1.0))
    return p_value


def _pooled(unit: NDArray[np.intp]) -> NDArray[np.intp]:
    """At most so many units, each of neighbours."""
    _, index = np.unique(unit, return_inverse=True)
    count = int(index.max()) + 1
    return index if count <= MOST_UNITS else (index * MOST_UNITS // count).astype(np.intp)


def _numbers(fit: FreeFit, k: int) -> dict[str, float | None]:
    names = ("bias_cm", "log_spread", "log_odds_short", "log_odds_missed", "log_odds_random")
    found: dict[str, float | None] = {name: float(value) for name, value in zip(names, fit.values[k], strict=True)}
    found["nats"] = _nats(fit, k)
    return found


def _nats(fit: FreeFit, k: int) -> float:
    return float((fit.gain_nats[k] - fit.chance_nats[k]) / max(int(fit.counts[k]), 1))


def _slice(partition: Partition, k: int, fit: FreeFit, channel: str, z: float, p_value: float) -> Slice:
    (bias, spread, short, missed, random) = fit.values[k].tolist()
    (bias_se, spread_se, short_se, missed_se, random_se) = fit.errors[k].tolist()
    return Slice(
        where=partition.labels[k],
        variables=partition.variables,
        readings=int(fit.counts[k]),
        bias_cm=bias,
        bias_se_cm=bias_se,
        log_spread=spread,
        log_spread_se=spread_se,
        log_odds_short=short,
        log_odds_short_se=short_se,
        log_odds_missed=missed,
        log_odds_missed_se=missed_se,
        log_odds_random=random,
        log_odds_random_se=random_se,
        nats=_nats(fit, k),
        channel=channel,
        z=z,
        p_value=p_value,
    )
