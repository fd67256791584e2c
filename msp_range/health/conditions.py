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
    Status.NO_ANSWER: "no answer",
    Status.CLOCK_FAULT: "I2C clock fault, use 50 kHz",
    Status.IMPOSSIBLE: "impossible answers",
    Status.PART_INFO: "answers without ranging",
    Status.STUCK: "stuck at one value",
    Status.GARBLED: "garbled answers, check the bus",
}


class Condition(NamedTuple):
    """What `Health.set` needs: a condition's key, what is wrong or None, what to report at its end, how bad it is, and
    whether a text that changes is reported again."""

    key: str
    text: str | None
    over: str
    severity: Severity = Severity.WARNING
    renews: bool = False


class _SensorHealth:
    def __init__(self) -> None:
        self.fault: str | None = None
        self.known = False
        self.streak = 0
        self.streak_bad = False
        self.last_fault = ""
        self.recent: deque[bool] = deque(maxlen=READINGS_JUDGED)
        self.to_be_good = READINGS_TO_CHANGE


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
        self._conditions: dict[str, tuple[Severity, str]] = {}

    @property
    def bad_sensors(self) -> list[str]:
        """Sensors that are out of order now."""
        return [name for name, sensor in self._sensors.items() if sensor.fault is not None]

    @property
    def sensor_faults(self) -> dict[str, str | None]:
        """What is wrong with each sensor; None for a good one."""
        return {name: sensor.fault for name, sensor in self._sensors.items()}

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
            sensor.last_fault = _WORDS[reading.status]
            if ranging.error is not None:
                sensor.last_fault += f" (errno {ranging.error.errno})"
        in_a_row = sensor.streak >= READINGS_TO_CHANGE
        if not in_a_row and len(sensor.recent) < READINGS_JUDGED:
            return
        often = len(sensor.recent) == READINGS_JUDGED and 2 * sum(sensor.recent) >= READINGS_JUDGED
        if sensor.fault is None and (often or (bad and in_a_row)):
            sensor.fault = sensor.last_fault
            self._report(Severity.ERROR, f"Range {reading.sensor}: {sensor.fault}")
        elif not bad and sensor.fault is not None and sensor.streak >= sensor.to_be_good:
            sensor.fault = None
            sensor.to_be_good = min(2 * sensor.to_be_good, MOST_TO_BE_GOOD)
            sensor.recent.clear()
            self._report(Severity.INFO, f"Range {reading.sensor}: good again")
        if not bad and sensor.streak > MOST_TO_BE_GOOD:
            sensor.to_be_good = READINGS_TO_CHANGE
        if not sensor.known:
            sensor.known = True
            if self.complete and not self.bad_sensors:
                self._report(Severity.INFO, f"Range: all {len(self._sensors)} sensors good")

    def set(
        self, condition: str, text: str | None, over: str, severity: Severity = Severity.WARNING, renews: bool = False
    ) -> None:
        """Note a condition that is not a sensor's: ``text`` while it lasts, None when it is over.

        Parameters
        ----------
        condition
            Its key.
        text
            What is wrong, or None.
        over
            What to say when it is over.
        severity
            How bad it is.
        renews
            Whether another text while it lasts is reported too.
        """
        known = self._conditions.get(condition)
        if text is not None and (known is None or (renews and known[1] != text)):
            self._conditions[condition] = (severity, text)
            self._report(severity, text)
        elif text is None and self._conditions.pop(condition, None) is not None:
            self._report(Severity.INFO, over)

    def faults(self) -> list[tuple[Severity, str]]:
        """What is wrong now, for an autopilot that has just come."""
        sensors = [
            (Severity.ERROR, f"Range {name}: {sensor.fault}")
            for name, sensor in self._sensors.items()
            if sensor.fault is not None
        ]
        return sensors + list(self._conditions.values())
