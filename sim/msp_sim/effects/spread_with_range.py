"""Effect: the scatter grows with range."""

import numpy as np

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene, Values


def _apply(scene: Scene, values: Values) -> Contribution:
    return Contribution(log_spread=np.log1p(values["growth_per_m"] * np.maximum(scene.range_cm, 0.0) / 100.0))


SPREAD_WITH_RANGE = Effect(
    name="spread_with_range",
    sentence="Far readings scatter more than near ones.",
    finding="readings scatter {growth_per_m:%} more with each metre of range",
    physics="sigma (1 + growth z): weak echoes cross the threshold less precisely, and air is turbulent",
    source="usual for time-of-flight sensors; the linear form is an assumption",
    parameters=(Parameter("growth_per_m", "1/m", "relative growth of sigma per metre", 0.0, 5.0),),
    requires=("true_range_cm",),
    channels=("spread",),
    experiment="a thousand readings of a wall at 50 and at 400 cm",
    apply=_apply,
    base="reading_model.sigma_growth_cm_per_m",
)
