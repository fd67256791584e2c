"""The humidity of the air: what a hygrometer changes in the speed of sound, and what is uncertain without one."""

import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import common

from msp_range.acoustics.air import FIXED, Air, sonic_temperature_c, speed_of_sound
from msp_range.correction.humidity import MAX_AGE_S, Humidity
from msp_sim.acoustics.atmosphere import Atmosphere
from tests.support.humid_air import speed_of_sound_humid


def hygrometer(percent: float, temperature_c: float = 20.0, number: int = 0) -> Any:
    """The message as ArduPilot sends it: in hundredths."""
    return common.MAVLink_hygrometer_sensor_message(number, round(100 * temperature_c), round(100 * percent))


def measured(message: Any, air: Air, age_s: float = 0.0) -> Air:
    humidity = Humidity()
    humidity.on_message(100.0, message)
    return humidity.applied(100.0 + age_s, air)


@pytest.mark.parametrize("temperature_c", [0.0, 15.0, 30.0])
@pytest.mark.parametrize("percent", [30.0, 100.0])
def test_sound_in_humid_air_is_as_fast_as_cramer_says(temperature_c: float, percent: float) -> None:
    """To 0.01 %, 0.5 mm at 5 m, of the speed in dry air; the difference is up to 0.7 %."""
    faster_by = speed_of_sound(sonic_temperature_c(temperature_c, percent)) / speed_of_sound(temperature_c)
    dry, humid = (speed_of_sound_humid(Atmosphere(temperature_c, each)) for each in (0.0, percent))
    assert faster_by == pytest.approx(humid / dry, abs=1e-4)


def test_units_of_both_autopilots() -> None:
    """Hundredths of a per cent by the message's definition and from ArduPilot; PX4 sends whole per cents."""
    fields = common.MAVLink_hygrometer_sensor_message
    assert (fields.fieldunits_by_name["temperature"], fields.fieldunits_by_name["humidity"]) == ("cdegC", "c%")
    air = Air(20.0, 1.4, "one")
    of_ardupilot = measured(hygrometer(60.0), air)
    of_px4 = measured(common.MAVLink_hygrometer_sensor_message(0, 2000, 60), air)
    assert of_ardupilot.humidity_percent == pytest.approx(60.0)
    assert of_px4 == of_ardupilot


@pytest.mark.parametrize(
    ("temperature", "humidity"), [(2000, 0), (2000, 10100), (2000, 65535), (-24304, 5000), (-32768, 5000), (6001, 5000)]
)
def test_what_is_no_humidity_of_air_is_passed_over(temperature: int, humidity: int) -> None:
    message = common.MAVLink_hygrometer_sensor_message(0, temperature, humidity)
    assert measured(message, Air(20.0, 1.4, "one")).humidity_percent == 0.0


def test_a_hygrometer_that_is_warmer_than_the_air_has_the_same_vapour() -> None:
    """At a dew point of 9.3 C air of 20 C has 50 %, and the hygrometer in the sun at 30 C shows 27.6 %."""
    assert measured(hygrometer(27.6, 30.0), Air(20.0, 1.4, "one")).humidity_percent == pytest.approx(50.0, abs=0.2)
    assert measured(hygrometer(80.0, 30.0), Air(10.0, 1.4, "one")).humidity_percent == 100.0


def test_a_measured_humidity_leaves_a_tenth_of_its_effect() -> None:
    air = measured(hygrometer(100.0, 30.0), Air(30.0, 1.4, "one"))
    assert air.sonic_c == pytest.approx(34.1, abs=0.05)
    assert air.std_c == pytest.approx(math.hypot(1.4, 0.41), abs=0.01)


@pytest.mark.parametrize(("temperature_c", "left_c"), [(0.0, 0.31), (20.0, 1.25), (30.0, 2.35), (45.0, 2.35)])
def test_an_unknown_humidity_leaves_the_root_mean_square_of_dry_to_saturated(
    temperature_c: float, left_c: float
) -> None:
    air = Humidity().applied(0.0, Air(temperature_c, 1.4, "one"))
    assert air.sonic_c == temperature_c
    assert air.std_c == pytest.approx(math.hypot(1.4, left_c), abs=0.01)
    moist_c = min(temperature_c, 30.0)
    effects_c = [sonic_temperature_c(moist_c, 0.1 * each) - moist_c for each in range(1001)]
    assert math.sqrt(sum(each**2 for each in effects_c) / 1001) == pytest.approx(left_c, rel=0.02)


def test_a_fixed_temperature_has_the_deviation_that_is_stated_for_it() -> None:
    assert Humidity().applied(0.0, Air(20.0, 3.0, FIXED)) == Air(20.0, 3.0, FIXED)
    assert measured(hygrometer(50.0), Air(20.0, 3.0, FIXED)).sonic_c == pytest.approx(21.08, abs=0.01)


def test_an_old_humidity_is_no_longer_used() -> None:
    air = Air(20.0, 1.4, "one")
    assert measured(hygrometer(50.0), air, MAX_AGE_S).humidity_percent == pytest.approx(50.0)
    assert measured(hygrometer(50.0), air, MAX_AGE_S + 1.0) == Humidity().applied(0.0, air)
