"""Where readings and model disagree: slices of context, ranked by what differs, corrected for their number.

The five numbers of each slice (bias, spread, odds of short, missed and random readings) are tested by their scores;
p-values come from the step-down maximum of their multiplier bootstrap over units (Westfall and Young 1993;
Chernozhukov, Chetverikov & Kato 2013, Annals of Statistics 41). This finds less than a catalogue of effects does, and
says where to look.
"""

from collections.abc import Mapping, Sequence, Set
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.special import chdtrc

from msp_lab.gap import rules
from msp_lab.gap.bootstrap import inflation_of_units, unit_sums
from msp_lab.gap.cell_fits import CellFits, scale_of
from msp_lab.gap.cells import Partition
from msp_lab.gap.findings import Slice, error_name
from msp_lab.gap.measures import Measures, free_fits
from msp_lab.gap.prepared import CHANNELS
from msp_range.arrays import Array, Indices

PAIRS_SHOWN = 2
"""Pairs of variables of which slices are listed: more repeat the same."""
NUMBERS = ("bias_cm", "log_spread", "log_odds_short", "log_odds_missed", "log_odds_random")
"""Fields of a `Slice` with its five numbers."""


def ranked(measured: Measures, rng: np.random.Generator) -> tuple[Slice, ...]:
    """The whole, and then all slices of one variable and some of two, those first that differ most surely.

    Parameters
    ----------
    measured
        What the readings show of the model.
    rng
        Random generator of the bootstrap's multipliers.
    """
    z, shares = _contributions(measured)
    p_value = _step_down(np.abs(z).ravel(), shares.reshape(z.size, -1), rng).reshape(z.shape)
    channel = np.abs(z).argmax(axis=1)
    largest = np.abs(z).max(axis=1)
    places = [(part, k) for part in measured.stack.parts for k in range(len(part.labels))]
    pairs: list[tuple[str, ...]] = []
    # The whole comes first.
    first = [0]
    for number in np.argsort(-largest, kind="stable").tolist():
        variables = places[number][0].variables
        if len(variables) > 1 and variables not in pairs:
            if len(pairs) == PAIRS_SHOWN:
                continue
            pairs.append(variables)
        if number != 0:
            first.append(number)
    # A slice is listed with its own fit, not with the one step that only ranks it.
    fits = _fits(measured, {places[number][0].variables for number in first})
    units_of_all = np.unique(measured.readings.unit).size
    found = []
    for number in first:
        part, k = places[number]
        j = int(channel[number])
        fit = fits[part.variables]
        p = float(p_value[number, j])
        promised, gained = float(measured.step.gain_nats[number]), float(fit.gain_nats[k])
        if units_of_all >= rules.MIN_CELL_UNITS and not _within_factor(gained, promised, rules.EXPANSION_FACTOR):
            p = min(p, _p_of_likelihood(fit, k, len(places)))
        found.append(_slice(part, k, fit, CHANNELS[j], float(z[number, j]), p))
    return tuple(found)


def _within_factor(one: float, other: float, factor: float) -> bool:
    return one < factor * other and other < factor * one


def _p_of_likelihood(fit: CellFits, k: int, slices: int) -> float:
    """p-value of one of many slices by the likelihood that its free fit gains; not below the bootstrap's smallest."""
    numbers = len(CHANNELS)
    inflation = max(2.0 * fit.noise_nats[k] / numbers, 1.0)
    p = slices * float(chdtrc(numbers, max(2.0 * fit.gain_nats[k] / inflation, 0.0)))
    return max(p, 1.0 / (rules.SLICE_DRAWS + 1.0))


def remeasured(slices: Sequence[Slice], measured: Measures) -> tuple[Slice, ...]:
    """The same slices with what they show of another model in `after`."""
    wanted = {piece.variables for piece in slices}
    fits = _fits(measured, wanted)
    numbers: dict[str, dict[str, Any]] = {}
    for part in measured.stack.parts:
        if part.variables in wanted:
            numbers |= {label: _numbers(fits[part.variables], k) for k, label in enumerate(part.labels)}
    return tuple(replace(piece, after=numbers.get(piece.where, {})) for piece in slices)


def _fits(measured: Measures, wanted: Set[tuple[str, ...]]) -> Mapping[tuple[str, ...], CellFits]:
    """Free fits of the partitions by these variables: those that are known, and the others."""
    known = measured.fits
    others = [part for part in measured.stack.parts if part.variables in wanted and part.variables not in known]
    return {**known, **(free_fits(measured.rows, measured.readings, others) if others else {})}


def noise_of(measured: Measures) -> Array:
    """Standard deviation of the sum of a slice's scores, by units, for each of its five numbers, (K, 5)."""
    return _by_unit(measured)[2]


def _contributions(measured: Measures) -> tuple[Array, Array]:
    """The statistic of each slice and number (K, 5), and the units' shares in it (K, 5, U)."""
    per_cell, about_mean, deviation, few = _by_unit(measured)
    shares = about_mean / deviation[:, None, :]
    shares[few] = 0.0
    shares[few, few % shares.shape[1]] = 1.0
    return per_cell.sum(axis=1) / deviation, np.moveaxis(shares, 1, 2)


def _by_unit(measured: Measures) -> tuple[Array, Array, Array, Indices]:
    """Sums of the units' scores (K, U, 5), the same about their mean, the standard deviation of each sum (K, 5), and
    slices that have too few units."""
    scores, stack = measured.scores, measured.stack
    per_cell, about_mean, there = unit_sums(scores[stack.readings], measured.readings.unit, stack)
    # One number at a time: its own score over its own error, so that a rare class does not blur the others.
    deviation = np.sqrt((about_mean**2).sum(axis=1))
    # About the variance of a score that the model expects, from the errors of the one step.
    errors = measured.step.errors / np.maximum(scale_of(stack, measured.rows.sigma_cm), 1e-12)
    expected = np.sqrt(np.maximum(1.0 / np.maximum(errors, 1e-12) ** 2, 1e-12))
    # Units show no spread of a class that never came, so at least what the model expects.
    deviation = np.maximum(deviation, expected)
    # A slice of few units: its single readings, with the dependence that the others show, as one unit.
    few = np.flatnonzero(there < rules.MIN_CELL_UNITS)
    squares = stack.sums(scores**2)
    inflation = inflation_of_units(about_mean, there, squares)
    deviation[few] = np.maximum(np.sqrt(squares * inflation)[few], expected[few])
    return per_cell, about_mean, deviation, few


def _step_down(statistic: Array, shares: Array, rng: np.random.Generator) -> Array:
    """Corrected p-values, (m,)."""
    order = np.argsort(-statistic, kind="stable")
    shares = shares[order]
    above = np.zeros(statistic.size)
    block = 100
    for start in range(0, rules.SLICE_DRAWS, block):
        signs = rng.standard_normal((shares.shape[1], min(block, rules.SLICE_DRAWS - start)))
        null = np.abs(shares @ signs)
        largest_below = np.maximum.accumulate(null[::-1], axis=0)[::-1]
        above += (largest_below >= statistic[order, None]).sum(axis=1)
    p_value = np.empty(statistic.size)
    p_value[order] = np.maximum.accumulate((above + 1.0) / (rules.SLICE_DRAWS + 1.0))
    return p_value


def _numbers(fit: CellFits, k: int) -> dict[str, Any]:
    nats = float((fit.gain_nats[k] - fit.noise_nats[k]) / max(int(fit.counts[k]), 1))
    return {**dict(zip(NUMBERS, fit.values[k].tolist(), strict=True)), "nats": nats}


def _slice(partition: Partition, k: int, fit: CellFits, channel: str, z: float, p_value: float) -> Slice:
    errors: dict[str, Any] = dict(zip(map(error_name, NUMBERS), fit.errors[k].tolist(), strict=True))
    return Slice(
        where=partition.labels[k],
        variables=partition.variables,
        readings=int(fit.counts[k]),
        **_numbers(fit, k),
        **errors,
        channel=channel,
        z=z,
        p_value=p_value,
        differs=p_value < rules.SLICE_P,
    )
