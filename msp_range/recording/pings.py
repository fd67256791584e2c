"""Measured readings as the pings that a `msp_range.recording.replay_bus.ReplayBus` plays again.

A recording knows when each sensor was pinged and when it answered; a CSV file knows the time of the echo, from which
the ping follows by half the time of flight.
"""

import math
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from operator import itemgetter
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from msp_range.acoustics.air import FIXED, Air
from msp_range.arrays import Column
from msp_range.correction.temperature import COLDEST_C, FIXED_STD_C, GRADIENT_STD_C, HOTTEST_C, THERMOMETER_STD_C
from msp_range.fusion import Acceleration, PressureHeight, Received
from msp_range.fusion.attitude import Angles
from msp_range.reading import Status
from msp_range.reading_model.sensor_model import SensorModel, load_sensor_model
from msp_range.recording.csv_form import MeasuredData, read_csv
from msp_range.recording.error import RecordingError
from msp_range.recording.reader import Recording, is_recording
from msp_range.recording.topics import ATTITUDE_TOPIC, LARGEST_TIME_S, MOTION_TOPIC, RANGE_PREFIX
from msp_range.sensors.base import RecordedPing
from msp_range.sensors.table import DRIVERS

ROUNDING_S = 1e-6
"""Recorded times are rounded to nanoseconds [s]."""
LONGEST_READY_S = 1.0
"""A sensor was not busy for longer than this, whatever the record says [s]: the program that recorded stood still."""

MEASURED_STD_C = math.hypot(THERMOMETER_STD_C, GRADIENT_STD_C)
"""Standard deviation of a temperature that was recorded without its own [deg C]: a thermometer's."""
Pings = Mapping[str, Sequence[RecordedPing]]
"""Recorded pings by the name of their sensor."""


class Recorded(NamedTuple):
    """The input of a bridge, to be played again; from a table only pings and air."""

    pings: Pings
    """Pings of every sensor."""
    air: Sequence[tuple[float, Air]] = ()
    """The air that readings were corrected for, or that a table has, and its time [s], by time. A deviation that was
    not recorded is that of a thermometer, or of a fixed temperature."""
    received: Sequence[tuple[float, Received]] = ()
    """Attitudes, accelerations and pressures that the autopilot sent, and when each was received [s], by that time."""

    @property
    def first_ping_s(self) -> float:
        """Time of the first ping [s]."""
        return min(of_sensor[0].ping_s for of_sensor in self.pings.values())

    def air_at(self, now_s: float) -> Air:
        """The air at a time [s]."""
        return self.air[max(bisect_right(self.air, now_s + ROUNDING_S, key=itemgetter(0)) - 1, 0)][1]


def read_recorded(
    source: Path | str | Recording,
    run: str | None = None,
    models: Mapping[str, SensorModel] = MappingProxyType({}),
) -> Recorded:
    """Read a recording or a CSV file.

    Parameters
    ----------
    source
        An MCAP recording, whole or cut, or measured data in the one CSV form.
    run
        Which run of a CSV file; needed where there are several.
    models
        Of the sensors of a CSV file, by name: when they were pinged follows from their timing. Others are of the first
        kind of `DRIVERS`.

    Raises
    ------
    RecordingError
        The file cannot be read, holds no readings or several runs, its times go backwards, or a reading is not one
        that two bytes can hold.
    """
    if not isinstance(source, Recording) and is_recording(source):
        source = Recording(source)
    if isinstance(source, Recording):
        path, recorded = source.path, _of_recording(source)
    else:
        path = Path(source)
        recorded = _of_table(path, _one_run(path, read_csv(path), run), models)
    if not recorded.pings:
        raise RecordingError(f"{path}: no readings to replay")
    # Values that the bridge would not believe of a thermometer are left out.
    believed = [
        (time_s, air)
        for time_s, air in recorded.air
        if COLDEST_C <= air.temperature_c <= HOTTEST_C and 0.0 <= air.humidity_percent <= 100.0
    ]
    return recorded._replace(air=sorted(believed, key=itemgetter(0)))


def recorded_attitudes(recording: Recording) -> list[tuple[float, Angles]]:
    """Attitudes that the autopilot sent, and when each was received [s], by that time.

    Raises
    ------
    RecordingError
        The file cannot be read.
    """
    return sorted((time_s, _angles(message)) for topic, time_s, message in recording if topic == ATTITUDE_TOPIC)


def _angles(message: dict[str, Any]) -> Angles:
    return Angles(message["time_s"], message["roll_rad"], message["pitch_rad"], message["yaw_rad"])


def _of_recording(recording: Recording) -> Recorded:
    pings: dict[str, list[RecordedPing]] = {}
    air: list[tuple[float, Air]] = []
    received: list[tuple[float, Received]] = []
    for topic, time_s, message in recording:
        if topic == ATTITUDE_TOPIC:
            received.append((time_s, _angles(message)))
        elif topic == MOTION_TOPIC:
            if (up_m_s2 := message.get("up_m_s2")) is not None:
                received.append((time_s, Acceleration(message["time_s"], up_m_s2)))
            elif (height_m := message.get("pressure_height_m")) is not None:
                received.append((time_s, PressureHeight(message["time_s"], height_m)))
        elif topic.startswith(RANGE_PREFIX):
            if "temperature_c" in message:
                air.append((time_s, _air_of(message)))
            if message["status"] != Status.PART_INFO.value:
                word = None if message["status"] == Status.NO_ANSWER.value else message.get("raw")
                ready_s = min(max(0.0, message["read_s"] - message["ping_s"]), LONGEST_READY_S)
                sensor = topic.removeprefix(RANGE_PREFIX)
                pings.setdefault(sensor, []).append(RecordedPing(message["ping_s"], word, ready_s))
    for sensor, of_sensor in pings.items():
        ping_s, words, _ = np.array(of_sensor, dtype=float).T  # None becomes NaN
        _check(recording.path, sensor, ping_s, words, ("ping_s", "raw"))
    return Recorded(pings, air, sorted(received, key=itemgetter(0)))


def _air_of(message: dict[str, Any]) -> Air:
    source = message.get("temperature_source", "recorded")
    std_c = message.get("temperature_std_c", FIXED_STD_C if source == FIXED else MEASURED_STD_C)
    return Air(message["temperature_c"], std_c, source, message.get("humidity_pct", 0.0))


def _of_table(path: Path, data: MeasuredData, models: Mapping[str, SensorModel]) -> Recorded:
    pings: dict[str, list[RecordedPing]] = {}
    for name in np.unique(data["sensor"]).tolist():
        own, model = data.select(data["sensor"] == name), models.get(name) or load_sensor_model(next(iter(DRIVERS)))
        _check(path, name, own["time_s"], own["reading_cm"], ("time_s", "reading_cm"))
        pings[name] = [
            _ping_of(model, time_s, _answer_cm(reading_cm, model))
            for time_s, reading_cm in zip(own["time_s"].tolist(), own["reading_cm"].tolist(), strict=True)
        ]
    known = data.select(~np.isnan(data.column("air_temperature_c")))
    humidity_pct = np.nan_to_num(known.column("humidity_pct"))
    rows = np.column_stack((known["time_s"], known.column("air_temperature_c"), humidity_pct)).tolist()
    air = [(time_s, Air(air_c, MEASURED_STD_C, "recorded", percent)) for time_s, air_c, percent in rows]
    return Recorded(pings, air)


def _answer_cm(reading_cm: float, model: SensorModel) -> float | None:
    """A reading as a driver answers it [cm]; None where it is no number."""
    if reading_cm != reading_cm:
        return None
    per_cm = round(1.0 / min(model.answered_cm, 1.0))
    return round(reading_cm) if per_cm == 1 else round(reading_cm * per_cm) / per_cm


def _ping_of(model: SensorModel, echo_s: float, raw: float | None) -> RecordedPing:
    """The ping of an answer: half a time of flight before the echo, if there was one."""
    timing = model.timing
    # A flag above the centimetres is no other time.
    echo_cm = (raw or 0) % 0x8000
    is_range = raw is not None and model.minimum_cm <= raw < model.maximum_cm
    ready_s = timing.answer_s(echo_cm) if echo_cm < model.maximum_cm else timing.cycle_s
    return RecordedPing(echo_s - 0.5 * timing.s_per_cm * echo_cm * is_range, raw, ready_s)


def _one_run(path: Path, data: MeasuredData, run: str | None) -> MeasuredData:
    runs = np.unique(data["run"]).tolist() if "run" in data else []
    if run is None and len(runs) < 2:
        return data
    if run not in runs:
        found = ", ".join(runs) if runs else "no column 'run'"
        raise RecordingError(f"{path}: {'choose one run' if run is None else f'no run {run!r}'}; found: {found}")
    return data.select(data["run"] == run)


def _check(path: Path, sensor: str, time_s: Column, words: Column, names: tuple[str, str]) -> None:
    """Refuse times that are none or go back, and answers of more than two bytes; ``names``: those of both columns."""
    far = np.flatnonzero(~(np.abs(time_s) <= LARGEST_TIME_S))  # also what is not a number
    if far.size:
        raise RecordingError(
            f"{path}: sensor {sensor!r}: found {names[0]} {time_s[far[0]]:g}, expected seconds, at most "
            f"{LARGEST_TIME_S:g}"
        )
    back = np.flatnonzero(np.diff(time_s) < 0)
    if back.size:
        before_s, after_s = time_s[back[0] : back[0] + 2]
        raise RecordingError(
            f"{path}: sensor {sensor!r}: {names[0]} goes back from {before_s} to {after_s}; "
            "expected the readings in order, and several sessions with different names in the column 'run'"
        )
    odd = np.flatnonzero((np.rint(words) < 0) | (np.rint(words) > 0xFFFF))
    if odd.size:
        raise RecordingError(
            f"{path}: sensor {sensor!r} at {time_s[odd[0]]} s: {names[1]} {words[odd[0]]:g} is not a number that the "
            "sensor's two bytes can hold; expected 0 to 65535"
        )
