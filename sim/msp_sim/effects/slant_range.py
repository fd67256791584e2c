"""Effect: a tilted sensor measures the range along its axis, which is longer than the perpendicular."""

import numpy as np

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene, Values


def _apply(scene: Scene, values: Values) -> Contribution:
    tilt_rad = np.radians(np.minimum(np.abs(scene["incidence_deg"]), 85.0))
    slant_cm = scene.optional("slant_range_cm", scene.range_cm / np.cos(tilt_rad))
    return Contribution(bias_cm=values["share"] * (slant_cm - scene.range_cm))


SLANT_RANGE = Effect(
    name="slant_range",
    sentence="A tilted sensor measures along its axis, which is longer than the perpendicular distance to the surface.",
    finding="tilted, the sensor reads {share:% of the slant too far|% of the slant too near}",
    physics=(
        "z / cos(incidence), or slant_range_cm if known, instead of the perpendicular z; share -1 if the truth is "
        "along the axis and the sensor reads the perpendicular"
    ),
    source="report eq 8",
    parameters=(Parameter("share", "1", "strength; 1 is the effect of the equation", -1.5, 1.5),),
    requires=("true_range_cm", "incidence_deg"),
    channels=("bias",),
    experiment="tilt the sensor to both sides in front of a wall: the error grows with the square of the angle",
    apply=_apply,
    media=("sound", "light"),
    optional=("slant_range_cm",),
)
