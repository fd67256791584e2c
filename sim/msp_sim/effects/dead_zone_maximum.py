"""Effect: a surface nearer than the sensor can measure gives the code for no echo."""

from dataclasses import replace

from msp_sim.effects.dead_zone_minimum import DEAD_ZONE_MINIMUM, dead_zone

DEAD_ZONE_MAXIMUM = replace(
    DEAD_ZONE_MINIMUM,
    name="dead_zone_maximum",
    sentence="Very near the ground the echo is hidden by the sensor's own ringing, and the sensor reports no echo.",
    finding="nearer than {depth_cm}, {share:of} readings are reported as no echo",
    physics="no echo in place of a hit, for a share of the readings of surfaces within the zone",
    source="range finders that ignore input during their ring-down",
    apply=dead_zone(lambda sensor: sensor.maximum_cm),
)
