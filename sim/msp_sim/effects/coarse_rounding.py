"""Effect: readings are rounded to a coarser step than the sensor's."""

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene, Values, share_of_readings
from msp_sim.effects.codes import Coarser

STEPS_CM = (2.0, 2.5, 2.54, 3.0, 4.0, 5.0, 5.08, 10.0)
"""Steps that are tried: what people round to, in centimetres and inches. Another one is named as the nearest of these,
or not at all."""


def _apply(scene: Scene, values: Values) -> Contribution:
    sensor = scene.sensor
    fault = Coarser(values["step_cm"], sensor.minimum_cm, sensor.maximum_cm, sensor.resolution_cm)
    return Contribution(fault=fault, fault_share=values["share"])


COARSE_ROUNDING = Effect(
    name="coarse_rounding",
    sentence="Software between sensor and recording rounds the readings to inches or to steps of several centimetres.",
    finding="{share:of} readings are rounded to steps of {step_cm}",
    physics="rounded to multiples of a step, then to the sensor's resolution; the sensor's limits are unchanged",
    source="drivers and loggers that convert units",
    parameters=(
        share_of_readings("1 if every reading is rounded"),
        Parameter("step_cm", "cm", "the step", 1.5, 100.0, None, 2.54, STEPS_CM, jumps=True),
    ),
    channels=("code",),
    experiment="a target moved slowly: the readings go up in steps",
    apply=_apply,
    any_step=True,
)
