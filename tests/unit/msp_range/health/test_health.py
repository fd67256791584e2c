"""What is reported to a pilot of the sensors, and how often."""

import errno

import pytest
from pymavlink.dialects.v20 import common

from msp_range.bus import BusError
from msp_range.health import Health
from msp_range.pilot_texts import Condition, Severity
from msp_range.reading import Reading, Status
from msp_range.sensors.polling import Ranging


class Pilot:
    """A health of one or more sensors, and what it reported."""

    def __init__(self, *sensors: str) -> None:
        self.reported: list[tuple[Severity, str]] = []
        self.health = Health(sensors, lambda severity, text: self.reported.append((severity, text)))

    def take(self, *statuses: Status, sensor: str = "a", error: BusError | None = None) -> None:
        for status in statuses:
            reading = Reading(0.0, sensor, status, 3.0 if status.has_range else None)
            self.health.on_ranging(Ranging(reading, 0.0, 0.1, error))


OK, SILENT = Status.OK, Status.NO_ANSWER


def test_all_good_is_reported_once_when_all_are_known() -> None:
    pilot = Pilot("a", "b")
    pilot.take(OK, OK)
    pilot.take(OK, OK, OK, sensor="b")
    assert not pilot.health.complete
    pilot = Pilot("a", "b")
    pilot.take(OK, OK, OK)
    assert pilot.reported == []
    assert not pilot.health.complete
    pilot.take(OK, Status.NO_ECHO, Status.AT_MINIMUM, OK, OK, sensor="b")
    assert pilot.reported == [(Severity.INFO, "Range: all 2 sensors good")]
    assert pilot.health.complete


def test_three_in_a_row_change_what_is_reported_and_fewer_do_not() -> None:
    pilot = Pilot("a")
    pilot.take(OK, OK, OK)
    pilot.reported.clear()
    pilot.take(SILENT, SILENT, OK, OK, OK, SILENT, SILENT)
    assert (pilot.reported, list(pilot.health.sensor_faults)) == ([], [])
    pilot.take(SILENT)
    assert pilot.reported == [(Severity.ERROR, "Range a: no answer")]
    pilot.take(*[SILENT] * 20, OK, OK, SILENT, OK, OK)
    assert (len(pilot.reported), list(pilot.health.sensor_faults)) == (1, ["a"])
    pilot.take(OK)
    assert pilot.reported[1:] == [(Severity.INFO, "Range a: good again")]
    assert list(pilot.health.sensor_faults) == []


@pytest.mark.parametrize(
    ("status", "error", "text"),
    [
        (Status.NO_ANSWER, BusError(errno.EREMOTEIO, "read", 0x70), "Range a: no answer (errno 121)"),
        (Status.CLOCK_FAULT, None, "Range a: I2C clock fault, use 50 kHz"),
        (Status.IMPOSSIBLE, None, "Range a: impossible answers"),
        (Status.PART_INFO, None, "Range a: answers without ranging"),
    ],
)
def test_what_is_wrong_is_named(status: Status, error: BusError | None, text: str) -> None:
    pilot = Pilot("a")
    pilot.take(status, status, status, error=error)
    assert pilot.reported == [(Severity.ERROR, text)]


@pytest.mark.parametrize("status", [status for status in Status if not status.is_fault])
def test_what_the_scene_does_is_no_fault(status: Status) -> None:
    pilot = Pilot("a")
    pilot.take(*[status] * 10)
    assert list(pilot.health.sensor_faults) == []


def test_a_sensor_that_never_worked_is_reported_and_all_good_is_not() -> None:
    pilot = Pilot("a", "b")
    pilot.take(SILENT, SILENT, SILENT)
    pilot.take(OK, OK, OK, sensor="b")
    assert [text for _, text in pilot.reported] == ["Range a: no answer"]
    pilot.take(OK, OK, OK)
    assert [text for _, text in pilot.reported][1:] == ["Range a: good again"]


def test_a_condition_is_reported_when_it_comes_and_when_it_goes() -> None:
    pilot = Pilot("a")
    for text in ("no temperature", None):
        for _ in range(3):
            pilot.health.set(Condition("temperature", text, "temperature is back"))
    assert pilot.reported == [(Severity.WARNING, "no temperature"), (Severity.INFO, "temperature is back")]


def test_severities_are_those_of_mavlink() -> None:
    for severity in Severity:
        assert severity == getattr(common, f"MAV_SEVERITY_{severity.name}")


def test_what_is_wrong_now_can_be_asked_for() -> None:
    pilot = Pilot("a", "b", "c")
    pilot.take(SILENT, SILENT, SILENT)
    pilot.take(SILENT, SILENT, SILENT, OK, OK, OK, sensor="b")
    pilot.health.set(Condition("bus", "bus is locked up", "", Severity.ERROR))
    pilot.health.set(Condition("temperature", "gone", "back"))
    pilot.health.set(Condition("temperature", None, "back"))
    assert [each.text for each in pilot.health.conditions] == ["Range a: no answer", "bus is locked up"]


@pytest.mark.parametrize("pattern", [(OK, SILENT), (SILENT, SILENT, OK), (SILENT, OK, OK, SILENT)])
def test_a_sensor_that_fails_every_other_time_is_bad(pattern: tuple[Status, ...]) -> None:
    """No three are alike in a row: it is reported once, and it is not good in between."""
    pilot = Pilot("a")
    pilot.take(*pattern * 50)
    assert pilot.reported == [(Severity.ERROR, "Range a: no answer")]
    assert pilot.health.complete


def test_a_sensor_that_comes_and_goes_is_reported_less_and_less() -> None:
    pilot = Pilot("a")
    pilot.take(*([SILENT] * 3 + [OK] * 4) * 200)
    assert len(pilot.reported) <= 4
    pilot.take(*[OK] * 200)
    assert pilot.reported[-1] == (Severity.INFO, "Range a: good again")
    count = len(pilot.reported)
    pilot.take(*[SILENT] * 3, *[OK] * 3)
    assert len(pilot.reported) == count + 2
