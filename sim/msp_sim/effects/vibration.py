"""Effect: the sensor's mount vibrates."""

import numpy as np

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene, Values


def _apply(scene: Scene, values: Values) -> Contribution:
    return Contribution(log_spread=np.log1p(values["growth"]) * (scene["vibration_hz"] > 0.0))


VIBRATION = Effect(
    name="vibration",
    sentence="On a vibrating mount the readings scatter more.",
    finding="a vibrating mount makes readings scatter {growth:factor}",
    physics="sigma (1 + growth) if the mount vibrates, at any frequency",
    source="report 4.3.6 (figure 4.19): no effect at 60 Hz",
    parameters=(Parameter("growth", "1", "relative growth of sigma if the mount vibrates", 0.0, 20.0),),
    requires=("true_range_cm", "vibration_hz"),
    channels=("spread",),
    experiment="a shaker under the sensor, switched on and off, in front of a fixed target",
    apply=_apply,
)
