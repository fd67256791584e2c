"""A recording as measured data in the one CSV form.

One row is one ping. What a simulator knew of it (``/truth/<sensor>``) becomes its context; from a real flight the
context is the air temperature, where it was measured, and the time since another sensor's ping. `export` adds what the
bridge made of the reading (`BRIDGE_COLUMNS`).
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from msp_range.acoustics.air import FIXED, HELD
from msp_range.arrays import Column, numbered
from msp_range.reading import Status
from msp_range.recording.csv_form import MeasuredData, table_of, write_csv
from msp_range.recording.error import RecordingError
from msp_range.recording.reader import Recording
from msp_range.recording.topics import FUSED_TOPIC, RANGE_PREFIX, TRUTH_PREFIX

MOST_COLUMNS = 100
"""Most columns of a table; a recording with more is refused. The contexts that are known have 17, and each column costs
8 bytes of memory a row."""

_NOT_A_READING = frozenset({Status.NO_ANSWER.value, Status.PART_INFO.value})


def export(recording: Path | str | Recording, csv_path: Path | str) -> int:
    """Write a recording as CSV, with what the bridge made of each reading; return the number of rows.

    Raises
    ------
    RecordingError
        The recording cannot be read or the CSV file cannot be written.
    """
    data = measured_data(recording if isinstance(recording, Recording) else Recording(recording), stages=True)
    write_csv(csv_path, data)
    return len(data)


def measured_data(recording: Recording, *, faults: bool = True, stages: bool = False) -> MeasuredData:
    """The readings of a recording as columns, in the order in which they were recorded.

    ``reading_cm`` is the sensor's answer as it was read, fault codes included; empty where there was no answer, or only
    part information. ``run`` is the recording's file name, or what a bench or simulator called it.

    Parameters
    ----------
    recording
        Of a flight, a simulation or a bench.
    faults
        False: every answer that is a fault is empty.
    stages
        True: with `BRIDGE_COLUMNS`.
    """
    not_a_reading = _NOT_A_READING if faults else frozenset(status.value for status in Status if status.is_fault)
    rows: list[dict[str, Any]] = []
    pings_s: list[float] = []
    truth: dict[str, dict[str, Any]] = {}
    for topic, _, message in recording:
        if topic.startswith(TRUTH_PREFIX):
            truth[topic.removeprefix(TRUTH_PREFIX)] = message
        elif topic.startswith(RANGE_PREFIX):
            sensor = topic.removeprefix(RANGE_PREFIX)
            row = {"time_s": message["time_s"], "sensor": sensor, "run": recording.path.stem}
            if message["status"] not in not_a_reading:
                row["reading_cm"] = message.get("raw")
            # A truth belongs to one ping: a ping that the sensor did not take leaves none behind.
            row |= truth.pop(sensor, {})
            if message.get("temperature_source") not in (FIXED, HELD):
                row.setdefault("air_temperature_c", message.get("temperature_c"))
                if "humidity_pct" in message:
                    row.setdefault("humidity_pct", message["humidity_pct"])
            if stages:
                row |= {key: message.get(key) for key in ("status", "rejected")}
                row |= {f"{key}_cm": _cm(message.get(f"{key}_m")) for key in ("corrected", "filtered")}
            rows.append(row)
            pings_s.append(message["ping_s"])
        elif stages and topic == FUSED_TOPIC and rows:
            # The bridge records it right after the reading that it follows from.
            variance_m2 = message.get("variance_m2", -1.0)
            std_m = math.sqrt(variance_m2) if variance_m2 >= 0.0 else None
            rows[-1] |= {"fused_cm": _cm(message.get("range_m")), "fused_std_cm": _cm(std_m)}
    sensors, runs = ([row[key] for row in rows] for key in ("sensor", "run"))
    lags_ms = neighbour_lags_ms(np.array(pings_s, dtype=float), sensors, numbered(np.array(runs)))
    for row, lag_ms in zip(rows, lags_ms.tolist(), strict=True):
        row.setdefault("neighbour_lag_ms", round(lag_ms, 3))
    first = ("time_s", "sensor", "run", "reading_cm", "true_range_cm")
    names = dict.fromkeys([*first, *(name for row in rows for name in row)])
    if len(names) > MOST_COLUMNS:
        raise RecordingError(f"{recording.path}: found {len(names)} kinds of context, expected at most {MOST_COLUMNS}")
    return table_of(str(recording.path), rows, names)


def _cm(value_m: float | None) -> float | None:
    """Centimetres, to a hundredth of a millimetre, so that a table of them can be read."""
    return None if value_m is None else round(100.0 * value_m, 3)


def neighbour_lags_ms(time_s: Column, sensors: Sequence[str], runs: Column) -> Column:
    """Time since the last ping of another sensor in the run [ms], for each ping; NaN where there was none before."""
    lags_ms = np.full(time_s.size, math.nan)
    last_s: dict[str, float] = {}
    here = None
    for row in np.lexsort((time_s, runs)).tolist():
        if runs[row] != here:
            here, last_s = runs[row], {}
        others_s = [ping_s for name, ping_s in last_s.items() if name != sensors[row]]
        if others_s:
            lags_ms[row] = 1e3 * (time_s[row] - max(others_s))
        last_s[sensors[row]] = float(time_s[row])
    return lags_ms
