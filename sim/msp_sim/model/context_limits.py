"""Limits of context columns: a value beyond them is of another unit.

A column that cannot be what its name says raises an error with what to do.
"""

import numpy as np

from msp_range.arrays import Column
from msp_range.recording.csv_form import MeasuredData
from msp_range.recording.error import RecordingError

CONTEXT_LIMITS = {
    "air_temperature_c": (-50.0, 65.0, "deg C from -50 to 65"),
    "target_temperature_c": (-50.0, 85.0, "deg C from -50 to 85"),
    "true_range_std_cm": (0.0, 1000.0, "the standard deviation of true_range_cm's error in cm, 0 or more"),
    "humidity_pct": (0.0, 100.0, "per cent of saturation, 0 to 100"),
    "incidence_deg": (-90.0, 90.0, "degrees between beam and normal, -90 to 90"),
    "throttle": (0.0, 1.0, "a share, 0 to 1"),
    "external_duty": (0.0, 1.0, "a share, 0 to 1"),
}
"""Smallest and largest value of a column, and what is expected: by definition of the column, or temperatures of
air that people and sensors endure and of asphalt in the sun. Narrower limits of these would refuse hot
boxes, wider ones accept deg F."""


def check_contexts(name: str, data: MeasuredData) -> None:
    """Refuse columns in another unit.

    Raises
    ------
    RecordingError
        In a line, with what to do; it begins with `name`, that of the file.
    """
    for column, (low, high, expected) in CONTEXT_LIMITS.items():
        known = data.column(column)[~np.isnan(data.column(column))]
        if not known.size:
            continue
        least, most = known.min(), known.max()
        if column == "humidity_pct" and 0.0 < most <= 1.0 and least >= low:
            remedy = "A share? --map humidity_pct=COLUMN*100"
        elif low <= least and most <= high:
            continue
        elif column.endswith("temperature_c"):
            remedy = "In deg F or K? give --map a file with its unit (unit: F or K)"
        else:
            remedy = f"In another unit? --map {column}=COLUMN*FACTOR"
        raise RecordingError(f"{name}: found {column} of {span(known)}, expected {expected}. {remedy}")


def span(values: Column) -> str:
    """Smallest and largest of these numbers, for a message."""
    return f"{values.min():g} to {values.max():g}"
