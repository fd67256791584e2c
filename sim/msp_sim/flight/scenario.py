"""The scenario file: a flight, the world below it, and the faults to inject.

A `Scenario` is made of YAML; every error is reported with its place (`msp_range.yaml_file`). Two errors are found here
and not only in flight: a vehicle that would fly into the ground, and a fault of a sensor that does not exist.
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal

from numpy.random import Generator, default_rng
from pydantic import Field, model_validator

from msp_range.config import NamedAirframe
from msp_range.yaml_file import Section, config_path, load
from msp_sim.device import device
from msp_sim.device.table import emulated_kind
from msp_sim.flight.autopilot import AutopilotSection
from msp_sim.flight.vary import VarySection
from msp_sim.world.profiles import NotNegative, Positive
from msp_sim.world.surfaces import GroundSection
from msp_sim.world.vehicle import FlightSection, Vehicle
from msp_sim.world.world import AirSection, World

CHECK_EVERY_S = 0.1
"""Time between two checks of the vehicle's height above the ground when a scenario is loaded [s]. Larger may miss a
short contact with the ground; smaller takes longer."""
MAX_CHECKS = 36_000
"""Largest number of these checks, 10 us each: in flights of more than an hour they are further apart."""
LONGEST_FLIGHT_S = 36_000.0
"""Longer flights are refused [s]: ten hours of simulated flight take some 200 s of wall time."""
LONGEST_EXCESS_S = 3600.0
"""If the altitude segments exceed the flight by more than this, the error is reported without simulating them [s]."""
GROUND_TOLERANCE_M = 0.01
"""Depth to which the vehicle's feet may be in the ground without an error [m]: sloped ground under a landed vehicle."""

_VALUE_OF_KIND = {
    "word": "impossible",
    "spread_cm": "noisy",
    "offset_cm": "offset",
    "rate_cm_s": "drift",
    "constant_cm": "constant",
    "object_cm": "fixed_object",
    "jitter_cm": "fixed_object",
    "swing_cm": "fixed_object",
    "swing_period_s": "fixed_object",
    "dust_cm": "dust",
}
"""Keys of a planned fault that are valid for one kind only."""


class ImpossibleFlight(ValueError):
    """The vehicle would fly into the ground, or longer than the scenario."""


class PlannedFault(Section):
    """A fault of a sensor or of the bus for some time; kinds: `msp_sim.device.device`."""

    sensor: str
    """name of the sensor in the airframe; one that blocks the bus (locked_up) stops all sensors"""
    kind: str
    """kind of fault, such as clock_fault, silent or stuck"""
    from_s: NotNegative
    """when it begins, from the start of the flight [s]"""
    to_s: NotNegative
    """when it ends [s]"""
    probability: float = 1.0
    """probability that it affects a reading, more than 0 and at most 1"""
    word: Annotated[int, Field(ge=0, le=0xFFFF)] | None = None
    """answer of the kind impossible, 16 bits that are not a range; default: 1000"""
    spread_cm: Positive | None = None
    """standard deviation of the errors of the kind noisy [cm]; default: 100"""
    offset_cm: float | None = None
    """error of the kind offset [cm]; default: 100"""
    rate_cm_s: float | None = None
    """how fast the error of the kind drift grows [cm/s]; default: 2"""
    constant_cm: Annotated[int, Field(gt=0)] | None = None
    """reading of the kind constant [cm]; default: 100"""
    object_cm: Positive | None = None
    """mean range of the object of the kind fixed_object [cm]; default: 40"""
    jitter_cm: NotNegative | None = None
    """standard deviation of its range from ping to ping [cm]; default: 0.5"""
    swing_cm: NotNegative | None = None
    """amplitude with which it swings about its mean range [cm]; default: 0"""
    swing_period_s: Positive | None = None
    """period of that swing [s]; default: 2"""
    dust_cm: Positive | None = None
    """how far down the dust of the kind dust is [cm]; default: 100"""

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
        """The fault in the form that the emulated sensor uses."""
        given = {name: value for name in _VALUE_OF_KIND if (value := getattr(self, name)) is not None}
        return device.Fault(self.kind, self.from_s, self.to_s, self.probability, **given)


class ThermometerFault(Section):
    """A fault of the thermometers for some time."""

    kind: Literal["jump", "freeze", "settle", "flap"]
    """jump: wrong by by_c from one moment to the next; freeze: the value at from_s is kept; settle: wrong by by_c at
    from_s, and less and less as its housing takes the air's temperature; flap: right and wrong by by_c in turn"""
    from_s: NotNegative
    """when it begins, from the start of the flight [s]"""
    to_s: NotNegative
    """when it ends [s]"""
    by_c: Annotated[float, Field(ge=-200, le=200)] = 0.0
    """error of the kinds jump, settle and flap [K]"""
    time_constant_s: Positive = 90.0
    """time in which the error of the kind settle falls to 37 % [s]"""
    period_s: Positive = 2.0
    """time of one right and one wrong value of the kind flap [s]"""

    def error_c(self, time_s: float) -> float:
        """Error at a time of the flight at which the fault lasts [K]; a frozen value is not of this fault alone."""
        elapsed_s = time_s - self.from_s
        if self.kind == "settle":
            return self.by_c * math.exp(-elapsed_s / self.time_constant_s)
        if self.kind == "flap":
            return self.by_c if elapsed_s % self.period_s >= self.period_s / 2 else 0.0
        return self.by_c if self.kind == "jump" else 0.0


class Thermometer(Section):
    """What the vehicle's thermometers read: those read from files, and those whose values the autopilot sends."""

    warmer_by_c: Annotated[float, Field(ge=-200, le=200)] = 0.0
    """constant error, as in sunshine or next to a processor [K]"""
    faults: tuple[ThermometerFault, ...] = ()
    """faults, in any order"""

    def reading_c(self, time_s: float, air_c: Callable[[float], float]) -> float:
        """Reading at a time of the flight [deg C]; ``air_c`` gives the air temperature at the vehicle at a time [s]."""
        if not self.faults:
            return air_c(time_s) + self.warmer_by_c
        active = [fault for fault in self.faults if fault.from_s <= time_s < fault.to_s]
        frozen_s = [fault.from_s for fault in active if fault.kind == "freeze"]
        return air_c(min([time_s, *frozen_s])) + self.warmer_by_c + sum(fault.error_c(time_s) for fault in active)


class Scenario(Section):
    """A scenario file."""

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")]
    """name of the scenario: lower-case letters, digits and underscores"""
    airframe: NamedAirframe
    """airframe file, relative to the scenario file"""
    duration_s: Annotated[float, Field(gt=0, le=LONGEST_FLIGHT_S)]
    """duration of the simulated flight [s]"""
    flight: FlightSection
    """what the vehicle does"""
    ground: GroundSection = GroundSection()
    """the ground and the objects on it"""
    air: AirSection = AirSection()
    """air temperature over height"""
    thermometer: Thermometer = Thermometer()
    """what the vehicle's thermometers read"""
    faults: tuple[PlannedFault, ...] = ()
    """faults, in any order"""
    autopilot: AutopilotSection | None = AutopilotSection()
    """the autopilot at the other end of the link; null: no autopilot is ever received"""
    vary: VarySection | None = None
    """what varies from flight to flight of 'msp-sim monte-carlo'; default: see docs/simulating.md"""

    @model_validator(mode="after")
    def _consistent(self) -> "Scenario":
        kinds = {sensor.name: emulated_kind(sensor.sensor_model.driver) for sensor in self.airframe.sensors}
        for i, fault in enumerate(self.faults):
            if fault.sensor not in kinds:
                raise ValueError(f"faults[{i}].sensor: found {fault.sensor!r}; expected one of {', '.join(kinds)}")
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
        takes_s = sum(getattr(segment, "duration_s", 0.0) for segment in self.flight.altitude)
        if takes_s <= self.duration_s + LONGEST_EXCESS_S:
            vehicle = self.vehicle(self.world(), default_rng(0))
            takes_s = vehicle.duration_s
        if takes_s > self.duration_s + 1e-6:
            raise ImpossibleFlight(
                f"duration_s: found {self.duration_s:g}; expected at least {takes_s:.1f}, which flight.altitude takes"
            )
        every_s = max(CHECK_EVERY_S, self.duration_s / MAX_CHECKS)
        for i in range(math.ceil(self.duration_s / every_s)):
            clearance_m = vehicle.pose(i * every_s).clearance_m
            if clearance_m < -GROUND_TOLERANCE_M:
                raise ImpossibleFlight(
                    f"flight: at {i * every_s:.1f} s the vehicle would stand {-clearance_m:.2f} m deep in what "
                    "is below it; expected heights above the ground and its boxes, and a landing at rest"
                )

    def device_faults(self) -> dict[str, list[device.Fault]]:
        """Faults in the form that the emulated sensors use, by sensor."""
        faults: dict[str, list[device.Fault]] = {}
        for planned in self.faults:
            faults.setdefault(planned.sensor, []).append(planned.on_device())
        return faults

    def world(self) -> World:
        """The world: ground, objects and air."""
        return World(self.ground, self.air)

    def vehicle(self, world: World, generator: Generator) -> Vehicle:
        """The vehicle that flies over this world; ``generator`` draws its random heights and its sway."""
        return Vehicle(self.flight, world.elevation_m, generator)


def load_scenario(path: Path | str) -> Scenario:
    """Read a scenario file, and the airframe file that it names.

    Raises
    ------
    ConfigError
        The file cannot be read or used; one line per error.
    """
    return load(config_path(path, "scenarios"), Scenario)
