"""Air that gets warmer or colder all along the path."""

from collections.abc import Mapping

from msp_range.acoustics.air import speed_of_sound
from msp_sim.effects.base import Contribution, Effect, Parameter, Scene


def _apply(scene: Scene, values: Mapping[str, float]) -> Contribution:
    at_sensor_m_s = speed_of_sound(scene["air_temperature_c"])
    at_target_m_s = speed_of_sound(scene["target_temperature_c"])
    slowness = scene.assumed_m_s * (2.0 / (at_sensor_m_s + at_target_m_s) - 1.0 / at_sensor_m_s)
    return Contribution(bias_cm=values["share"] * scene.range_cm * slowness)


TEMPERATURE_GRADIENT = Effect(
    name="temperature_gradient",
    sentence="Over hot ground the air gets warmer on the way down, and a thermometer at the sensor tells half of it.",
    physics=(
        "temperature linear from sensor to target: the mean of 1 / c is 2 / (c_sensor + c_target), exactly. Beside "
        "air_temperature, which takes the sensor's air for all of the path"
    ),
    source="integral of dx / c(T(x)) with c = 20.05 sqrt(T)",
    parameters=(Parameter("share", "1", "share of it that is there", -0.5, 2.5),),
    requires=("true_range_cm", "air_temperature_c", "target_temperature_c"),
    channels=("bias",),
    experiment="hot asphalt at noon and cool asphalt in the morning, a thermometer at the sensor and one at the ground",
    apply=_apply,
)
