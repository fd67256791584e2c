"""The temperature sources of an airframe file, and how far each is to be trusted.

Sections of the airframe file enter, validated; `error_std_c` of each source leaves: the standard deviation of the
air's temperature along the beam when the source has just reported. A wrong temperature costs 0.18 % of range a degree,
so a source that is known to be warm (the barometer's die is often 20 to 30 C above the air) needs its bias stated or
should be left out. What becomes of the values is in `msp_range.correction.air_temperature`.
"""

import math
from typing import Annotated, Literal, NamedTuple

from pydantic import Field, model_validator

from msp_range.yaml_file import Section

COLDEST_C, HOTTEST_C = -40.0, 60.0
"""Air temperatures outside of these are not measurements of air in which this sensor works [deg C]."""
FIXED_STD_C = 12.0
"""Standard deviation of the air's temperature about the airframe file's constant where nothing is stated [deg C]. A
year of days and nights of a temperate climate scatters by 8 to 10 about its mean, and the mean is a guess. Larger:
distances without a thermometer state a larger variance."""
THERMOMETER_STD_C = 1.0
"""Of a thermometer's error on a vehicle [deg C]: 0.2 (SHT4x) to 0.5 (DS18B20, BME280, TMP102) by the data sheets, and
what sun and warm parts near it add, 0.5 to 1.5. Moves the stated variance of vehicles with a thermometer file or a
hygrometer."""
AIRSPEED_STD_C = 2.0
"""The same of an airspeed sensor's temperature [deg C]: a die (1.5 for an MS4525, by its data sheet) in a tube of
outside air, inside of the vehicle."""
DIE_STD_C = 1.5
"""The same of a barometer's die about its own temperature [deg C]: MS5611, BMP388 and DPS310 by their data sheets."""
DIE_WARMER_STD_C = 15.0
"""What a barometer's die is warmer than the air where no bias is stated, as a standard deviation [deg C]: 5 to 30 on
flight controllers in the sun or in a box, and 95 % of a normal distribution lie within 29."""
BIAS_SHARE = 1 / 4
"""Standard deviation of a stated bias as a share of it. What warms a source varies with sun, wind and load: 15 C of a
barometer measured on the ground are 8 to 22 in flight. Smaller: a measured bias is trusted more."""
GRADIENT_STD_C = 1.0
"""Standard deviation of the mean along the beam about the air at the vehicle [deg C]. In the logarithmic profile of the
surface layer that difference is the temperature scale over von Karman's constant, at every height: 0.5 to 2 over ground
in the sun, and as much below zero over snow or on a clear night."""


class MavlinkField(NamedTuple):
    """A field of a MAVLink message: degrees Celsius per unit, and the standard deviation of its error [deg C]."""

    c_per_unit: float
    std_c: float
    is_die: bool = False


_BAROMETER = MavlinkField(0.01, DIE_STD_C, is_die=True)
_AIRSPEED = MavlinkField(0.01, AIRSPEED_STD_C)
MAVLINK_FIELDS: dict[tuple[str, str], MavlinkField] = {
    ("SCALED_PRESSURE", "temperature"): _BAROMETER,
    ("SCALED_PRESSURE", "temperature_press_diff"): _AIRSPEED,
    ("SCALED_PRESSURE2", "temperature"): _BAROMETER,
    ("SCALED_PRESSURE2", "temperature_press_diff"): _AIRSPEED,
    ("SCALED_PRESSURE3", "temperature"): _BAROMETER,
    ("SCALED_PRESSURE3", "temperature_press_diff"): _AIRSPEED,
    ("HYGROMETER_SENSOR", "temperature"): MavlinkField(0.01, THERMOMETER_STD_C),
    ("HIGHRES_IMU", "temperature"): MavlinkField(1.0, DIE_STD_C, is_die=True),
}
"""Message and field -> what it is. SCALED_IMU and RAW_IMU carry the gyro's die and are left out."""


class SourceLimits(Section):
    """What all kinds of sources have."""

    bias_c: float = Field(0.0, ge=-60, le=60)
    """how much warmer than the air the source reads [deg C]; subtracted"""
    std_c: float | None = Field(None, gt=0, le=60)
    """standard deviation of its error after that [deg C]; left out: by its kind, and a quarter of bias_c"""
    max_age_s: float = Field(10.0, gt=0, le=3600)
    """an older value is not new: the next source is used, or the value with a deviation that grows [s]"""
    max_rate_c_per_s: float = Field(2.0, gt=0, le=100)
    """a faster change has to be confirmed [deg C/s]; 2 is a thermometer of 12 s that is carried through 25 deg C"""

    def _error_std_c(self, own_c: float, unstated_bias_c: float) -> float:
        if self.std_c is not None:
            return math.hypot(self.std_c, GRADIENT_STD_C)
        return math.hypot(own_c, abs(self.bias_c) * BIAS_SHARE if self.bias_c else unstated_bias_c, GRADIENT_STD_C)


class FileSource(SourceLimits):
    """A hwmon or iio file that holds a number."""

    source: Literal["file"]
    """the word file"""
    path: str
    """file, with * where a number varies from boot to boot: /sys/bus/i2c/devices/1-0044/hwmon/hwmon*/temp1_input"""
    scale: float = Field(0.001, gt=0)
    """degrees Celsius a unit; hwmon temp1_input and iio in_temp_input count thousandths"""
    period_s: float = Field(1.0, gt=0, le=60)
    """time between two reads of the file [s]"""

    @model_validator(mode="after")
    def _read_in_time(self) -> "FileSource":
        if self.max_age_s <= self.period_s:
            raise ValueError(f"max_age_s: found {self.max_age_s:g}; expected more than period_s, {self.period_s:g}")
        return self

    @property
    def name(self) -> str:
        """What it is called in recordings and messages."""
        return self.path

    @property
    def error_std_c(self) -> float:
        """Standard deviation of the air's temperature by a new value of this source [deg C]."""
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
        """What it is called in recordings and messages."""
        return f"{self.message}.{self.field}"

    @property
    def error_std_c(self) -> float:
        """Standard deviation of the air's temperature by a new value of this source [deg C]."""
        kind = MAVLINK_FIELDS[self.message, self.field]
        return self._error_std_c(kind.std_c, DIE_WARMER_STD_C if kind.is_die else 0.0)


class TemperatureParameters(Section):
    """Where the air temperature comes from."""

    fixed_c: float = Field(20.0, ge=COLDEST_C, le=HOTTEST_C)
    """used where no source has a value [deg C]"""
    fixed_std_c: float = Field(FIXED_STD_C, ge=0, le=60)
    """standard deviation of the air's temperature about fixed_c [deg C]; smaller where somebody looks at a thermometer
    before the flight and states what it shows"""
    sources: tuple[Annotated[FileSource | MavlinkSource, Field(discriminator="source")], ...] = ()
    """sources in the order of trust"""
