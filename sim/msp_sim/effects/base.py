"""What an effect is: physics on top of the base reading model, named, bounded, and the same to draw and to score.

Context columns enter as a `Scene`, and a `Contribution` leaves: a shift of the hits, a change of their spread, of the odds of
the outliers, one more component of the mixture, or a fault of the reading's code. `msp_sim.model` adds the changes of
all effects to the base mixture; what is not known of a reading (a column that is absent, an empty cell) does not act on
it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from msp_range.acoustics.air import speed_of_sound
from msp_range.reading_model.sensor_model import SensorModel
from msp_sim.effects.codes import CodeFault
from msp_sim.effects.component import Component

Array: TypeAlias = NDArray[np.float64]
Channel: TypeAlias = Literal["bias", "spread", "short", "missed", "random", "component", "code"]

TRUE_RANGE = "true_range_cm"
WORD_COLUMNS = frozenset({"sensor", "run", "target"})
"""Context columns that hold words; an effect of one sensor, run or target names its word."""


@dataclass(frozen=True)
class Parameter:
    """A number of an effect.

    Attributes
    ----------
    name
        Ends with its unit where it has one.
    unit
        As people write it; "1" for a ratio.
    meaning
        What it is.
    low, high
        Bounds.
    null
        Value at which the effect vanishes; None for a parameter of its shape, which means nothing while it is away.
    default
        Of a shape; a file may leave it out.
    tried
        Values of a shape among which a search begins.
    step
        A change that is small, for derivatives.
    power
        The power with which it enters where it is small; one of 2 has no slope at its null.
    """

    name: str
    unit: str
    meaning: str
    low: float
    high: float
    neutral: float | None = 0.0
    default: float | None = None
    grid: tuple[float, ...] = ()
    step: float = 1e-3
    power: int = 1


class Scene:
    """The contexts of n readings as an effect reads them, and the sensor.

    Parameters
    ----------
    sensor
        Its model file.
    contexts
        Columns by name, of length n: numbers with NaN, words with "" where unknown. For one reading a number or a
        word each, None where unknown.
    """

    def __init__(self, sensor: SensorModel, contexts: Mapping[str, Any]) -> None:
        self.sensor = sensor
        self._contexts = contexts
        self._known: dict[str, Any] = {}
        self.kept: dict[Any, Any] = {}
        """What an effect wants to work out once for all its values."""

    def __contains__(self, column: str) -> bool:
        return column in self._contexts

    def __getitem__(self, column: str) -> Any:
        """A column; KeyError where it is absent."""
        return self._contexts[column]

    @property
    def range_cm(self) -> Any:
        """True range [cm]; NaN where nothing can be heard."""
        return self._contexts[TRUE_RANGE]

    @property
    def assumed_m_s(self) -> float:
        """Speed of sound that the sensor's own conversion to centimetres assumes [m/s]."""
        return speed_of_sound(self.sensor.calibration_temperature_c)

    def optional(self, column: str, otherwise: float) -> Any:
        """A column with a value in place of what is unknown."""
        known = self.known(column)
        if known is True or known is False:
            return self._contexts[column] if known else otherwise
        return np.where(known, self._contexts[column], otherwise)

    def known(self, column: str) -> Any:
        """True where a column says something; False alone where the column is absent."""
        if column not in self._known:
            self._known[column] = column in self._contexts and _says(column, self._contexts[column])
        return self._known[column]


def _says(column: str, values: Any) -> Any:
    if not isinstance(values, np.ndarray):
        return bool(values) if column in WORD_COLUMNS else values is not None and abs(values) < np.inf
    said = values != "" if column in WORD_COLUMNS else np.isfinite(values)
    return True if said.all() else said


@dataclass(frozen=True)
class Contribution:
    """What an effect changes about n readings; what is left out stays as it is.

    Attributes
    ----------
    bias_cm
        Added to the centre of the hits [cm].
    log_spread
        Added to the logarithm of the hits' standard deviation.
    run_offset_cm
        Standard deviation of an offset that all readings of one run share [cm].
    log_odds_short, log_odds_missed, log_odds_random
        Added to the logarithm of the odds of a short, a missed or a random reading against a hit.
    component, share
        One more component of the mixture, and the share of the readings that it gets when it is alone.
    fault, fault_share
        A fault of the reading's code, and the share of the readings that it befalls.
    """

    bias_cm: Any = None
    log_spread: Any = None
    run_offset_cm: float | None = None
    log_odds_short: Any = None
    log_odds_missed: Any = None
    log_odds_random: Any = None
    component: Component | None = None
    share: Any = None
    fault: CodeFault | None = None
    fault_share: Any = None


@dataclass(frozen=True)
class Effect:
    """An entry of the catalogue.

    Attributes
    ----------
    name
        As in a model file.
    sentence
        What it is, for a pilot.
    physics
        The equation or the mechanism, and how far it holds.
    source
        Where it is from.
    parameters
        Its numbers.
    needs
        Context columns without which it does not act.
    channels
        What it changes.
    experiment
        What would show it alone.
    act
        What it changes, given the contexts and the parameters' values by name. At the null values, nothing.
    reads
        Further context columns that it takes into account where they are known.
    of
        Column of words of which it concerns one (`mounting_offset` of one sensor); None for all readings.
    base
        Parameter of the sensor model that says the same; adding the effect is then calibration.
    also
        Other causes that look the same in every reading.
    """

    name: str
    sentence: str
    physics: str
    source: str
    parameters: tuple[Parameter, ...]
    requires: tuple[str, ...]
    channels: tuple[Channel, ...]
    experiment: str
    apply: Callable[[Scene, Mapping[str, float]], Contribution] = field(repr=False)
    optional: tuple[str, ...] = ()
    per: Literal["sensor", "run", "target"] | None = None
    base: str | None = None
    equivalent_causes: tuple[str, ...] = ()

    @property
    def columns(self) -> frozenset[str]:
        """Context columns that it reads."""
        return frozenset({*self.requires, *self.optional, *([self.per] if self.per else [])})

    def neutral_values(self) -> dict[str, float]:
        """Values at which it vanishes, shapes at their defaults."""
        return {p.name: p.neutral if p.neutral is not None else _default(p) for p in self.parameters}


def _default(parameter: Parameter) -> float:
    if parameter.default is None:
        raise ValueError(f"parameter {parameter.name}: a shape needs a default")
    return parameter.default
