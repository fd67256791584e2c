"""Effects of the catalogue that do nearly what another effect does.

Readings are drawn with the effect, and each effect of the catalogue is fitted to them. Its gain in log probability over
the model without an effect, divided by that of the effect itself, is the share that it explains.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from msp_range.arrays import Array
from msp_range.reading_model.rows import MIN_PROBABILITY
from msp_range.reading_model.sensor_model import SensorModel
from msp_sim.effects import CATALOGUE
from msp_sim.effects.base import Effect
from msp_sim.model.model import Model
from msp_sim.model.trial import Trial

ALIKE = 0.95
"""An effect that explains this share is nearly the same. In the catalogue `bend`, which contains it, explains
`range_scale`, and `temperature_gradient` and `hot_box` explain each other; all other shares are at most 0.89."""
STARTS = (-0.6, -0.3, -0.1, 0.1, 0.3, 0.6)
"""Fractions of the way from the neutral values to the bounds at which a fit may start."""
PROMISING = 0.15
"""From the best start on, an effect that explains less is not fitted. More is quicker, and misses effects of which no
start is near; 0.15 takes a second for the whole catalogue."""
ROWS, EVALUATIONS = 4000, 120
"""Readings, and likelihoods of a fit: shares are right to 0.02."""


class Alike(NamedTuple):
    """An effect of the catalogue, and the share that it explains."""

    name: str
    share: float


def alike(effect: Effect, sensor: SensorModel) -> list[Alike]:
    """Effects of the catalogue that explain at least `ALIKE` of what an effect does on a sensor, the best first."""
    trial = Trial(effect, sensor)
    given = trial.contexts(ROWS, 9)
    readings_cm = trial.model.sample(given, np.random.default_rng(2))

    def log_prob(model: Model) -> Array:
        with np.errstate(all="ignore"):
            return np.maximum(model.log_prob(readings_cm, given), np.log(MIN_PROBABILITY))

    base = log_prob(trial.base)
    own = float(np.mean(log_prob(trial.model) - base))
    found = []
    for other in CATALOGUE.values():
        if other.name != effect.name:
            terms = Trial(other, sensor)

            def gain(values: Mapping[str, float], terms: Trial = terms) -> float:
                return float(np.mean(log_prob(Model(terms.base.sensor, (terms.at(values),))) - base))

            found.append(Alike(other.name, _largest(other, gain, PROMISING * own) / own))
    return sorted([each for each in found if each.share >= ALIKE], key=lambda each: -each.share)


def _largest(effect: Effect, gain: Callable[[Mapping[str, float]], float], promising: float) -> float:
    """The largest gain of an effect; where no start promises one, that of the best start."""
    names = [parameter.name for parameter in effect.parameters]
    low, high = np.array([(parameter.low, parameter.high) for parameter in effect.parameters]).T

    def values(place: Array) -> dict[str, float]:
        return dict(zip(names, np.clip(place, low, high).tolist(), strict=True))

    neutral = np.array([*effect.neutral_values().values()])
    free = np.array([parameter.neutral is not None for parameter in effect.parameters])
    starts = [neutral + free * abs(share) * ((high if share > 0 else low) - neutral) for share in STARTS]
    best, start = max(((gain(values(start)), start) for start in starts), key=lambda each: each[0])
    if best < promising:
        return best
    fit = minimize(
        lambda place: -gain(values(low + place * (high - low))),
        (start - low) / (high - low),
        method="Nelder-Mead",
        options={"maxfev": EVALUATIONS},
    )
    return max(best, -float(fit.fun))
