"""The temperature sources of an airframe file, with the accuracy of each.

They are sections of the airframe file; `error_std_c` of each source is the standard deviation of the air temperature
along the beam right after a value of the source. An error of one degree is 0.18 % of the range, so a source that is
warmer than the air (the barometer's chip often by 20 to 30 C) needs its bias stated, or should be left out.
`msp_range.correction.air_temperature` uses the values.
"""

import math
from typing import Annotated, Literal, NamedTuple

from pydantic import Field, model_validator

from msp_range.acoustics.air import FIXED, Air
from msp_range.yaml_file import Section

COLDEST_C, HOTTEST_C = -40.0, 60.0
"""Values outside these limits are rejected: the sensor does not work in such air [deg C]."""
FIXED_STD_C = 12.0
"""Default standard deviation of the air temperature about the airframe file's constant [deg C]. Over a year in a
temperate climate it is 8 to 10 about the mean, and the mean is a guess. With more, distances without a thermometer
state a larger variance."""
THERMOMETER_STD_C = 1.0
"""Standard deviation of a thermometer's error on a vehicle [deg C]: 0.2 (SHT4x) to 0.5 (DS18B20, BME280, TMP102) by the
data sheets, and 0.5 to 1.5 from sun and warm parts near it. It determines the stated variance of vehicles with a
thermometer file or hygrometer."""
AIRSPEED_STD_C = 2.0
"""The same for an airspeed sensor's temperature [deg C]: a chip (1.5 for an MS4525, data sheet) inside the vehicle, in
a tube of outside air."""
DIE_STD_C = 1.5
"""Standard deviation of a barometer's chip temperature about its true value [deg C]: data sheets of MS5611, BMP388,
DPS310."""
DIE_WARMER_STD_C = 15.0
"""Standard deviation for the difference between a barometer's chip and the air if no bias is stated [deg C]: 5 to 30 on
flight controllers in the sun or in a box; 95 % of a normal distribution lie within 29."""
BIAS_SHARE = 1 / 4
"""Standard deviation of a stated bias as a share of it. The bias varies with sun, wind and load: 15 C of a barometer
measured on the ground may be 8 to 22 in flight. With less, a stated bias is trusted more."""
GRADIENT_STD_C = 1.0
"""Standard deviation of the difference between the mean along the beam and the air at the vehicle [deg C]. In the
logarithmic profile of the surface layer it is the temperature scale divided by von Karman's constant at any height: 0.5
to 2 over ground in the sun, and the negative over snow or on a clear night."""


class MavlinkField(NamedTuple):
    """A field of a MAVLink message that has a temperature."""

    c_per_unit: float
    """Degrees Celsius per unit."""
    std_c: float
    """Standard deviation of its error [deg C]."""
    is_die: bool = False
    """Whether it is that of a barometer's chip."""
    absent_c: float | None = None
    """Temperatures that autopilots without such a sensor send [deg C]."""


MAVLINK_FIELDS: dict[tuple[str, str], MavlinkField] = {
    **{
        (message, field): known
        for message in ("SCALED_PRESSURE", "SCALED_PRESSURE2", "SCALED_PRESSURE3")
        for field, known in (
            ("temperature", MavlinkField(0.01, DIE_STD_C, is_die=True)),
            ("temperature_press_diff", MavlinkField(0.01, AIRSPEED_STD_C, absent_c=0.0)),
        )
    },
    ("HYGROMETER_SENSOR", "temperature"): MavlinkField(0.01, THERMOMETER_STD_C),
    ("HIGHRES_IMU", "temperature"): MavlinkField(1.0, DIE_STD_C, is_die=True, absent_c=15.0),
}
"""Known fields of messages. SCALED_IMU and RAW_IMU have the temperature of the gyro's chip and are left out."""


class SourceLimits(Section):
    """Keys that all kinds of sources have."""

    bias_c: float = Field(0.0, ge=-60, le=60)
    """how much warmer than the air the source reads [deg C]; subtracted"""
    std_c: float | None = Field(None, gt=0, le=60)
    """standard deviation of its remaining error [deg C]; default: by its kind, plus a quarter of bias_c"""
    max_age_s: float = Field(10.0, gt=0, le=3600)
    """age [s] beyond which the next source is used, or else this value with a growing standard deviation"""
    max_rate_c_per_s: float = Field(2.0, gt=0, le=100)
    """faster changes have to be confirmed [deg C/s]; default: a thermometer of 12 s that passes a step of 25 deg C"""

    def _error_std_c(self, own_c: float, unstated_bias_c: float) -> float:
        if self.std_c is not None:
            return math.hypot(self.std_c, GRADIENT_STD_C)
        return math.hypot(own_c, abs(self.bias_c) * BIAS_SHARE if self.bias_c else unstated_bias_c, GRADIENT_STD_C)


class FileSource(SourceLimits):
    """A hwmon or iio file that contains a number."""

    source: Literal["file"]
    """the word file"""
    path: str
    """file, with * where a number varies from boot to boot: /sys/bus/i2c/devices/1-0044/hwmon/hwmon*/temp1_input"""
    scale: float = Field(0.001, gt=0)
    """degrees Celsius per unit; hwmon temp1_input and iio in_temp_input are in thousandths"""
    period_s: float = Field(1.0, gt=0, le=60)
    """time between two reads of the file [s]"""

    @model_validator(mode="after")
    def _read_in_time(self) -> "FileSource":
        if self.max_age_s <= self.period_s:
            raise ValueError(f"max_age_s: found {self.max_age_s:g}; expected more than period_s, {self.period_s:g}")
        return self

    @property
    def name(self) -> str:
        """Its name in recordings and messages."""
        return self.path

    @property
    def error_std_c(self) -> float:
        """Standard deviation of the air temperature for a new value of this source [deg C]."""
        return self._error_std_c(THERMOMETER_STD_C, 0.0)


class MavlinkSource(SourceLimits):
    """A field of a message that the autopilot sends."""

    source: Literal["mavlink"]
    """the word mavlink"""
    message: str
    """message name, e.g. SCALED_PRESSURE"""
    field: str = "temperature"
    """field of that message, e.g. temperature_press_diff for an airspeed sensor in outside air"""

    @model_validator(mode="after")
    def _known(self) -> "MavlinkSource":
        if (self.message, self.field) not in MAVLINK_FIELDS:
            known = ", ".join(f"{message}.{field}" for message, field in MAVLINK_FIELDS)
            raise ValueError(f"no air temperature in {self.message}.{self.field}; known: {known}")
        return self

    @property
    def name(self) -> str:
        """Its name in recordings and messages."""
        return f"{self.message}.{self.field}"

    @property
    def error_std_c(self) -> float:
        """Standard deviation of the air temperature for a new value of this source [deg C]."""
        kind = MAVLINK_FIELDS[self.message, self.field]
        return self._error_std_c(kind.std_c, DIE_WARMER_STD_C if kind.is_die else 0.0)


class TemperatureParameters(Section):
    """Sources of the air temperature."""

    fixed_c: float = Field(20.0, ge=COLDEST_C, le=HOTTEST_C)
    """used while no source has a value [deg C]"""
    fixed_std_c: float = Field(FIXED_STD_C, ge=0, le=60)
    """standard deviation of the air temperature about fixed_c, unknown humidity included [deg C]; smaller if somebody
    sets fixed_c before each flight"""
    sources: tuple[Annotated[FileSource | MavlinkSource, Field(discriminator="source")], ...] = ()
    """sources, the most trusted first"""

    @property
    def fixed_air(self) -> Air:
        """The air while no source has a value."""
        return Air(self.fixed_c, self.fixed_std_c, FIXED)
