"""Two bytes OR-ed into one."""

from collections.abc import Mapping

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene
from msp_sim.effects.codes import OrEd


def _apply(scene: Scene, values: Mapping[str, float]) -> Contribution:
    return Contribution(fault=OrEd(), fault_share=values["share"])


OR_ED_BYTES = Effect(
    name="or_ed_bytes",
    sentence="A driver puts the two bytes of a reading on top of each other: no echo (765) arrives as 255, 300 as 45.",
    physics="high | low in place of 256 high + low: 0x02 | 0xFD = 255",
    source="a lost shift, found in two public drivers of this sensor",
    parameters=(Parameter("share", "1", "share of the readings that it befalls", 0.0, 1.0),),
    requires=(),
    channels=("code",),
    experiment="a wall at 300 cm: 45",
    apply=_apply,
)
