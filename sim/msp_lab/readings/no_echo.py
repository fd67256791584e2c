"""Readings of no echo in a log, in the code of a sensor model.

An imported log has its own maximum (`RNGFND1_MAX`, `max_distance`), which is its reading of no echo and is in the
column ``no_echo_cm``. The model's code is its own ``maximum_cm``: without a translation a log's 700 cm would be hits of
a model that reads up to 765 cm.
"""

import math

import numpy as np

from msp_range.arrays import Column, Flags
from msp_range.reading_model.sensor_model import SensorModel
from msp_range.recording.csv_form import MeasuredData
from msp_sim.effects.base import TRUE_RANGE

NO_ECHO = "no_echo_cm"
"""Column of an imported log: its reading of no echo [cm]; empty: it states none."""
NEAR_MAXIMUM = 0.95
"""Where a model reaches farther than a log's maximum, the log does not show what the sensor read beyond it. From this
share of the log's maximum on, up to the model's, its readings of no echo are left out: a hit there may have been just
beyond the maximum. Nearer to 1: noise of a few centimetres at 7 m counts as missed echoes; smaller: missed echoes of
long ranges are lost, which are the most frequent ones."""


def in_code_of(sensor: SensorModel, data: MeasuredData) -> tuple[MeasuredData, list[str]]:
    """Give readings of no echo the model's code, where the log that they are from has another one.

    Parameters
    ----------
    sensor
        Its maximum is the code.
    data
        Readings with or without `NO_ECHO` and a true range [cm].

    Returns
    -------
    tuple of MeasuredData and list of str
        The table, whose `NO_ECHO` is the model's maximum where it is known, and what was changed, a sentence each.
    """
    if NO_ECHO not in data or data[NO_ECHO].dtype.kind != "f":
        return data, []
    reading_cm, log_cm = data["reading_cm"], data[NO_ECHO]
    changed = (reading_cm == log_cm) & (log_cm != sensor.maximum_cm)
    code: Column = np.where(np.isnan(log_cm), math.nan, float(sensor.maximum_cm))
    columns = {**data.columns, NO_ECHO: code}
    if not changed.any():
        return MeasuredData(columns), []
    true_cm = data.column(TRUE_RANGE)
    hidden = changed & (true_cm > NEAR_MAXIMUM * log_cm) & (true_cm < sensor.maximum_cm)
    columns["reading_cm"] = np.where(hidden, math.nan, np.where(changed, float(sensor.maximum_cm), reading_cm))
    maxima = ", ".join(f"{value:g}" for value in np.unique(log_cm[changed]))
    text = f"No echo is {maxima} cm in the log and {sensor.maximum_cm} cm in the model: {changed.sum()} readings."
    if hidden.any():
        text += (
            f" Left out: {hidden.sum()} of these, at true ranges from {100.0 * NEAR_MAXIMUM:g} % of the log's maximum "
            "to the model's, where the log does not show what the sensor read."
        )
    return MeasuredData(columns), [text]


def without_negative(data: MeasuredData) -> tuple[MeasuredData, list[str]]:
    """Make negative readings no answer, with a note: they are a program's codes and no distances."""
    data, notes = as_no_answer(data, data["reading_cm"] < 0.0, "negative readings are codes and no distances,")
    return data, [
        f"{note}. Do they mean no echo? Then name them in a map file: codes: {{no_echo: [...]}}" for note in notes
    ]


def as_no_answer(data: MeasuredData, rows: Flags, what: str) -> tuple[MeasuredData, list[str]]:
    """Make readings no answer where there are any such, with a note of what they are and their first values."""
    if not rows.any():
        return data, []
    reading_cm = data["reading_cm"]
    values = np.unique(reading_cm[rows])
    shown = ", ".join(f"{value:g}" for value in values[:5]) + (" ..." if values.size > 5 else "")
    columns = {**data.columns, "reading_cm": np.where(rows, math.nan, reading_cm)}
    return MeasuredData(columns), [f"{rows.sum()} {what} and count as no answer: {shown}"]
