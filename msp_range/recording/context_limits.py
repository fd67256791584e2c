"""Limits of context columns: a value beyond them is of another unit.

A table enters; a column that cannot be what its name says raises an error with what to do.
"""

import numpy as np

from msp_range.arrays import Column
from msp_range.recording.csv_form import MeasuredData
from msp_range.recording.error import RecordingError

TEMPERATURES_C = {"air_temperature_c": (-50.0, 65.0), "target_temperature_c": (-50.0, 85.0)}
"""Temperatures outside of these limits are taken for another unit [deg C]: air that people and sensors endure, and
what asphalt reaches in the sun. Narrower limits would refuse hot boxes, wider ones accept deg F."""
CONTEXT_LIMITS = {
    "true_range_std_cm": (0.0, 1000.0, "the standard deviation of true_range_cm's error in cm, 0 or more"),
    "humidity_pct": (0.0, 100.0, "per cent of saturation, 0 to 100"),
    "incidence_deg": (-90.0, 90.0, "degrees between beam and normal, -90 to 90"),
    "throttle": (0.0, 1.0, "a share, 0 to 1"),
    "external_duty": (0.0, 1.0, "a share, 0 to 1"),
}
"""Smallest and largest possible value of a column, and what is expected; by definition of the column."""


def check_contexts(name: str, data: MeasuredData) -> None:
    """Refuse columns in another unit.

    Raises
    ------
    RecordingError
        In a line, with what to do; it begins with `name`, that of the file.
    """
    for column, (low_c, high_c) in TEMPERATURES_C.items():
        if column in data and ((data[column] < low_c) | (data[column] > high_c)).any():
            raise RecordingError(
                f"{name}: found {column} of {span(data[column][~np.isnan(data[column])])}, expected deg C from "
                f"{low_c:g} to {high_c:g}. In deg F or K? give --map a file with its unit (unit: F or K)"
            )
    for column, (low, high, expected) in CONTEXT_LIMITS.items():
        known = data[column][~np.isnan(data[column])] if column in data else np.zeros(0)
        if known.size and (known.min() < low or known.max() > high):
            raise RecordingError(
                f"{name}: found {column} of {span(known)}, expected {expected}. In another unit? "
                f"--map {column}=COLUMN*FACTOR"
            )
        if known.size and column == "humidity_pct" and 0.0 < known.max() <= 1.0:
            raise RecordingError(
                f"{name}: found {column} of {span(known)}, expected {expected}. A share? --map {column}=COLUMN*100"
            )


def span(values: Column) -> str:
    """Smallest and largest of these numbers, for a message."""
    return f"{values.min():g} to {values.max():g}"
