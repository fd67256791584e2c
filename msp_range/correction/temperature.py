"""Air temperature for the speed of sound: sources in the order of trust, each with an age limit and a plausible rate.

The first source that is fresh and plausible counts; where none is, the airframe's fixed temperature does, and the
health says so. A wrong temperature costs 0.18 % of range a degree, so a source that is known to be warm (the
barometer's die is often 20 to 30 C above the air) needs its bias stated or should be left out.
"""

import glob
from collections.abc import Callable
from contextlib import suppress
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from msp_range.yaml_file import Section

COLDEST_C, HOTTEST_C = -40.0, 60.0
"""Air temperatures outside of these are not measurements of air in which this sensor works [deg C]."""
GRACE_S = 5.0
"""Sources may be silent for this long before the fall-back is worth a word [s]."""

MAVLINK_FIELDS: dict[tuple[str, str], float] = {
    ("SCALED_PRESSURE", "temperature"): 0.01,
    ("SCALED_PRESSURE", "temperature_press_diff"): 0.01,
    ("SCALED_PRESSURE2", "temperature"): 0.01,
    ("SCALED_PRESSURE2", "temperature_press_diff"): 0.01,
    ("SCALED_PRESSURE3", "temperature"): 0.01,
    ("SCALED_PRESSURE3", "temperature_press_diff"): 0.01,
    ("HYGROMETER_SENSOR", "temperature"): 0.01,
    ("HIGHRES_IMU", "temperature"): 1.0,
}
"""Message and field -> degrees Celsius a unit. SCALED_IMU and RAW_IMU carry the gyro's die and are left out."""
_NO_SOURCE = {("HIGHRES_IMU", "temperature"): 15.0, "temperature_press_diff": 0.0}
"""Values that autopilots send where they have no such sensor."""


class _Limits(Section):
    bias_c: float = Field(0.0, ge=-60, le=60)
    """how much warmer than the air the source reads [deg C]; subtracted"""
    max_age_s: float = Field(10.0, gt=0, le=3600)
    """an older value is not used [s]"""
    max_rate_c_per_s: float = Field(1.0, gt=0, le=100)
    """a faster change is not the air [deg C/s]"""


class FileSource(_Limits):
    """A hwmon or iio file that holds a number."""

    source: Literal["file"]
    """the word file"""
    path: str
    """file, with * where a number varies from boot to boot: /sys/bus/i2c/devices/1-0044/hwmon/hwmon*/temp1_input"""
    scale: float = Field(0.001, gt=0)
    """degrees Celsius a unit; hwmon temp1_input and iio in_temp_input count thousandths"""
    period_s: float = Field(1.0, gt=0, le=60)
    """time between two reads of the file [s]"""


class MavlinkSource(_Limits):
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


class TemperatureParameters(Section):
    """Where the air temperature comes from."""

    fixed_c: float = Field(20.0, ge=COLDEST_C, le=HOTTEST_C)
    """used where no source has a value [deg C]"""
    sources: tuple[Annotated[FileSource | MavlinkSource, Field(discriminator="source")], ...] = ()
    """sources in the order of trust"""


class _Watched:
    """The last believable value of a source."""

    def __init__(self, name: str, limits: _Limits) -> None:
        self.name = name
        self._limits = limits
        self._value_c: float | None = None
        self._time_s = float("-inf")

    def _offer(self, now_s: float, reported_c: float) -> None:
        air_c = reported_c - self._limits.bias_c
        if not COLDEST_C <= air_c <= HOTTEST_C:
            return
        elapsed_s = now_s - self._time_s
        if self._value_c is not None and elapsed_s <= self._limits.max_age_s:
            allowed_c = self._limits.max_rate_c_per_s * elapsed_s + 0.2
            if abs(air_c - self._value_c) > allowed_c:
                return
        self._value_c, self._time_s = air_c, now_s

    def value_c(self, now_s: float) -> float | None:
        """The last value, while it is fresh."""
        return self._value_c if now_s - self._time_s <= self._limits.max_age_s else None


def read_thermometer(source: FileSource) -> float:
    """The number in a source's file, in the file's unit.

    Raises
    ------
    OSError, ValueError
        There is no such file, or it holds no number.
    """
    paths = sorted(glob.glob(source.path))
    with open(paths[0] if paths else source.path, encoding="ascii") as file:
        return float(file.read())


class TemperatureFile(_Watched):
    """Reads a `FileSource` now and then."""

    def __init__(self, parameters: FileSource, read: Callable[[FileSource], float]) -> None:
        super().__init__(parameters.path, parameters)
        self._parameters = parameters
        self._read = read
        self._next_read_s = float("-inf")

    def value_c(self, now_s: float) -> float | None:
        """Read the file where that is due; a missing or odd file only makes the value older."""
        if now_s >= self._next_read_s:
            self._next_read_s = now_s + self._parameters.period_s
            with suppress(OSError, ValueError):
                self._offer(now_s, self._read(self._parameters) * self._parameters.scale)
        return super().value_c(now_s)


class TemperatureMessage(_Watched):
    """Takes the values of a `MavlinkSource` as the link hears them."""

    def __init__(self, parameters: MavlinkSource) -> None:
        super().__init__(f"{parameters.message}.{parameters.field}", parameters)
        self._parameters = parameters
        self._scale = MAVLINK_FIELDS[parameters.message, parameters.field]

    def hear(self, now_s: float, message: Any) -> None:
        """Look at a message from the autopilot, whatever it is."""
        field = self._parameters.field
        if message.get_type() != self._parameters.message:
            return
        reported_c = getattr(message, field) * self._scale
        if reported_c in (_NO_SOURCE.get((self._parameters.message, field)), _NO_SOURCE.get(field)):
            return
        self._offer(now_s, reported_c)


class AirTemperature:
    """The best value that there is.

    Attributes
    ----------
    source
        Name of the source in use; ``fixed`` where none had a value.
    fixed_c
        Used where no source has a value [deg C].
    """

    def __init__(
        self,
        parameters: TemperatureParameters,
        start_s: float,
        thermometer: Callable[[FileSource], float] = read_thermometer,
    ) -> None:
        self.fixed_c = parameters.fixed_c
        self._sources = [
            TemperatureMessage(each) if isinstance(each, MavlinkSource) else TemperatureFile(each, thermometer)
            for each in parameters.sources
        ]
        self._messages = [each for each in self._sources if isinstance(each, TemperatureMessage)]
        self.source = "fixed"
        self._had_value_s = start_s

    def fallen_back(self, now_s: float) -> bool:
        """True where sources are named and none of them has had a value for a while."""
        return bool(self._sources) and now_s - self._had_value_s > GRACE_S

    def hear(self, now_s: float, message: Any) -> None:
        """Pass on a message from the autopilot."""
        for each in self._messages:
            each.hear(now_s, message)

    def now_c(self, now_s: float) -> float:
        """Air temperature [deg C] at ``now_s``."""
        for each in self._sources:
            value_c = each.value_c(now_s)
            if value_c is not None:
                self.source = each.name
                self._had_value_s = now_s
                return value_c
        self.source = "fixed"
        return self.fixed_c
