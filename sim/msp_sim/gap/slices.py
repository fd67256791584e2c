"""Where readings and model disagree: slices of context, ranked by what differs, corrected for their number.

Readings, a model and partitions enter; slices leave. Each slice is asked for its five numbers (bias, spread, odds of
short, missed and random readings) by the efficient score of the model; the largest of all is judged by the step-down
maximum of their multiplier bootstrap over units (Westfall and Young 1993; Chernozhukov, Chetverikov & Kato 2013,
Annals of Statistics 41). What was fitted in the slice is shown beside it. This finds less than a catalogue of effects
does, and says where to look.
"""

from collections.abc import Mapping, Sequence

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
FEWEST_UNITS = 4
"""In a slice; with fewer, nothing is known of what units share, and it is not judged."""


def ranked(
    model: Model, table: Table, parts: Sequence[Partition], twins: Twins, rng: np.random.Generator, shown: int = SHOWN
) -> tuple[Slice, ...]:
    """The slices that differ most, the surest first; then the whole, whatever it shows.

    Parameters
    ----------
    model, table, parts, twins
        As for `measures.measure`.
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
    first = sorted(best, key=lambda key: -statistic[best[key]])[:shown]
    if (0, 0) not in first:
        first.append((0, 0))
    fitted: dict[int, FreeFit] = {}
    found = []
    for i, k in first:
        if i not in fitted:
            # What is drawn and said of a slice is its own fit, not the one step that only ranks it.
            fitted[i] = free_fit(model, table, parts[i], scores, sigma_cm) if len(fitted) < 4 else fits[parts[i].variables]
        number = best[(i, k)]
        j = places[number][2]
        found.append(_slice(parts[i], k, fitted[i], CHANNELS[j], float(z[i][k, j]), float(p_value[number])))
    return tuple(found)


def after(
    slices: Sequence[Slice], parts: Sequence[Partition], fits: Mapping[tuple[str, ...], FreeFit]
) -> dict[str, dict[str, float | None]]:
    """The same slices' numbers with another model, by the slice's name, as far as its partition was fitted."""
    wanted = {each.where for each in slices}
    found: dict[str, dict[str, float | None]] = {}
    for part in parts:
        fit = fits.get(part.variables)
        if fit is None:
            continue
        for k, label in enumerate(part.labels):
            if label in wanted:
                found[label] = _numbers(fit, k)
    return found


def _contributions(
    scores: _Array, unit: NDArray[np.intp], partition: Partition, fit: FreeFit, sigma_cm: _Array
) -> tuple[_Array, _Array]:
    """Of each slice and number the statistic (K, 5), and the units' shares in it (K, 5, U)."""
    cells, units = len(partition.labels), int(unit.max()) + 1
    of_cell, of_unit, sums = unit_sums(scores, unit, partition)
    per_cell = np.zeros((cells, units, len(CHANNELS)))
    per_cell[of_cell, of_unit] = sums
    # One number at a time: its own score over its own error, so that a rare class does not blur the others.
    deviation = np.sqrt((per_cell**2).sum(axis=1))
    scale = np.zeros((cells, len(CHANNELS)))
    scale[:, 0] = np.bincount(partition.cell, sigma_cm, cells) / np.maximum(partition.counts, 1)
    expected = np.sqrt(np.maximum(_information(fit, scale), 1e-12))
    # Of a class of which nothing came the units show no spread, so at least what the model expects.
    deviation = np.maximum(deviation, expected)
    few = (per_cell != 0.0).any(axis=2).sum(axis=1) < FEWEST_UNITS
    deviation[few] = np.inf
    shares = per_cell / deviation[:, None, :]
    return shares.sum(axis=1), np.moveaxis(shares, 1, 2)


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
    values, errors = fit.values[k].tolist(), fit.errors[k].tolist()
    both = [number for pair in zip(values, errors, strict=True) for number in pair]
    return Slice(
        partition.labels[k],
        partition.variables,
        int(fit.counts[k]),
        *both,
        nats=_nats(fit, k),
        channel=channel,
        z=z,
        p_value=p_value,
    )
