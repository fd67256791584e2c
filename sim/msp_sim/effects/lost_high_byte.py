"""Effect: the high byte of a reading is lost."""

from msp_sim.effects.base import Effect, damage, share_of_readings
from msp_sim.effects.codes import LostHighByte

LOST_HIGH_BYTE = Effect(
    name="lost_high_byte",
    sentence="Half of a reading is lost on the bus: 300 arrives as 44, and no echo (765) as 253.",
    finding="{share:of} readings lose a byte on the bus",
    physics="reading modulo 256",
    source="drivers that read one byte of two",
    parameters=(share_of_readings("share of the readings affected"),),
    channels=("code",),
    experiment="a wall at 300 cm reads 44",
    apply=damage(LostHighByte()),
)
