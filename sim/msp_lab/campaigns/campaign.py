"""The campaign file: what to measure, at which settings, how often, and against which reference.

A `Campaign` is made of YAML and validated; every error is reported with its place (`msp_range.yaml_file`). The
experiments follow the report's chapter 4 and Table 4.1. `msp_lab.campaigns.plan` makes the points from it, in the order
in which a person sets them up.
"""

from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, PrivateAttr, ValidationInfo, model_validator

from msp_range.correction.temperature import FileSource
from msp_range.sensor_on_bus import Name, SensorOnBus
from msp_range.yaml_file import Section, config_path, folder_of, load, read_config

RangeCm = Annotated[float, Field(gt=0, le=2000)]
AngleDeg = Annotated[float, Field(gt=-90, lt=90)]
SizeCm = Annotated[float, Field(gt=0, le=10_000)]
TemperatureC = Annotated[float, Field(ge=-40, le=80)]
HumidityPct = Annotated[float, Field(ge=0, le=100)]
Firing = Literal["sequential", "simultaneous"]

MAX_STEPS = 1000
"""Refuse a longer span: it is a typing error, and its points would take years."""


def repeated(values: Iterable[Any]) -> list[Any]:
    """Those of the values that are there more than once."""
    return [value for value, count in Counter(values).items() if count > 1]


class Span(Section):
    """Evenly spaced values, both ends included."""

    first: float
    """the first value"""
    last: float
    """the last value"""
    step: float = Field(gt=0)
    """distance between two values"""

    @model_validator(mode="after")
    def _whole(self) -> "Span":
        steps = (self.last - self.first) / self.step
        if not (abs(steps - round(steps)) < 1e-6 and 0 < round(steps) <= MAX_STEPS):
            raise ValueError(
                f"expected last to be first plus 1 to {MAX_STEPS} whole steps, "
                f"found first {self.first:g}, last {self.last:g}, step {self.step:g}"
            )
        return self

    @property
    def values(self) -> tuple[float, ...]:
        """All values."""
        count = round((self.last - self.first) / self.step)
        return tuple(round(self.first + self.step * i, 6) for i in range(count + 1))


_Spread = BeforeValidator(
    lambda given: Span.model_validate(given).values if isinstance(given, dict) else given,
    json_schema_input_type=Span | tuple[float, ...],
)
"""A span's values in place of the span."""


class BenchSensor(SensorOnBus):
    """One range finder on the bench."""

    simulator: str | None = None
    """sensor model file of the simulated sensor, relative to the campaign file; left out: the same"""

    _simulated_by: Path = PrivateAttr()

    @model_validator(mode="after")
    def _name_simulator(self, info: ValidationInfo) -> "BenchSensor":
        self._simulated_by = config_path(self.simulator or self.model, "sensors", folder_of(info))
        return self

    @property
    def simulated_by(self) -> Path:
        """Sensor model file of the simulated sensor."""
        return self._simulated_by


class Reference(Section):
    """What the readings are compared with."""

    method: str = Field(min_length=1)
    """how the true range is measured, from where to where"""
    uncertainty_cm: float = Field(gt=0, le=100)
    """its standard deviation [cm]; half the step of a ruler is about right. The simulator's true ranges err by it"""


class BenchTarget(Section):
    """What the beam meets."""

    material: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_ -]{0,31}$")]
    """a word: plywood, asphalt, concrete, wall ..."""
    size_cm: tuple[SizeCm, SizeCm] | None = None
    """width and height [cm]; left out: larger than the beam"""
    how: str = ""
    """instructions for placing it"""


class BenchAir(Section):
    """The air between sensor and target."""

    air_temperature_c: TemperatureC | None = None
    """at the sensor [deg C]; left out: not controlled, taken from the thermometer"""
    target_temperature_c: TemperatureC | None = None
    """at the far end, next to the target [deg C]; left out: the same as at the sensor"""
    humidity_pct: HumidityPct | None = None
    """relative humidity [%]; left out: unknown"""
    how: str = ""
    """how it is done: a box, a vent, a humidifier"""

    @model_validator(mode="after")
    def _near_end_first(self) -> "BenchAir":
        if self.target_temperature_c is not None and self.air_temperature_c is None:
            raise ValueError("target_temperature_c: found without air_temperature_c, expected both ends or none")
        return self


class External(Section):
    """An ultrasonic transmitter next to the bench, at every combination of the values listed here."""

    levels_db: tuple[Annotated[float, Field(ge=0, le=160)], ...] = Field(min_length=1)
    """sound level at 30 cm from it [dB re 20 uPa]"""
    duties: tuple[Annotated[float, Field(gt=0, le=1)], ...] = Field(min_length=1)
    """share of the time that it sounds"""
    distances_cm: tuple[Annotated[float, Field(gt=0, le=2000)], ...] = Field(min_length=1)
    """from it to the sensor [cm]"""
    frequencies_khz: tuple[Annotated[float, Field(ge=20, le=200)], ...] = Field(min_length=1)
    """frequency of its sound [kHz]"""
    quiet: bool = True
    """whether each point is also read with it switched off, to compare with"""


class Moving(Section):
    """A target that moves along the beam at a constant rate, from each range to another."""

    to_cm: RangeCm
    """where it ends [cm]"""
    rates_cm_s: tuple[Annotated[float, Field(gt=0, le=500)], ...] = Field(min_length=1)
    """how fast [cm/s]; the direction follows from the ranges"""


class Experiment(Section):
    """One experiment, read at every combination of the values that it lists."""

    condition: Name
    """its name in the column `condition`; several entries may share it. If both ways of firing are listed, each is
    added: crosstalk_simultaneous"""
    question: str = ""
    """the question that it answers, and the report's section"""
    setup: str = ""
    """instructions for its start"""
    ranges_cm: Annotated[tuple[RangeCm, ...], _Spread] = Field(min_length=1)
    """perpendicular distances from sensor to target [cm]: a list, or {first, last, step}"""
    angles_deg: Annotated[tuple[AngleDeg, ...], _Spread] = Field((0.0,), min_length=1)
    """angles between the beam and the target's normal, signed [deg]: a list, or {first, last, step}"""
    targets: tuple[BenchTarget, ...] = Field(min_length=1)
    """what the beam meets"""
    air: tuple[BenchAir, ...] = Field((), max_length=100)
    """air between sensor and target; left out: the campaign's room"""
    vibrations_hz: tuple[Annotated[float, Field(ge=0, le=100_000)], ...] = Field((0.0,), min_length=1)
    """vibration of the sensor's housing [Hz]; 0: none"""
    sensors: tuple[Name, ...] = ()
    """names of the sensors to read; left out: the first one"""
    apart_cm: float | None = Field(None, gt=0, le=1000)
    """distance between them, where there are several [cm]"""
    firing: tuple[Firing, ...] = Field(("sequential",), min_length=1)
    """sequential: each waits for the previous one; simultaneous: all ping at once"""
    external: External | None = None
    """an ultrasonic transmitter nearby; left out: none"""
    moving: Moving | None = None
    """a target that moves; left out: it stands still"""
    readings: int | None = Field(None, ge=1, le=10_000_000)
    """readings per point and sensor; left out: the campaign's"""

    @model_validator(mode="after")
    def _once_each(self) -> "Experiment":
        for key in ("ranges_cm", "angles_deg", "targets", "air", "vibrations_hz", "sensors", "firing"):
            if twice := repeated(getattr(self, key)):
                raise ValueError(f"{key}: found {twice[0]!r} more than once, expected each once")
        if self.moving is not None and self.moving.to_cm in self.ranges_cm:
            raise ValueError(f"moving.to_cm: found {self.moving.to_cm:g}, which is also where a movement begins")
        if len(self.sensors) < 2 and self.firing != ("sequential",):
            raise ValueError("firing: found with one sensor, expected it where sensors lists several")
        return self


class Campaign(Section):
    """A campaign file."""

    campaign: Name
    """a name of its own: small letters, digits and underscores"""
    purpose: str = ""
    """what it is for"""
    reference: Reference
    """what the readings are compared with"""
    sensors: tuple[BenchSensor, ...] = Field(min_length=1)
    """the range finders; the first one is read if an experiment names none"""
    room: BenchAir = BenchAir()
    """the air, unless an experiment sets another"""
    thermometer: FileSource | None = None
    """file of a thermometer next to the sensor; left out: a person enters what a thermometer shows"""
    readings: int = Field(100, ge=1, le=10_000_000)
    """readings per point and sensor, unless an experiment sets another number"""
    conditions: tuple[Experiment, ...] = Field(min_length=1)
    """the experiments, in their order"""

    _files: dict[str, str] = PrivateAttr(default_factory=dict)

    @model_validator(mode="after")
    def _consistent(self) -> "Campaign":
        names = [sensor.name for sensor in self.sensors]
        for what, values in (("name", names), ("address", [sensor.shown_address for sensor in self.sensors])):
            if twice := repeated(values):
                raise ValueError(f"sensors: {what} {twice[0]} is given more than once; each needs its own")
        for number, condition in enumerate(self.conditions):
            for name in condition.sensors:
                if name not in names:
                    raise ValueError(
                        f"conditions.{number}.sensors: no sensor is named {name!r}; the sensors are {', '.join(names)}"
                    )
        return self

    @property
    def files(self) -> dict[str, str]:
        """Text of the campaign file, as ``campaign.yaml``, and of the sensor model files by the names it gives them."""
        return self._files

    def sensor(self, name: str) -> BenchSensor:
        """The sensor of that name."""
        return next(sensor for sensor in self.sensors if sensor.name == name)


def load_campaign(path: Path | str) -> Campaign:
    """Read a campaign file and the sensor model files that it names.

    Raises
    ------
    ConfigError
        The file cannot be read or used; one line per error.
    """
    path = config_path(path, "campaigns")
    campaign = load(path, Campaign)
    campaign.files["campaign.yaml"] = read_config(path)
    for sensor in campaign.sensors:
        campaign.files[sensor.model] = read_config(config_path(sensor.model, "sensors", path.parent))
    return campaign
