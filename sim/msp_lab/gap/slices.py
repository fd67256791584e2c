"""Where readings and model disagree: slices of context, ranked by what differs, corrected for their number.

The five numbers of each slice (bias, spread, odds of short, missed and random readings) are tested by their scores;
p-values come from the step-down maximum of their multiplier bootstrap over units (Westfall and Young 1993;
Chernozhukov, Chetverikov & Kato 2013, Annals of Statistics 41). This finds less than a catalogue of effects does, and
says where to look.

Where what was found shows is there too: the extended model is compared with itself without one of its terms, by the
scores of the held-out readings. Both have the same readings, so the difference of the sums is what the term does there
and hardly noise. What counts as noise is the standard deviation of the sums over units.
"""

from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import replace
from itertools import groupby
from typing import Any

import numpy as np
from scipy.special import chdtrc

from msp_lab.gap import rules
from msp_lab.gap.cell_fits import CellFits, inflation_of_units, scale_of, scores_of, unit_sums
from msp_lab.gap.cells import Partition
from msp_lab.gap.conclusion import STILL_OPEN, found_parts
from msp_lab.gap.findings import FoundEffect, GapFindings, Slice, UnknownEffect, error_name
from msp_lab.gap.labels import name_of, with_unit
from msp_lab.gap.measures import Measures, free_fits
from msp_lab.gap.prepared import CHANNELS
from msp_range.arrays import Array, Column, Flags, Indices, Texts
from msp_sim.effects.base import TRUE_RANGE
from msp_sim.effects.curve import Ripple
from msp_sim.model.model import Model, Term
from msp_sim.page.text import and_list

PAIRS_SHOWN = 2
"""Pairs of variables of which slices are listed: more repeat the same."""
NUMBERS = ("bias_cm", "log_spread", "log_odds_short", "log_odds_missed", "log_odds_random")
"""Fields of a `Slice` with its five numbers."""
MOST_SHARE = 0.5
"""A finding shows most where it changes readings by at least this share of its largest change, in the scatter of a
reading. Half, as people use the word. Higher: smaller places."""
MOST_PLACES, MOST_WORDS = 2, 4
"""Where a finding shows most is only said if that is in so few separate ranges of a number; and so many words or ranges
are listed. More: nobody reads them."""


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


def located(findings: GapFindings, extended: Model, given: int, after: Measures) -> GapFindings:
    """Fill in where each finding shows, and which slices differ.

    Where something was found the slices that differ are those that it changes; while a part of the gap is left, those
    too that differ from the given model significantly.

    Parameters
    ----------
    findings
        With verdict and slices.
    extended, given
        The model with what was found, and how many of its effects are the given model's own.
    after
        What the held-out readings show of it.
    """
    found, stack, (_, _, noise, _) = found_parts(findings), after.stack, _by_unit(after)
    labels = [label for part in stack.parts for label in part.labels]
    by: dict[str, tuple[str, ...]] = {}
    where = []
    parts: list[FoundEffect | UnknownEffect] = [*findings.effects, *findings.unknown]
    for finding in parts:
        term = next((added for added in extended.effects[given:] if _is_of(finding, added)), None)
        if term is None:
            where.append("")
            continue
        without = replace(extended, effects=tuple(other for other in extended.effects if other is not term))
        _, scores = scores_of(without.rows(after.readings.contexts).marginal, after.readings.reading_cm)
        change = np.abs(stack.sums(scores - after.scores))
        is_changed: Flags = np.any(change > noise, axis=1)
        if finding in found:
            for k in np.flatnonzero(is_changed).tolist():
                by[labels[k]] = (*by.get(labels[k], ()), term.stream)
        own = [j for j, channel in enumerate(CHANNELS) if channel in term.effect.channels]
        # A component shows in the channel in which it is surest.
        j = own[0] if own else int((change / noise).max(axis=0).argmax())
        size = change[:, j] / np.maximum(stack.counts, 1)
        where.append(_in_words(term, size, is_changed, after))
    count = len(findings.effects)
    findings = replace(
        findings,
        effects=tuple(
            replace(effect, where=words) for effect, words in zip(findings.effects, where[:count], strict=True)
        ),
        unknown=tuple(
            replace(effect, where=words) for effect, words in zip(findings.unknown, where[count:], strict=True)
        ),
    )
    if not found:
        return findings
    is_left = findings.verdict in STILL_OPEN
    slices = [
        replace(piece, by=by.get(piece.where, ()), differs=piece.where in by or (is_left and piece.differs))
        for piece in findings.slices
    ]
    return replace(findings, slices=tuple(slices))


def _is_of(finding: FoundEffect | UnknownEffect, term: Term) -> bool:
    """Whether a finding is this term."""
    if isinstance(finding, FoundEffect):
        return (finding.name, finding.of) == (term.effect.name, term.of)
    if term.shape is None:
        return False
    channel, variables, (knots, *_) = term.shape
    return (finding.channel, finding.variables, finding.period) == (channel, variables, getattr(knots, "period", None))


def _in_words(term: Term, size: Array, is_changed: Flags, after: Measures) -> str:
    """The place in the term's own columns; empty where it changes nothing by more than the noise.

    Parameters
    ----------
    term
        What was found.
    size, is_changed
        How much it changes a reading of each slice, and whether that is more than the slice's noise, (K,).
    after
        With the slices.
    """
    own = {TRUE_RANGE, *term.effect.columns} if term.shape is None else {*term.shape[1]}
    parts = [pair for pair in after.stack.each() if len(pair[0].variables) == 1 and {*pair[0].variables} <= own]
    is_ripple = term.shape is not None and isinstance(term.shape[2][0], Ripple)
    if is_ripple or not parts:
        # A ripple goes up and down within a slice.
        return "everywhere" if is_ripple or is_changed[0] else ""
    # The column along which it changes most.
    part, cells = max(parts, key=lambda pair: float(np.cov(size[pair[1]], fweights=pair[0].counts)))
    known, size = _is_known(part), size[cells]
    here = is_changed[cells] & known
    if not here.any():
        return ""
    most = here & (size >= MOST_SHARE * size[here].max())
    values, (name,) = after.readings.contexts[part.variables[0]], part.variables
    extent, core = (_places(part, values, shown) for shown in (here, most))
    is_everywhere = np.array_equal(here, known)
    text = "everywhere" if is_everywhere else f"{name_of(name)} {with_unit(and_list(extent), name)}"
    if not is_everywhere and len(extent) > MOST_PLACES and any(" to " in place for place in extent):
        # Many ranges are no place: how much of the column is.
        low, high = _ends(part, values)[[0, -1], [0, 1]]
        text = f"{here.sum()} of {known.sum()} parts of {name_of(name)} {with_unit(f'{low} to {high}', name)}"
    if np.array_equal(most, here) or len(core) > MOST_PLACES:
        return text
    return f"{text}, most {f'at {name_of(name)} ' * is_everywhere}{with_unit(and_list(core), name)}"


def _places(part: Partition, values: Column, here: Flags) -> list[str]:
    """Some cells of a partition by one column: their words, or ranges of their numbers."""
    known = _is_known(part)
    here = here[known]
    if part.centres is None:
        words = [part.labels[k].removeprefix(f"{part.variables[0]} ") for k in np.flatnonzero(known)]
        return _some(np.array(words)[here].tolist())
    ends, last = _ends(part, values), here.size - 1
    if np.all(ends[:, 0] == ends[:, 1]):
        return _some(ends[here, 0].tolist())
    places = []
    # Cells next to each other are one range.
    for is_here, group in groupby(range(here.size), key=here.__getitem__):
        cells = list(group)
        low, high = ends[cells[0], 0], ends[cells[-1], 1]
        if is_here and cells[0] == 0:
            places.append(f"up to {high}")
        elif is_here and cells[-1] == last:
            places.append(f"from {low}")
        elif is_here:
            places.append(f"{low} to {high}")
    return _some(places)


def _ends(part: Partition, values: Column) -> Texts:
    """Smallest and largest number in each known cell, (known, 2), with as many digits as they differ in, up to six."""
    own = [values[part.cell == k] for k in np.flatnonzero(_is_known(part))]
    ends = np.array([(cell.min(), cell.max()) for cell in own])
    for digits in range(3, 7):
        written = np.array([[f"{float(f'{end:.{digits}g}'):,g}" for end in pair] for pair in ends.tolist()])
        if np.array_equal(written[:, 0] == written[:, 1], ends[:, 0] == ends[:, 1]):
            break
    return written


def _some(words: Iterable[str]) -> list[str]:
    """The first words, and how many more there are."""
    first = list(words)
    return [*first[:MOST_WORDS], *[f"{len(first) - MOST_WORDS} more"] * (len(first) > MOST_WORDS)]


def _is_known(part: Partition) -> Flags:
    """Cells with readings of a known number or word: not those of the rest."""
    if part.centres is not None:
        return np.isfinite(part.centres) & (part.counts > 0)
    (name,) = part.variables
    return np.array([label.startswith(f"{name} ") and label != f"{name} unknown" for label in part.labels])
