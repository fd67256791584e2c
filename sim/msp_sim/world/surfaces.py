"""The ground and the objects on it, and the echoes that they return.

A scenario's `GroundSection` becomes `Terrain` and `Block`, which list the echoes of a ping and find where a ray ends.
The ground is a plane with a slope and with steps along one heading; upright boxes stand on it. World frame NED with its
origin on the ground; heights are above the origin, up positive.

A smooth face returns an echo like a mirror, from the foot of the perpendicular, if that lies within the breakaway angle
of the beam (report 4.3.3 measured this angle against a wall). The edge of a step or box returns an echo from its
nearest point within the beam. Not modelled: corner reflectors, shadows behind objects, echoes via a second surface.
"""

import math
from bisect import bisect_right
from collections.abc import Callable, Iterator
from typing import Annotated, Any, NamedTuple

from pydantic import BeforeValidator, Field, model_validator

from msp_range.geometry import Vector, dot
from msp_range.yaml_file import Section, suggest
from msp_sim.acoustics.materials import MATERIALS, find_material
from msp_sim.world.profiles import Positive

EDGE_REACH_M = 50.0
"""Half length of a step's edge [m], which stands for an infinite one: far beyond any beam."""
TOUCH_M = 1e-6
"""Depth below a surface at which a point still counts as on it [m]: rounding errors."""
MAX_ITERATIONS = 50
"""Largest number of iterations in which the point where an edge enters the beam is found; a few are typical."""
WAVES = 24
"""Number of sine waves of which a rough surface is the sum; more cost time and make it more Gaussian."""
GOLDEN_ANGLE_RAD = math.pi * (3 - math.sqrt(5))
PARALLEL = 1e-12
"""Leading coefficient below which a quadratic equation is solved as a linear one."""

HalfAngle = Callable[[float], float]
"""Half angle of the beam [rad] at a range [m]; does not grow with range."""


class GroundStep(Section):
    """A line across the ground where its height, its surface or both change."""

    at_m: float
    """distance from the origin along `steps_heading_deg` [m]"""
    rise_m: float = 0.0
    """how much higher the ground is beyond it; negative: lower [m]"""
    surface: str | None = None
    """name of the surface beyond it; default: the same as before"""


class Box(Section):
    """An upright object with a level top: a crate, a wall, a table."""

    surface: str = "box"
    """name of the object or its material"""
    centre_m: tuple[float, float]
    """north and east coordinates of its centre [m]"""
    size_m: tuple[Positive, Positive]
    """length along its heading, and width [m]"""
    height_m: Positive
    """height of its top above the ground at its centre [m]"""
    heading_deg: float = 0.0
    """heading of its length, from north to east [deg]"""


class Roughness(Section):
    """Roughness of a surface, constant in time."""

    rms_m: Annotated[float, Field(ge=0, le=0.2)]
    """root mean square of the height relative to the mean surface, from which heights above ground are counted [m]"""
    length_m: Annotated[float, Field(gt=0, le=10)] = 0.3
    """typical distance between two bumps [m]"""


def _known_roughness(given: Any) -> Any:
    if not isinstance(given, str):
        return given
    material = find_material(given)
    return Roughness(rms_m=material.rms_m, length_m=material.length_m)


NamedRoughness = Annotated[Roughness, BeforeValidator(_known_roughness, json_schema_input_type=Roughness | str)]
"""A roughness by its numbers, or by the name of a surface in `msp_sim.acoustics.materials`."""


class GroundSection(Section):
    """The ground and the objects on it."""

    surface: str = "grass"
    """name of the surface before the first step"""
    rough: dict[str, NamedRoughness] = Field(default_factory=dict)
    """roughness of surfaces of the ground by name: its numbers, or a known surface's name; the others, and the tops of
    boxes, are smooth"""
    slope_deg: Annotated[float, Field(ge=0, le=45)] = 0.0
    """slope of the ground [deg]"""
    uphill_deg: float = 0.0
    """heading in which the ground rises, from north to east [deg]"""
    steps_heading_deg: float = 0.0
    """heading along which the distances of steps are measured, from north to east [deg]"""
    steps: tuple[GroundStep, ...] = ()
    """steps in order of distance"""
    boxes: tuple[Box, ...] = ()
    """boxes in any order; they should not overlap"""

    @model_validator(mode="after")
    def _steps_in_order(self) -> "GroundSection":
        for before, after in zip(self.steps, self.steps[1:], strict=False):
            if after.at_m <= before.at_m:
                raise ValueError(f"expected steps in order of at_m, but {after.at_m} comes after {before.at_m}")
        return self

    @model_validator(mode="after")
    def _rough_surfaces_exist(self) -> "GroundSection":
        # Known surfaces too: which one the ground has may vary from flight to flight.
        known = dict.fromkeys([self.surface, *(step.surface for step in self.steps if step.surface), *MATERIALS])
        for name in self.rough:
            if name not in known:
                raise ValueError(f"rough: found {name!r}; expected one of {', '.join(known)}.{suggest(name, known)}")
        return self


class Echo(NamedTuple):
    """An echo of a ping, or the point where a ray ends."""

    range_m: float
    """Perpendicular distance to a face, distance to the nearest point of an edge [m]."""
    direction: Vector
    """Unit vector along which ``range_m`` is measured, away from the sensor, NED."""
    slant_m: float
    """Distance along the boresight to the face's plane; the same as ``range_m`` for an edge [m]."""
    target: str
    """Name of the surface."""
    target_size_m: float | None
    """Shorter side of a box [m]; None for the ground."""


_Found = tuple[float, Vector, float]
"""The first three of an `Echo`."""


def face_echo(range_m: float, into: Vector, axis: Vector, half_angle_rad: HalfAngle) -> _Found | None:
    """Echo of a smooth face whose perpendicular foot is ``range_m`` away along ``into``; None outside the beam."""
    cos_incidence = dot(axis, into)
    if cos_incidence <= 0 or cos_incidence < math.cos(half_angle_rad(range_m)):
        return None
    return range_m, into, range_m / cos_incidence


def edge_echo(
    point: Vector, along: Vector, low_m: float, high_m: float, axis: Vector, half_angle_rad: HalfAngle
) -> _Found | None:
    """Echo of a straight edge from its nearest point within the beam; None if it is outside.

    The edge is p + t d for low <= t <= high, p relative to the sensor and d a unit vector. It is within the cone of
    half angle a about the unit vector b where (b . p + t b . d)^2 >= cos(a)^2 |p + t d|^2, which is quadratic in t.
    """
    on_axis, axis_along, square, across = dot(point, axis), dot(along, axis), dot(point, point), dot(point, along)
    nearest_t = min(max(-across, low_m), high_m)
    t = nearest_t
    for _ in range(MAX_ITERATIONS):
        range_m = math.sqrt(max(square + t * (2 * across + t), 0.0))
        cos_half = math.cos(half_angle_rad(range_m))
        if on_axis + t * axis_along >= (range_m - TOUCH_M) * cos_half:
            break
        # The point is outside the beam at this range. The nearest point inside a cone of this angle is further away,
        # where the beam may be narrower. So the points only move outwards, until one is inside or there is none.
        ends = _cone_ends(on_axis, axis_along, square, across, cos_half)
        inside = [end for end in ends if low_m <= end <= high_m and on_axis + end * axis_along > 0]
        if not inside:
            return None
        t = min(inside, key=lambda end: abs(end - nearest_t))
    else:
        return None
    if range_m == 0:
        return 0.0, axis, 0.0
    direction = (
        (point[0] + t * along[0]) / range_m,
        (point[1] + t * along[1]) / range_m,
        (point[2] + t * along[2]) / range_m,
    )
    return range_m, direction, range_m


def _cone_ends(on_axis: float, axis_along: float, square: float, across: float, cos_half: float) -> tuple[float, ...]:
    """Parameters t at which a line crosses a cone's surface; see `edge_echo`."""
    k = cos_half * cos_half
    a = axis_along * axis_along - k
    b = on_axis * axis_along - k * across
    c = on_axis * on_axis - k * square
    if abs(a) < PARALLEL:
        return (-c / (2 * b),) if b else ()
    discriminant = b * b - a * c
    if discriminant < 0:
        return ()
    root = math.sqrt(discriminant)
    return ((-b - root) / a, (-b + root) / a)


class RoughSurface:
    """Height of a rough surface relative to its mean: a sum of waves of all directions, constant in time.

    Directions and phases are evenly distributed (golden angle), not random: the roughness is part of the scenario.
    """

    def __init__(self, roughness: Roughness) -> None:
        self._scale_m = roughness.rms_m * math.sqrt(2 / WAVES)
        self._waves = []
        for i in range(WAVES):
            # 0.7 to 1.4 waves per length.
            number = 2 * math.pi / roughness.length_m * 0.7 * 2 ** (i % 5 / 4)
            angle = i * GOLDEN_ANGLE_RAD
            self._waves.append((number * math.cos(angle), number * math.sin(angle), i * i * GOLDEN_ANGLE_RAD))

    def height_m(self, north_m: float, east_m: float) -> float:
        """Height relative to the mean surface [m]."""
        return self._scale_m * sum([math.cos(kn * north_m + ke * east_m + phase) for kn, ke, phase in self._waves])


class _Wall(NamedTuple):
    """The upright face of a step: its distance along the steps' heading, and the heights of its foot and edge [m].
    ``up`` is 1 if the ground is higher beyond it, -1 if lower, and ``into`` the horizontal unit vector into it; the
    surface is that of the higher side."""

    at_m: float
    low_m: float
    high_m: float
    up: float
    into: Vector
    surface: str


class Terrain:
    """The ground without the boxes: strips of one inclined plane, each raised by its own amount.

    With slope angle s, uphill unit vector u and rise r of a strip, its height is tan(s) (p . u) + r, and a point at
    height h is (h - tan(s) (p . u) - r) cos(s) from its plane.
    """

    def __init__(self, ground: GroundSection) -> None:
        slope_rad, uphill_rad = math.radians(ground.slope_deg), math.radians(ground.uphill_deg)
        heading_rad = math.radians(ground.steps_heading_deg)
        self._cos_slope = math.cos(slope_rad)
        self._heading_n, self._heading_e = math.cos(heading_rad), math.sin(heading_rad)
        self._grade_n = math.tan(slope_rad) * math.cos(uphill_rad)
        self._grade_e = math.tan(slope_rad) * math.sin(uphill_rad)
        self._into = (self._grade_n * self._cos_slope, self._grade_e * self._cos_slope, self._cos_slope)
        self._grade_along = self._grade_n * self._heading_n + self._grade_e * self._heading_e
        grade_across = self._grade_e * self._heading_n - self._grade_n * self._heading_e
        length = math.hypot(1.0, grade_across)
        self._lip = (-self._heading_e / length, self._heading_n / length, -grade_across / length)
        self._rough = {name: RoughSurface(roughness) for name, roughness in ground.rough.items()}
        self._starts_m = starts_m = [-math.inf, *(step.at_m for step in ground.steps)]
        rises_m, surfaces = [0.0], [ground.surface]
        self._walls = []
        for step in ground.steps:
            before_m, after_m = rises_m[-1], rises_m[-1] + step.rise_m
            before, after = surfaces[-1], step.surface or surfaces[-1]
            if step.rise_m:
                up = math.copysign(1.0, step.rise_m)
                into = (up * self._heading_n, up * self._heading_e, 0.0)
                low_m, high_m, surface = min((before_m, after_m, after), (after_m, before_m, before))
                self._walls.append(_Wall(step.at_m, low_m, high_m, up, into, surface))
            rises_m.append(after_m)
            surfaces.append(after)
        self._strips = list(zip(starts_m, [*starts_m[1:], math.inf], rises_m, surfaces, strict=True))

    def elevation_m(self, north_m: float, east_m: float) -> float:
        """Height of the ground above the origin [m]."""
        strip = bisect_right(self._starts_m, self._along_m(north_m, east_m)) - 1
        return self._plane_m(north_m, east_m) + self._strips[strip][2]

    def strip_echoes(self, sensor: Vector, axis: Vector, half_angle_rad: HalfAngle, within_m: float) -> Iterator[Echo]:
        """Echoes of the ground between its steps.

        Parameters
        ----------
        sensor, axis, half_angle_rad
            Position [m, NED], boresight and beam of the sensor.
        within_m
            Echoes that are not nearer than this are of no interest and may be left out [m].
        """
        x, base_m = self._above_start(sensor)
        into_along = self._grade_along * self._cos_slope
        for start_m, end_m, rise_m, surface in self._strips:
            range_m = (base_m - rise_m) * self._cos_slope
            if start_m <= x + range_m * into_along < end_m:
                if surface in self._rough:
                    foot = sensor[0] + range_m * self._into[0], sensor[1] + range_m * self._into[1]
                    range_m -= self._rough[surface].height_m(*foot) * self._cos_slope
                flat = face_echo(max(range_m, 0.0), self._into, axis, half_angle_rad)
                if flat:
                    yield Echo(*flat, surface, None)

    def step_echoes(self, sensor: Vector, axis: Vector, half_angle_rad: HalfAngle, within_m: float) -> Iterator[Echo]:
        """Echoes of the steps; parameters as for `strip_echoes`."""
        x, base_m = self._above_start(sensor)
        for at_m, low_m, high_m, up, into, surface in self._walls:
            ahead_m = at_m - x
            if abs(ahead_m) >= within_m:
                continue
            faces = up * ahead_m > 0
            over_m = base_m - self._grade_along * ahead_m
            if faces and low_m < over_m < high_m:
                wall = face_echo(abs(ahead_m), into, axis, half_angle_rad)
                if wall:
                    yield Echo(*wall, surface, None)
            if faces or base_m > high_m:
                lip = (self._heading_n * ahead_m, self._heading_e * ahead_m, over_m - high_m)
                edge = edge_echo(lip, self._lip, -EDGE_REACH_M, EDGE_REACH_M, axis, half_angle_rad)
                if edge:
                    yield Echo(*edge, surface, None)

    def ray(self, sensor: Vector, axis: Vector) -> Echo | None:
        """First point where a ray meets the ground; its range is the perpendicular distance to that plane."""
        x, base_m = self._above_start(sensor)
        ahead = self._along_m(axis[0], axis[1])
        # Loss of height above the planes per metre of the ray.
        sinks = axis[2] + self._plane_m(axis[0], axis[1])
        first: Echo | None = None
        first_m = math.inf
        if sinks > 0:
            for start_m, end_m, rise_m, surface in self._strips:
                over_m = base_m - rise_m
                slant_m = over_m / sinks if over_m > 0.0 else 0.0
                if slant_m < first_m and over_m >= -TOUCH_M and start_m <= x + slant_m * ahead < end_m:
                    first_m = slant_m
                    first = Echo(slant_m * sinks * self._cos_slope, self._into, slant_m, surface, None)
        for at_m, low_m, high_m, up, into, surface in self._walls:
            if up * ahead > 0 and up * (at_m - x) > 0:
                slant_m = (at_m - x) / ahead
                if slant_m < first_m and low_m < base_m - slant_m * sinks < high_m:
                    first_m = slant_m
                    first = Echo(abs(at_m - x), into, slant_m, surface, None)
        return first

    def _above_start(self, sensor: Vector) -> tuple[float, float]:
        """Where a sensor is along the steps, and how high above the slope without them [m]."""
        return self._along_m(sensor[0], sensor[1]), -sensor[2] - self._plane_m(sensor[0], sensor[1])

    def _along_m(self, north_m: float, east_m: float) -> float:
        """Distance along the steps' heading [m]."""
        return north_m * self._heading_n + east_m * self._heading_e

    def _plane_m(self, north_m: float, east_m: float) -> float:
        """Height of the first strip's plane [m]."""
        return north_m * self._grade_n + east_m * self._grade_e


class Block:
    """A `Box` on the ground. Its own frame: x along its heading, y across, z down, origin at the centre of its top."""

    def __init__(self, box: Box, terrain: Terrain) -> None:
        self._terrain = terrain
        self._surface = box.surface
        self._size_m = min(box.size_m)
        self._north_m, self._east_m = box.centre_m
        self._half_x, self._half_y = box.size_m[0] / 2, box.size_m[1] / 2
        heading_rad = math.radians(box.heading_deg)
        self._cos, self._sin = math.cos(heading_rad), math.sin(heading_rad)
        self.top_m = terrain.elevation_m(self._north_m, self._east_m) + box.height_m
        corners = [(sx * self._half_x, sy * self._half_y) for sx in (-1, 1) for sy in (-1, 1)]
        lowest_m = min(terrain.elevation_m(*self._place(x, y)) for x, y in corners)
        self._half_height_m = max(self.top_m - lowest_m, box.height_m) / 2
        self._radius_m = math.hypot(self._half_x, self._half_y, self._half_height_m)
        self._limits_m = ((-self._half_x, self._half_x), (-self._half_y, self._half_y), (-self.top_m, math.inf))

    def covers(self, north_m: float, east_m: float) -> bool:
        """Whether this position on the ground is covered by the box."""
        north_m, east_m = north_m - self._north_m, east_m - self._east_m
        if abs(self._cos * north_m + self._sin * east_m) > self._half_x:
            return False
        return abs(self._cos * east_m - self._sin * north_m) <= self._half_y

    def echoes(self, sensor: Vector, axis: Vector, half_angle_rad: HalfAngle, within_m: float) -> Iterator[Echo]:
        """Echoes of the box; parameters as for `Terrain.strip_echoes`."""
        if not self._may_return_echo(sensor, axis, half_angle_rad, within_m):
            return
        half_x, half_y = self._half_x, self._half_y
        x, y = self._turn(sensor[0] - self._north_m, sensor[1] - self._east_m)
        above_m = -sensor[2] - self.top_m
        own_axis = (*self._turn(axis[0], axis[1]), axis[2])
        beside_x, beside_y = abs(x) > half_x, abs(y) > half_y
        if not (beside_x or beside_y):
            top = face_echo(max(above_m, 0.0), (0.0, 0.0, 1.0), own_axis, half_angle_rad)
            if top:
                yield self._echo(top)
                return
        if above_m < 0 and beside_x != beside_y:
            # In front of one of its sides, below its top.
            range_m = abs(x) - half_x if beside_x else abs(y) - half_y
            into = (-math.copysign(1.0, x), 0.0, 0.0) if beside_x else (0.0, -math.copysign(1.0, y), 0.0)
            foot = self._place(x + range_m * into[0], y + range_m * into[1])
            side = face_echo(range_m, into, own_axis, half_angle_rad)
            if side and -sensor[2] > self._terrain.elevation_m(*foot):
                yield self._echo(side)
        for edge in self._edges(x, y, above_m):
            point = edge_echo(*edge, own_axis, half_angle_rad)
            if point:
                yield self._echo(point)

    def ray(self, sensor: Vector, axis: Vector, within_m: float) -> Echo | None:
        """Point where a ray enters the box from outside, if it is nearer than ``within_m`` along it.

        The box is treated as extending down without limit.
        """
        north_m, east_m = sensor[0] - self._north_m, sensor[1] - self._east_m
        if max(abs(north_m), abs(east_m)) - self._radius_m > within_m * math.hypot(axis[0], axis[1]):
            return None  # The ray does not get as far as that sideways.
        x, y = self._turn(north_m, east_m)
        own_axis = (*self._turn(axis[0], axis[1]), axis[2])
        enters_m, leaves_m, side = -math.inf, math.inf, 0
        for i, (own_m, (low_m, high_m)) in enumerate(zip((x, y, sensor[2]), self._limits_m, strict=True)):
            if own_axis[i] == 0:
                if not low_m <= own_m <= high_m:
                    return None
                continue
            if own_axis[i] < 0:
                low_m, high_m = high_m, low_m
            first_m, last_m = (low_m - own_m) / own_axis[i], (high_m - own_m) / own_axis[i]
            if first_m > enters_m:
                enters_m, side = first_m, i
            if last_m < leaves_m:
                leaves_m = last_m
            if leaves_m < enters_m or leaves_m < -TOUCH_M or enters_m >= within_m:
                return None
        if enters_m < -TOUCH_M:
            return None
        slant_m = max(enters_m, 0.0)
        sign = math.copysign(1.0, own_axis[side])
        into = (sign if side == 0 else 0.0, sign if side == 1 else 0.0, sign if side == 2 else 0.0)
        return self._echo((slant_m * abs(own_axis[side]), into, slant_m))

    def _may_return_echo(self, sensor: Vector, axis: Vector, half_angle_rad: HalfAngle, within_m: float) -> bool:
        """Quick test: False if the sphere around the box lies outside the beam, or beyond ``within_m``."""
        middle_down_m = self._half_height_m - self.top_m
        to_middle = (self._north_m - sensor[0], self._east_m - sensor[1], middle_down_m - sensor[2])
        distance_m = math.sqrt(dot(to_middle, to_middle))
        if distance_m <= self._radius_m:
            return True
        if distance_m - self._radius_m >= within_m:
            return False
        angle_rad = math.acos(min(max(dot(to_middle, axis) / distance_m, -1.0), 1.0))
        return angle_rad <= half_angle_rad(distance_m - self._radius_m) + math.asin(self._radius_m / distance_m)

    def _edges(self, x: float, y: float, above_m: float) -> Iterator[tuple[Vector, Vector, float, float]]:
        """Edges visible from (x, y) at this height above its top, as arguments for `edge_echo`."""
        half_x, half_y = self._half_x, self._half_y
        for sign in (-1.0, 1.0):
            if above_m > 0 or sign * x > half_x:
                yield (sign * half_x - x, -y, above_m), (0.0, 1.0, 0.0), -half_y, half_y
            if above_m > 0 or sign * y > half_y:
                yield (-x, sign * half_y - y, above_m), (1.0, 0.0, 0.0), -half_x, half_x
        for sign_x in (-1.0, 1.0):
            for sign_y in (-1.0, 1.0):
                if sign_x * x > half_x or sign_y * y > half_y:
                    corner_x, corner_y = sign_x * half_x, sign_y * half_y
                    down_m = max(self.top_m - self._terrain.elevation_m(*self._place(corner_x, corner_y)), 0.0)
                    yield (corner_x - x, corner_y - y, above_m), (0.0, 0.0, 1.0), 0.0, down_m

    def _turn(self, north: float, east: float) -> tuple[float, float]:
        """Rotate a vector into the box's frame."""
        return self._cos * north + self._sin * east, self._cos * east - self._sin * north

    def _place(self, x: float, y: float) -> tuple[float, float]:
        """North and east coordinates of a point in the box's frame [m]."""
        return self._north_m + self._cos * x - self._sin * y, self._east_m + self._sin * x + self._cos * y

    def _echo(self, found: _Found) -> Echo:
        range_m, (x, y, z), slant_m = found
        direction = (self._cos * x - self._sin * y, self._sin * x + self._cos * y, z)
        return Echo(range_m, direction, slant_m, self._surface, self._size_m)
