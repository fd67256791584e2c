"""Effect: the vehicle moves while the sound travels."""

from msp_range.acoustics.air import speed_of_sound
from msp_sim.effects.base import Contribution, Effect, Parameter, Scene, Values


def _apply(scene: Scene, values: Values) -> Contribution:
    temperature_c = scene.optional("air_temperature_c", scene.sensor.calibration_temperature_c)
    ago_s = -values["share"] * scene.range_cm / (100.0 * speed_of_sound(temperature_c))
    return Contribution(bias_cm=scene.at(ago_s).range_cm - scene.range_cm, ago_s=ago_s)


MOTION_DURING_PING = Effect(
    name="motion_during_ping",
    sentence="The vehicle moves while the sound travels, so the reading belongs to a moment after the ping.",
    finding="readings belong to a moment {share:number} times the sound's one-way travel time before the reflection",
    physics=(
        "the sound meets the surface z / c after the ping: z(t + z / c). Share 1 if the truth is that at the "
        "ping, 0 at the reflection, -1 at the return of the echo"
    ),
    source="kinematics",
    parameters=(
        Parameter("share", "1", "time of the truth before the reflection, in one-way times of flight", -2.0, 2.0),
    ),
    requires=("true_range_cm", "range_rate_cm_s"),
    channels=("bias",),
    experiment="climb and descend fast at 1 m and at 5 m: this lag grows with range, that of latency does not",
    apply=_apply,
    is_shift=True,
    media=("sound",),
    optional=("air_temperature_c",),
)
