"""What an effect is: a change of the distribution of readings with one number for its size."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from evaluation.second_hand.base import Base
from evaluation.second_hand.density import Law, base_law
from evaluation.second_hand.flights import Design
from evaluation.second_hand.rows import Rows


@dataclass(frozen=True)
class Effect:
    """One hidden effect.

    Attributes
    ----------
    title
        Its name here.
    apply
        Changes a `Law` by an effect of this size; at 0 it changes nothing.
    limit
        Largest size that is physically possible.
    start
        Size to begin the search with.
    names
        Names in `msp-lab effects` that are right; none of an unknown effect.
    channel, variable
        What it changes (bias, spread, missed, short, random) and the column that it depends on.
    same_as
        Numbers of the base that are the same as this effect: only the bench separates them.
    between_runs
        It varies (nearly) between runs only.
    last
        Applied after the effects on the place of a hit.
    details
        Further numbers, for the record.
    """

    title: str
    apply: Callable[[Rows, Law, float], None]
    limit: float
    start: float
    names: frozenset[str] = frozenset()
    channel: str = "bias"
    variable: str = ""
    same_as: tuple[str, ...] = ()
    between_runs: bool = False
    last: bool = False
    details: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True)
class Kind:
    """How an effect is drawn: what it asks of the runs, and its numbers from random ones and the runs."""

    title: str
    design: Design
    draw: Callable[[np.random.Generator, Rows], Effect]


def law_with(rows: Rows, base: Base, effects: Sequence[Effect], sizes: Sequence[float]) -> Law:
    """The distribution of the readings with these effects."""
    law = base_law(rows, base)
    for effect, size in sorted(zip(effects, sizes, strict=True), key=lambda pair: pair[0].last):
        effect.apply(rows, law, size)
    return law
