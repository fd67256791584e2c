"""An unknown effect as a curve: one channel as a function of one or two context columns.

`curve` makes an `Effect` from knots and values, or from a period and two amplitudes. It describes how the readings
depend on a context, without a physical cause.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np

from msp_range.arrays import Array, Column, Indices
from msp_sim.effects.base import Contribution, Effect, Parameter, Scene

CurveChannel: TypeAlias = Literal["bias", "spread", "short", "missed", "random"]
CURVE = "curve"
FIELDS: dict[str, str] = {
    "bias": "bias_cm",
    "spread": "log_spread",
    "short": "log_odds_short",
    "missed": "log_odds_missed",
    "random": "log_odds_random",
}
"""Field of a `Contribution` for each channel."""
MAX_VALUE = {"bias": 200.0, "spread": 5.0, "short": 15.0, "missed": 15.0, "random": 15.0}
"""Largest magnitude of a curve's values, by channel: far beyond any real effect, so that a fit cannot diverge."""


@dataclass(frozen=True)
class Ripple:
    """In place of knots: the two values are the amplitudes of a cosine and a sine of this period."""

    period: float

    def __len__(self) -> int:
        return 2


Knots: TypeAlias = Sequence[Any] | Ripple
"""Places of a curve's values over one variable: increasing numbers, words, or a period."""


def curve(channel: CurveChannel, variables: Sequence[str], knots: Sequence[Knots]) -> Effect:
    """A curve as an effect; its parameters are its values at the knots.

    Linear between knots and constant beyond them. Over two variables it is bilinear, with values row by row. For a
    column of words the knots are words, and the value for other words is 0.

    Parameters
    ----------
    channel
        bias [cm], spread [log sigma], or log odds of short, missed or random readings.
    variables
        One or two context columns.
    knots
        Knots of each variable, increasing, or the period of a ripple.

    Examples
    --------
    >>> bow = curve("bias", ["throttle"], [[0.0, 0.5, 1.0]])
    >>> [parameter.name for parameter in bow.parameters]
    ['value_0', 'value_1', 'value_2']
    """
    limit = MAX_VALUE[channel]
    count = int(np.prod([len(knot) for knot in knots]))
    unit = "cm" if channel == "bias" else "1"
    names = [f"value_{i}" for i in range(count)]
    places = tuple(knot if isinstance(knot, Ripple) else tuple(knot) for knot in knots)

    def apply(scene: Scene, values: Mapping[str, float]) -> Contribution:
        at = np.array([values[name] for name in names])
        return Contribution(**{FIELDS[channel]: knot_weights(scene, tuple(variables), places) @ at})

    return Effect(
        name=CURVE,
        sentence=f"Something makes the {channel} depend on {' and '.join(variables)}; the cause is unknown.",
        physics="none: a curve through knots, linear between them",
        source="found in measured data by msp-lab gap",
        parameters=tuple(Parameter(name, unit, "value at a knot", -limit, limit) for name in names),
        requires=tuple(dict.fromkeys((*variables, *(("true_range_cm",) if channel in ("bias", "spread") else ())))),
        channels=(channel,),
        experiment=f"vary {' and '.join(variables)} alone",
        apply=apply,
    )


def knot_weights(scene: Scene, variables: tuple[str, ...], knots: tuple[Knots, ...]) -> Array:
    """As `hats`, worked out once for a scene."""
    kept = scene.kept(variables)
    if (variables, knots) not in kept:
        kept[variables, knots] = hats(scene, variables, knots)
    weights: Array = kept[variables, knots]
    return weights


def hats(scene: Any, variables: Sequence[str], knots: Sequence[Knots]) -> Array:
    """Interpolation weights of the knots for each row, shape (n, knots); for two variables products of both.

    Of a ripple its cosine and sine, which are 0 where the variable is unknown.
    """
    weights, *others = (
        _hats(np.atleast_1d(scene[each]), places) for each, places in zip(variables, knots, strict=True)
    )
    for own in others:
        weights = (weights[:, :, None] * own[:, None, :]).reshape(own.shape[0], -1)
    return weights if np.ndim(scene[variables[0]]) else weights[0]


def _hats(values: Column, places: Knots) -> Array:
    if isinstance(places, Ripple):
        turned = np.exp(2j * np.pi * np.where(np.isfinite(values), values, 0.0) / places.period)
        return np.column_stack([turned.real, turned.imag]) * np.isfinite(values)[:, None]
    if isinstance(places[0], str):
        return np.asarray(values[:, None] == np.asarray(places)[None, :], dtype=np.float64)
    left, share = between(values, places)
    weights = np.zeros((values.size, len(places)))
    rows = np.arange(values.size)
    weights[rows, left] = 1.0 - share
    weights[rows, left + 1] += share
    return weights


def between(values: Column, places: Sequence[float] | Array) -> tuple[Indices, Array]:
    """Place of the knot before each value, and how far it is to the next one, (n,); beyond the last ones the ends."""
    knots = np.asarray(places, dtype=np.float64)
    values = np.clip(np.where(np.isfinite(values), values, knots[0]), knots[0], knots[-1])
    left = np.clip(np.searchsorted(knots, values, "right") - 1, 0, knots.size - 2)
    return left, (values - knots[left]) / (knots[left + 1] - knots[left])
