"""Effect: the previous reading is reported again."""

from msp_range.reading_model.kernel import is_on_grid
from msp_sim.effects.base import Contribution, Effect, Scene, Values, share_of_readings
from msp_sim.effects.component import Code


def _apply(scene: Scene, values: Values) -> Contribution:
    previous_cm = scene["previous_reading_cm"]
    is_reading = is_on_grid(previous_cm, scene.sensor.resolution_cm)
    within = (previous_cm >= scene.sensor.minimum_cm) & (previous_cm <= scene.sensor.maximum_cm)
    return Contribution(component=Code(previous_cm), share=values["share"] * (is_reading & within))


STALE = Effect(
    name="stale",
    sentence="Sometimes the sensor's previous reading is reported again instead of a new one.",
    finding="{share:of} readings are repeats of the one before",
    physics="the sensor's previous reading instead of a new one",
    source="drivers that read before the measurement has ended; register reads that trigger a new ping",
    parameters=(share_of_readings("share of repeated readings"),),
    requires=("previous_reading_cm",),
    channels=("component",),
    experiment="a target in steady motion: some readings do not change",
    apply=_apply,
)
