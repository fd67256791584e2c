"""Effect: readings are older than their time stamp."""

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene, Values


def _apply(scene: Scene, values: Values) -> Contribution:
    return Contribution(bias_cm=-values["delay_ms"] / 1000.0 * scene["range_rate_cm_s"])


LATENCY = Effect(
    name="latency",
    sentence="A reading is older than its time stamp, so it lags while the vehicle climbs or descends.",
    finding="readings are late by {delay_ms}",
    physics="reading(t) = z(t - delay), to the first order z - delay dz/dt",
    source="PX4's mb12xx driver stamps the previous cycle's ping with the present time: about 400 ms late",
    parameters=(Parameter("delay_ms", "ms", "age of a reading at its time stamp", -1000.0, 1000.0, physical_low=0.0),),
    requires=("true_range_cm", "range_rate_cm_s"),
    channels=("bias",),
    experiment="climb and descend at 1 m/s over the same ground: up and down differ by twice the lag",
    apply=_apply,
    equivalent_causes=("the reference's delay, with the other sign",),
)
