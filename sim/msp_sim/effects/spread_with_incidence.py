"""Effect: the scatter grows with the angle of incidence."""

import numpy as np

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene, Values


def _apply(scene: Scene, values: Values) -> Contribution:
    return Contribution(log_spread=np.log1p(values["growth_per_10deg"] * np.abs(scene["incidence_deg"]) / 10.0))


SPREAD_WITH_INCIDENCE = Effect(
    name="spread_with_incidence",
    sentence="Readings of a tilted surface scatter more.",
    finding="readings scatter {growth_per_10deg:%} more with each 10 degrees of tilt",
    physics="sigma (1 + growth |incidence| / 10 deg): the beam's footprint on a tilted surface covers a span of ranges",
    source="report 4.3.3: readings become unreliable towards the breakaway angle; the linear form is an assumption",
    parameters=(Parameter("growth_per_10deg", "1", "relative growth of sigma per 10 deg", 0.0, 10.0),),
    requires=("true_range_cm", "incidence_deg"),
    channels=("spread",),
    experiment="a thousand readings of a wall at 0 and at 10 deg",
    apply=_apply,
)
