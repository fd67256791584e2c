"""Effect: sound is a little faster in humid air."""

from msp_range.acoustics.air import SONIC_PER_VAPOUR, vapour_fraction
from msp_sim.effects.base import Contribution, Effect, Parameter, Scene, Values


def _apply(scene: Scene, values: Values) -> Contribution:
    # The speed of sound grows with the root of the sonic temperature.
    faster_by = 0.5 * SONIC_PER_VAPOUR * vapour_fraction(scene["air_temperature_c"], scene["humidity_pct"])
    return Contribution(bias_cm=-values["share"] * scene.range_cm * faster_by)


HUMIDITY = Effect(
    name="humidity",
    sentence="Sound is a little faster in humid air, so on a hot and humid day ranges read up to 0.7 % short.",
    finding="readings are not corrected for the humidity ({share:%} of its effect is left)",
    physics="c grows by 0.16 of the mole fraction of water vapour, h p_sat(T) / p at sea level",
    source="Kaimal and Gaynor 1991, Boundary-Layer Meteorology 56, 401; p_sat of Magnus (Alduchov and Eskridge 1996)",
    parameters=(Parameter("share", "1", "share that is not compensated", -0.5, 3.0),),
    requires=("true_range_cm", "air_temperature_c", "humidity_pct"),
    channels=("bias",),
    experiment="a room at 30 deg C, first dry and then with wet cloths: readings differ by 0.5 % of the range",
    apply=_apply,
    media=("sound",),
)
