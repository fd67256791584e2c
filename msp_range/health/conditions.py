"""Health as a pilot wants it reported: once when it changes, and again when an autopilot comes back.

Every sensor is good or bad; one odd reading changes nothing, three of a kind in a row do. The texts are those of
`msp_range.pilot_texts`.
"""

from collections import deque
from collections.abc import Iterable

from msp_range.pilot_texts import SENSOR_FAULTS, Condition, Report, Severity, Text
from msp_range.sensors.polling import Ranging

READINGS_TO_CHANGE = 3
"""Readings in a row that make a sensor bad, or good again."""
READINGS_JUDGED = 10
"""A sensor is bad, too, where half of this many readings are faults, whatever lies between them."""
MOST_TO_BE_GOOD = 96
"""Each relapse doubles how many good readings in a row it takes to be good again, up to this many."""


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
            words, remedy = SENSOR_FAULTS[reading.status]
            sensor.last_fault = words if ranging.error is None else f"{words} (errno {ranging.error.errno})", remedy
        in_a_row = sensor.streak >= READINGS_TO_CHANGE
        is_full = len(sensor.recent) == READINGS_JUDGED
        often = is_full and 2 * sum(sensor.recent) >= READINGS_JUDGED
        if sensor.fault is None and (often or (bad and in_a_row)):
            sensor.fault = sensor.last_fault
            self._report(*Text.SENSOR.said(sensor=reading.sensor, fault=sensor.fault[0]))
        elif not bad and sensor.fault is not None and sensor.streak >= sensor.to_be_good:
            sensor.fault = None
            sensor.to_be_good = min(2 * sensor.to_be_good, MOST_TO_BE_GOOD)
            sensor.recent.clear()
            self._report(Severity.INFO, Text.SENSOR.of(sensor=reading.sensor).over)
        if not bad and sensor.streak > MOST_TO_BE_GOOD:
            sensor.to_be_good = READINGS_TO_CHANGE
        if not sensor.known and (in_a_row or is_full):
            sensor.known = True
            if self.complete and not self.sensor_faults:
                self._report(*Text.ALL_GOOD.said(count=len(self._sensors)))

    def set(self, condition: Condition) -> None:
        """Note a condition that is not a sensor's, as it is now."""
        if condition.text is None:
            ended = self._conditions.pop(condition.key, None)
            if ended is not None and ended.is_reported:
                self._report(Severity.INFO, condition.over)
            return
        known = self._conditions.get(condition.key)
        if known is None or not known.is_reported or (condition.renews and known.text != condition.text):
            self._conditions[condition.key] = condition
            if condition.is_reported:
                self._report(condition.severity, condition.text)

    @property
    def conditions(self) -> list[Condition]:
        """All that is wrong now, of sensors first."""
        sensors = [
            Text.SENSOR.of(sensor=name).when(True, sensor=name, fault=sensor.fault[0])._replace(remedy=sensor.fault[1])
            for name, sensor in self._sensors.items()
            if sensor.fault is not None
        ]
        return sensors + list(self._conditions.values())
