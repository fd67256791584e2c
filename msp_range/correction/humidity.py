"""The humidity of the air for the speed of sound, as a hygrometer measures it, or the uncertainty of not knowing it.

HYGROMETER_SENSOR messages give the humidity, with which an `Air` is corrected. Without a hygrometer the speed of sound
is that of dry air (the report's eq 6).
"""

import math
from typing import Any

from msp_range.acoustics.air import FIXED, Air, sonic_temperature_c, vapour_fraction
from msp_range.correction.temperature import COLDEST_C, HOTTEST_C
from msp_range.numbers import Numbers

HYGROMETER = "HYGROMETER_SENSOR"
MAX_AGE_S = 600.0
"""Time for which a measured humidity is used [s]: the vapour in the air changes with the weather, hardly along a
flight. Longer uses that of another air mass, shorter loses it when the link is interrupted."""
MOISTEST_C = 30.0
"""Dew point that open air does not exceed [deg C]; the record is 35. Larger states a larger variance for air that is
warmer than this."""
UNKNOWN_SHARE = 1 / math.sqrt(3)
"""Standard deviation of an unknown humidity's effect as a share of saturated air's: 50 +- 29 % (0 to 100, evenly
distributed), of which the dry formula leaves the root mean square, 58 %. In degrees, 0.3 at 0 C, 1.3 at 20 C and 2.3 at
30 C."""
MEASURED_SHARE = 0.1
"""Standard deviation of a measured humidity's effect as a share of it: 3 % of relative humidity by data sheets, 6 % of
vapour per degree of the hygrometer's own error, and 8 % for pressure 700 m above the sea. Larger states a larger
variance in humid air."""
WHOLE_PERCENT = 100
"""HYGROMETER_SENSOR has hundredths of a per cent (ArduPilot), but PX4 sends whole per cents: numbers up to this are
taken as whole per cents. Air of less than 1 % does not occur."""


def relative_humidity_percent(sent: Numbers) -> Numbers:
    """The relative humidity of HYGROMETER_SENSOR's field [%], any shape; see `WHOLE_PERCENT`.

    Examples
    --------
    >>> relative_humidity_percent(50), relative_humidity_percent(5000)
    (50.0, 50.0)
    """
    percent: Numbers = sent * 0.01 ** (sent > WHOLE_PERCENT)
    return percent


class Humidity:
    """The newest humidity that the autopilot sends, of whichever hygrometer: the vapour is the same at each."""

    def __init__(self) -> None:
        self._vapour = 0.0
        self._received_s = -math.inf

    def on_message(self, now_s: float, message: Any) -> None:
        """Update with a HYGROMETER_SENSOR message."""
        temperature_c = 0.01 * message.temperature
        percent = relative_humidity_percent(message.humidity)
        if COLDEST_C <= temperature_c <= HOTTEST_C and 0.0 < percent <= 100.0:
            # A hygrometer that is warmer than the air shows less, and has the air's mole fraction of vapour.
            self._vapour = vapour_fraction(temperature_c, percent)
            self._received_s = now_s

    def applied(self, now_s: float, air: Air) -> Air:
        """The air with its humidity, and with what that leaves uncertain.

        The deviation of a fixed temperature is stated by the airframe file, unknown humidity included.
        """
        if now_s - self._received_s <= MAX_AGE_S:
            percent = min(100.0 * self._vapour / vapour_fraction(air.temperature_c, 100.0), 100.0)
            air = air._replace(humidity_percent=percent)
            effect_c = MEASURED_SHARE * (air.sonic_c - air.temperature_c)
        elif air.source == FIXED:
            return air
        else:
            moist_c = min(air.temperature_c, MOISTEST_C)
            effect_c = UNKNOWN_SHARE * (sonic_temperature_c(moist_c, 100.0) - moist_c)
        return air._replace(std_c=math.hypot(air.std_c, effect_c))
