"""Effect: the rotors' noise in the sensor's frequency band increases the scatter."""

import numpy as np

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene, Values


def _apply(scene: Scene, values: Values) -> Contribution:
    return Contribution(log_spread=np.log1p(values["growth"] * scene["throttle"] ** values["exponent"]))


ROTOR_NOISE = Effect(
    name="rotor_noise",
    sentence="With more throttle the rotors are louder, and the readings scatter more.",
    finding="full throttle makes readings scatter {growth:factor} as none",
    physics="sigma (1 + growth throttle^exponent): noise on the envelope shifts its threshold crossing",
    source="MaxBotix: mount out of the prop wash, away from rotors; the power law is an assumption",
    parameters=(
        Parameter("growth", "1", "relative growth of sigma from zero to full throttle", 0.0, 20.0),
        Parameter("exponent", "1", "1: proportional to throttle, 2: to thrust", 0.5, 6.0, None, 1.0, (1.0, 3.0)),
    ),
    requires=("true_range_cm", "throttle"),
    channels=("spread",),
    experiment="the vehicle tied down over a floor, with the throttle raised in steps",
    apply=_apply,
)
