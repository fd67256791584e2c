"""Sources of the air temperature: what is believed, for how long, and how far it is to be trusted."""

import math
from pathlib import Path
from typing import Any

import pytest
from pydantic import TypeAdapter, ValidationError
from pymavlink.dialects.v20 import common

from msp_range.acoustics.air import FIXED, HELD, Air
from msp_range.check import describe_air
from msp_range.correction.air_temperature import GRACE_S, AirTemperature
from msp_range.correction.temperature import (
    AIRSPEED_STD_C,
    BIAS_SHARE,
    DIE_STD_C,
    DIE_WARMER_STD_C,
    GRADIENT_STD_C,
    MAVLINK_FIELDS,
    THERMOMETER_STD_C,
    TemperatureParameters,
)
from msp_range.correction.temperature_track import AGE_C_PER_S
from msp_range.correction.thermometer import LoopReader

FIXED_C = 18.0
MAXIMUM_M = 7.65


def parameters(*sources: dict[str, Any], **fixed: float) -> TemperatureParameters:
    return TypeAdapter(TemperatureParameters).validate_python({"fixed_c": FIXED_C, "sources": sources} | fixed)


def air(*sources: dict[str, Any], **fixed: float) -> AirTemperature:
    return AirTemperature(parameters(*sources, **fixed), 0.0, LoopReader(), MAXIMUM_M)


def reported(source: AirTemperature, now_s: float) -> list[str]:
    """What the pilot should know now."""
    source.now(now_s)
    return [each.text for each in source.conditions(now_s) if each.text is not None]


class File:
    """A hwmon file, and an air temperature that reads it."""

    def __init__(self, folder: Path, **limits: float) -> None:
        self.path = folder / "temp1_input"
        self.air = air({"source": "file", "path": str(self.path), **limits})

    def holds(self, milli_c: object) -> "File":
        self.path.write_text(f"{milli_c}\n")
        return self

    def now_c(self, now_s: float) -> float:
        return self.air.now(now_s).temperature_c


def test_without_sources_the_fixed_temperature_counts_with_its_deviation() -> None:
    assert air().now(100.0) == Air(FIXED_C, 12.0, FIXED)
    assert air(fixed_std_c=2.5).now(100.0) == Air(FIXED_C, 2.5, FIXED)


def test_a_vehicle_without_a_thermometer_is_reported_with_what_that_costs() -> None:
    """Air that is 1.96 times 12 C colder, 7.65 m away; nothing where the pilot states the temperature to 3 C."""
    coldest_c = FIXED_C - 1.96 * 12
    off_cm = 765 * (math.sqrt((FIXED_C + 273.15) / (coldest_c + 273.15)) - 1)
    assert reported(air(), 0.0) == [f"Range: no thermometer, {off_cm:.0f} cm off at {coldest_c:.0f} C, 7.65 m"]
    assert reported(air(), 1000.0) == reported(air(), 0.0)
    remedy = next(each.remedy for each in air().conditions(0.0) if each.text is not None)
    assert "fixed_c to the air's temperature of today and fixed_std_c to 3" in remedy
    assert reported(air(fixed_std_c=3.0), 0.0) == []


def test_a_person_reads_what_each_source_is_worth() -> None:
    lines = describe_air(parameters({"source": "mavlink", "message": "SCALED_PRESSURE", "std_c": 4.0}), MAXIMUM_M)
    assert len(lines) == 4
    assert "SCALED_PRESSURE.temperature +-4.12 C: up to 11 cm off at 7.65 m" in lines[1]
    assert "humidity, unless the autopilot sends HYGROMETER_SENSOR: also +-1.09 C" in lines[2]
    assert "fixed_c 18 C +-12 C: up to 33 cm off at 7.65 m; right for air of -6 to 42 C" in lines[3]


def test_a_file_counts_thousandths_of_a_degree(tmp_path: Path) -> None:
    file = File(tmp_path).holds(21875)
    assert file.now_c(0.0) == 21.875
    assert file.air.now(0.0).source == str(file.path)


def test_scale_and_bias_of_a_file(tmp_path: Path) -> None:
    assert File(tmp_path, scale=0.1, bias_c=2.5).holds(-31).now_c(0.0) == pytest.approx(-3.1 - 2.5)


def source(message: str, field: str = "temperature", **limits: float) -> dict[str, Any]:
    return {"source": "mavlink", "message": message, "field": field, **limits}


FILE = {"source": "file", "path": "temp1_input"}


@pytest.mark.parametrize(
    ("named", "own_c"),
    [
        (FILE, [THERMOMETER_STD_C]),
        (FILE | {"bias_c": -6.0}, [THERMOMETER_STD_C, 6.0 * BIAS_SHARE]),
        (FILE | {"std_c": 0.2, "bias_c": -6.0}, [0.2]),
        (source("HYGROMETER_SENSOR"), [THERMOMETER_STD_C]),
        (source("SCALED_PRESSURE", "temperature_press_diff"), [AIRSPEED_STD_C]),
        (source("SCALED_PRESSURE"), [DIE_STD_C, DIE_WARMER_STD_C]),
        (source("HIGHRES_IMU"), [DIE_STD_C, DIE_WARMER_STD_C]),
        (source("SCALED_PRESSURE", bias_c=15.0), [DIE_STD_C, 15.0 * BIAS_SHARE]),
        (source("SCALED_PRESSURE", bias_c=15.0, std_c=3.0), [3.0]),
    ],
)
def test_the_deviation_of_each_source(named: dict[str, Any], own_c: list[float]) -> None:
    """Its own, that of a bias, and the air over the ground, which no thermometer on a vehicle knows."""
    (of_source,) = parameters(named).sources
    assert of_source.error_std_c == pytest.approx(math.hypot(*own_c, GRADIENT_STD_C))


@pytest.mark.parametrize("content", [None, "", "warm", "nan"])
def test_a_value_that_gets_no_younger_is_held_with_a_growing_deviation(tmp_path: Path, content: str | None) -> None:
    """Old air is a better guess than the airframe's constant for ten minutes; but it is reported."""
    file = File(tmp_path, max_age_s=10.0).holds(25000)
    fresh = file.air.now(0.0)
    if content is None:
        file.path.unlink()
    else:
        file.holds(content)
    seen = {time_s: file.air.now(time_s) for time_s in (5.0, 10.0, 10.1, 300.0, 590.0, 600.0)}
    assert [each.source == HELD for each in seen.values()] == [False, False, True, True, True, False]
    for time_s in (5.0, 10.0, 10.1, 300.0, 590.0):
        assert seen[time_s][:2] == pytest.approx((25.0, math.hypot(fresh.std_c, AGE_C_PER_S * time_s)))
    assert seen[600.0] == Air(FIXED_C, 12.0, FIXED)


def test_a_source_that_is_silent_is_reported_and_that_it_is_back(tmp_path: Path) -> None:
    file = File(tmp_path, max_age_s=10.0).holds(25000)
    assert reported(file.air, 0.0) == []
    file.path.unlink()
    assert reported(file.air, 10.0) == []
    assert reported(file.air, 10.0 + GRACE_S) == []
    assert reported(file.air, 10.1 + GRACE_S) == ["Range: no air temperature, using 25 C"]
    file.holds(25500)
    assert reported(file.air, 17.0) == []
    assert file.now_c(17.0) == 25.5


def test_before_there_was_a_value_the_grace_counts_from_the_start(tmp_path: Path) -> None:
    file = File(tmp_path)
    assert file.now_c(0.0) == FIXED_C
    assert reported(file.air, GRACE_S) == []
    assert reported(file.air, GRACE_S + 0.1) == ["Range: no air temperature, using 18 C"]


@pytest.mark.parametrize(("milli_c", "believed"), [(-40000, True), (-40001, False), (60000, True), (60001, False)])
def test_what_is_no_air_to_fly_in_is_not_believed(tmp_path: Path, milli_c: int, believed: bool) -> None:
    assert File(tmp_path).holds(milli_c).now_c(0.0) == (milli_c / 1000 if believed else FIXED_C)


def test_the_first_source_that_has_a_value_counts(tmp_path: Path) -> None:
    files = [tmp_path / "first", tmp_path / "second"]
    both = air(*({"source": "file", "path": str(path), "max_age_s": 1.5} for path in files))
    files[1].write_text("10000")
    assert both.now(0.0)[::2] == (10.0, str(files[1]))
    files[0].write_text("12000")
    assert both.now(1.0)[::2] == (12.0, str(files[0]))
    files[0].unlink()
    assert both.now(3.0)[::2] == (10.0, str(files[1]))
    files[1].unlink()
    # Of two old values the one that is known better now.
    assert both.now(60.0)[::2] == (10.0, HELD)


def test_a_file_that_is_read_less_often_than_its_values_hold_is_refused() -> None:
    with pytest.raises(ValidationError, match="max_age_s: found 10; expected more than period_s, 20"):
        parameters(FILE | {"period_s": 20.0})


def blank(name: str, **fields: Any) -> Any:
    """A MAVLink message with zeros in all other fields."""
    kind = getattr(common, f"MAVLink_{name.lower()}_message")
    return kind(**(dict.fromkeys(kind.fieldnames, 0) | fields))


@pytest.mark.parametrize(("message", "field"), MAVLINK_FIELDS)
def test_every_field_is_one_that_its_message_has_and_in_its_unit(message: str, field: str) -> None:
    kind = getattr(common, f"MAVLink_{message.lower()}_message")
    c_per_unit = MAVLINK_FIELDS[message, field].c_per_unit
    assert (kind.fieldunits_by_name[field], c_per_unit) in [("cdegC", 0.01), ("degC", 1.0)]
    named = air(source(message, field, bias_c=10.0))
    named.on_message(0.0, blank(message, **{field: round(31.0 / c_per_unit)}))
    assert named.now(0.0).temperature_c == pytest.approx(21.0)
    assert named.now(0.0).source == f"{message}.{field}"


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
    named = air(source(message, field))
    named.on_message(0.0, blank(message, **{field: nothing}))
    assert named.now(0.0).temperature_c == FIXED_C
    named.on_message(0.0, blank(message, **{field: something}))
    assert named.now(0.0).temperature_c == pytest.approx(something * MAVLINK_FIELDS[message, field].c_per_unit)


def test_zero_and_fifteen_degrees_are_temperatures_elsewhere() -> None:
    named = air(source("HYGROMETER_SENSOR"))
    for time_s, hundredths in [(0.0, 1500), (60.0, 0)]:
        named.on_message(time_s, blank("HYGROMETER_SENSOR", temperature=hundredths))
        assert named.now(time_s).temperature_c == hundredths / 100


def test_other_messages_are_passed_over_and_a_silent_autopilots_value_grows_old() -> None:
    named = air(source("SCALED_PRESSURE", max_age_s=4.0, std_c=1.0))
    named.on_message(0.0, blank("SCALED_PRESSURE", temperature=2500))
    named.on_message(3.0, blank("SCALED_PRESSURE2", temperature=2600))
    named.on_message(3.0, blank("HEARTBEAT"))
    assert {named.now(time_s).temperature_c for time_s in (3.0, 4.0, 4.1)} == {25.0}
    assert [named.now(time_s).source == HELD for time_s in (3.0, 4.0, 4.1)] == [False, False, True]


@pytest.mark.parametrize("message", ["SCALED_IMU", "RAW_IMU", "SCALED_PRESURE"])
def test_a_message_without_an_air_temperature_is_refused(message: str) -> None:
    with pytest.raises(ValidationError, match=rf"no air temperature in {message}\.temperature"):
        air(source(message))
