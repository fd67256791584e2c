"""An effect: the sensor's clock runs slow while the motors pull the supply down."""

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene, Values


def _apply(scene: Scene, values: Values) -> Contribution:
    return Contribution(bias_cm=-values["sag_pct"] / 100.0 * scene["throttle"] * scene.range_cm)


SUPPLY_SAG = Effect(
    name="supply_sag",
    sentence="With more throttle the supply sags, the sensor's clock runs slow, and ranges read too short.",
    finding="full throttle makes ranges {sag_pct:too short|too long}",
    physics="z (1 - sag throttle): a slower clock counts fewer ticks in the same time of flight",
    source="an example; RC oscillators change by some percent per volt",
    parameters=(Parameter("sag_pct", "%", "how much slower the clock is at full throttle", -20.0, 20.0),),
    requires=("throttle", "true_range_cm"),
    channels=("bias",),
    experiment="the vehicle tied down, throttle in steps, at two ranges",
    apply=_apply,
)
