"""A sensor that is not yet warm."""

from collections.abc import Mapping

import numpy as np

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene


def _apply(scene: Scene, values: Mapping[str, float]) -> Contribution:
    return Contribution(bias_cm=values["offset_cm"] * np.exp(-scene["uptime_s"] / values["time_constant_s"]))


WARM_UP = Effect(
    name="warm_up",
    sentence="In its first minutes a sensor warms up, and its readings drift until it is warm.",
    physics="offset exp(-t / tau), t since the sensor was powered",
    source="heating of a body by a constant power",
    parameters=(
        Parameter("offset_cm", "cm", "error right after power-up", -20.0, 20.0),
        Parameter("time_constant_s", "s", "tau", 5.0, 3600.0, None, 300.0, (60.0, 180.0, 600.0)),
    ),
    requires=("true_range_cm", "uptime_s"),
    channels=("bias",),
    experiment="one target from power-up for half an hour, in a room of one temperature",
    apply=_apply,
)
