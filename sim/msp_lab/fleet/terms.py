"""Numbers that are compared over a fleet: effects of the catalogue and numbers of the base, in all sessions or in some.

A `FleetTerm` is plain data, so that it can be sent to another process. There it becomes a candidate of the search, by
`candidate_of`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from msp_lab.gap.candidates import CandidateEffect
from msp_sim.effects import CATALOGUE
from msp_sim.effects.base import Contribution, Effect, Parameter, Scene, Values
from msp_sim.model.model import Term

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
    sessions: tuple[str, ...] = ()
    """Sessions in which it acts; none: all."""
    start: float = 0.0
    """Its number where a fit starts, as a change from the neutral value; 0: not known."""

    @property
    def key(self) -> tuple[str, str | None]:
        """Terms that differ in shape alone have the same."""
        return self.effect, self.of

    @property
    def anywhere(self) -> "FleetTerm":
        """The same number, wherever its fits start."""
        return replace(self, start=0.0)

    @property
    def is_base(self) -> bool:
        """A number that every sensor has."""
        return self.effect in BASE_NUMBERS

    @property
    def calibrates(self) -> bool:
        """It says what a number of the sensor model says too."""
        return effect_of(self.effect).base is not None


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
    number = next(parameter for parameter in effect.parameters if parameter.name == term.number)
    if term.sessions:
        effect = _in_sessions(effect, term.sessions)
    return CandidateEffect(replace(effect, parameters=(number,)), term.of, term.shape, number)


def term_of(active: Term, candidate: CandidateEffect | None = None) -> FleetTerm:
    """What the search found as plain data; of several numbers that of its candidate, or the first one."""
    numbers = [parameter for parameter in active.effect.parameters if parameter.neutral is not None]
    number = numbers[0] if candidate is None else candidate.parameter
    shape = tuple((name, value) for name, value in active.values.items() if name != number.name)
    start = active.values[number.name] - (number.neutral or 0.0)
    return FleetTerm(active.effect.name, number.name, active.of, shape, start=start)


def _in_sessions(effect: Effect, sessions: Sequence[str]) -> Effect:
    """The effect in some sessions only."""

    def apply(scene: Scene, values: Values) -> Contribution:
        inside = np.isin(scene["run"], sessions)
        changed = effect.apply(scene, values)._asdict()
        return Contribution(**{name: _inside(name, value, inside) for name, value in changed.items()})

    return replace(effect, apply=apply, requires=(*effect.requires, "run"))


def _inside(name: str, value: Any, inside: Any) -> Any:
    """A part of what an effect changes, nothing outside of its sessions."""
    return value if value is None or name in ("component", "fault") else np.where(inside, value, 0.0)
