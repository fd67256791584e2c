"""The airframe file: everything that differs between vehicles, validated.

`load_airframe` makes an `Airframe` of YAML; every error is reported with its place (`msp_range.yaml_file`). Conditions
on several keys are checked here too, such as two sensors at one address or two streams that an autopilot would mix up.
"""

import math
from collections import Counter
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path, PurePath
from tempfile import TemporaryDirectory
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, PrivateAttr, ValidationInfo, field_validator, model_validator

from msp_range.correction.temperature import TemperatureParameters
from msp_range.extras import missing
from msp_range.filters.changepoint import ChangepointParameters
from msp_range.filters.table import FilterParameters
from msp_range.geometry import Vector, angle_between, boresight
from msp_range.mavlink.distance_sensor import Autopilot
from msp_range.mavlink.orientation import CUSTOM, DOWN, Orientation, orientation_of
from msp_range.mavlink.transport.url import parse_url
from msp_range.sensor_on_bus import Name, SensorOnBus
from msp_range.sensors.schedule import Near
from msp_range.yaml_file import ConfigError, Section, config_path, load, load_named, read_config

AIRFRAME_NAME = "airframe.yaml"

MOST_SENSORS = 117
"""Largest number of sensors on a bus: the number of 7-bit addresses from 0x03 to 0x77. Files with more are refused
before the models that they name are read."""

FARTHEST_M = 50.0
"""Larger lengths are refused [m]: no vehicle has them, and a 60 was meant as 0.60."""


def _not_centimetres(value: Any) -> Any:
    if isinstance(value, int | float) and FARTHEST_M < abs(value) < float("inf"):
        raise ValueError(f"expected metres, at most {FARTHEST_M:g}: is it written in centimetres or millimetres?")
    return value


Metres = Annotated[float, Field(ge=-FARTHEST_M, le=FARTHEST_M), BeforeValidator(_not_centimetres)]


Degrees = Annotated[float, Field(ge=-360, le=360)]
StreamId = Annotated[int, Field(ge=1, le=254)]


class RotationDeg(Section):
    """Euler angles [deg], intrinsic yaw, pitch, roll in body FRD; the sensor looks along its own x axis."""

    roll: Degrees = 0.0
    """rotation about the beam [deg]; no effect for a round beam"""
    pitch: Degrees = 0.0
    """-90 looks straight down, 0 forward, 90 up [deg]"""
    yaw: Degrees = 0.0
    """90 looks to the right [deg]"""

    @property
    def radians(self) -> tuple[float, float, float]:
        """(roll, pitch, yaw) [rad]."""
        return math.radians(self.roll), math.radians(self.pitch), math.radians(self.yaw)


class SensorSettings(SensorOnBus):
    """One range finder of the vehicle."""

    id: StreamId
    """DISTANCE_SENSOR.id of its stream, 1 to 254"""
    position_m: tuple[Metres, Metres, Metres]
    """[forward, right, down] of the vehicle's reference point [m]"""
    rotation_deg: RotationDeg
    """Euler angles of the mounting {roll, pitch, yaw} [deg]; pitch -90 looks down"""

    @property
    def boresight(self) -> Vector:
        """Unit vector of its axis, body FRD."""
        return boresight(*self.rotation_deg.radians)

    @cached_property
    def tilt_from_down_rad(self) -> float:
        """Angle between its axis and straight down [rad]."""
        return angle_between(self.boresight, (0.0, 0.0, 1.0))

    @cached_property
    def orientation(self) -> Orientation:
        """Orientation in its messages; the narrowest characterised half angle decides."""
        narrowest_rad = math.radians(min(point.half_angle_deg for point in self._model.breakaway))
        return orientation_of(*self.rotation_deg.radians, breakaway_rad=narrowest_rad)


class Polling(Section):
    """Order and timing of pings."""

    groups: list[list[Name]] | None = None
    """groups of sensors that ping together; default: each sensor alone, in the order of the file. Sensors of one group
    must not receive each other's echoes"""
    ping_interval_s: float | None = Field(None, ge=0.03, le=10)
    """time between pings, in which the sound dies away [s]; default: the sensor model's (100 ms)"""
    near: Near | None = None
    """faster pings below a height, if tests on the vehicle have shown that they do no harm"""
    adaptive: bool = True
    """read as soon as a sensor answers; false: wait until its deadline, for a bus master that has problems with a
    sensor that does not acknowledge"""


class LinkSettings(Section):
    """The connection to the autopilot."""

    url: str
    """URL in the form of pymavlink: udpout:HOST:PORT, udpin:HOST:PORT, tcp:HOST:PORT, tcpin:HOST:PORT,
    serial:PATH:BAUD"""
    autopilot: Autopilot = "ardupilot"
    """ardupilot or px4: they interpret DISTANCE_SENSOR differently"""
    component_id: int = Field(191, ge=2, le=254)
    """MAVLink component id of the bridge; 191 is the first onboard computer"""
    system_id: int | None = Field(None, ge=1, le=255)
    """MAVLink system id of the autopilot (ArduPilot MAV_SYSID, SYSID_THISMAV before 4.7; PX4 MAV_SYS_ID), for a link on
    which several autopilots can be received; default: that of the first one"""
    signing_key: str | None = None
    """file with the key for MAVLink signing, made by `msp-range sign`, relative to the working folder of the program;
    default: messages are not signed"""

    @field_validator("url")
    @classmethod
    def _understood(cls, url: str) -> str:
        parse_url(url)
        return url


class FusedSettings(Section):
    """One stream along the vehicle's down axis, from all sensors that look down."""

    id: StreamId = 10
    """DISTANCE_SENSOR.id of the stream"""
    sensors: list[Name] | None = None
    """sensors in it; default: all that look down within their beam"""
    reference_down_m: Metres = 0.0
    """how far below the vehicle's reference point the distance starts [m]: RNGFND1_POS_Z, EKF2_RNG_POS_Z"""


class Send(Section):
    """Streams to send."""

    nothing: bool = False
    """true: work out, record and show these streams, and send no distance; for flights that do not rely on it yet"""
    fused: FusedSettings | None = None
    """the fused downward stream; default: none"""
    sensors: tuple[Name, ...] | Literal["all"] = ()
    """single sensors that have a stream of their own: a list of names, or all"""
    standing_m: Metres | None = Field(None, gt=0)
    """distance that the downward stream has when the vehicle stands on the ground [m]: RNGFND1_GNDCLR, EKF2_MIN_RNG;
    measured by `msp-range commission`; default: the shortest that its sensors report"""


def _streams(value: Any) -> Any:
    if value == "nothing":
        return {"nothing": True, "fused": {}}
    if isinstance(value, str):
        raise ValueError("expected a mapping with fused, sensors or both, or the word nothing")
    return value


class RecordingSettings(Section):
    """Where flights are recorded."""

    folder: str
    """folder for the files, relative to the working folder of the program"""


class Airframe(Section):
    """An airframe file."""

    vehicle: str = Field(min_length=1, max_length=100)
    """name of the vehicle"""
    bus: Annotated[int, Field(ge=0)] | Annotated[str, Field(pattern="^/")] = 1
    """I2C bus number (1 is /dev/i2c-1), or the path of the device file"""
    sensors: list[SensorSettings] = Field(min_length=1, max_length=MOST_SENSORS)
    """the range finders"""
    polling: Polling = Polling()
    """order and timing of pings"""
    filters: tuple[FilterParameters, ...] = (ChangepointParameters(filter="changepoint"),)
    """filters of every single stream, in order; [] for none; default: the changepoint filter"""
    temperature: TemperatureParameters = TemperatureParameters()
    """sources of the air temperature"""
    link: LinkSettings
    """the connection to the autopilot"""
    send: Annotated[Send, BeforeValidator(_streams, json_schema_input_type=Send | Literal["nothing"])]
    """streams to send; the word nothing stands for {nothing: true, fused: {}}"""
    sensor_watch: bool = True
    """compare each downward sensor with its model and the others while flying, and report what differs"""
    recording: RecordingSettings | None = None
    """where flights are recorded; default: only if the command line says so"""

    _files: dict[str, str] = PrivateAttr(default_factory=dict)
    _path: str = PrivateAttr("AIRFRAME.yaml")

    def changed(
        self, *, link: str | None = None, bus: int | str | None = None, autopilot: Autopilot | None = None
    ) -> "Airframe":
        """A copy with values from the command line: URL of the link, I2C bus, type of the autopilot.

        Raises
        ------
        ConfigError
            The URL is invalid.
        """
        if link is not None:
            check_link(link)
        changed = {key: value for key, value in (("url", link), ("autopilot", autopilot)) if value is not None}
        known = {"link": self.link.model_copy(update=changed), "bus": self.bus if bus is None else bus}
        return self.model_copy(update=known)

    @property
    def files(self) -> dict[str, str]:
        """Text of the airframe file, as ``airframe.yaml``, and of the model files by their names in it."""
        return self._files

    @property
    def path(self) -> str:
        """The airframe file as it was named, for commands that a user is to type."""
        return self._path

    @model_validator(mode="after")
    def _consistent(self) -> "Airframe":
        names = [sensor.name for sensor in self.sensors]
        _refuse_twice("sensors", "name", names)
        _refuse_twice("sensors", "address", [sensor.shown_address for sensor in self.sensors])
        if any(sensor.shown_address == str(parse_url(self.link.url)) for sensor in self.sensors):
            raise ValueError(f"sensors: {self.link.url} is the link to the autopilot; a sensor has a port of its own")
        ids = [sensor.id for sensor in self.sensors] + ([self.send.fused.id] if self.send.fused else [])
        _refuse_twice("sensors and send.fused", "id", ids)
        self._check_groups(names)
        for place, some in (("send.fused.sensors", self.fused_names), ("send.sensors", self.sent_names)):
            _refuse_unknown(place, some, names)
        if self.send.fused is None and not self.sent_names:
            raise ValueError(
                "send: no stream is given; give fused, sensors or both. To send none of them yet, add nothing: true"
            )
        if self.send.fused is not None:
            self._check_fused()
        self._check_orientations()
        return self

    @property
    def extras(self) -> tuple[str, ...]:
        """Optional packages that it needs, keys of `msp_range.extras.EXTRAS`."""
        # Only a sensor with a stream of its own has a chain of filters.
        is_kalman = self.sent_names and any(parameters.filter == "kalman" for parameters in self.filters)
        return ("kalman",) if is_kalman else ()

    def _check_groups(self, names: list[str]) -> None:
        if self.polling.groups is None:
            return
        grouped = [name for group in self.polling.groups for name in group]
        _refuse_unknown("polling.groups", grouped, names)
        _refuse_twice("polling.groups", "sensor", grouped)
        left_out = [name for name in names if name not in grouped]
        if left_out or not all(self.polling.groups):
            raise ValueError(f"polling.groups: every sensor in one group, no group empty; missing: {left_out}")

    def _check_fused(self) -> None:
        if not self.downward:
            instead = "; send: {nothing: true, sensors: all} tries those that look elsewhere" * self.send.nothing
            raise ValueError(
                f"send.fused: no sensor looks down (pitch -90 does); a fused downward stream requires one{instead}"
            )
        for sensor in self.downward:
            if sensor.tilt_from_down_rad > math.radians(45):
                raise ValueError(
                    f"send.fused.sensors: {sensor.name} looks {math.degrees(sensor.tilt_from_down_rad):.0f} deg away "
                    "from straight down; at most 45 can be fused"
                )

    def _check_orientations(self) -> None:
        streams = [(sensor.name, sensor.orientation) for sensor in self.sent]
        if self.send.fused is not None:
            streams.append(("fused", Orientation(DOWN, (0.0, 0.0, 0.0, 0.0))))
        if self.link.autopilot == "ardupilot":
            for value, count in Counter(orientation.value for _, orientation in streams).items():
                if count > 1 and value != CUSTOM:
                    those = [name for name, orientation in streams if orientation.value == value]
                    raise ValueError(
                        f"send: the streams {', '.join(those)} all have orientation {value} "
                        f"({Orientation(value, (0, 0, 0, 0)).name}); ArduPilot before 4.8 would mix them into "
                        "one, and later versions use one of them. Send the fused stream alone, or one of them"
                    )
        elif self.send.fused is None and not any(orientation.value == DOWN for _, orientation in streams):
            looks_down = [sensor.name for sensor in self.sent if sensor.tilt_from_down_rad < math.radians(45)]
            if looks_down:
                raise ValueError(
                    f"send: {', '.join(looks_down)} look down at an angle, and PX4 takes a height from orientation "
                    "25 (straight down) only; give send.fused"
                )

    @property
    def on_i2c(self) -> list[SensorSettings]:
        """The sensors on the I2C bus; the others have serial ports."""
        return [sensor for sensor in self.sensors if not sensor.driver.is_serial]

    @property
    def sent_names(self) -> list[str]:
        """Sensors with a stream of their own."""
        if self.send.sensors == "all":
            return [sensor.name for sensor in self.sensors]
        return list(self.send.sensors)

    @property
    def sent(self) -> list[SensorSettings]:
        """The sensors with a stream of their own."""
        return [sensor for sensor in self.sensors if sensor.name in self.sent_names]

    @property
    def reference_down_m(self) -> float:
        """Where the fused distance starts, below the reference point [m]; 0 without one."""
        return self.send.fused.reference_down_m if self.send.fused is not None else 0.0

    @property
    def polling_groups(self) -> list[list[str]]:
        """Names of the sensors that ping together, group after group."""
        groups = self.polling.groups
        return groups if groups is not None else [[sensor.name] for sensor in self.sensors]

    @property
    def polling_interval_s(self) -> float:
        """Time between the pings of two groups [s]."""
        interval_s = self.polling.ping_interval_s
        if interval_s is not None:
            return interval_s
        return max(sensor.sensor_model.timing.ping_interval_s for sensor in self.sensors)

    @property
    def without_thermometers(self) -> "Airframe":
        """The airframe with its fixed temperature only."""
        return self.model_copy(update={"temperature": self.temperature.model_copy(update={"sources": ()})})

    @property
    def maximum_by_sound_m(self) -> float:
        """Longest range of the sensors whose ranges depend on the air [m]; 0 if there are none."""
        by_sound = [sensor.sensor_model for sensor in self.sensors if sensor.sensor_model.depends_on_air]
        return max([model.maximum_cm for model in by_sound], default=0) / 100

    @property
    def fused_names(self) -> list[str]:
        """Sensors of the fused stream."""
        if self.send.fused is None:
            return []
        if self.send.fused.sensors is not None:
            return self.send.fused.sensors
        return [
            sensor.name
            for sensor in self.sensors
            if sensor.tilt_from_down_rad
            <= math.radians(max(point.half_angle_deg for point in sensor.sensor_model.breakaway))
        ]

    @property
    def downward(self) -> list[SensorSettings]:
        """The sensors of the fused stream."""
        return [sensor for sensor in self.sensors if sensor.name in self.fused_names]


def check_link(url: str) -> None:
    """Check the URL that --link gives; raises ConfigError if it is not one of a link."""
    try:
        parse_url(url)
    except ValueError as error:
        raise ConfigError(f"--link: {error}") from None


def load_airframe(path: Path | str) -> Airframe:
    """Read an airframe file and the sensor model files that it names.

    Parameters
    ----------
    path
        The file, or the name of one that comes with the package.

    Raises
    ------
    ConfigError
        The file cannot be read or used; one line per error.

    Examples
    --------
    >>> [sensor.name for sensor in load_airframe("quad_pallet").sensors]
    ['front_left', 'front_right', 'rear_left', 'rear_right']
    """
    airframe = read_airframe(path)
    for extra in airframe.extras:
        if (absent := missing(extra)) is not None:
            raise ConfigError(f"{path}: filters: {extra} requires {absent}; or use another filter, such as changepoint")
    return airframe


def read_airframe(path: Path | str) -> Airframe:
    """As `load_airframe`, also where packages are missing that the airframe needs."""
    given, path = path, config_path(path, "")
    airframe = load(path, Airframe)
    files = {AIRFRAME_NAME: read_config(path)}
    for sensor in airframe.sensors:
        files[sensor.model] = read_config(config_path(sensor.model, "sensors", path.parent))
    airframe._files, airframe._path = files, str(given)
    return airframe


def _load_named(named: Any, info: ValidationInfo) -> Airframe:
    if isinstance(named, Airframe):
        return named
    if not isinstance(named, str):
        raise ValueError("expected the path of an airframe file, relative to this file")
    return load_named(info, named, "", load_airframe)


NamedAirframe = Annotated[Airframe, BeforeValidator(_load_named, json_schema_input_type=str)]
"""An airframe named in another file: a path there, the airframe after reading; or one that was read already."""


def load_airframe_from(files: Mapping[str, str], source: Path, instead: str = "") -> Airframe:
    """Read an airframe from the texts that a recording has of it (`Airframe.files`). ``instead`` ends each error
    message: what the user can give the command in its place.

    Raises
    ------
    ConfigError
        There is none, it names files outside its own folder, or one cannot be used.
    """
    if AIRFRAME_NAME not in files:
        raise ConfigError(f"{source}: contains no airframe file{instead}")
    with TemporaryDirectory() as name:
        folder = Path(name)
        for name_in_file, text in files.items():
            path = PurePath(name_in_file)
            if path.is_absolute() or ".." in path.parts:
                raise ConfigError(f"{source}: its airframe names {name_in_file}, outside of its folder{instead}")
            try:
                (folder / path).parent.mkdir(parents=True, exist_ok=True)
                (folder / path).write_text(text, encoding="utf-8")
            except (OSError, ValueError):
                raise ConfigError(
                    f"{source}: no file can have the name of the attached {name_in_file[:80]!r}"
                ) from None
        try:
            airframe = load_airframe(folder / AIRFRAME_NAME)
        except ConfigError as error:
            raise ConfigError(str(error).replace(f"{folder}/", f"{source}: attached ")) from None
    strangers = [sensor.model for sensor in airframe.sensors if sensor.model not in files]
    if strangers:
        raise ConfigError(f"{source}: its airframe names {strangers[0]}, which it does not contain{instead}")
    return airframe


def _refuse_twice(place: str, what: str, values: list[Any]) -> None:
    twice = [str(value) for value, count in Counter(values).items() if count > 1]
    if twice:
        raise ValueError(f"{place}: {what} {', '.join(twice)} is given more than once; each needs its own")


def _refuse_unknown(place: str, some: list[str], names: list[str]) -> None:
    for name in some:
        if name not in names:
            raise ValueError(f"{place}: no sensor is named {name!r}; the sensors are {', '.join(names)}")
