"""Effect: noise with more large errors than a normal distribution has."""

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene, Values
from msp_sim.effects.component import Normal


def _apply(scene: Scene, values: Values) -> Contribution:
    return Contribution(component=Normal(0.0, from_hit=True, wider=values["wider"]), share=values["share"])


HEAVY_TAILS = Effect(
    name="heavy_tails",
    sentence="Most readings scatter little, and some scatter several times as much.",
    finding="{share:of} readings scatter {wider:number} times as much as the others",
    physics="a share of the hits has a wider normal distribution with the same centre",
    source="contaminated normal of Tukey 1960; air and reference vary from ping to ping",
    parameters=(
        Parameter("share", "1", "share of the readings that scatter more", 0.0, 0.5),
        Parameter("wider", "1", "factor on the standard deviation", 1.5, 6.0, None, 2.5, (2.5,)),
    ),
    requires=("true_range_cm",),
    channels=("component",),
    experiment="a histogram of ten thousand readings of one target: equal tails on both sides",
    apply=_apply,
    base="effects.heavy_tails",
)
