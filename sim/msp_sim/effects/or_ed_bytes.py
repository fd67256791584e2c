"""Effect: the two bytes of a reading are OR-ed into one."""

from msp_sim.effects.base import Effect, damage, share_of_readings
from msp_sim.effects.codes import OrEd

OR_ED_BYTES = Effect(
    name="or_ed_bytes",
    sentence="A driver ORs the two bytes of a reading into one: no echo (765) arrives as 255, and 300 as 45.",
    finding="{share:of} readings arrive with their two bytes merged into one",
    physics="high | low instead of 256 high + low: 0x02 | 0xFD = 255",
    source="a missing shift, found in two public drivers of this sensor",
    parameters=(share_of_readings("share of the readings affected"),),
    channels=("code",),
    experiment="a wall at 300 cm reads 45",
    apply=damage(OrEd()),
)
