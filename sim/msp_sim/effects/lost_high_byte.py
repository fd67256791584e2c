"""Effect: the high byte of a reading is lost."""

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene, Values
from msp_sim.effects.codes import LostHighByte


def _apply(scene: Scene, values: Values) -> Contribution:
    return Contribution(fault=LostHighByte(), fault_share=values["share"])


LOST_HIGH_BYTE = Effect(
    name="lost_high_byte",
    sentence="Half of a reading is lost on the bus: 300 arrives as 44, and no echo (765) as 253.",
    finding="{share:of} readings lose a byte on the bus",
    physics="reading modulo 256",
    source="drivers that read one byte of two",
    parameters=(Parameter("share", "1", "share of the readings affected", 0.0, 1.0),),
    requires=(),
    channels=("code",),
    experiment="a wall at 300 cm reads 44",
    apply=_apply,
)
