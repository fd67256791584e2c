"""The scenario file: a flight, the world below it, and what goes wrong.

YAML enters, a `Scenario` leaves; every mistake is named with its place (`msp_range.yaml_file`). That the vehicle would
fly through the ground, or a fault hit a sensor that the airframe does not have, is found here too and not in flight.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

from numpy.random import Generator, default_rng
from pydantic import Field, model_validator

from msp_range.config import NamedAirframe
from msp_range.mavlink.distance_sensor import Autopilot
from msp_range.yaml_file import Section, config_path, load
from msp_sim.device import device
from msp_sim.device.table import emulated_kind
from msp_sim.world.profiles import Positive
from msp_sim.world.surfaces import GroundSection
from msp_sim.world.vehicle import FlightSection, Pose, Vehicle
from msp_sim.world.world import AirSection, World

CHECK_EVERY_S = 0.1
"""Time between two looks at the vehicle's height above the ground when a scenario is loaded [s]."""
MOST_CHECKS = 36_000
"""Looks in all, 10 us each: in flights of more than an hour they are farther apart."""
LONGEST_FLIGHT_S = 36_000.0
"""A longer flight is refused [s]: ten hours of simulated flight take 200 s."""
LONGEST_EXCESS_S = 3600.0
"""A plan that is longer than the flight by more than this is not worked out to say by how much [s]."""
SCRAPES_M = 0.01
"""The vehicle's feet may be this deep in the ground [m]."""

NotNegative = Annotated[float, Field(ge=0)]

_VALUE_OF_KIND = {"word": "impossible", "spread_cm": "noisy", "offset_cm": "offset"}
"""Keys of a planned fault that belong to one kind only."""


class PlannedFault(Section):
    """Something that goes wrong with a sensor or the bus for a while; kinds: `msp_sim.device.device`."""

    sensor: str
    """name of the sensor in the airframe; one that holds the bus (locked_up) stops all of them"""
    kind: str
    """what goes wrong: one of the fault kinds, such as clock_fault, silent or stuck"""
    from_s: NotNegative
    """when it begins, from the start of the flight [s]"""
    to_s: NotNegative
    """when it ends [s]"""
    probability: float = 1.0
    """that it shows at one opportunity, more than 0 and at most 1"""
    word: Annotated[int, Field(ge=0, le=0xFFFF)] | None = None
    """the answer of the kind impossible: 16 bits that are no range; left out: 1000"""
    spread_cm: Positive | None = None
    """standard deviation of the errors of the kind noisy [cm]; left out: 100"""
    offset_cm: float | None = None
    """error of the kind offset [cm]; left out: 100"""

    @model_validator(mode="after")
    def _possible(self) -> "PlannedFault":
        if self.to_s < self.from_s:
            raise ValueError(f"to_s: found {self.to_s:g}; expected a time after from_s {self.from_s:g}")
        for name, kind in _VALUE_OF_KIND.items():
            value = getattr(self, name)
            if value is not None and self.kind != kind:
                raise ValueError(
                    f"{name}: found {value:g}; expected none with the kind {self.kind!r}, only with {kind!r}"
                )
        self.on_device()
        return self

    def on_device(self) -> device.Fault:
        """The fault as the emulated sensor takes it."""
        fault = device.Fault(self.kind, self.from_s, self.to_s, self.probability)
        given = {name: value for name in _VALUE_OF_KIND if (value := getattr(self, name)) is not None}
        return replace(fault, **given)


class ThermometerFault(Section):
    """Something that goes wrong for a while with what thermometers read."""

    kind: Literal["jump", "freeze"]
    """jump: off by by_c at once; freeze: the value at from_s stays"""
    from_s: NotNegative
    """when it begins, from the start of the flight [s]"""
    to_s: NotNegative
    """when it ends [s]"""
    by_c: float = 0.0
    """error of the kind jump [K]"""


class Thermometer(Section):
    """What the vehicle's thermometers read: files of this computer, and what the autopilot sends."""

    warmer_by_c: float = 0.0
    """constant error, as in the sun or beside a processor [K]"""
    faults: tuple[ThermometerFault, ...] = ()
    """what goes wrong, in any order"""

    def reading_c(self, time_s: float, air_c: Callable[[float], float]) -> float:
        """What is read at a time of the flight [deg C], where ``air_c`` is the air at the vehicle at a time [s]."""
        active = [fault for fault in self.faults if fault.from_s <= time_s < fault.to_s]
        frozen_s = [fault.from_s for fault in active if fault.kind == "freeze"]
        jumps_c = [fault.by_c for fault in active if fault.kind == "jump"]
        return air_c(min([time_s, *frozen_s])) + self.warmer_by_c + sum(jumps_c)


class AttitudeFault(Section):
    """Attitudes that make no sense, for a while."""

    kind: Literal["roll", "huge", "not_a_number"]
    """roll: this roll is sent; huge: 1e38 rad; not_a_number: NaN"""
    from_s: NotNegative
    """when it begins, from the start of the flight [s]"""
    to_s: NotNegative
    """when it ends [s]"""
    roll_deg: float = 180.0
    """the roll of the kind roll [deg]"""

    @property
    def roll_rad(self) -> float:
        """The roll that is sent [rad]."""
        return {"roll": math.radians(self.roll_deg), "huge": 1e38, "not_a_number": math.nan}[self.kind]


class AutopilotSection(Section):
    """The autopilot at the other end of the link."""

    kind: Autopilot | None = None
    """ardupilot or px4; left out: the one that the airframe's link names"""
    heard_from_s: NotNegative = 0.0
    """when its first heartbeat comes, from the start of the flight [s]"""
    reboots_at_s: tuple[NotNegative, ...] = ()
    """when it starts anew, its clock with it [s]"""
    attitude_faults: tuple[AttitudeFault, ...] = ()
    """attitudes that make no sense, in any order"""
    sends_motion: bool = True
    """sends accelerations and pressures; where it does not, nothing is sent of its barometer's temperature either"""

    def sent_pose(self, pose: Pose) -> Pose:
        """The pose that its messages are made of."""
        for fault in self.attitude_faults:
            if fault.from_s <= pose.time_s < fault.to_s:
                pose = pose._replace(roll_rad=fault.roll_rad)
        return pose


class Scenario(Section):
    """A scenario file."""

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")]
    """a name of its own: small letters, digits and underscores"""
    airframe: NamedAirframe
    """airframe file, relative to the scenario file"""
    duration_s: Annotated[float, Field(gt=0, le=LONGEST_FLIGHT_S)]
    """how long the flight is looked at [s]"""
    flight: FlightSection
    """what the vehicle does"""
    ground: GroundSection = GroundSection()
    """what lies and stands below"""
    air: AirSection = AirSection()
    """air temperature over height"""
    thermometer: Thermometer = Thermometer()
    """what the vehicle's thermometers read"""
    faults: tuple[PlannedFault, ...] = ()
    """what goes wrong, in any order"""
    autopilot: AutopilotSection | None = AutopilotSection()
    """the autopilot at the other end of the link; null: none is ever heard"""

    @model_validator(mode="after")
    def _consistent(self) -> "Scenario":
        names = [sensor.name for sensor in self.airframe.sensors]
        kinds = {sensor.name: emulated_kind(sensor.sensor_model.driver) for sensor in self.airframe.sensors}
        for i, fault in enumerate(self.faults):
            if fault.sensor not in names:
                raise ValueError(f"faults[{i}].sensor: found {fault.sensor!r}; expected one of {', '.join(names)}")
            try:
                kinds[fault.sensor].check_fault(fault.on_device())
            except ValueError as error:
                raise ValueError(f"faults[{i}].{error}, for {fault.sensor}") from None
            if fault.from_s >= self.duration_s:
                raise ValueError(
                    f"faults[{i}].from_s: found {fault.from_s:g}; expected a time before the end, duration_s "
                    f"{self.duration_s:g}"
                )
        self._check_flight()
        return self

    def _check_flight(self) -> None:
        planned_s = sum(getattr(segment, "duration_s", 0.0) for segment in self.flight.altitude)
        if planned_s > self.duration_s + LONGEST_EXCESS_S:
            raise ValueError(
                f"duration_s: found {self.duration_s:g}; expected at least {planned_s:.1f}, which flight.altitude takes"
            )
        vehicle = self.vehicle(self.world(), default_rng(0))
        if vehicle.duration_s > self.duration_s + 1e-6:
            raise ValueError(
                f"duration_s: found {self.duration_s:g}; expected at least {vehicle.duration_s:.1f}, which "
                "flight.altitude takes"
            )
        every_s = max(CHECK_EVERY_S, self.duration_s / MOST_CHECKS)
        for i in range(math.ceil(self.duration_s / every_s)):
            clearance_m = vehicle.clearance_m(i * every_s)
            if clearance_m < -SCRAPES_M:
                raise ValueError(
                    f"flight: at {i * every_s:.1f} s the vehicle would stand {-clearance_m:.2f} m deep in what "
                    "is below it; expected heights above the ground and its boxes, and a landing at rest"
                )

    def device_faults(self) -> dict[str, list[device.Fault]]:
        """Faults as the emulated sensors take them, by sensor."""
        faults: dict[str, list[device.Fault]] = {}
        for planned in self.faults:
            faults.setdefault(planned.sensor, []).append(planned.on_device())
        return faults

    def world(self) -> World:
        """Ground, objects and air."""
        return World(self.ground, self.air)

    def vehicle(self, world: World, generator: Generator) -> Vehicle:
        """The vehicle that flies over this world; ``generator`` draws its random heights and its sway."""
        return Vehicle(self.flight, world.elevation_m, generator)


def load_scenario(path: Path | str) -> Scenario:
    """Read a scenario file, and the airframe file that it names.

    Raises
    ------
    ConfigError
        The file cannot be read or used; one line a mistake.
    """
    return load(config_path(path, "scenarios"), Scenario)
