"""What is recorded of one reading: every stage of its way through the bridge, in one message."""

from typing import Any

from msp_range.acoustics.air import NO_AIR, Air
from msp_range.filters.chain import Filtered
from msp_range.reading import Reading
from msp_range.sensors.polling import Ranging


def answer_of(ranging: Ranging) -> dict[str, Any]:
    """What the sensor answered, for a message of its topic (see `msp_range.recording.topics`)."""
    reading = ranging.reading
    answer: dict[str, Any] = {
        "time_s": reading.time_s,
        "ping_s": ranging.ping_s,
        "read_s": ranging.answered_s,
        "status": reading.status.value,
    }
    if reading.raw is not None:
        answer["raw"] = reading.raw
    if reading.range_m is not None:
        answer["range_m"] = reading.range_m
        answer["suspect"] = reading.suspect
    return answer


def stages_of(ranging: Ranging, air: Air, corrected: Reading, filtered: Filtered) -> dict[str, Any]:
    """The message of a sensor's topic (see `msp_range.recording.topics`); what is not known is left out.

    Parameters
    ----------
    ranging
        As it came from the sensor.
    air
        The air that it was corrected for.
    corrected, filtered
        What correction and filters made of it.
    """
    reading, estimate, stages = ranging.reading, filtered.estimate, answer_of(ranging)
    if air.source != NO_AIR:
        stages["temperature_c"] = air.temperature_c
        stages["temperature_std_c"] = air.std_c
        stages["temperature_source"] = air.source
        if air.humidity_percent:
            stages["humidity_pct"] = air.humidity_percent
    if reading.range_m is not None:
        stages["std_m"] = reading.std_m
        stages["corrected_m"] = corrected.range_m
    if filtered.rejected is not None:
        stages["rejected"] = filtered.rejected
    if estimate is not None:
        stages["filtered_m"], stages["variance_m2"] = estimate
    return stages
