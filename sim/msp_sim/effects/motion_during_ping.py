"""The way that the vehicle makes while the sound is in the air."""

from collections.abc import Mapping

from msp_range.acoustics.air import speed_of_sound
from msp_sim.effects.base import Contribution, Effect, Parameter, Scene


def _apply(scene: Scene, values: Mapping[str, float]) -> Contribution:
    temperature_c = scene.optional("air_temperature_c", scene.sensor.calibration_temperature_c)
    flight_s = scene.range_cm / (100.0 * speed_of_sound(temperature_c))
    return Contribution(bias_cm=values["share"] * scene["range_rate_cm_s"] * flight_s)


MOTION_DURING_PING = Effect(
    name="motion_during_ping",
    sentence="While the sound is under way the vehicle moves on, so the range belongs to a moment after the ping.",
    physics=(
        "the sound meets the surface z / c after the ping: z + z dz/dt / c. Share 1 where the truth is that of the "
        "ping, 0 where it is that of the meeting, -1 where it is that of the echo's return"
    ),
    source="kinematics",
    parameters=(
        Parameter("share", "1", "time of the truth before the meeting, in times of flight one way", -2.0, 2.0),
    ),
    requires=("true_range_cm", "range_rate_cm_s"),
    channels=("bias",),
    experiment="climb and sink fast at 1 m and at 5 m: the lag grows with range, that of latency does not",
    apply=_apply,
    optional=("air_temperature_c",),
)
