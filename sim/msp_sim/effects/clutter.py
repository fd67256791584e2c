"""Effect: a fixed object in front of the sensor, such as landing gear or a cable, or the transducer's ring-down."""

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene, Values, share_of_readings
from msp_sim.effects.component import Normal


def _apply(scene: Scene, values: Values) -> Contribution:
    own_cm = scene.optional("true_range_cm", scene.sensor.maximum_cm)
    nearer = values["location_cm"] < own_cm
    component = Normal(values["location_cm"], values["sigma_cm"])
    return Contribution(component=component, share=values["share"] * nearer)


CLUTTER = Effect(
    name="clutter",
    sentence="A leg, a cable or the sensor's own ringing gives an echo at a fixed range instead of the ground.",
    finding="{share:of} readings are of something at {location_cm}",
    physics="readings near a fixed range, if the ground is farther away",
    source="ring-down of the transducer; parts of the airframe in the beam",
    parameters=(
        share_of_readings("share of the readings if the surface is farther away"),
        Parameter("location_cm", "cm", "its range", 0.0, 1000.0, None, 30.0, (25.0, 35.0, 50.0, 80.0)),
        Parameter("sigma_cm", "cm", "its scatter", 0.1, 50.0, None, 2.0, (2.0,)),
    ),
    channels=("component",),
    experiment="the sensor on its vehicle, pointed at the open sky",
    apply=_apply,
    optional=("true_range_cm",),
    gathers="location_cm",
)
