"""Effect: a surface nearer than the sensor can measure gives the sensor's minimum."""

from collections.abc import Callable

from msp_range.reading_model.sensor_model import SensorModel
from msp_sim.effects.base import Contribution, Effect, Parameter, Scene, Values, share_of_readings
from msp_sim.effects.component import Code


def dead_zone(code_cm: Callable[[SensorModel], float]) -> Callable[[Scene, Values], Contribution]:
    """What an effect does that gives this code of the sensor [cm] in place of hits within its zone."""

    def apply(scene: Scene, values: Values) -> Contribution:
        inside = scene.range_cm < values["depth_cm"]
        return Contribution(component=Code(code_cm(scene.sensor)), share=values["share"] * inside)

    return apply


DEAD_ZONE_MINIMUM = Effect(
    name="dead_zone_minimum",
    sentence="Very near the ground the sensor still rings from its own ping, and reads its minimum.",
    finding="nearer than {depth_cm}, {share:of} readings are the sensor's minimum",
    physics="the minimum in place of a hit, for a share of the readings of surfaces within the zone",
    source="report: objects closer than 20 cm read 20",
    parameters=(
        share_of_readings("share of the readings within the zone"),
        Parameter("depth_cm", "cm", "how far the zone reaches", 1.0, 200.0, None, 30.0, (25.0, 30.0, 40.0, 60.0)),
    ),
    requires=("true_range_cm",),
    channels=("component",),
    experiment="a plate from 10 to 60 cm in steps of 2 cm",
    apply=dead_zone(lambda sensor: sensor.minimum_cm),
)
