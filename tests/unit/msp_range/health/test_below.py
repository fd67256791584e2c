"""What is below single sensors, as the pilot reads it."""

from msp_range.health import ObservationsBelow
from msp_range.pilot_texts import Severity


def test_what_comes_and_goes_below_a_sensor_is_reported_once_and_is_no_fault() -> None:
    reports: list[tuple[Severity, str]] = []
    below = ObservationsBelow(lambda severity, text: reports.append((severity, text)))
    for object_m in (None, 0.52, 0.55, None, None):
        below.update("a", object_m, sees_ground=object_m is None)
    assert reports == [
        (Severity.WARNING, "Range a: object below, 0.5 m high"),
        (Severity.INFO, "Range a: ground below"),
    ]


def test_a_hole_is_no_object_and_an_autopilot_that_comes_gets_all_that_is_there() -> None:
    below = ObservationsBelow(lambda severity, text: None)
    below.update("a", 0.5)
    below.update("b", -1.25)
    below.update("c", 0.3)
    below.update("c", None)
    assert below.texts() == [
        (Severity.WARNING, "Range a: object below, 0.5 m high"),
        (Severity.WARNING, "Range b: hole below, 1.2 m deep"),
    ]


def test_a_hole_that_a_sensor_without_an_echo_no_longer_sees_is_no_ground() -> None:
    reports: list[str] = []
    below = ObservationsBelow(lambda severity, text: reports.append(text))
    for object_m in (-0.8, None):
        below.update("a", object_m)
    assert reports == ["Range a: hole below, 0.8 m deep", "Range a: hole not seen now"]


def test_a_hole_that_a_lost_byte_of_the_others_would_make_as_well_is_reported_as_doubt() -> None:
    below = ObservationsBelow(lambda severity, text: None)
    below.update("front_left", -2.54, is_ground_in_doubt=True)
    below.update("b", 0.5, is_ground_in_doubt=True)
    assert below.texts() == [
        (Severity.WARNING, "Range front_left 2.5 m longer: garbled?"),
        (Severity.WARNING, "Range b: object below, 0.5 m high"),
    ]
