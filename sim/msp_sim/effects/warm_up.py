"""Effect: the sensor is still warming up."""

import numpy as np

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene, Values


def _apply(scene: Scene, values: Values) -> Contribution:
    return Contribution(bias_cm=values["offset_cm"] * np.exp(-scene["uptime_s"] / values["time_constant_s"]))


WARM_UP = Effect(
    name="warm_up",
    sentence="In the first minutes after power-up the sensor warms up, and its readings drift.",
    finding="right after power-up readings are {offset_cm:too far|too near}, which fades within {time_constant_s}",
    physics="offset exp(-t / tau), t since the sensor was powered",
    source="heating of a body by a constant power",
    parameters=(
        Parameter("offset_cm", "cm", "error right after power-up", -20.0, 20.0),
        Parameter("time_constant_s", "s", "tau", 5.0, 3600.0, None, 300.0, (60.0, 180.0, 600.0)),
    ),
    requires=("true_range_cm", "uptime_s"),
    channels=("bias",),
    experiment="a fixed target for half an hour from power-up, at constant room temperature",
    apply=_apply,
)
