"""The candidates of the search: every effect of the catalogue that the data can show, and its score.

Candidates follow from a model and its contexts, with the derivative of every reading's log probability by the number of
each. What acts through a channel is the channel's slope times the effect's template; components and faults of the code
act linearly on the probability.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from msp_lab.gap import rules
from msp_lab.gap.prepared import ODDS_CHANNELS, ChannelSlopes, Prepared, templates
from msp_lab.gap.runs import known_values
from msp_range.arrays import Array
from msp_range.reading_model.sensor_model import SensorModel
from msp_sim.effects import CATALOGUE
from msp_sim.effects.base import OTHERS, REFERENCE, TRUE_RANGE, Effect, Parameter, Scene
from msp_sim.effects.component import Normal
from msp_sim.effects.curve import Ripple
from msp_sim.model.derived import TIME_OF_DAY
from msp_sim.model.model import LARGEST_SHARE, Model, Term, applies
from msp_sim.model.rows import score_of_component, score_of_fault

Key = tuple[str, str | None]
"""Name of an effect, and the sensor, run or target that it is of."""
COMMON = frozenset(
    {
        "air_temperature",
        "thermometer_offset",
        "temperature_gradient",
        "humidity",
        "motion_during_ping",
        "session_offset",
        "run_offsets",
    }
)
"""Effects that all sensors of a vehicle have in common in a flight: not asked where the other sensors are the
reference, which has them too. What differs between flights there is the ground below the sensors."""
BETWEEN_RUNS = frozenset({"run_offsets"})
"""Effects that show between runs and not in single readings (`run_offsets.py`)."""


@dataclass(frozen=True)
class CandidateEffect:
    """An effect with its shape held, of which one number is searched."""

    effect: Effect
    of: str | None
    """Effect of the catalogue, and the sensor, run or target that it is of."""
    shape: tuple[tuple[str, float], ...]
    """Values of its shape's parameters."""
    parameter: Parameter
    """The number that is neutral while the effect is absent."""

    @property
    def key(self) -> Key:
        """Candidates that differ in shape alone have the same."""
        return self.effect.name, self.of

    @property
    def neutral(self) -> float:
        """The value at which the effect is absent."""
        return self.parameter.neutral or 0.0

    @property
    def one_sided(self) -> bool:
        """Its number cannot be negative."""
        return self.parameter.low >= 0.0

    @property
    def odds(self) -> int | None:
        """Which of the three odds it changes, if that is all it does: 1 short, 2 missed, 3 random."""
        found = [i for i, channel in enumerate(ODDS_CHANNELS, 1) if channel in self.effect.channels]
        return found[0] if len(found) == 1 and len(self.effect.channels) == 1 else None

    @property
    def linear(self) -> bool:
        """It mixes something into the probability."""
        return bool({"component", "code"} & set(self.effect.channels))

    @property
    def is_rare(self) -> bool:
        """It acts on single improbable readings: its score may promise more than it gains."""
        return self.linear or self.odds is not None

    @property
    def is_base(self) -> bool:
        """It says what a number of the base says too."""
        return self.effect.base is not None

    @property
    def cost_nats(self) -> float:
        """What the search over its shapes gains by random variation [nat]."""
        searched = sum(parameter.neutral is None and len(parameter.grid) > 1 for parameter in self.effect.parameters)
        if self.effect.gathers:
            return rules.GATHERED_COST_NATS
        return searched * (rules.PLACE_COST_NATS if self.linear else rules.SHAPE_COST_NATS)

    def moved_by(self, moved_cm: float, sensor: SensorModel) -> "CandidateEffect":
        """The candidate whose shape moves a part of the hits by so much; it is one that moves hits."""
        somewhere = Scene(sensor, {TRUE_RANGE: np.zeros(1)})
        component = replace(self, shape=((self.effect.moves, 1.0),)).at(1.0).change(somewhere).component
        assert isinstance(component, Normal)
        return replace(self, shape=((self.effect.moves, moved_cm / float(np.mean(component.location_cm))),))

    def from_neutral(self, change: float) -> float:
        """The value that is so far from the neutral one, within the parameter's bounds."""
        return float(np.clip(self.neutral + change, self.parameter.low, self.parameter.high))

    def from_score(self, change: float) -> float:
        """The value at which its template is by so much larger, at least by that of a step."""
        size = max(abs(change), self.parameter.step) ** (1.0 / self.parameter.power)
        return self.from_neutral(float(np.sign(change)) * size)

    def at(self, value: float) -> Term:
        """The effect with this value of its number."""
        values = {**self.effect.neutral_values(), **dict(self.shape), self.parameter.name: value}
        return Term(self.effect, values, self.of, is_added=True)


@dataclass(frozen=True)
class SelectedTerm:
    """An effect or a curve that was taken into the model."""

    active: Term
    """The effect or curve with its values."""
    candidate: CandidateEffect | None
    """The candidate that it came from; None for a curve."""

    @property
    def key(self) -> Key:
        """Name, and the sensor, run or target that it is of."""
        if self.active.shape is not None:
            kind = "ripple" if isinstance(self.active.shape[2][0], Ripple) else "curve"
            return f"{kind} {self.active.shape[0]} {self.active.shape[1]}", None
        return self.active.effect.name, self.active.of

    @property
    def label(self) -> str:
        """For a person."""
        if self.active.shape is not None:
            ripple = self.active.shape[2][0]
            what = f"ripple of {ripple.period:.3g}" if isinstance(ripple, Ripple) else self.active.shape[0]
            return f"{what} over {' and '.join(self.active.shape[1])}"
        return self.active.effect.name + (f" of {self.active.of}" if self.active.of else "")

    @property
    def cost_nats(self) -> float:
        """What the search over its shapes gains by random variation [nat]."""
        return 0.0 if self.candidate is None else self.candidate.cost_nats

    @property
    def numbers(self) -> int:
        """How many numbers a candidate has: its strength and its shape."""
        return 1 if self.candidate is None else 1 + len(self.candidate.shape)

    @property
    def is_base(self) -> bool:
        """It says what a number of the base says too."""
        return self.candidate is not None and self.candidate.is_base


def candidates_of(
    model: Model, contexts: Mapping[str, Any], gathered_cm: tuple[float, ...] = ()
) -> tuple[tuple[CandidateEffect, ...], tuple[tuple[str, tuple[str, ...]], ...]]:
    """Candidates that these contexts can show, and effects with the columns that are missing for them.

    An effect that the model already has is a candidate again: more of it may be there. What happens to sound only is no
    candidate for a sensor that ranges with light, and a fault of bytes none for readings in millimetres. An effect that
    gathers readings is searched at `gathered_cm`, the ranges at which they do, and at those of its own grid if there
    are none.
    """
    of_others = bool(np.any(contexts.get(REFERENCE, "") == OTHERS))
    found: list[CandidateEffect] = []
    missing: list[tuple[str, tuple[str, ...]]] = []
    for effect in CATALOGUE.values():
        if not effect.happens_to(model.sensor) or (of_others and effect.name in COMMON):
            continue
        required = (*effect.requires, *((effect.per,) if effect.per else ()))
        absent = tuple(name for name in required if not _is_recorded(contexts, name))
        if absent:
            # Of a day or less nobody can record another time of day.
            if absent != (TIME_OF_DAY,) or not _is_recorded(contexts, "time_s"):
                missing.append((effect.name, absent))
            continue
        words: Sequence[str | None] = (None,)
        if effect.per is not None:
            words = [word for word in np.unique(contexts[effect.per]).tolist() if word]
            if len(words) < 2:
                continue
            if effect.per == "run" and not rules.MIN_RUNS <= len(words) <= rules.MAX_RUN_CANDIDATES:
                continue
        if effect.name in BETWEEN_RUNS:
            continue
        shapes = [parameter for parameter in effect.parameters if parameter.neutral is None]
        numbers = [parameter for parameter in effect.parameters if parameter.neutral is not None]
        grids = [
            (gathered_cm if parameter.name == effect.gathers else ()) or parameter.grid or (parameter.default or 0.0,)
            for parameter in shapes
        ]
        for word in words:
            for tried in product(*grids):
                held = tuple((parameter.name, float(value)) for parameter, value in zip(shapes, tried, strict=True))
                found.extend(CandidateEffect(effect, word, held, number) for number in numbers)
    return tuple(found), tuple(missing)


def _is_recorded(contexts: Mapping[str, Any], name: str) -> bool:
    return name in contexts and known_values(contexts[name]).size > 0


def score_of(candidate: CandidateEffect, prepared: Prepared, here: ChannelSlopes) -> Array:
    """Score of a candidate where it is absent, (n,)."""
    parameter = candidate.parameter
    active = candidate.at(candidate.neutral + parameter.step)
    scene, reading_cm, rows = prepared.scene, prepared.reading_cm, here.rows
    known = applies(scene, active)
    score = np.zeros(reading_cm.size)
    if known is False:
        return score
    change = active.change(scene)
    step = active.values[parameter.name] - candidate.neutral
    for i, template in templates(known, change).items():
        score += here.score(i, template / step**parameter.power)
    if change.component is not None:
        share = np.broadcast_to(np.nan_to_num(np.where(known, change.share, 0.0)), reading_cm.shape)
        share = np.clip(share, 0.0, LARGEST_SHARE)
        some = np.flatnonzero(share > 0.0)
        if some.size:
            own = score_of_component(rows.take(some), reading_cm[some], change.component.take(some), here.log_p[some])
            score[some] = own * share[some] / step
    if change.fault is not None:
        own = score_of_fault(rows, reading_cm, change.fault, here.log_p)
        score += own * np.where(known, change.fault_share, 0.0) / step
    return score
