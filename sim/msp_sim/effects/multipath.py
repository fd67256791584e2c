"""Effect: an echo that travelled twice between ground and vehicle."""

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene, Values, share_of_readings
from msp_sim.effects.component import Normal


def _apply(scene: Scene, values: Values) -> Contribution:
    twice_cm = 2.0 * scene.range_cm
    in_range = twice_cm < scene.sensor.maximum_cm
    return Contribution(component=Normal(twice_cm, values["sigma_cm"]), share=values["share"] * in_range)


MULTIPATH = Effect(
    name="multipath",
    sentence="The sound bounces between ground and vehicle, and the second echo is measured: about twice the height.",
    finding="{share:of} readings are second echoes from about twice the height",
    physics="hits at 2 z instead of z, if that is within the maximum range",
    source="echo sounding over hard ground; the vehicle's underside is the second reflector",
    parameters=(
        share_of_readings("share of the readings"),
        Parameter("sigma_cm", "cm", "scatter of the second echo", 0.1, 50.0, None, 3.0, (3.0,)),
    ),
    requires=("true_range_cm",),
    channels=("component",),
    experiment="a hard floor at 1 m, with and without a plate around the sensor",
    apply=_apply,
)
