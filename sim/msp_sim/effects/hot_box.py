"""Effect: hot or cold air around the sensor only, as in the report's hot box."""

import numpy as np

from msp_range.acoustics.air import speed_of_sound
from msp_sim.effects.base import Contribution, Effect, Parameter, Scene, Values

EDGE_CM = 3.0
"""Distance over which the air changes from one temperature to the other [cm]; assumed, sharp compared with the box."""


def _apply(scene: Scene, values: Values) -> Contribution:
    range_cm, length_cm = scene.range_cm, values["length_cm"]
    # Integral of a logistic edge at length_cm: how much of the path lies in the air of the sensor.
    near_cm = range_cm - EDGE_CM * (
        np.logaddexp(0.0, (range_cm - length_cm) / EDGE_CM) - np.logaddexp(0.0, -length_cm / EDGE_CM)
    )
    at_sensor_m_s = speed_of_sound(scene["air_temperature_c"])
    beyond_m_s = speed_of_sound(scene["target_temperature_c"])
    slowness = scene.assumed_m_s / beyond_m_s - scene.assumed_m_s / at_sensor_m_s
    return Contribution(bias_cm=values["share"] * (range_cm - near_cm) * slowness)


HOT_BOX = Effect(
    name="hot_box",
    sentence="Only the air close to the sensor is hot or cold, but the thermometer there is used for the whole path.",
    finding="air of another temperature over the {length_cm} next to the sensor shifts readings by {share:%} of "
    "what the thermometers predict",
    physics=(
        "beyond the box, z - h(z), the air has the target's temperature; h(z) is the length of path in the sensor's "
        "air, min(z, length) with an edge of 3 cm. Acts in addition to air_temperature, which assumes the sensor's "
        "air along the whole path"
    ),
    source="report 4.3.5 and its erratum 11: hot air confined to about 30 cm explains 1-2 cm at all ranges",
    parameters=(
        Parameter("share", "1", "strength; 1 is the effect of the equation", -0.5, 1.5),
        Parameter(
            "length_cm",
            "cm",
            "length of the path in the sensor's air",
            1.0,
            300.0,
            None,
            30.0,
            (15.0, 30.0, 60.0, 120.0),
        ),
    ),
    requires=("true_range_cm", "air_temperature_c", "target_temperature_c"),
    channels=("bias",),
    experiment="sensor in a warm box, target outside, ranges below and above the box's length",
    apply=_apply,
    media=("sound",),
)
