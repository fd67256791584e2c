"""Numbers that are compared over a fleet: effects of the catalogue and numbers of the base.

A `FleetTerm` is plain data, so that it can be sent to another process. There an effect becomes a candidate of the
search, by `candidate_of`.
"""

from dataclasses import dataclass, replace

from msp_lab.gap.candidates import CandidateEffect
from msp_sim.effects import CATALOGUE
from msp_sim.effects.base import Contribution, Effect, Parameter
from msp_sim.model.model import Term

_FINDINGS = {
    "offset": "readings are {value:too far|too near}",
    "scatter": "readings scatter {value:times much}",
    "short": "short readings come {value:times}",
    "missed": "missed echoes come {value:times}",
    "random": "readings at random ranges come {value:times}",
}
BASE = {
    name: Effect(
        name,
        f"{name} of this sensor",
        "",
        "",
        (Parameter("value", "cm" if name == "offset" else "1", "change of the number", -50.0, 50.0),),
        (),
        "",
        lambda scene, values: Contribution(),
        finding=finding,
    )
    for name, finding in _FINDINGS.items()
}
"""Numbers of the base that are compared, in the order of the laboratory's ``prepared.BASE``, described as effects."""


@dataclass(frozen=True)
class FleetTerm:
    """A number that one vehicle may have and others not."""

    effect: str
    """Name in the catalogue or in `BASE`."""
    number: str
    """Name of the parameter."""
    of: str | None = None
    """The target (kind of ground) that it applies to; None: all."""
    shape: tuple[tuple[str, float], ...] = ()
    """Values of its other parameters, which are fixed, so that numbers of vehicles can be compared."""
    start: float = 0.0
    """Its number where a fit starts, as a change from the neutral value; 0: not known."""

    @property
    def key(self) -> tuple[str, str | None]:
        """Effect and target: the same for terms that differ only in shape."""
        return self.effect, self.of

    @property
    def anywhere(self) -> "FleetTerm":
        """The same number, wherever its fits start."""
        return replace(self, start=0.0)

    @property
    def is_base(self) -> bool:
        """Whether it is a number that every sensor has: `missed` is the name of one, and of an effect."""
        return self.effect in BASE and self.number == "value"

    @property
    def catalogued(self) -> Effect:
        """The effect of the catalogue, or the number of the base as one."""
        return BASE[self.effect] if self.is_base else CATALOGUE[self.effect]

    @property
    def parameter(self) -> Parameter:
        """The number as a parameter of its effect."""
        return next(parameter for parameter in self.catalogued.parameters if parameter.name == self.number)

    @property
    def calibrates(self) -> bool:
        """Whether a number of the sensor model means the same."""
        return self.catalogued.base is not None


def candidate_of(term: FleetTerm) -> CandidateEffect:
    """The effect with its shape held, as a candidate of the search."""
    effect = replace(term.catalogued, parameters=(term.parameter,))
    return CandidateEffect(effect, term.of, term.shape, term.parameter)


def term_of(active: Term, candidate: CandidateEffect | None = None) -> FleetTerm:
    """What the search found as plain data; of several numbers that of its candidate, or the first one."""
    numbers = [parameter for parameter in active.effect.parameters if parameter.neutral is not None]
    number = numbers[0] if candidate is None else candidate.parameter
    shape = tuple((name, value) for name, value in active.values.items() if name != number.name)
    start = active.values[number.name] - (number.neutral or 0.0)
    return FleetTerm(active.effect.name, number.name, active.of, shape, start)
