"""The simulated world: the ground, the objects on it, and the air.

`World.ping` gets a pose and a beam and gives the truth of one ping. World frame NED with its origin on the ground;
heights are above the origin, up positive. `msp_sim.world.surfaces` says which echoes a surface returns; the nearest of
them counts.
"""

import math
from typing import Annotated, NamedTuple

from pydantic import Field, model_validator

from msp_range.geometry import Vector, dot, rotate, rotation_matrix
from msp_range.yaml_file import Section
from msp_sim.world.surfaces import Block, Echo, GroundSection, HalfAngle, Terrain
from msp_sim.world.vehicle import Pose


class WarmLayer(Section):
    """A layer of warmer air, as over hot asphalt."""

    bottom_m: float
    """height of its lower boundary above the origin [m]"""
    top_m: float
    """height of its upper boundary above the origin [m]"""
    warmer_by_c: Annotated[float, Field(ge=-60, le=60)]
    """how much warmer the air in it is; negative: colder [K]"""

    @model_validator(mode="after")
    def _upright(self) -> "WarmLayer":
        if self.top_m <= self.bottom_m:
            raise ValueError(f"expected top_m above bottom_m, but {self.top_m} is not above {self.bottom_m}")
        return self


class AirSection(Section):
    """Air temperature as a function of height."""

    ground_c: Annotated[float, Field(ge=-40, le=60)] = 20.0
    """temperature at the height of the origin [deg C]"""
    lapse_c_per_m: Annotated[float, Field(ge=-2, le=2)] = 0.0065
    """decrease with height [K per metre]; default: standard atmosphere"""
    warm_layer: WarmLayer | None = None
    """a layer of warmer air; default: none"""

    def mean_c(self, from_m: float, to_m: float) -> float:
        """Mean temperature along the straight path between two heights [deg C].

        The speed of sound is nearly linear in temperature, so this mean gives the delay of the echo.
        """
        mean_c = self.ground_c - self.lapse_c_per_m * (from_m + to_m) / 2
        layer = self.warm_layer
        if layer is None:
            return mean_c
        low_m, high_m = min(from_m, to_m), max(from_m, to_m)
        if high_m == low_m:
            share = 1.0 if layer.bottom_m <= low_m <= layer.top_m else 0.0
        else:
            share = max(min(high_m, layer.top_m) - max(low_m, layer.bottom_m), 0.0) / (high_m - low_m)
        return mean_c + share * layer.warmer_by_c


class MountedBeam(NamedTuple):
    """A sensor's position on the vehicle, its direction and its beam."""

    position_m: Vector
    """Position, body FRD [m]."""
    boresight: Vector
    """Unit vector of its axis, body FRD."""
    half_angle_rad: HalfAngle | None
    """Half angle of the beam [rad] as a function of range [m]; does not grow with range. None: a ray of light, which
    returns from the first surface that the boresight meets."""


class Ping(NamedTuple):
    """The truth of one ping, with the names and units of the CSV columns.

    Without an echo, ranges, incidence and target are those of the surface that the boresight meets, or None if there is
    none.
    """

    has_echo: bool
    """Whether an echo returns from within the beam."""
    true_range_cm: float | None
    """Perpendicular distance to the surface; for an edge the distance to its nearest point [cm]."""
    slant_range_cm: float | None
    """Distance along the boresight to that surface's plane; the same as ``true_range_cm`` for an edge [cm]."""
    incidence_deg: float | None
    """Angle between the boresight and the direction of ``true_range_cm`` (a surface's normal), 0 to 90 [deg]."""
    range_rate_cm_s: float | None
    """Rate of ``true_range_cm`` due to the vehicle's velocity; its rotation is neglected [cm/s]."""
    air_temperature_c: float
    """Mean along the path; at the sensor if there is no surface [deg C]."""
    target: str | None
    """Name of the surface."""
    target_size_cm: float | None
    """Shorter side of a box [cm]; None for the ground."""


class World:
    """Ground, objects and air.

    Examples
    --------
    >>> world = World(GroundSection(surface="concrete"), AirSection(ground_c=15.0, lapse_c_per_m=0.0))
    >>> beam = MountedBeam((0.2, 0.0, 0.1), (0.0, 0.0, 1.0), lambda range_m: math.radians(12.0))
    >>> ping = world.ping(Pose(0.0, (0.0, 0.0, -2.1), 0.0, 0.0, 0.0, (0.0, 0.0, -0.5)), beam)
    >>> ping.has_echo, f"{ping.true_range_cm:.1f}", f"{ping.range_rate_cm_s:.1f}", ping.target
    (True, '200.0', '50.0', 'concrete')
    """

    def __init__(self, ground: GroundSection, air: AirSection) -> None:
        self._terrain = Terrain(ground)
        self._blocks = [Block(box, self._terrain) for box in ground.boxes]
        self._echoes = [
            self._terrain.strip_echoes,
            self._terrain.step_echoes,
            *(block.echoes for block in self._blocks),
        ]
        self._air = air

    def elevation_m(self, north_m: float, east_m: float) -> float:
        """Height of the surface above the origin, objects included [m]."""
        elevation_m = self._terrain.elevation_m(north_m, east_m)
        for block in self._blocks:
            if block.top_m > elevation_m and block.covers(north_m, east_m):
                elevation_m = block.top_m
        return elevation_m

    def air_temperature_c(self, height_m: float) -> float:
        """Air temperature at a height above the origin [deg C]."""
        return self._air.mean_c(height_m, height_m)

    def ping(self, pose: Pose, beam: MountedBeam) -> Ping:
        """The truth of a ping that a sensor sends from this pose."""
        rotation = rotation_matrix(pose.roll_rad, pose.pitch_rad, pose.yaw_rad)
        north_m, east_m, down_m = pose.position_ned_m
        ahead_m, right_m, below_m = rotate(rotation, beam.position_m)
        sensor = (north_m + ahead_m, east_m + right_m, down_m + below_m)
        axis = rotate(rotation, beam.boresight)
        is_ray = beam.half_angle_rad is None
        echo = None if beam.half_angle_rad is None else self._nearest_echo(sensor, axis, beam.half_angle_rad)
        surface = echo or self._ray(sensor, axis)
        height_m = -sensor[2]
        if surface is None:
            return Ping(False, None, None, None, None, self.air_temperature_c(height_m), None, None)
        range_m, direction, slant_m, target, target_size_m = surface
        return Ping(
            echo is not None or is_ray,
            100 * range_m,
            100 * slant_m,
            math.degrees(math.acos(min(max(dot(direction, axis), -1.0), 1.0))),
            -100 * dot(pose.velocity_ned_m_s, direction),
            self._air.mean_c(height_m, height_m - range_m * direction[2]),
            target,
            None if target_size_m is None else 100 * target_size_m,
        )

    def height_m(self, pose: Pose) -> float:
        """Vertical distance from the body frame's origin to the surface below, objects included [m]."""
        north_m, east_m, down_m = pose.position_ned_m
        return -down_m - self.elevation_m(north_m, east_m)

    def down_axis_m(self, pose: Pose) -> float | None:
        """Distance to the surface along the body's down axis, as an autopilot expects it [m]; None if it meets
        nothing."""
        north, east, down = rotation_matrix(pose.roll_rad, pose.pitch_rad, pose.yaw_rad)
        below = self._ray(pose.position_ned_m, (north[2], east[2], down[2]))
        return below.slant_m if below else None

    def _nearest_echo(self, sensor: Vector, axis: Vector, half_angle_rad: HalfAngle) -> Echo | None:
        nearest, nearest_m = None, math.inf
        for echoes in self._echoes:
            for echo in echoes(sensor, axis, half_angle_rad, nearest_m):
                if echo.range_m < nearest_m and not self._is_covered(sensor, echo):
                    nearest, nearest_m = echo, echo.range_m
        return nearest

    def _is_covered(self, sensor: Vector, echo: Echo) -> bool:
        """Whether a block covers the point on the ground from which an echo would come."""
        if echo.target_size_m is not None:
            return False
        north_m = sensor[0] + echo.range_m * echo.direction[0]
        east_m = sensor[1] + echo.range_m * echo.direction[1]
        return any(block.covers(north_m, east_m) for block in self._blocks)

    def _ray(self, sensor: Vector, axis: Vector) -> Echo | None:
        first = self._terrain.ray(sensor, axis)
        for block in self._blocks:
            first = block.ray(sensor, axis, first.slant_m if first else math.inf) or first
        return first
