"""Effect: readings are limited to eight bits."""

from msp_sim.effects.base import Effect, damage, share_of_readings
from msp_sim.effects.codes import Saturated

SATURATED_BYTE = Effect(
    name="saturated_byte",
    sentence="Ranges beyond 255 cm all arrive as 255: they do not fit into the one byte of some driver's variable.",
    finding="{share:of} readings beyond 255 cm arrive as 255",
    physics="min(reading, 255)",
    source="report 4.3.2: 255 as well as 765; 8-bit variables in drivers and loggers",
    parameters=(share_of_readings("share of the readings affected"),),
    channels=("code",),
    experiment="a wall at 300 cm reads 255 (OR-ed bytes would give 45)",
    apply=damage(Saturated()),
)
