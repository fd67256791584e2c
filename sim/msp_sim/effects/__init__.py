"""The catalogue of effects: physical causes that change a sensor's readings, one file each."""

from msp_sim.effects.air_temperature import AIR_TEMPERATURE
from msp_sim.effects.base import Effect
from msp_sim.effects.bend import BEND
from msp_sim.effects.beyond_field_of_view import BEYOND_FIELD_OF_VIEW
from msp_sim.effects.clock_fault import CLOCK_FAULT
from msp_sim.effects.clutter import CLUTTER
from msp_sim.effects.coarse_rounding import COARSE_ROUNDING
from msp_sim.effects.crosstalk import CROSSTALK
from msp_sim.effects.cycle_slip import CYCLE_SLIP
from msp_sim.effects.dead_zone_maximum import DEAD_ZONE_MAXIMUM
from msp_sim.effects.dead_zone_minimum import DEAD_ZONE_MINIMUM
from msp_sim.effects.external_source import EXTERNAL_SOURCE
from msp_sim.effects.flooring import FLOORING
from msp_sim.effects.heavy_tails import HEAVY_TAILS
from msp_sim.effects.hot_box import HOT_BOX
from msp_sim.effects.humidity import HUMIDITY
from msp_sim.effects.latency import LATENCY
from msp_sim.effects.lost_high_byte import LOST_HIGH_BYTE
from msp_sim.effects.missed import MISSED
from msp_sim.effects.missed_by_target import MISSED_BY_TARGET
from msp_sim.effects.missed_with_range import MISSED_WITH_RANGE
from msp_sim.effects.motion_during_ping import MOTION_DURING_PING
from msp_sim.effects.mounting_offset import MOUNTING_OFFSET
from msp_sim.effects.multipath import MULTIPATH
from msp_sim.effects.nearest_point import NEAREST_POINT
from msp_sim.effects.or_ed_bytes import OR_ED_BYTES
from msp_sim.effects.prop_wash import PROP_WASH
from msp_sim.effects.random_readings import RANDOM_READINGS
from msp_sim.effects.range_scale import RANGE_SCALE
from msp_sim.effects.rotor_noise import ROTOR_NOISE
from msp_sim.effects.run_offsets import RUN_OFFSETS
from msp_sim.effects.saturated_byte import SATURATED_BYTE
from msp_sim.effects.session_offset import SESSION_OFFSET
from msp_sim.effects.slant_range import SLANT_RANGE
from msp_sim.effects.small_target import SMALL_TARGET
from msp_sim.effects.spread_with_incidence import SPREAD_WITH_INCIDENCE
from msp_sim.effects.spread_with_range import SPREAD_WITH_RANGE
from msp_sim.effects.stale import STALE
from msp_sim.effects.temperature_gradient import TEMPERATURE_GRADIENT
from msp_sim.effects.thermometer_offset import THERMOMETER_OFFSET
from msp_sim.effects.threshold_walk import THRESHOLD_WALK
from msp_sim.effects.unexpected_objects import UNEXPECTED_OBJECTS
from msp_sim.effects.vibration import VIBRATION
from msp_sim.effects.warm_up import WARM_UP

CATALOGUE: dict[str, Effect] = {
    effect.name: effect
    for effect in (
        MOUNTING_OFFSET,
        SESSION_OFFSET,
        RANGE_SCALE,
        AIR_TEMPERATURE,
        THERMOMETER_OFFSET,
        TEMPERATURE_GRADIENT,
        HOT_BOX,
        HUMIDITY,
        LATENCY,
        MOTION_DURING_PING,
        SLANT_RANGE,
        NEAREST_POINT,
        THRESHOLD_WALK,
        CYCLE_SLIP,
        HEAVY_TAILS,
        WARM_UP,
        BEND,
        FLOORING,
        COARSE_ROUNDING,
        SPREAD_WITH_RANGE,
        SPREAD_WITH_INCIDENCE,
        ROTOR_NOISE,
        VIBRATION,
        RUN_OFFSETS,
        MISSED,
        MISSED_WITH_RANGE,
        BEYOND_FIELD_OF_VIEW,
        MISSED_BY_TARGET,
        SMALL_TARGET,
        DEAD_ZONE_MINIMUM,
        DEAD_ZONE_MAXIMUM,
        UNEXPECTED_OBJECTS,
        PROP_WASH,
        CROSSTALK,
        EXTERNAL_SOURCE,
        MULTIPATH,
        CLUTTER,
        STALE,
        RANDOM_READINGS,
        SATURATED_BYTE,
        LOST_HIGH_BYTE,
        OR_ED_BYTES,
        CLOCK_FAULT,
    )
}
"""Effects by name."""
