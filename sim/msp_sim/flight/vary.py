"""What varies from flight to flight of a Monte Carlo run: parameters of a scenario, and random faults.

The section ``vary`` of a scenario file says which values of a flight are random. A parameter is named by its path in
the file, such as ``air.ground_c`` or ``flight.altitude[1].to_m``; ``[*]`` stands for every element of a list, which all
get the same draw.
"""

import math
import re
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, Self

from numpy.random import Generator
from pydantic import Field, model_validator

from msp_range.yaml_file import Place, Section, SectionT
from msp_sim.device.device import ALWAYS_HAPPEN, FAULT_KINDS, SERIAL_FAULT_KINDS
from msp_sim.world.profiles import Positive

DIGITS = 4
"""Significant digits of a drawn number: those that a table shows are those that were flown. Fewer would make the steps
of a distribution visible."""
EACH = "[*]"
Value = float | int | str | bool


class _Limits(Section):
    """Two limits, the lower one first."""

    low: float
    """smallest value"""
    high: float
    """largest value"""

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        return _ordered(self, self.low, self.high)

    @property
    def ends(self) -> tuple[Value, ...]:
        """Values that the parameter must be able to have."""
        return self.low, self.high


class _LogLimits(_Limits):
    """Two limits, between which every factor is equally likely."""

    low: Positive
    """smallest value"""
    high: Positive
    """largest value"""

    def draw(self, generator: Generator) -> Value:
        """A random value."""
        return rounded(math.exp(float(generator.uniform(math.log(self.low), math.log(self.high)))))


class Uniform(_Limits):
    """Every value between two limits is equally likely."""

    kind: Literal["uniform"]

    def draw(self, generator: Generator) -> Value:
        """A random value."""
        return rounded(float(generator.uniform(self.low, self.high)))


class LogUniform(_LogLimits):
    """Every factor is equally likely: as many values between 1 and 2 as between 2 and 4."""

    kind: Literal["log_uniform"]


class Factor(_LogLimits):
    """The scenario's own value times a factor, of which every ratio is equally likely."""

    kind: Literal["factor"]


class TruncatedNormal(Section):
    """A normal distribution, cut off at limits if they are given."""

    kind: Literal["normal"]
    mean: float
    """mean before it is cut off"""
    std: Positive
    """standard deviation before it is cut off"""
    low: float | None = None
    """smaller values are drawn again; default: no limit"""
    high: float | None = None
    """larger values are drawn again; default: no limit"""

    @model_validator(mode="after")
    def _reachable(self) -> Self:
        low, high = self._limits
        if high <= low or low > self.mean + 2 * self.std or high < self.mean - 2 * self.std:
            raise ValueError(
                f"found low {low:g} and high {high:g}; expected low < high, and neither of them further than two "
                f"standard deviations on the wrong side of the mean {self.mean:g}"
            )
        return self

    @property
    def _limits(self) -> tuple[float, float]:
        return -math.inf if self.low is None else self.low, math.inf if self.high is None else self.high

    @property
    def ends(self) -> tuple[Value, ...]:
        """Values that the parameter must be able to have."""
        return tuple(min(max(self.mean + by * self.std, self._limits[0]), self._limits[1]) for by in (-2.0, 2.0))

    def draw(self, generator: Generator) -> Value:
        """A random value."""
        low, high = self._limits
        while True:
            value = rounded(float(generator.normal(self.mean, self.std)))
            if low <= value <= high:
                return value


class Choice(Section):
    """One of several values, each equally likely."""

    kind: Literal["choice"]
    of: Annotated[tuple[bool | int | float | str, ...], Field(min_length=1)]
    """the values; one that is listed twice is twice as likely"""

    @property
    def ends(self) -> tuple[Value, ...]:
        """Values that the parameter must be able to have."""
        return self.of

    def draw(self, generator: Generator) -> Value:
        """A random value."""
        return self.of[int(generator.integers(len(self.of)))]


Distribution = Annotated[Uniform | LogUniform | TruncatedNormal | Factor | Choice, Field(discriminator="kind")]


class RandomFaults(Section):
    """Faults of sensors at random times, on top of the scenario's own."""

    share: Annotated[float, Field(gt=0, le=1)] = 0.3
    """share of the flights that have any"""
    most: Annotated[int, Field(ge=1, le=20)] = 2
    """largest number of faults in a flight; each number from 1 is equally likely"""
    kinds: Annotated[tuple[str, ...], Field(min_length=1)] = tuple(FAULT_KINDS)
    """kinds of fault, each equally likely; those that a sensor cannot show are left out for it; default: all"""
    shortest_s: Positive = 2.0
    """shortest duration [s]"""
    longest_s: Positive = 20.0
    """longest duration [s]; every factor between the two is equally likely"""

    @model_validator(mode="after")
    def _known(self) -> Self:
        for kind in self.kinds:
            if kind not in (known := FAULT_KINDS | SERIAL_FAULT_KINDS):
                raise ValueError(f"kinds: found {kind!r}; expected some of {', '.join(known)}")
        return _ordered(self, self.shortest_s, self.longest_s)

    def draw(self, generator: Generator, kinds: Mapping[str, Sequence[str]], flight_s: float) -> list[dict[str, Any]]:
        """Faults of a flight, as in the section ``faults`` of a scenario.

        Parameters
        ----------
        generator
            Source of randomness.
        kinds
            Kinds of fault by sensor, at least one each.
        flight_s
            Duration of the flight [s].
        """
        if generator.random() >= self.share:
            return []
        drawn = []
        for _ in range(int(generator.integers(1, self.most, endpoint=True))):
            sensor = list(kinds)[int(generator.integers(len(kinds)))]
            kind = kinds[sensor][int(generator.integers(len(kinds[sensor])))]
            from_s = round(float(generator.uniform(0.0, flight_s)), 2)
            log_s = generator.uniform(math.log(self.shortest_s), math.log(self.longest_s))
            often = round(float(generator.uniform(0.2, 1.0)), 2)
            to_s = round(from_s + math.exp(float(log_s)), 2)
            probability = 1.0 if kind in ALWAYS_HAPPEN else often
            drawn.append({"sensor": sensor, "kind": kind, "from_s": from_s, "to_s": to_s, "probability": probability})
        return drawn


class VarySection(Section):
    """What varies from flight to flight of 'msp-sim monte-carlo'; other commands fly the scenario as it stands."""

    parameters: dict[str, Distribution] = Field(default_factory=dict)
    """distributions by the parameter's path in this file, such as air.ground_c"""
    faults: RandomFaults | None = None
    """random faults; default: only those of the scenario"""


def default_parameters(ground: str, *, has_track: bool) -> dict[str, Any]:
    """Parameters that vary if a scenario file does not say it: terrain, motion and temperatures.

    The ranges are assumed: fields and yards, light to strong wind, frost to heat, a thermometer in the sun.

    Parameters
    ----------
    ground
        Name of the ground's first surface, which gets a roughness.
    has_track
        Whether the vehicle moves along the ground.
    """
    speed = {"flight.track.legs[*].speed_m_s": {"kind": "factor", "low": 0.5, "high": 2.0}}
    return {
        "ground.slope_deg": {"kind": "uniform", "low": 0.0, "high": 3.0},
        "ground.uphill_deg": {"kind": "uniform", "low": 0.0, "high": 360.0},
        f"ground.rough.{ground}.rms_m": {"kind": "log_uniform", "low": 0.005, "high": 0.05},
        **(speed if has_track else {}),
        "flight.attitude.yaw_deg": {"kind": "uniform", "low": 0.0, "high": 360.0},
        "flight.attitude.sway.roll_rms_deg": {"kind": "log_uniform", "low": 0.3, "high": 3.0},
        "flight.attitude.sway.pitch_rms_deg": {"kind": "log_uniform", "low": 0.3, "high": 3.0},
        "air.ground_c": {"kind": "uniform", "low": -10.0, "high": 40.0},
        "thermometer.warmer_by_c": {"kind": "normal", "mean": 0.0, "std": 1.0},
    }


def _ordered(section: SectionT, low: float, high: float) -> SectionT:
    if high <= low:
        raise ValueError(f"found {low:g} and {high:g}; expected the second to be larger")
    return section


def rounded(value: float) -> float:
    """A number with `DIGITS` significant digits.

    Examples
    --------
    >>> rounded(0.0123456), rounded(-12.34567)
    (0.01235, -12.35)
    """
    return float(f"{value:.{DIGITS}g}")


def places(values: Mapping[str, Any], path: str) -> list[Place]:
    """The places that a parameter's path names; several with ``[*]``.

    Parameters
    ----------
    values
        The scenario as plain values.
    path
        Names separated by dots, with indices or ``[*]`` behind those of lists.

    Raises
    ------
    ValueError
        The path is not of this form, or a list in it does not have this element.

    Examples
    --------
    >>> places({"a": [{"b": 1}, {"b": 2}]}, "a[*].b")
    [('a', 0, 'b'), ('a', 1, 'b')]
    """
    if not re.fullmatch(r"\w+(\[(\*|\d+)\])*(\.\w+(\[(\*|\d+)\])*)*", path):
        raise ValueError("expected the path of a parameter, such as air.ground_c or flight.altitude[1].to_m")
    found: list[Place] = [()]
    for step in re.findall(r"\w+|\[\*\]", re.sub(r"\[(\d+)\]", r".\1", path)):
        following: list[Place] = []
        for place in found:
            value = value_at(values, place)
            if isinstance(value, list | tuple):
                if step != EACH and not (step.isdigit() and int(step) < len(value)):
                    raise ValueError(f"{step.strip('[]')} is not an element of the list, which has {len(value)}")
                following += [(*place, i) for i in (range(len(value)) if step == EACH else [int(step)])]
            elif step == EACH or step.isdigit():
                raise ValueError(f"{step.strip('[]')} stands behind what is not a list")
            else:
                following.append((*place, step))
        found = following
    return found


def value_at(values: Any, place: Sequence[int | str]) -> Any:
    """The value at a place; None if there is none."""
    for step in place:
        if isinstance(values, dict):
            values = values.get(step)
        elif isinstance(values, list | tuple) and isinstance(step, int):
            values = values[step]
        else:
            return None
    return values
