"""Effect: a surface nearer than the sensor can measure gives the code for no echo."""

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene, Values, share_of_readings
from msp_sim.effects.component import Code


def _apply(scene: Scene, values: Values) -> Contribution:
    inside = scene.range_cm < values["depth_cm"]
    return Contribution(component=Code(scene.sensor.maximum_cm), share=values["share"] * inside)


DEAD_ZONE_MAXIMUM = Effect(
    name="dead_zone_maximum",
    sentence="Very near the ground the echo is hidden by the sensor's own ringing, and the sensor reports no echo.",
    finding="nearer than {depth_cm}, {share:of} readings are reported as no echo",
    physics="no echo in place of a hit, for a share of the readings of surfaces within the zone",
    source="range finders that ignore input during their ring-down",
    parameters=(
        share_of_readings("share of the readings within the zone"),
        Parameter("depth_cm", "cm", "how far the zone reaches", 1.0, 200.0, None, 30.0, (25.0, 30.0, 40.0, 60.0)),
    ),
    requires=("true_range_cm",),
    channels=("component",),
    experiment="a plate from 10 to 60 cm in steps of 2 cm",
    apply=_apply,
)
