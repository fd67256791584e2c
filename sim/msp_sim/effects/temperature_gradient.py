"""Effect: the air gets steadily warmer or colder along the path."""

from msp_range.acoustics.air import speed_of_sound
from msp_sim.effects.base import Contribution, Effect, Parameter, Scene, Values


def _apply(scene: Scene, values: Values) -> Contribution:
    at_sensor_m_s = speed_of_sound(scene["air_temperature_c"])
    at_target_m_s = speed_of_sound(scene["target_temperature_c"])
    slowness = scene.assumed_m_s * (2.0 / (at_sensor_m_s + at_target_m_s) - 1.0 / at_sensor_m_s)
    return Contribution(bias_cm=values["share"] * scene.range_cm * slowness)


TEMPERATURE_GRADIENT = Effect(
    name="temperature_gradient",
    sentence="Over hot ground the air is warmer further down, but the sensor's thermometer shows one end only.",
    finding="air of another temperature near the ground shifts readings by {share:%} of what the thermometers predict",
    physics=(
        "temperature linear from sensor to target: the mean of 1 / c is 2 / (c_sensor + c_target), exactly. Acts in "
        "addition to air_temperature, which assumes the sensor's air along the whole path"
    ),
    source="integral of dx / c(T(x)) with c = 20.05 sqrt(T)",
    parameters=(Parameter("share", "1", "strength; 1 is the effect of the equation", -0.5, 2.5),),
    requires=("true_range_cm", "air_temperature_c", "target_temperature_c"),
    channels=("bias",),
    experiment="hot asphalt at noon and cool asphalt in the morning, thermometers at sensor and ground",
    apply=_apply,
    media=("sound",),
)
