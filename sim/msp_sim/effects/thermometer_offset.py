"""A thermometer that shows too much."""

from collections.abc import Mapping

import numpy as np

from msp_range.acoustics.air import ZERO_CELSIUS_K
from msp_sim.effects.base import Contribution, Effect, Parameter, Scene


def _apply(scene: Scene, values: Mapping[str, float]) -> Contribution:
    shown_k = scene["air_temperature_c"] + ZERO_CELSIUS_K
    return Contribution(bias_cm=scene.range_cm * (np.sqrt(shown_k / (shown_k - values["offset_c"])) - 1.0))


THERMOMETER_OFFSET = Effect(
    name="thermometer_offset",
    sentence="The thermometer shows more than the air has, so compensated ranges come out too long.",
    physics="z sqrt(T / (T - d)) with T the temperature that is shown [K] and T - d the air's",
    source="report eq 7; barometers' own dies are often 10 to 30 C above the air",
    parameters=(Parameter("offset_c", "K", "how much too much the thermometer shows", -50.0, 50.0),),
    requires=("true_range_cm", "air_temperature_c"),
    channels=("bias",),
    experiment="a second thermometer in the shade beside the first",
    apply=_apply,
    equivalent_causes=("range_scale, unless the temperature varies by tens of degrees",),
)
