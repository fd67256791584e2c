"""What is reported to a pilot of the sensors, and how often."""

import errno

import pytest
from pymavlink.dialects.v20 import common

from msp_range.bus import BusError
from msp_range.health import Health, Severity
from msp_range.reading import Reading, Status
from msp_range.sensors.polling import Ranging


class Ear:
    """A health of one or more sensors, and what it reported."""

    def __init__(self, *sensors: str) -> None:
        self.heard: list[tuple[Severity, str]] = []
        self.health = Health(sensors, lambda severity, text: self.heard.append((severity, text)))

    def take(self, *statuses: Status, sensor: str = "a", error: BusError | None = None) -> None:
        for status in statuses:
            reading = Reading(0.0, sensor, status, 3.0 if status.has_range else None)
            self.health.on_ranging(Ranging(reading, 0.0, 0.1, error))


OK, SILENT = Status.OK, Status.NO_ANSWER


def test_all_good_is_reported_once_when_all_are_known() -> None:
    ear = Ear("a", "b")
    ear.take(OK, OK)
    ear.take(OK, OK, OK, sensor="b")
    assert not ear.health.complete
    ear = Ear("a", "b")
    ear.take(OK, OK, OK)
    assert ear.heard == []
    assert not ear.health.complete
    ear.take(OK, Status.NO_ECHO, Status.AT_MINIMUM, OK, OK, sensor="b")
    assert ear.heard == [(Severity.INFO, "Range: all 2 sensors good")]
    assert ear.health.complete


def test_three_in_a_row_change_what_is_reported_and_fewer_do_not() -> None:
    ear = Ear("a")
    ear.take(OK, OK, OK)
    ear.heard.clear()
    ear.take(SILENT, SILENT, OK, OK, OK, SILENT, SILENT)
    assert (ear.heard, ear.health.bad_sensors) == ([], [])
    ear.take(SILENT)
    assert ear.heard == [(Severity.ERROR, "Range a: no answer")]
    ear.take(*[SILENT] * 20, OK, OK, SILENT, OK, OK)
    assert (len(ear.heard), ear.health.bad_sensors) == (1, ["a"])
    ear.take(OK)
    assert ear.heard[1:] == [(Severity.INFO, "Range a: good again")]
    assert ear.health.bad_sensors == []


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
    ear = Ear("a")
    ear.take(status, status, status, error=error)
    assert ear.heard == [(Severity.ERROR, text)]


@pytest.mark.parametrize("status", [status for status in Status if not status.is_fault])
def test_what_the_scene_does_is_no_fault(status: Status) -> None:
    ear = Ear("a")
    ear.take(*[status] * 10)
    assert ear.health.bad_sensors == []


def test_a_sensor_that_never_worked_is_reported_and_all_good_is_not() -> None:
    ear = Ear("a", "b")
    ear.take(SILENT, SILENT, SILENT)
    ear.take(OK, OK, OK, sensor="b")
    assert [text for _, text in ear.heard] == ["Range a: no answer"]
    ear.take(OK, OK, OK)
    assert [text for _, text in ear.heard][1:] == ["Range a: good again"]


def test_a_condition_is_reported_when_it_comes_and_when_it_goes() -> None:
    ear = Ear("a")
    for _ in range(3):
        ear.health.set("temperature", "no temperature", "temperature is back")
    for _ in range(3):
        ear.health.set("temperature", None, "temperature is back")
    assert ear.heard == [(Severity.WARNING, "no temperature"), (Severity.INFO, "temperature is back")]


def test_severities_are_those_of_mavlink() -> None:
    for severity in Severity:
        assert severity == getattr(common, f"MAV_SEVERITY_{severity.name}")


def test_what_is_wrong_now_can_be_asked_for() -> None:
    ear = Ear("a", "b", "c")
    ear.take(SILENT, SILENT, SILENT)
    ear.take(SILENT, SILENT, SILENT, OK, OK, OK, sensor="b")
    ear.health.set("bus", "bus is locked up", "", Severity.ERROR)
    ear.health.set("temperature", "gone", "back")
    ear.health.set("temperature", None, "back")
    assert ear.health.faults() == [(Severity.ERROR, "Range a: no answer"), (Severity.ERROR, "bus is locked up")]


@pytest.mark.parametrize("pattern", [(OK, SILENT), (SILENT, SILENT, OK), (SILENT, OK, OK, SILENT)])
def test_a_sensor_that_fails_every_other_time_is_bad(pattern: tuple[Status, ...]) -> None:
    """No three are alike in a row: it is reported once, and it is not good in between."""
    ear = Ear("a")
    ear.take(*pattern * 50)
    assert ear.heard == [(Severity.ERROR, "Range a: no answer")]
    assert ear.health.complete


def test_a_sensor_that_comes_and_goes_is_reported_less_and_less() -> None:
    ear = Ear("a")
    ear.take(*([SILENT] * 3 + [OK] * 4) * 200)
    assert len(ear.heard) <= 4
    ear.take(*[OK] * 200)
    assert ear.heard[-1] == (Severity.INFO, "Range a: good again")
    count = len(ear.heard)
    ear.take(*[SILENT] * 3, *[OK] * 3)
    assert len(ear.heard) == count + 2
