"""Sources of the air temperature: what is believed, for how long, and what counts as no source at all."""

from pathlib import Path
from typing import Any

import pytest
from pydantic import TypeAdapter, ValidationError
from pymavlink.dialects.v20 import common

from msp_range.correction.temperature import GRACE_S, MAVLINK_FIELDS, AirTemperature, TemperatureParameters

FIXED_C = 18.0


def air(*sources: dict[str, Any]) -> AirTemperature:
    parameters = TypeAdapter(TemperatureParameters).validate_python({"fixed_c": FIXED_C, "sources": sources})
    return AirTemperature(parameters, 0.0)


class File:
    """A hwmon file, and an air temperature that reads it."""

    def __init__(self, folder: Path, **limits: float) -> None:
        self.path = folder / "temp1_input"
        self.air = air({"source": "file", "path": str(self.path), **limits})

    def says(self, milli_c: object) -> "File":
        self.path.write_text(f"{milli_c}\n")
        return self


def test_without_sources_the_fixed_temperature_counts_and_nothing_is_missed() -> None:
    fixed = air()
    assert fixed.now_c(100.0) == FIXED_C
    assert fixed.source == "fixed"
    assert not fixed.fallen_back(100.0)


def test_a_file_counts_thousandths_of_a_degree(tmp_path: Path) -> None:
    file = File(tmp_path).says(21875)
    assert file.air.now_c(0.0) == 21.875
    assert file.air.source == str(file.path)


def test_scale_and_bias_of_a_file(tmp_path: Path) -> None:
    assert File(tmp_path, scale=0.1, bias_c=2.5).says(-31).air.now_c(0.0) == pytest.approx(-3.1 - 2.5)


def test_a_file_is_read_once_a_period(tmp_path: Path) -> None:
    file = File(tmp_path, period_s=2.0).says(20000)
    assert file.air.now_c(0.0) == 20.0
    file.says(21000)
    assert file.air.now_c(1.9) == 20.0
    assert file.air.now_c(2.0) == 21.0


@pytest.mark.parametrize("content", [None, "", "warm", "nan"])
def test_a_file_that_says_nothing_any_more_grows_stale(tmp_path: Path, content: str | None) -> None:
    file = File(tmp_path, max_age_s=10.0).says(25000)
    file.air.now_c(0.0)
    if content is None:
        file.path.unlink()
    else:
        file.says(content)
    assert [file.air.now_c(time_s) for time_s in (5.0, 10.0, 10.1)] == [25.0, 25.0, FIXED_C]
    assert file.air.source == "fixed"
    assert not file.air.fallen_back(10.0 + GRACE_S)
    assert file.air.fallen_back(10.1 + GRACE_S)
    file.says(25500)
    assert file.air.now_c(12.0) == 25.5
    assert not file.air.fallen_back(12.0)


def test_before_there_was_a_value_the_grace_counts_from_the_start(tmp_path: Path) -> None:
    file = File(tmp_path)
    assert file.air.now_c(0.0) == FIXED_C
    assert not file.air.fallen_back(GRACE_S)
    assert file.air.fallen_back(GRACE_S + 0.1)


@pytest.mark.parametrize(("after_s", "jump_c", "believed"), [(1.0, 1.1, True), (1.0, 1.3, False), (4.0, -4.1, True)])
def test_a_change_that_is_too_fast_is_not_the_air(
    tmp_path: Path, after_s: float, jump_c: float, believed: bool
) -> None:
    """At most 1 deg C a second here, and two tenths that a thermometer may flicker."""
    file = File(tmp_path, max_rate_c_per_s=1.0).says(20000)
    file.air.now_c(100.0)
    file.says(round((20.0 + jump_c) * 1000))
    assert file.air.now_c(100.0 + after_s) == pytest.approx(20.0 + (jump_c if believed else 0.0))


def test_a_jump_that_stays_is_believed_when_what_it_left_is_stale(tmp_path: Path) -> None:
    file = File(tmp_path, max_age_s=10.0, max_rate_c_per_s=0.1).says(20000)
    file.air.now_c(100.0)
    file.says(45000)
    assert {file.air.now_c(float(time_s)) for time_s in range(101, 111)} == {20.0}
    assert file.air.now_c(111.0) == 45.0


@pytest.mark.parametrize(("milli_c", "believed"), [(-40000, True), (-40001, False), (60000, True), (60001, False)])
def test_what_is_no_air_to_fly_in_is_not_believed(tmp_path: Path, milli_c: int, believed: bool) -> None:
    assert File(tmp_path).says(milli_c).air.now_c(0.0) == (milli_c / 1000 if believed else FIXED_C)


def test_a_number_that_varies_from_boot_to_boot(tmp_path: Path) -> None:
    air_c = air({"source": "file", "path": str(tmp_path / "hwmon*" / "temp1_input")})
    assert air_c.now_c(0.0) == FIXED_C
    (tmp_path / "hwmon3").mkdir()
    (tmp_path / "hwmon3" / "temp1_input").write_text("15500\n")
    assert air_c.now_c(1.0) == 15.5


def test_the_first_source_that_has_a_value_counts(tmp_path: Path) -> None:
    files = [tmp_path / "first", tmp_path / "second"]
    both = air(*({"source": "file", "path": str(path), "max_age_s": 1.5} for path in files))
    files[1].write_text("10000")
    assert (both.now_c(0.0), both.source) == (10.0, str(files[1]))
    files[0].write_text("12000")
    assert (both.now_c(1.0), both.source) == (12.0, str(files[0]))
    files[0].unlink()
    assert (both.now_c(3.0), both.source) == (10.0, str(files[1]))


def blank(name: str, **fields: Any) -> Any:
    """A MAVLink message with zeros in all other fields."""
    kind = getattr(common, f"MAVLink_{name.lower()}_message")
    return kind(**(dict.fromkeys(kind.fieldnames, 0) | fields))


@pytest.mark.parametrize(("message", "field"), MAVLINK_FIELDS)
def test_every_field_is_one_that_its_message_has_and_in_its_unit(message: str, field: str) -> None:
    kind = getattr(common, f"MAVLink_{message.lower()}_message")
    assert (kind.fieldunits_by_name[field], MAVLINK_FIELDS[message, field]) in [("cdegC", 0.01), ("degC", 1.0)]
    source = air({"source": "mavlink", "message": message, "field": field, "bias_c": 10.0})
    reported = 31.0 / MAVLINK_FIELDS[message, field]
    source.hear(0.0, blank(message, **{field: round(reported)}))
    assert source.now_c(0.0) == pytest.approx(21.0)
    assert source.source == f"{message}.{field}"


@pytest.mark.parametrize(
    ("message", "field", "nothing", "something"),
    [
        ("HIGHRES_IMU", "temperature", 15.0, 15.5),
        ("SCALED_PRESSURE", "temperature_press_diff", 0, 1),
        ("SCALED_PRESSURE2", "temperature_press_diff", 0, 1),
    ],
)
def test_what_autopilots_send_where_they_have_no_such_sensor(
    message: str, field: str, nothing: float, something: float
) -> None:
    source = air({"source": "mavlink", "message": message, "field": field})
    source.hear(0.0, blank(message, **{field: nothing}))
    assert source.now_c(0.0) == FIXED_C
    source.hear(0.0, blank(message, **{field: something}))
    assert source.now_c(0.0) == pytest.approx(something * MAVLINK_FIELDS[message, field])


def test_zero_and_fifteen_degrees_are_temperatures_elsewhere() -> None:
    source = air({"source": "mavlink", "message": "HYGROMETER_SENSOR"})
    for time_s, hundredths in [(0.0, 1500), (60.0, 0)]:
        source.hear(time_s, blank("HYGROMETER_SENSOR", temperature=hundredths))
        assert source.now_c(time_s) == hundredths / 100


def test_other_messages_are_passed_over_and_a_silent_autopilot_grows_stale() -> None:
    source = air({"source": "mavlink", "message": "SCALED_PRESSURE", "max_age_s": 4.0})
    source.hear(0.0, blank("SCALED_PRESSURE", temperature=2500))
    source.hear(3.0, blank("SCALED_PRESSURE2", temperature=2600))
    source.hear(3.0, blank("HEARTBEAT"))
    assert [source.now_c(time_s) for time_s in (3.0, 4.0, 4.1)] == [25.0, 25.0, FIXED_C]


@pytest.mark.parametrize("message", ["SCALED_IMU", "RAW_IMU", "SCALED_PRESURE"])
def test_a_message_without_an_air_temperature_is_refused(message: str) -> None:
    with pytest.raises(ValidationError, match=rf"no air temperature in {message}\.temperature"):
        air({"source": "mavlink", "message": message})
