"""Where what was found shows: the slices that each finding changes by more than their noise, and that place in words.

The extended model is compared with itself without one of its terms, by the scores of the held-out readings: the slopes
of their log probabilities by the five numbers of a slice. Both have the same readings, so the difference of the sums is
what the term does there and hardly noise. What counts as noise is the standard deviation of the sums over units.
"""

from collections.abc import Iterable
from dataclasses import replace
from itertools import groupby

import numpy as np

from msp_lab.gap.cell_fits import scores_of
from msp_lab.gap.cells import Partition
from msp_lab.gap.conclusion import STILL_OPEN, found_parts
from msp_lab.gap.findings import FoundEffect, GapFindings, UnknownEffect
from msp_lab.gap.labels import name_of, with_unit
from msp_lab.gap.measures import Measures
from msp_lab.gap.prepared import CHANNELS
from msp_lab.gap.slices import noise_of
from msp_range.arrays import Array, Column, Flags
from msp_sim.effects.base import TRUE_RANGE
from msp_sim.effects.curve import Ripple
from msp_sim.model.model import Model, Term
from msp_sim.page.text import and_list

MOST_SHARE = 0.5
"""A finding shows most where it changes readings by at least this share of its largest change, in the scatter of a
reading. Half, as people use the word. Higher: smaller places."""
MOST_PLACES, MOST_WORDS = 2, 4
"""Where a finding shows most is only said if that is in so few separate ranges of a number; and so many words or ranges
are listed. More: nobody reads them."""


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
    found, noise, stack = found_parts(findings), noise_of(after), after.stack
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
    if np.array_equal(most, here) or len(core) > MOST_PLACES:
        return text
    return f"{text}, most {f'at {name_of(name)} ' * is_everywhere}{with_unit(and_list(core), name)}"


def _places(part: Partition, values: Column, here: Flags) -> list[str]:
    """Some cells of a partition by one column: their words, or ranges of their numbers."""
    known = np.flatnonzero(_is_known(part)).tolist()
    if part.centres is None:
        return _some(part.labels[k].removeprefix(f"{part.variables[0]} ") for k in known if here[k])

    def ends(cells: list[int]) -> list[str]:
        own = values[np.isin(part.cell, cells)]
        return [f"{float(f'{end:.3g}'):,g}" for end in (own.min(), own.max())]

    if all(low == high for low, high in (ends([k]) for k in known)):
        return _some(ends([k])[0] for k in known if here[k])
    places = []
    # Cells next to each other are one range.
    for is_here, group in groupby(known, key=here.__getitem__):
        cells = list(group)
        low, high = ends(cells)
        if is_here and cells[0] == known[0]:
            places.append(f"up to {high}")
        elif is_here and cells[-1] == known[-1]:
            places.append(f"from {low}")
        elif is_here:
            places.append(f"{low} to {high}")
    return _some(places)


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
