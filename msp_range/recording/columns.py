"""Columns of a table of readings, each with what it holds, as CSV files and the truth in recordings name them."""

BASE_COLUMNS = {
    "time_s": "time of the echo, or of the ping where there was none [s]",
    "sensor": "name of the sensor",
    "run": "name of the session; times of different runs do not compare",
    "reading_cm": "distance as the sensor reported it [cm]; empty: no answer",
    "true_range_cm": "perpendicular distance to the surface [cm]",
    "true_range_std_cm": "standard deviation of that distance's error [cm]; empty: exact",
}
CONTEXT_COLUMNS = {
    "condition": "which experiment of a campaign the reading belongs to, a word",
    "air_temperature_c": "air temperature [deg C]",
    "target_temperature_c": "air temperature at the far end, next to the target [deg C]",
    "humidity_pct": "relative humidity [%]",
    "incidence_deg": "angle between the beam and the surface's normal, signed [deg]",
    "range_rate_cm_s": "rate of change of the range [cm/s]",
    "throttle": "throttle, 0 to 1",
    "vibration_hz": "frequency of vibration [Hz]",
    "uptime_s": "time since the sensor was powered [s]",
    "time_in_run_s": "time since the first reading of the run [s]",
    "time_of_day_h": "time since midnight [h]",
    "target": "what the beam meets, a word",
    "target_size_cm": "shorter side of the target [cm]",
    "neighbour_lag_ms": "time since the last ping of another sensor [ms]; empty: none",
    "neighbour_range_cm": "range of that other sensor [cm]",
    "external_level_db": "sound level of an external ultrasonic source at 30 cm from it [dB re 20 uPa]; empty: none",
    "external_duty": "share of the time that it sounds, 0 to 1",
    "external_distance_cm": "distance from that source to the sensor [cm]",
    "external_frequency_khz": "frequency of that source [kHz]",
    "reference": "what the true range is from, a word; others: the vehicle's other sensors",
}
BRIDGE_COLUMNS = {
    "status": "what the answer means, a word",
    "rejected": "why the bridge did not use the reading, a word; empty: it did",
    "corrected_cm": "range after the correction for air temperature [cm]",
    "filtered_cm": "what the sensor's own filters made of it [cm]; empty: no such stream, or rejected",
    "fused_cm": "fused distance along the vehicle's down axis after this reading [cm]",
    "fused_std_cm": "its standard deviation [cm]",
}
"""What the bridge made of a reading, in the table of `msp-range export`; no context, so no effect depends on it."""
KNOWN_COLUMNS = (*BASE_COLUMNS, *CONTEXT_COLUMNS, *BRIDGE_COLUMNS)
"""All of them, in the order of a table."""
WORD_COLUMNS = frozenset({"sensor", "run", "condition", "target", "reference", "status", "rejected"})
"""Known columns that hold words; the other known ones hold numbers."""
LARGEST_NUMBER = 1e30
"""A larger number is no measurement; squares of this one and their sums are still numbers."""
