"""Effect: readings are of another time than the reference that has the same stamp."""

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene, Values


def _apply(scene: Scene, values: Values) -> Contribution:
    ago_s = values["delay_ms"] / 1000.0
    return Contribution(bias_cm=scene.at(ago_s).range_cm - scene.range_cm, ago_s=ago_s)


LATENCY = Effect(
    name="latency",
    sentence="Readings and reference with one stamp are of different times, so they differ while the vehicle moves.",
    finding="readings are {delay_ms:behind|ahead of} the reference",
    physics="reading(t) = z(t - delay); where z is not known around a reading, z - delay dz/dt",
    source="PX4's mb12xx driver stamps the previous cycle's ping with the present time: about 400 ms late",
    parameters=(
        Parameter(
            "delay_ms",
            "ms",
            "time of the reading before that of the reference",
            -1000.0,
            1000.0,
            grid=(-400, -200, -100, 100, 200, 400),
        ),
    ),
    requires=("true_range_cm", "range_rate_cm_s"),
    channels=("bias",),
    experiment="climb and descend at 1 m/s over the same ground: up and down differ by twice the lag",
    apply=_apply,
    is_shift=True,
    equivalent_causes=("the reference's delay, with the other sign",),
)
