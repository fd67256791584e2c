"""Checks that readings can be compared with a truth at all, before any analysis.

What makes a comparison impossible, by the measured data and the sensor's limits, raises an error with what to do: no
true range, hardly any readings, another unit, readings that do not follow the range.
"""

import numpy as np

from msp_range.arrays import Column
from msp_range.reading_model.sensor_model import SensorModel
from msp_range.recording.csv_form import MeasuredData
from msp_range.recording.error import RecordingError
from msp_sim.model.context_limits import span

MIN_READINGS = 30
"""Refuse tables with fewer readings with a true range: their intervals would be wider than any effect that is asked
for. The report took 100 to 20,000 a point; with a smaller number a table of a few rows makes a model."""
WRONG_UNIT_SHARE = 0.5
"""Refuse readings of which a larger share is outside of the sensor's limits: they are in another unit, or of another
sensor. In the right unit only codes are outside, and few; any value in 0.3-0.9 decides alike."""
MIN_NEAR_SHARE = 0.1
"""Refuse readings of which a smaller share is within a factor of 2 of the true range. Sensors that miss nearly
everything still have a few hits; a wrong unit has none."""
STUCK_SHARE, STUCK_CM = 0.98, 30.0
"""Refuse readings of which more than this share are the same number while the true range covers more than this distance
[cm]: they do not follow it. A large share because a dead zone repeats one reading too; 30 cm are more than any beam's
blindness to a step."""


def check_comparable(name: str, data: MeasuredData, sensor: SensorModel) -> None:
    """Refuse readings that cannot be compared with a truth: none, hardly any, or in another unit.

    Raises
    ------
    RecordingError
        In a line, with what to do.
    """
    if not len(data):
        raise RecordingError(f"{name}: no readings, only a header")
    if "true_range_cm" not in data or np.isnan(data["true_range_cm"]).all():
        raise RecordingError(
            f"{name}: no true_range_cm, so there is nothing to compare readings with; add the reference's range as a "
            "column, or name the column that it is in with --map true_range_cm=COLUMN"
        )
    answered = ~np.isnan(data["reading_cm"])
    usable = answered & ~np.isnan(data["true_range_cm"])
    if not answered.any():
        raise RecordingError(f"{name}: no row has a reading: reading_cm is empty in all {len(data)}")
    if usable.sum() < MIN_READINGS:
        raise RecordingError(
            f"{name}: found {int(usable.sum())} readings with a true range, expected at least {MIN_READINGS}; "
            "the report took 100 to 20000 a point"
        )
    reading_cm, true_cm = data["reading_cm"][usable], data["true_range_cm"][usable]
    if (reading_cm == sensor.maximum_cm).all():
        raise RecordingError(
            f"{name}: all {reading_cm.size} readings are {sensor.maximum_cm} cm, the sensor's code of no echo: nothing "
            "to compare. Was there a surface within its range, and is the sensor the right one?"
        )
    outside = (reading_cm < sensor.minimum_cm) | (reading_cm > sensor.maximum_cm)
    echoed = reading_cm != sensor.maximum_cm
    ratios = reading_cm[echoed] / np.maximum(true_cm[echoed], 1e-9)
    ratio = float(np.median(ratios)) if echoed.any() else 1.0
    values, counts = np.unique(reading_cm[echoed], return_counts=True)
    if values.size and counts.max() > STUCK_SHARE * counts.sum() and np.ptp(true_cm[echoed]) > STUCK_CM:
        raise RecordingError(
            f"{name}: nearly all readings are {values[counts.argmax()]:g} cm while the true range is {span(true_cm)} "
            "cm: they do not follow it. A sensor or a recording that is stuck?"
        )
    near = ((ratios > 0.5) & (ratios < 2.0)).mean() if echoed.any() else 1.0
    if outside.mean() > WRONG_UNIT_SHARE or near < MIN_NEAR_SHARE:
        raise RecordingError(
            f"{name}: readings of {span(reading_cm)} against true ranges of {span(true_cm)} (median ratio "
            f"{ratio:.3g}; the sensor reads {sensor.minimum_cm} to {sensor.maximum_cm} cm)."
            + _unit_hint(reading_cm, true_cm, ratio)
        )


def _unit_hint(reading_cm: Column, true_cm: Column, ratio: float) -> str:
    for column, is_small in (("reading_cm", ratio), ("true_range_cm", 1.0 / ratio)):
        for unit, factor in (("metres", 0.01), ("inches", 1 / 2.54), ("millimetres", 10.0), ("feet", 1 / 30.48)):
            if 0.8 * factor < is_small < 1.25 * factor:
                return f" Is {column} in {unit}? Then: --map {column}=COLUMN*{1 / factor:g}"
    if float(np.median(true_cm)) < 12.0 and 0.5 < ratio < 2.0:
        return " Are both in metres? Then: --map reading_cm=COLUMN*100 --map true_range_cm=COLUMN*100"
    return (
        " Both have to be centimetres of the same thing, and the sensor model that of the sensor that read; "
        "--map converts."
    )
