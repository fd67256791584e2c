"""Effect: a rough surface gives an echo from the nearest point inside the beam."""

import numpy as np

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene, Values


def _apply(scene: Scene, values: Values) -> Contribution:
    half_angle_rad = values["beam"] * scene.sensor.beam.half_angle_rad(scene.range_cm / 100.0)
    tilt_rad = np.radians(np.minimum(np.abs(scene["incidence_deg"]), 85.0))
    beyond_rad = np.maximum(tilt_rad - half_angle_rad, 0.0)
    return Contribution(bias_cm=values["share"] * scene.range_cm * (1.0 / np.cos(beyond_rad) - 1.0))


NEAREST_POINT = Effect(
    name="nearest_point",
    sentence="If its perpendicular lies outside the beam, a rough surface gives an echo from the edge of the beam.",
    finding="tilt beyond the breakaway angle moves readings by {share:%} of what the edge of the beam gives",
    physics="z / cos(incidence - half angle) beyond the beam's half angle at that range, z within it",
    source="geometry of a cone; msp_sim.acoustics.slant.nearest_range_in_beam; needs roughness of about 8 mm",
    parameters=(
        Parameter("share", "1", "strength; 1 is the effect of the equation", -1.5, 1.5),
        Parameter(
            "beam", "1", "the beam's half angle over that of the sensor model", 0.5, 1.5, None, 1.0, (0.5, 0.75, 1.0)
        ),
    ),
    requires=("true_range_cm", "incidence_deg"),
    channels=("bias",),
    experiment="gravel at angles below and beyond the breakaway angle: no error below, growing beyond",
    apply=_apply,
    media=("sound",),
)
