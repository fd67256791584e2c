"""A sensor whose clock runs fast or slow."""

from collections.abc import Mapping

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene


def _apply(scene: Scene, values: Mapping[str, float]) -> Contribution:
    return Contribution(bias_cm=values["scale_pct"] / 100.0 * scene.range_cm)


RANGE_SCALE = Effect(
    name="range_scale",
    sentence="The sensor's clock runs a little fast or slow, so every range is too long or too short by some percent.",
    physics="reading = z (1 + scale)",
    source="time of flight is counted in ticks of the sensor's own clock",
    parameters=(Parameter("scale_pct", "%", "how much too long ranges read", -10.0, 10.0),),
    requires=("true_range_cm",),
    channels=("bias",),
    experiment="ranges from 50 to 500 cm against a tape measure, in air of one temperature",
    apply=_apply,
    equivalent_causes=("the reference's scale", "air of one other temperature throughout", "a thermometer that is off throughout"),
)
