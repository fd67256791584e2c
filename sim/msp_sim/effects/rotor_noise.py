"""Noise of the rotors in the sensor's band."""

from collections.abc import Mapping

import numpy as np

from msp_sim.effects.base import Change, Effect, Parameter, Scene


def _act(scene: Scene, values: Mapping[str, float]) -> Change:
    return Change(log_spread=np.log1p(values["growth"] * scene["throttle"]))


ROTOR_NOISE = Effect(
    name="rotor_noise",
    sentence="With more throttle the rotors are louder, and the readings scatter more.",
    physics="sigma (1 + growth throttle): noise on the envelope moves the time at which it crosses the threshold",
    source="MaxBotix: mount out of the prop wash, away from rotors; the linear form is a choice",
    parameters=(Parameter("growth", "1", "growth of sigma from no to full throttle", 0.0, 20.0),),
    needs=("true_range_cm", "throttle"),
    channels=("spread",),
    experiment="the vehicle tied down over a floor, throttle in steps",
    act=_act,
)
