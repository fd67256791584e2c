"""The catalogue of effects: physical causes that change a sensor's readings, one file each."""

from importlib import import_module

from msp_sim.effects.base import Effect

_FILES = """
    mounting_offset session_offset range_scale air_temperature thermometer_offset temperature_gradient hot_box humidity
    latency motion_during_ping slant_range nearest_point threshold_walk cycle_slip heavy_tails warm_up day_cycle bend
    flooring coarse_rounding spread_with_range spread_with_incidence rotor_noise vibration run_offsets missed
    missed_with_range beyond_field_of_view missed_by_target small_target dead_zone_minimum dead_zone_maximum
    unexpected_objects prop_wash crosstalk external_source multipath clutter stale random_readings saturated_byte
    lost_high_byte or_ed_bytes clock_fault
"""
"""Files of this package that hold an effect of their own name, as a constant in capitals; lists follow this order."""

CATALOGUE: dict[str, Effect] = {
    name: getattr(import_module(f"{__name__}.{name}"), name.upper()) for name in _FILES.split()
}
"""Effects by name."""
