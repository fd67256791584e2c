"""Effect: the thermometer shows too high a temperature."""

import numpy as np

from msp_range.acoustics.air import ZERO_CELSIUS_K
from msp_sim.effects.base import Contribution, Effect, Parameter, Scene, Values


def _apply(scene: Scene, values: Values) -> Contribution:
    shown_k = scene["air_temperature_c"] + ZERO_CELSIUS_K
    return Contribution(bias_cm=scene.range_cm * (np.sqrt(shown_k / (shown_k - values["offset_c"])) - 1.0))


THERMOMETER_OFFSET = Effect(
    name="thermometer_offset",
    sentence="The thermometer shows more than the air temperature, so compensated ranges are too long.",
    finding="the thermometer shows {offset_c:too much|too little}",
    physics="z sqrt(T / (T - d)) with T the temperature shown [K] and T - d that of the air",
    source="report eq 7; the chips of barometers are often 10 to 30 C above the air",
    parameters=(Parameter("offset_c", "K", "error of the thermometer", -50.0, 50.0),),
    requires=("true_range_cm", "air_temperature_c"),
    channels=("bias",),
    experiment="a second thermometer in the shade next to the first",
    apply=_apply,
    media=("sound",),
    equivalent_causes=("range_scale, unless the temperature varies by tens of degrees",),
)
