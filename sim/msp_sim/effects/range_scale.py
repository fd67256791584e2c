"""Effect: the sensor's clock runs fast or slow."""

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene, Values


def _apply(scene: Scene, values: Values) -> Contribution:
    return Contribution(bias_cm=values["scale_pct"] / 100.0 * scene.range_cm)


RANGE_SCALE = Effect(
    name="range_scale",
    sentence="The sensor's clock runs a little fast or slow, so all ranges are off by the same percentage.",
    finding="ranges read {scale_pct:too long|too short}",
    physics="reading = z (1 + scale)",
    source="time of flight is counted in ticks of the sensor's own clock",
    parameters=(Parameter("scale_pct", "%", "relative error of the readings", -10.0, 10.0),),
    requires=("true_range_cm",),
    channels=("bias",),
    experiment="ranges from 50 to 500 cm against a tape measure, at constant air temperature",
    apply=_apply,
    equivalent_causes=(
        "the reference's scale",
        "a constant difference of the air temperature",
        "a constant error of the thermometer",
    ),
)
