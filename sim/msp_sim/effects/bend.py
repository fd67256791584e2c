"""Effect: the slope of the response changes at some range."""

import numpy as np

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene, Values


def _apply(scene: Scene, values: Values) -> Contribution:
    return Contribution(bias_cm=values["slope_pct"] / 100.0 * np.maximum(scene.range_cm - values["from_cm"], 0.0))


BEND = Effect(
    name="bend",
    sentence="Beyond some range the readings grow faster or slower with range than before.",
    finding="beyond {from_cm} readings grow {slope_pct:too fast|too slowly}",
    physics="z + slope max(z - from, 0); several of them are a piecewise linear curve",
    source="piecewise linear calibration, as the report's literature proposes",
    parameters=(
        Parameter("slope_pct", "%", "change of the slope", -20.0, 20.0),
        Parameter(
            "from_cm",
            "cm",
            "range at which the slope changes",
            0.0,
            1000.0,
            None,
            200.0,
            (100.0, 150.0, 200.0, 300.0, 400.0),
        ),
    ),
    requires=("true_range_cm",),
    channels=("bias",),
    experiment="ranges in steps of 20 cm against a tape measure",
    apply=_apply,
    equivalent_causes=("the same nonlinearity of the reference",),
)
