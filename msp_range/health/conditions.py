"""Health as a pilot wants it reported: once when it changes, and again when an autopilot comes back.

Every sensor is good or bad; one odd reading changes nothing, three of a kind in a row do. What is wrong is reported in
at most 50 characters, the length of a STATUSTEXT.
"""

from collections import deque
from collections.abc import Callable, Iterable
from enum import IntEnum
from typing import NamedTuple

from msp_range.reading import Status
from msp_range.sensors.polling import Ranging

EXPLAINED = "docs/flying.md explains the texts"

READINGS_TO_CHANGE = 3
"""Readings in a row that make a sensor bad, or good again."""
READINGS_JUDGED = 10
"""A sensor is bad, too, where half of this many readings are faults, whatever lies between them."""
MOST_TO_BE_GOOD = 96
"""Each relapse doubles how many good readings in a row it takes to be good again, up to this many."""


class Severity(IntEnum):
    """MAV_SEVERITY, of which three are used."""

    ERROR = 3
    WARNING = 4
    INFO = 6


Report = Callable[[Severity, str], None]

_WORDS = {
    Status.NO_ANSWER: ("no answer", "check its power, its wires and its address"),
    Status.CLOCK_FAULT: ("I2C clock fault, use 50 kHz", "msp-range doctor says how the bus's clock is set"),
    Status.IMPOSSIBLE: ("impossible answers", "check that it is of the model in the airframe file, and its supply"),
    Status.PART_INFO: ("answers without ranging", "switch its power off and on"),
    Status.STUCK: ("stuck at one value", "switch its power off and on"),
    Status.FIXED: ("sees part of the vehicle", "free its beam: payload, strap, landing gear, ice"),
    Status.GARBLED: ("garbled answers, check the bus", "check the bus's wires, pull-ups and clock"),
}


class Condition(NamedTuple):
    """Something that is wrong while it lasts."""

    key: str
    """Which condition it is."""
    text: str | None
    """What is wrong, for the pilot; None: nothing."""
    over: str
    """What to report at its end."""
    severity: Severity = Severity.WARNING
    """How bad it is."""
    renews: bool = False
    """Whether another text while it lasts is reported too."""
    remedy: str = EXPLAINED
    """What to do about it."""
    is_reported: bool = True
    """Whether the pilot is to read it; else it only counts for the verdict."""


class _SensorHealth:
    # What is wrong, and what to do about it.
    fault: tuple[str, str] | None = None
    last_fault = ("", "")
    known = False
    streak, streak_bad = 0, False
    to_be_good = READINGS_TO_CHANGE

    def __init__(self) -> None:
        self.recent: deque[bool] = deque(maxlen=READINGS_JUDGED)


class Health:
    """Notices changes and reports them.

    Parameters
    ----------
    sensors
        Names of the sensors.
    report
        Called with (severity, text) at each change.
    """

    def __init__(self, sensors: Iterable[str], report: Report) -> None:
        self._sensors = {name: _SensorHealth() for name in sensors}
        self._report = report
        self._conditions: dict[str, Condition] = {}

    @property
    def sensor_faults(self) -> dict[str, str]:
        """What is wrong with each sensor that is out of order now."""
        return {name: sensor.fault[0] for name, sensor in self._sensors.items() if sensor.fault is not None}

    @property
    def failing_sensors(self) -> list[str]:
        """Sensors that are out of order, and those whose newest reading was a fault."""
        return [name for name, sensor in self._sensors.items() if sensor.fault is not None or sensor.streak_bad]

    @property
    def complete(self) -> bool:
        """True when it is known of every sensor whether it is in order."""
        return all(sensor.known for sensor in self._sensors.values())

    def on_ranging(self, ranging: Ranging) -> None:
        """Update the health of the sensor that a ranging is of."""
        reading = ranging.reading
        sensor = self._sensors[reading.sensor]
        bad = reading.status.is_fault
        sensor.streak = sensor.streak + 1 if bad == sensor.streak_bad else 1
        sensor.streak_bad = bad
        sensor.recent.append(bad)
        if bad:
            words, remedy = _WORDS[reading.status]
            sensor.last_fault = words if ranging.error is None else f"{words} (errno {ranging.error.errno})", remedy
        in_a_row = sensor.streak >= READINGS_TO_CHANGE
        is_full = len(sensor.recent) == READINGS_JUDGED
        often = is_full and 2 * sum(sensor.recent) >= READINGS_JUDGED
        if sensor.fault is None and (often or (bad and in_a_row)):
            sensor.fault = sensor.last_fault
            self._report(Severity.ERROR, f"Range {reading.sensor}: {sensor.fault[0]}")
        elif not bad and sensor.fault is not None and sensor.streak >= sensor.to_be_good:
            sensor.fault = None
            sensor.to_be_good = min(2 * sensor.to_be_good, MOST_TO_BE_GOOD)
            sensor.recent.clear()
            self._report(Severity.INFO, f"Range {reading.sensor}: good again")
        if not bad and sensor.streak > MOST_TO_BE_GOOD:
            sensor.to_be_good = READINGS_TO_CHANGE
        if not sensor.known and (in_a_row or is_full):
            sensor.known = True
            if self.complete and not self.sensor_faults:
                self._report(Severity.INFO, f"Range: all {len(self._sensors)} sensors good")

    def set(self, condition: Condition) -> None:
        """Note a condition that is not a sensor's, as it is now."""
        known = self._conditions.get(condition.key)
        if condition.text is None:
            if known is not None:
                del self._conditions[condition.key]
                if known.is_reported:
                    self._report(Severity.INFO, condition.over)
            return
        if known is None or not known.is_reported or (condition.renews and known.text != condition.text):
            self._conditions[condition.key] = condition
            if condition.is_reported:
                self._report(condition.severity, condition.text)

    @property
    def conditions(self) -> list[Condition]:
        """All that is wrong now, of sensors first."""
        sensors = [
            Condition(f"sensor {name}", f"Range {name}: {sensor.fault[0]}", "", Severity.ERROR, remedy=sensor.fault[1])
            for name, sensor in self._sensors.items()
            if sensor.fault is not None
        ]
        return sensors + list(self._conditions.values())
