"""What an effect is: a change of the distribution of readings with one number for its size."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from numpy.random import Generator

from evaluation.second_hand.base import Base
from evaluation.second_hand.density import Law, base_law
from evaluation.second_hand.flights import Design
from evaluation.second_hand.rows import Floats, Rows

Apply = Callable[[Law, float], None]
"""Changes a `Law` by an effect of this size; at 0 it changes nothing."""
OUTLIERS = ("short", "missed", "random")
"""Channels of the log odds, in the order of a `Law`."""


@dataclass(frozen=True)
class Kind:
    """An effect before it is drawn."""

    title: str
    """Its name here."""
    design: Design
    """What it asks of the runs."""
    change: Callable[[Generator, Rows], tuple[Apply, dict[str, float]]]
    """Draws its numbers from random ones and the runs: what it does, and those that are for the record."""
    limit: float
    """Largest size that is physically possible."""
    start: float
    """Size to begin the search with."""
    names: frozenset[str] = frozenset()
    """Names in `msp-lab effects` that are right; none of an unknown effect."""
    channel: str = "bias"
    variable: str = ""
    """What it changes (bias, spread, missed, short, random) and the column that it depends on."""
    same_as: tuple[str, ...] = ()
    """Numbers of the base that are the same as this effect: only the bench separates them."""
    between_runs: bool = False
    """It varies (nearly) between runs only."""
    last: bool = False
    """Applied after the effects on the place of a hit."""

    def draw(self, rng: Generator, rows: Rows) -> "Effect":
        """Draw one for these runs."""
        return Effect(self, *self.change(rng, rows))


@dataclass(frozen=True)
class Effect:
    """One hidden effect: of which kind, what it does, and its further numbers for the record."""

    kind: Kind
    apply: Apply
    details: dict[str, float]


def moves(by_cm: Callable[[float], Floats]) -> Apply:
    """Move the hits."""

    def apply(law: Law, size: float) -> None:
        law.centre_cm += by_cm(size)

    return apply


def widens(factor: Callable[[float], Floats]) -> Apply:
    """Widen the hits."""

    def apply(law: Law, size: float) -> None:
        law.sigma_cm *= factor(size)

    return apply


def favours(channel: str, log_odds: Callable[[float], Floats]) -> Apply:
    """Make one kind of outlier likelier."""

    def apply(law: Law, size: float) -> None:
        law.odds[OUTLIERS.index(channel)] += log_odds(size)

    return apply


def law_with(rows: Rows, base: Base, effects: Sequence[Effect], sizes: Sequence[float]) -> Law:
    """The distribution of the readings with these effects."""
    law = base_law(rows, base)
    for effect, size in sorted(zip(effects, sizes, strict=True), key=lambda pair: pair[0].kind.last):
        effect.apply(law, size)
    return law
