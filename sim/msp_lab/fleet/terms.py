"""Numbers that are compared over a fleet: effects of the catalogue and numbers of the base.

A `FleetTerm` is plain data, so that it can be sent to another process. There it becomes a candidate of the search, by
`candidate_of`.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from msp_lab.gap.candidates import CandidateEffect, SelectedTerm
from msp_sim.effects import CATALOGUE
from msp_sim.effects.base import Contribution, Effect, Parameter, Scene, Values

_FIELDS = {"offset": "bias_cm", "scatter": "log_spread"} | {
    kind: f"log_odds_{kind}" for kind in ("short", "missed", "random")
}
BASE_NUMBERS = tuple(_FIELDS)
"""Numbers of the base that are compared, in the order of the laboratory's ``prepared.BASE``."""
_MEANINGS = {
    "offset": "readings are {value:too far|too near}",
    "scatter": "readings scatter {value:times}",
    "short": "short readings come {value:times}",
    "missed": "missed echoes come {value:times}",
    "random": "readings at random ranges come {value:times}",
}


@dataclass(frozen=True)
class FleetTerm:
    """A number that one vehicle may have and others not."""

    effect: str
    """Name in the catalogue, or one of `BASE_NUMBERS`."""
    number: str
    """Its parameter."""
    of: str | None = None
    """The target that it is of, or None."""
    shape: tuple[tuple[str, float], ...] = ()
    """Values of its other parameters, which are held, so that numbers of vehicles compare."""
    start: float = 0.0
    """Its number where a fit starts, as a change from the neutral value."""

    @property
    def key(self) -> tuple[str, str | None]:
        """Terms that differ in shape alone have the same."""
        return self.effect, self.of

    @property
    def is_base(self) -> bool:
        """A number that every sensor has."""
        return self.effect in BASE_NUMBERS


SCALE = FleetTerm("range_scale", "scale_pct", start=0.1)
"""The scale of the ranges, which is as plain as an offset."""


def base_effect(name: str) -> Effect:
    """A number of the base as an effect."""

    def apply(scene: Scene, values: Values) -> Contribution:
        changed: dict[str, Any] = {_FIELDS[name]: np.full(np.shape(scene.range_cm), values["value"])}
        return Contribution(**changed)

    number = Parameter("value", "cm" if name == "offset" else "1", "change of the number", -50.0, 50.0)
    channel: Any = {"offset": "bias", "scatter": "spread"}.get(name, name)
    return Effect(
        name, f"{name} of this sensor", "", "", (number,), (channel,), "", apply, finding=_MEANINGS[name]
    )  # fmt: skip


def effect_of(name: str) -> Effect:
    """An effect of the catalogue, or a number of the base as one."""
    return base_effect(name) if name in BASE_NUMBERS else CATALOGUE[name]


def candidate_of(term: FleetTerm) -> CandidateEffect:
    """The term as a candidate of the search."""
    effect = effect_of(term.effect)
    number = next(each for each in effect.parameters if each.name == term.number)
    return CandidateEffect(replace(effect, parameters=(number,)), term.of, term.shape, number)


def term_of(named: SelectedTerm, candidate: CandidateEffect) -> FleetTerm:
    """What the search named, with its values."""
    shape = tuple((name, named.active.values[name]) for name, _ in candidate.shape)
    number = candidate.parameter.name
    start = named.active.values[number] - candidate.neutral
    return FleetTerm(candidate.effect.name, number, candidate.of, shape, start=start)
