"""The type of an effect: a physical cause with a name and bounded parameters that changes the distribution of readings.

An effect gets the context columns as a `Scene` and returns a `Contribution`: a shift of the hits, a change of their
spread or of the odds of outliers, one more component of the mixture, or a fault of the reading's code. `msp_sim.model`
adds the contributions of all effects to the base mixture, for drawing readings and for their likelihood alike. An
effect does not change a reading whose context is unknown (a missing column or an empty cell).
"""

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple, TypeAlias, get_args

import numpy as np

from msp_range.acoustics.air import speed_of_sound
from msp_range.arrays import Indices, numbered
from msp_range.reading_model.sensor_model import Medium, SensorModel
from msp_sim.effects.codes import CodeFault
from msp_sim.effects.component import Component

Values: TypeAlias = Mapping[str, float]
"""Values of an effect's parameters by name."""
Channel: TypeAlias = Literal["bias", "spread", "short", "missed", "random", "component", "code"]

TRUE_RANGE = "true_range_cm"
PATH = "path"
"""Column of the readings' places on the reference's path (`msp_sim.effects.path`)."""
REFERENCE_STD = "true_range_std_cm"
REFERENCE = "reference"
OTHERS = "others"
"""Word in the column `REFERENCE` if the true range is that of the other sensors, less each run's mean difference from
it."""
WORD_COLUMNS = frozenset({"sensor", "run", "target"})
"""Context columns that contain words instead of numbers; an effect of one sensor, run or target is given its word."""


@dataclass(frozen=True)
class Parameter:
    """A parameter of an effect: a strength, which has a neutral value, or a shape parameter, which has a default."""

    name: str
    """Name, ending with the unit if there is one."""
    unit: str
    """Unit as people write it; "1" for a ratio."""
    meaning: str
    """Its meaning, for help texts."""
    low: float
    high: float
    """Bounds."""
    neutral: float | None = 0.0
    """Value at which the effect does nothing; None for a shape parameter."""
    default: float | None = None
    """Default of a shape parameter, if a model file leaves it out."""
    grid: tuple[float, ...] = ()
    """Values at which a search starts, of a shape parameter or of a strength in which the effect is far from linear."""
    step: float = 1e-3
    """A small change, for numeric derivatives."""
    power: int = 1
    """Leading power of the parameter in the effect; with 2 the slope at the neutral value is zero."""
    jumps: bool = False
    """Whether the likelihood jumps as it changes, so that a slope means nothing: only the values of its grid are
    tried."""


def share_of_readings(meaning: str) -> Parameter:
    """The parameter of an effect that acts on a share of the readings."""
    return Parameter("share", "1", meaning, 0.0, 1.0)


class Scene:
    """The input of an effect: the contexts of n readings, and the sensor.

    Parameters
    ----------
    sensor
        The sensor model file.
    contexts
        Columns by name, of length n: numbers with NaN, words with "" if unknown. For a single reading a number or a
        word each, None if unknown.
    """

    def __init__(self, sensor: SensorModel, contexts: Mapping[str, Any]) -> None:
        self.sensor = sensor
        self._contexts = contexts
        self._known: dict[str, Any] = {}
        self._ago_s: Any = 0.0
        self._stamped = contexts
        self._shifted: Scene | None = None
        self._of_range: dict[Any, Any] = {}
        self._of_others: dict[Any, Any] = {}

    def __contains__(self, column: str) -> bool:
        return column in self._contexts

    def __getitem__(self, column: str) -> Any:
        """A column; KeyError if it is absent."""
        return self._contexts[column]

    @property
    def range_cm(self) -> Any:
        """True range [cm]; NaN if there is no echo."""
        return self._contexts[TRUE_RANGE]

    @property
    def assumed_m_s(self) -> float:
        """Speed of sound that the sensor's own conversion to centimetres assumes [m/s]."""
        return speed_of_sound(self.sensor.calibration_temperature_c)

    def optional(self, column: str, otherwise: float) -> Any:
        """A column, with a default value in place of unknown ones."""
        known = self.known(column)
        if known is True or known is False:
            return self._contexts[column] if known else otherwise
        return np.where(known, self._contexts[column], otherwise)

    def kept(self, columns: Collection[str]) -> dict[Any, Any]:
        """Cache for what is computed once from some columns: of the same at all times, unless the true range is one."""
        return self._of_range if TRUE_RANGE in columns else self._of_others

    def at(self, ago_s: Any) -> "Scene":
        """The scene ``ago_s`` earlier [s]: the true ranges then, from the reference's path, or from the rate without a
        path."""
        stamped, ago_s = self._stamped, self._ago_s + ago_s
        last = self._shifted
        if last is not None and _is_equal(last._ago_s, ago_s):
            # A fit asks for it again for each of its numbers.
            return last
        moved_cm = stamped[PATH].moved_cm(ago_s) if PATH in stamped else -ago_s * stamped["range_rate_cm_s"]
        # numpy's functions take twenty times as long for a number as what they do.
        if not isinstance(moved_cm, float) or not math.isfinite(moved_cm):
            moved_cm = np.nan_to_num(moved_cm)
        scene = Scene(self.sensor, {**stamped, TRUE_RANGE: stamped[TRUE_RANGE] + moved_cm})
        scene._ago_s, scene._stamped = ago_s, stamped
        # Where ranges are known does not change: one that has no path stays where it is.
        scene._known, scene._of_others = self._known, self._of_others
        self._shifted = scene
        return scene

    def about_run_mean(self, bias_cm: Any) -> Any:
        """What was added to a bias [cm], as it shows against the reference.

        The other sensors do not know a constant offset of a run, and what the readings differ by from the given model
        is taken off them. So it counts about its mean: else a scale would have to explain that it shifts no run as a
        whole, and a bent curve would be the better name.
        """
        kept = self.kept(("run", REFERENCE))
        if "run" not in kept:
            own = np.any(self._contexts.get(REFERENCE, "") == OTHERS) and "run" in self._contexts
            kept["run"] = numbered(self._contexts["run"]) if own else np.zeros(0, dtype=np.intp)
        run: Indices = kept["run"]
        if not run.size:
            return bias_cm
        known = np.isfinite(bias_cm) & np.isfinite(self.range_cm)
        counts = np.maximum(np.bincount(run, known), 1.0)
        return bias_cm - (np.bincount(run, np.where(known, bias_cm, 0.0)) / counts)[run]

    def known(self, column: str) -> Any:
        """Rows in which a column is known: an array, or True for all rows, or False if the column is absent."""
        if column not in self._known:
            self._known[column] = column in self._contexts and _is_known(self._contexts[column])
        return self._known[column]


def _is_equal(one: Any, other: Any) -> bool:
    if isinstance(one, float) and isinstance(other, float):
        return one == other
    return np.array_equal(one, other)


def _is_known(values: Any) -> Any:
    if not isinstance(values, np.ndarray):
        return bool(values) if isinstance(values, str) else values is not None and abs(values) < np.inf
    known = values != "" if values.dtype.kind == "U" else np.isfinite(values)
    return True if known.all() else known


class Contribution(NamedTuple):
    """What an effect changes in the distribution of n readings; None leaves that part unchanged."""

    bias_cm: Any = None
    """Added to the centre of the hits [cm]."""
    ago_s: Any = None
    """Age of the reading at its stamp [s]: it shows the range of then, and the difference becomes a bias."""
    log_spread: Any = None
    """Added to the logarithm of the hits' standard deviation."""
    run_offset_cm: float | None = None
    """Standard deviation of an offset that is common to all readings of a run [cm]."""
    log_odds_short: Any = None
    log_odds_missed: Any = None
    log_odds_random: Any = None
    """Added to the log odds of a short, missed or random reading against a hit."""
    component: Component | None = None
    share: Any = None
    """An additional component of the mixture, and its share of the readings if it is the only one added."""
    fault: CodeFault | None = None
    fault_share: Any = None
    """A fault of the reading's code, and the share of the readings affected."""


def damage(fault: CodeFault) -> Callable[[Scene, Values], Contribution]:
    """``apply`` of an effect that turns a share of the codes into others, by a fault."""
    return lambda scene, values: Contribution(fault=fault, fault_share=values["share"])


def everywhere(field: str, parameter: str) -> Callable[[Scene, Values], Contribution]:
    """``apply`` of an effect that sets a field of the `Contribution` to its parameter, in any context."""

    def apply(scene: Scene, values: Values) -> Contribution:
        changed: dict[str, Any] = {field: values[parameter]}
        return Contribution(**changed)

    return apply


@dataclass(frozen=True)
class Effect:
    """An entry of the catalogue."""

    name: str
    """Name in model files."""
    sentence: str
    """What it does, in a sentence for a pilot."""
    physics: str
    """Equation or mechanism, and its range of validity."""
    source: str
    """Source of the equation."""
    parameters: tuple[Parameter, ...]
    """Parameters."""
    channels: tuple[Channel, ...]
    """Parts of the distribution that it changes."""
    experiment: str
    """An experiment that shows this effect alone."""
    apply: Callable[[Scene, Values], Contribution] = field(repr=False)
    """Function from the contexts and the parameters' values by name to a `Contribution`; nothing at the neutral
    values."""
    requires: tuple[str, ...] = ()
    """Context columns without which it does nothing."""
    optional: tuple[str, ...] = ()
    """Further context columns that it uses if they are known."""
    per: Literal["sensor", "run", "target"] | None = None
    """Column of words if the effect concerns one of them (`mounting_offset` of one sensor); None: all readings."""
    base: str | None = None
    """Parameter of the sensor model with the same meaning; adding the effect is then calibration."""
    equivalent_causes: tuple[str, ...] = ()
    """Other causes that change every reading in the same way."""
    media: tuple[Medium, ...] = get_args(Medium)
    """Media of the sensors that the effect concerns: sound, light or radio."""
    moves: str = ""
    """Parameter to which the shift of a part of the hits is proportional, with nothing else changed; empty: none."""
    gathers: str = ""
    """Parameter with the range [cm] at which readings accumulate, wherever the surface is; empty: none."""
    is_shift: bool = False
    """Whether it moves readings in time: all other effects then act on the scene of that moment."""
    any_step: bool = False
    """Whether a fault of the code is defined for readings in any step; others act on the bytes of whole centimetres."""
    finding: str = ""
    """Sentence for a pilot when the effect is found, without a full stop: {of} and its parameters in braces, with the
    formats of `msp_sim.effects.plain`. Empty: the effect's ``sentence`` with the parameters after it."""

    def happens_to(self, sensor: SensorModel) -> bool:
        """Whether a sensor can have the effect, by its medium and by the step of its readings."""
        has_bytes = sensor.resolution_cm == 1.0
        return sensor.medium in self.media and ("code" not in self.channels or self.any_step or has_bytes)

    @property
    def columns(self) -> frozenset[str]:
        """All context columns that it uses."""
        return frozenset({*self.requires, *self.optional, *([self.per] if self.per else [])})

    def neutral_values(self) -> dict[str, float]:
        """Values at which the effect does nothing; shape parameters at their defaults."""
        return {p.name: p.neutral if p.neutral is not None else _default(p) for p in self.parameters}


def _default(parameter: Parameter) -> float:
    if parameter.default is None:
        raise ValueError(f"parameter {parameter.name}: a shape parameter needs a default")
    return parameter.default
