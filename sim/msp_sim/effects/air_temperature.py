"""Effect: the air does not have the temperature that the sensor assumes."""

from msp_range.acoustics.air import speed_of_sound
from msp_sim.effects.base import Contribution, Effect, Parameter, Scene, Values


def _apply(scene: Scene, values: Values) -> Contribution:
    ratio = scene.assumed_m_s / speed_of_sound(scene["air_temperature_c"])
    return Contribution(bias_cm=values["share"] * scene.range_cm * (ratio - 1.0))


AIR_TEMPERATURE = Effect(
    name="air_temperature",
    sentence="Sound is slower in cold air, so the sensor reads too far in cold air and too near in warm air.",
    finding="readings are not corrected for the air temperature ({share:%} of its effect is left)",
    physics="reading = z c(T_C) / c(T), c = 20.05 sqrt(T); T_C the sensor's calibration temperature, T the air's [K]",
    source="report eq 6 and 7; MB1242 datasheet: the sensor does not compensate",
    parameters=(Parameter("share", "1", "share that is not compensated; 1 for the bare sensor", -1.5, 1.5),),
    requires=("true_range_cm", "air_temperature_c"),
    channels=("bias",),
    experiment="the same target at 0 and at 30 deg C: readings differ by 5 % of the range",
    apply=_apply,
    media=("sound",),
)
