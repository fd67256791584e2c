"""Something that stays before the sensor: ring-down, a landing gear, a cable."""

from collections.abc import Mapping

import numpy as np

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene
from msp_sim.effects.component import Normal


def _apply(scene: Scene, values: Mapping[str, float]) -> Contribution:
    own_cm = scene.optional("true_range_cm", scene.sensor.maximum_cm)
    nearer = values["location_cm"] < own_cm
    component = Normal(values["location_cm"], values["sigma_cm"])
    return Contribution(component=component, share=np.where(nearer, values["share"], 0.0))


CLUTTER = Effect(
    name="clutter",
    sentence="A leg, a cable or the sensor's own ringing answers at a fixed range in place of the ground.",
    physics="hits at a place that does not move with the ground, where the ground is farther",
    source="ring-down of the transducer; parts of the airframe in the beam",
    parameters=(
        Parameter("share", "1", "share of the readings of surfaces beyond it", 0.0, 1.0),
        Parameter("location_cm", "cm", "where it is", 0.0, 1000.0, None, 30.0, (25.0, 35.0, 50.0, 80.0)),
        Parameter("sigma_cm", "cm", "its scatter", 0.1, 50.0, None, 2.0, (2.0,)),
    ),
    requires=(),
    channels=("component",),
    experiment="the sensor on its vehicle, into open sky",
    apply=_apply,
    optional=("true_range_cm",),
)
