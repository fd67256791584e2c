"""Measured readings as the pings that a `msp_range.recording.replay_bus.ReplayBus` plays again.

A recording knows when each sensor was pinged and when it answered; a CSV file knows the time of the echo, from which
the ping follows by half the time of flight.
"""

import math
from collections.abc import Mapping, Sequence
from operator import attrgetter, itemgetter
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from msp_range.acoustics.air import FIXED, Air
from msp_range.arrays import Column
from msp_range.correction.temperature import COLDEST_C, FIXED_STD_C, GRADIENT_STD_C, HOTTEST_C, THERMOMETER_STD_C
from msp_range.fusion.attitude import Angles
from msp_range.fusion.vertical import Moved
from msp_range.reading import Status
from msp_range.recording.csv_form import MeasuredData, read_csv
from msp_range.recording.error import RecordingError
from msp_range.recording.reader import Recording, is_recording
from msp_range.recording.topics import ATTITUDE_TOPIC, LARGEST_TIME_S, MOTION_TOPIC, RANGE_PREFIX
from msp_range.sensors.base import Driver, RecordedPing
from msp_range.sensors.table import default_driver

LONGEST_READY_S = 1.0
"""A sensor was not busy for longer than this, whatever the record says [s]: the program that recorded stood still."""

MEASURED_STD_C = math.hypot(THERMOMETER_STD_C, GRADIENT_STD_C)
"""Standard deviation of a temperature that was recorded without its own [deg C]: a thermometer's."""
Source = Path | str | Recording
"""A recording or a table of readings, or its path."""
Pings = Mapping[str, Sequence[RecordedPing]]
"""Recorded pings by the name of their sensor."""


def recorded_pings(
    source: Source, run: str | None = None, drivers: Mapping[str, type[Driver]] = MappingProxyType({})
) -> Pings:
    """The pings of every sensor in a recording or a CSV file, by the sensor's name.

    Parameters
    ----------
    source
        An MCAP recording, whole or cut, or measured data in the one CSV form.
    run
        Which run of a CSV file; needed where there are several.
    drivers
        Of the sensors of a CSV file, by name: their pings follow from their kind. Others are of the default kind.

    Raises
    ------
    RecordingError
        The file cannot be read, holds no readings or several runs, its times go backwards, or a reading is not one
        that two bytes can hold.
    """
    recording, path = _opened(source)
    pings = _of_csv(path, run, drivers) if recording is None else _of_recording(recording)
    if not pings:
        raise RecordingError(f"{path}: no readings to replay")
    return pings


def recorded_air(source: Source, run: str | None = None) -> list[tuple[float, Air]]:
    """The air that readings were corrected for, or that a CSV file has: (time [s], air), by time.

    Where the deviation was not recorded, it is that of a thermometer, or of a fixed temperature.

    Raises
    ------
    RecordingError
        As `recorded_pings`.
    """
    recording, path = _opened(source)
    if recording is not None:
        pairs = [
            (time_s, _air_of(message))
            for topic, time_s, message in recording
            if topic.startswith(RANGE_PREFIX) and "temperature_c" in message
        ]
    else:
        data = _one_run(path, read_csv(path), run)
        if "air_temperature_c" not in data:
            return []
        known = data.select(~np.isnan(data["air_temperature_c"]))
        humidity_pct = known["humidity_pct"] if "humidity_pct" in known else np.zeros(known["time_s"].size)
        rows = np.column_stack((known["time_s"], known["air_temperature_c"], np.nan_to_num(humidity_pct))).tolist()
        pairs = [(time_s, Air(air_c, MEASURED_STD_C, "recorded", percent)) for time_s, air_c, percent in rows]
    # What no thermometer of the bridge is believed is not believed here.
    believed = [
        (time_s, air)
        for time_s, air in pairs
        if COLDEST_C <= air.temperature_c <= HOTTEST_C and 0.0 <= air.humidity_percent <= 100.0
    ]
    return sorted(believed, key=itemgetter(0))


def _air_of(message: dict[str, Any]) -> Air:
    source = message.get("temperature_source", "recorded")
    std_c = message.get("temperature_std_c", FIXED_STD_C if source == FIXED else MEASURED_STD_C)
    return Air(message["temperature_c"], std_c, source, message.get("humidity_pct", 0.0))


def recorded_attitudes(source: Source) -> list[tuple[float, Angles]]:
    """Attitudes that the autopilot sent, and when each was received [s], by that time; none in a CSV file.

    Raises
    ------
    RecordingError
        The file cannot be read.
    """
    return sorted(
        (received_s, Angles(message["time_s"], message["roll_rad"], message["pitch_rad"], message["yaw_rad"]))
        for received_s, message in _messages(source, ATTITUDE_TOPIC)
    )


def _opened(source: Source) -> tuple[Recording | None, Path]:
    """The recording, None where it is a table; and its file."""
    if isinstance(source, Recording):
        return source, source.path
    return Recording(source) if is_recording(source) else None, Path(source)


def _messages(source: Source, topic: str) -> list[tuple[float, dict[str, Any]]]:
    """Messages of a topic, and when each was received [s]; none of a table."""
    recording, _ = _opened(source)
    return [(time_s, message) for each, time_s, message in recording or () if each == topic]


def recorded_motion(source: Source) -> list[Moved]:
    """Accelerations and pressures that the autopilot sent, by time; none in a CSV file.

    Raises
    ------
    RecordingError
        The file cannot be read.
    """
    moved = (
        Moved(message["time_s"], message.get("up_m_s2"), message.get("pressure_height_m"))
        for _, message in _messages(source, MOTION_TOPIC)
    )
    return sorted(moved, key=attrgetter("time_s"))


def _of_recording(recording: Recording) -> Pings:
    pings: dict[str, list[RecordedPing]] = {}
    for topic, _, message in recording:
        if not topic.startswith(RANGE_PREFIX) or message["status"] == Status.PART_INFO.value:
            continue
        sensor = topic.removeprefix(RANGE_PREFIX)
        word = None if message["status"] == Status.NO_ANSWER.value else message.get("raw")
        ready_s = max(0.0, message["read_s"] - message["ping_s"])
        pings.setdefault(sensor, []).append(RecordedPing(message["ping_s"], word, min(ready_s, LONGEST_READY_S)))
    for sensor, each in pings.items():
        _check_order(recording.path, sensor, np.array([ping.ping_s for ping in each]), "ping_s")
        words = np.array([math.nan if ping.word is None else float(ping.word) for ping in each])
        _check_words(recording.path, sensor, np.array([ping.ping_s for ping in each]), words, "raw")
    return pings


def _check_order(path: Path, sensor: str, time_s: Column, name: str) -> None:
    far = np.flatnonzero(~(np.abs(time_s) <= LARGEST_TIME_S))  # also what is not a number
    if far.size:
        raise RecordingError(
            f"{path}: sensor {sensor!r}: found {name} {time_s[far[0]]:g}, expected seconds, at most {LARGEST_TIME_S:g}"
        )
    back = np.flatnonzero(np.diff(time_s) < 0)
    if back.size:
        before_s, after_s = time_s[back[0] : back[0] + 2]
        raise RecordingError(
            f"{path}: sensor {sensor!r}: {name} goes back from {before_s} to {after_s}; "
            "expected the readings in order, and several sessions with different names in the column 'run'"
        )


def _check_words(path: Path, sensor: str, time_s: Column, words: Column, name: str) -> None:
    odd = np.flatnonzero((np.rint(words) < 0) | (np.rint(words) > 0xFFFF))
    if odd.size:
        raise RecordingError(
            f"{path}: sensor {sensor!r} at {time_s[odd[0]]} s: {name} {words[odd[0]]:g} is not a number that the "
            "sensor's two bytes can hold; expected 0 to 65535"
        )


def _of_csv(path: Path, run: str | None, drivers: Mapping[str, type[Driver]]) -> Pings:
    data = _one_run(path, read_csv(path), run)
    return {
        name: _of_sensor(path, data.select(data["sensor"] == name), drivers.get(name, default_driver()))
        for name in np.unique(data["sensor"]).tolist()
    }


def _one_run(path: Path, data: MeasuredData, run: str | None) -> MeasuredData:
    runs = np.unique(data["run"]).tolist() if "run" in data else []
    if run is None and len(runs) < 2:
        return data
    if run not in runs:
        found = ", ".join(runs) if runs else "no column 'run'"
        raise RecordingError(f"{path}: {'choose one run' if run is None else f'no run {run!r}'}; found: {found}")
    return data.select(data["run"] == run)


def _of_sensor(path: Path, data: MeasuredData, driver: type[Driver]) -> list[RecordedPing]:
    time_s, reading_cm = data["time_s"], data["reading_cm"]
    sensor = str(data["sensor"][0])
    _check_order(path, sensor, time_s, "time_s")
    _check_words(path, sensor, time_s, reading_cm, "reading_cm")
    return [
        driver.recorded_ping(each_s, None if word != word else int(word))
        for each_s, word in zip(time_s.tolist(), np.rint(reading_cm).tolist(), strict=True)
    ]
