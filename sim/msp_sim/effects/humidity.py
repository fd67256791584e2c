"""Effect: sound is a little faster in humid air."""

import numpy as np

from msp_range.acoustics.atmosphere import STANDARD_PRESSURE_PA
from msp_sim.effects.base import Contribution, Effect, Parameter, Scene, Values

FASTER_BY = 0.158
"""Relative growth of the speed of sound with the mole fraction of water at 20 deg C: (a3 + a4 t) / c of Cramer 1993."""


def _apply(scene: Scene, values: Values) -> Contribution:
    temperature_c = scene["air_temperature_c"]
    saturation_pa = 610.94 * np.exp(17.625 * temperature_c / (temperature_c + 243.04))
    water = scene["humidity_pct"] / 100.0 * saturation_pa / STANDARD_PRESSURE_PA
    return Contribution(bias_cm=-values["share"] * scene.range_cm * FASTER_BY * water)


HUMIDITY = Effect(
    name="humidity",
    sentence="Sound is a little faster in humid air, so on a hot and humid day ranges read up to 0.7 % short.",
    finding="readings are not corrected for the humidity ({share:%} of its effect is left)",
    physics="c grows by 0.158 of the mole fraction of water vapour, h p_sat(T) / p at sea level",
    source="Cramer 1993, J. Acoust. Soc. Am. 93, 2510, eq 15; p_sat of Magnus (Alduchov and Eskridge 1996)",
    parameters=(Parameter("share", "1", "share that is not compensated", -0.5, 3.0),),
    requires=("true_range_cm", "air_temperature_c", "humidity_pct"),
    channels=("bias",),
    experiment="a room at 30 deg C, first dry and then with wet cloths: readings differ by 0.5 % of the range",
    apply=_apply,
    media=("sound",),
)
