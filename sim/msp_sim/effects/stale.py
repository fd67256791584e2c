"""The last reading, read again."""

from collections.abc import Mapping

import numpy as np

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene
from msp_sim.effects.component import Code


def _apply(scene: Scene, values: Mapping[str, float]) -> Contribution:
    previous_cm = scene["previous_reading_cm"]
    whole = np.rint(previous_cm) == previous_cm
    within = (previous_cm >= scene.sensor.minimum_cm) & (previous_cm <= scene.sensor.maximum_cm)
    return Contribution(component=Code(previous_cm), share=np.where(whole & within, values["share"], 0.0))


STALE = Effect(
    name="stale",
    sentence="Now and then the sensor's last reading is handed out once more, as if nothing had moved.",
    physics="the sensor's previous reading in place of a new one",
    source="drivers that read before the ranging is done; register reads that ping again",
    parameters=(Parameter("share", "1", "share of the readings that are old", 0.0, 1.0),),
    requires=("previous_reading_cm",),
    channels=("component",),
    experiment="a target in steady motion: readings that stand still",
    apply=_apply,
)
