"""The ground and the objects on it, and which of them a beam hears.

`GroundSection`, a scenario's section, enters; `Terrain` and `Block` leave, which list the echoes of a ping and what a ray
meets. The ground is a plane with a slope and with steps along one heading; upright boxes stand on it. World frame NED,
its origin on the ground; heights are over the origin, up positive.

What a sensor hears of a smooth face is the echo from the foot of the perpendicular, as from a mirror, where that foot
lies within the breakaway angle of the beam (the report's 4.3.3 measured that angle against a wall). The edge of a step
or of a box answers from its nearest point within the beam. Corners that reflect back whatever comes, shadows behind
objects and echoes by way of a second surface are left out.
"""

import math
from collections.abc import Callable, Iterator
from typing import Annotated, NamedTuple

from pydantic import Field, model_validator

from msp_range.geometry import Vector, dot
from msp_range.yaml_file import Section
from msp_sim.world.profiles import Positive

EDGE_REACH_M = 50.0
"""How far to either side the edge of a step is looked at; it has no ends [m]."""
TOUCH_M = 1e-6
"""A point that is no deeper in a surface than this stands on it [m]."""
MOST_STEPS = 50
"""An edge that touches the beam's limit is followed along it for so many steps."""
WAVES = 24
"""Waves that make up a rough surface."""
GOLDEN_ANGLE_RAD = math.pi * (3 - math.sqrt(5))
PARALLEL = 1e-12
"""Below this a quadratic is taken for linear."""

HalfAngle = Callable[[float], float]
"""Largest angle off the boresight [rad] from which an echo at a range [m] is heard; does not grow with range."""


class GroundStep(Section):
    """A line across the ground where its height, its surface or both change."""

    at_m: float
    """where, as a distance from the origin along `steps_heading_deg` [m]"""
    rise_m: float = 0.0
    """how much higher the ground is beyond it; negative where it is lower [m]"""
    surface: str | None = None
    """name of the surface beyond it; as before it where absent"""


class Box(Section):
    """An upright object with a level top: a crate, a wall, a table."""

    surface: str = "box"
    """name of what it is or is made of"""
    centre_m: tuple[float, float]
    """north and east of its middle [m]"""
    size_m: tuple[Positive, Positive]
    """along its heading and across [m]"""
    height_m: Positive
    """of its top over the ground at its middle [m]"""
    heading_deg: float = 0.0
    """how it is turned, from north to east [deg]"""


class Roughness(Section):
    """Tufts and hollows of a surface, which stay where they are."""

    rms_m: Annotated[float, Field(gt=0, le=0.2)]
    """root mean square of their heights over the mean surface, which is what heights above ground count from [m]"""
    length_m: Annotated[float, Field(gt=0, le=10)] = 0.3
    """typical distance from one tuft to the next [m]"""


class GroundSection(Section):
    """What lies and stands below."""

    surface: str = "grass"
    """name of the surface before the first step"""
    rough: dict[str, Roughness] = Field(default_factory=dict)
    """how rough surfaces are, by name; the others, and the tops of boxes, are smooth"""
    slope_deg: Annotated[float, Field(ge=0, le=45)] = 0.0
    """how steeply the ground rises [deg]"""
    uphill_deg: float = 0.0
    """heading in which it rises, from north to east [deg]"""
    steps_heading_deg: float = 0.0
    """heading along which the steps' distances are counted, from north to east [deg]"""
    steps: tuple[GroundStep, ...] = ()
    """in order of distance"""
    boxes: tuple[Box, ...] = ()
    """in any order; they should not overlap"""

    @model_validator(mode="after")
    def _steps_in_order(self) -> "GroundSection":
        for before, after in zip(self.steps, self.steps[1:], strict=False):
            if after.at_m <= before.at_m:
                raise ValueError(f"expected steps in order of at_m, but {after.at_m} comes after {before.at_m}")
        return self


class Echo(NamedTuple):
    """What answers a ping, or what a ray meets.

    Attributes
    ----------
    range_m
        Perpendicular distance to a face, distance to the nearest point of an edge [m].
    direction
        Unit vector along which ``range_m`` is measured, away from the sensor, NED.
    slant_m
        Distance along the boresight to the face's plane; the same as ``range_m`` for an edge [m].
    target
        Name of the surface.
    target_size_m
        Shorter side of a box [m]; None for the ground.
    """

    range_m: float
    direction: Vector
    slant_m: float
    target: str
    target_size_m: float | None


_Found = tuple[float, Vector, float]
"""The first three of an `Echo`."""


def face_echo(range_m: float, into: Vector, axis: Vector, half_angle_rad: HalfAngle) -> _Found | None:
    """The echo of a smooth face whose perpendicular foot is ``range_m`` away along ``into``; None where unheard."""
    cos_incidence = dot(axis, into)
    if cos_incidence <= 0 or cos_incidence < math.cos(half_angle_rad(range_m)):
        return None
    return range_m, into, range_m / cos_incidence


def edge_echo(
    point: Vector, along: Vector, low_m: float, high_m: float, axis: Vector, half_angle_rad: HalfAngle
) -> _Found | None:
    """The echo of a straight edge from its nearest point within the beam; None where it is outside.

    The edge is p + t d for low <= t <= high, p relative to the sensor and d a unit vector. It is within the cone of
    half angle a about the unit vector b where (b . p + t b . d)^2 >= cos(a)^2 |p + t d|^2, which is quadratic in t.
    """
    on_axis, axis_along, square, across = dot(point, axis), dot(along, axis), dot(point, point), dot(point, along)
    nearest_t = min(max(-across, low_m), high_m)
    t = nearest_t
    range_m = math.sqrt(max(square + t * (2 * across + t), 0.0))
    cos_half = math.cos(half_angle_rad(range_m))
    for _ in range(MOST_STEPS):
        if on_axis + t * axis_along >= (range_m - TOUCH_M) * cos_half:
            break
        # Outside the beam that is this wide. Its end nearest to here is further away, where the beam may be narrower
        # still: the ends move one way only, until one is inside or there is none.
        ends = _cone_ends(on_axis, axis_along, square, across, cos_half)
        inside = [end for end in ends if low_m <= end <= high_m and on_axis + end * axis_along > 0]
        if not inside:
            return None
        t = min(inside, key=lambda end: abs(end - nearest_t))
        range_m = math.sqrt(max(square + t * (2 * across + t), 0.0))
        cos_half = math.cos(half_angle_rad(range_m))
    if range_m == 0:
        return 0.0, axis, 0.0
    direction = (
        (point[0] + t * along[0]) / range_m,
        (point[1] + t * along[1]) / range_m,
        (point[2] + t * along[2]) / range_m,
    )
    return range_m, direction, range_m


def _cone_ends(on_axis: float, axis_along: float, square: float, across: float, cos_half: float) -> tuple[float, ...]:
    """Where a line crosses a cone's surface; see `edge_echo`."""
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


class Tufts:
    """Heights of a rough surface over its mean: a sum of waves of all directions, the same whenever it is asked.

    Directions and phases are spread evenly (golden angle), not drawn: the roughness is part of the scenario.
    """

    def __init__(self, roughness: Roughness) -> None:
        self._scale_m = roughness.rms_m * math.sqrt(2 / WAVES)
        self._waves = []
        for i in range(WAVES):
            # From 0.7 to 1.4 waves in a length.
            number = 2 * math.pi / roughness.length_m * 0.7 * 2 ** (i % 5 / 4)
            angle = i * GOLDEN_ANGLE_RAD
            self._waves.append((number * math.cos(angle), number * math.sin(angle), i * i * GOLDEN_ANGLE_RAD))

    def height_m(self, north_m: float, east_m: float) -> float:
        """Over the mean surface [m]."""
        return self._scale_m * sum([math.cos(kn * north_m + ke * east_m + phase) for kn, ke, phase in self._waves])


class _Wall(NamedTuple):
    """The upright face of a step: its distance along the steps' heading, and the rises at its foot and its lip [m].
    ``up`` is 1 where the ground is higher beyond it, -1 where it is lower; the surface is that of the higher side."""

    at_m: float
    low_m: float
    high_m: float
    up: float
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
        self._tufts = {name: Tufts(roughness) for name, roughness in ground.rough.items()}
        starts_m = [-math.inf, *(step.at_m for step in ground.steps)]
        rises_m, surfaces = [0.0], [ground.surface]
        self._walls = []
        for step in ground.steps:
            before_m, after_m = rises_m[-1], rises_m[-1] + step.rise_m
            before, after = surfaces[-1], step.surface or surfaces[-1]
            if step.rise_m > 0:
                self._walls.append(_Wall(step.at_m, before_m, after_m, 1.0, after))
            elif step.rise_m < 0:
                self._walls.append(_Wall(step.at_m, after_m, before_m, -1.0, before))
            rises_m.append(after_m)
            surfaces.append(after)
        self._strips = list(zip(starts_m, [*starts_m[1:], math.inf], rises_m, surfaces, strict=True))

    def elevation_m(self, north_m: float, east_m: float) -> float:
        """Height of the ground over the origin [m]."""
        x = self._along_m(north_m, east_m)
        rise_m = 0.0
        for start_m, _, strip_rise_m, _ in self._strips:
            if x < start_m:
                break
            rise_m = strip_rise_m
        return self._plane_m(north_m, east_m) + rise_m

    def echoes(self, sensor: Vector, axis: Vector, half_angle_rad: HalfAngle) -> Iterator[Echo]:
        """Whatever of the ground is heard from ``sensor`` [m, NED] looking along ``axis``, in no order."""
        x = self._along_m(sensor[0], sensor[1])
        base_m = -sensor[2] - self._plane_m(sensor[0], sensor[1])
        into_along = self._grade_along * self._cos_slope
        for start_m, end_m, rise_m, surface in self._strips:
            range_m = (base_m - rise_m) * self._cos_slope
            if start_m <= x + range_m * into_along < end_m:
                if surface in self._tufts:
                    foot = sensor[0] + range_m * self._into[0], sensor[1] + range_m * self._into[1]
                    range_m -= self._tufts[surface].height_m(*foot) * self._cos_slope
                flat = face_echo(max(range_m, 0.0), self._into, axis, half_angle_rad)
                if flat:
                    yield Echo(*flat, surface, None)
        for at_m, low_m, high_m, up, surface in self._walls:
            ahead_m = at_m - x
            faces = up * ahead_m > 0
            over_m = base_m - self._grade_along * ahead_m
            if faces and low_m < over_m < high_m:
                toward = (up * self._heading_n, up * self._heading_e, 0.0)
                wall = face_echo(abs(ahead_m), toward, axis, half_angle_rad)
                if wall:
                    yield Echo(*wall, surface, None)
            if faces or base_m > high_m:
                lip = (self._heading_n * ahead_m, self._heading_e * ahead_m, over_m - high_m)
                edge = edge_echo(lip, self._lip, -EDGE_REACH_M, EDGE_REACH_M, axis, half_angle_rad)
                if edge:
                    yield Echo(*edge, surface, None)

    def ray(self, sensor: Vector, axis: Vector) -> Echo | None:
        """Where a ray first meets the ground; its range is the perpendicular to the plane that it meets."""
        x = self._along_m(sensor[0], sensor[1])
        base_m = -sensor[2] - self._plane_m(sensor[0], sensor[1])
        ahead = self._along_m(axis[0], axis[1])
        # Height over the planes that a metre of the ray loses.
        sinks = axis[2] + self._plane_m(axis[0], axis[1])
        found = []
        if sinks > 0:
            for start_m, end_m, rise_m, surface in self._strips:
                over_m = base_m - rise_m
                slant_m = max(over_m, 0.0) / sinks
                if over_m >= -TOUCH_M and start_m <= x + slant_m * ahead < end_m:
                    found.append(Echo(slant_m * sinks * self._cos_slope, self._into, slant_m, surface, None))
        for at_m, low_m, high_m, up, surface in self._walls:
            if up * ahead > 0 and up * (at_m - x) > 0:
                slant_m = (at_m - x) / ahead
                if low_m < base_m - slant_m * sinks < high_m:
                    toward = (up * self._heading_n, up * self._heading_e, 0.0)
                    found.append(Echo(abs(at_m - x), toward, slant_m, surface, None))
        return min(found, key=lambda echo: echo.slant_m, default=None)

    def _along_m(self, north_m: float, east_m: float) -> float:
        """Distance along the steps' heading [m]."""
        return north_m * self._heading_n + east_m * self._heading_e

    def _plane_m(self, north_m: float, east_m: float) -> float:
        """Height of the first strip's plane [m]."""
        return north_m * self._grade_n + east_m * self._grade_e


class Block:
    """A `Box` on the ground. Its own frame: x along its heading, y across, z down, origin in the middle of its top."""

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

    def covers(self, north_m: float, east_m: float) -> bool:
        """Whether this place on the ground is below it."""
        north_m, east_m = north_m - self._north_m, east_m - self._east_m
        along_m, across_m = self._cos * north_m + self._sin * east_m, self._cos * east_m - self._sin * north_m
        return -self._half_x <= along_m <= self._half_x and -self._half_y <= across_m <= self._half_y

    def echoes(self, sensor: Vector, axis: Vector, half_angle_rad: HalfAngle) -> Iterator[Echo]:
        """Whatever of it is heard from ``sensor`` [m, NED] looking along ``axis``, in no order."""
        if not self._may_be_heard(sensor, axis, half_angle_rad):
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
            # Level with its side and in front of it.
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

    def ray(self, sensor: Vector, axis: Vector) -> Echo | None:
        """Where a ray enters it from outside; it is taken to reach down without end."""
        x, y = self._turn(sensor[0] - self._north_m, sensor[1] - self._east_m)
        own_axis = (*self._turn(axis[0], axis[1]), axis[2])
        enters_m, leaves_m, side = -math.inf, math.inf, 0
        limits = ((-self._half_x, self._half_x), (-self._half_y, self._half_y), (-self.top_m, math.inf))
        for i, (own_m, (low_m, high_m)) in enumerate(zip((x, y, sensor[2]), limits, strict=True)):
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
            if leaves_m < enters_m or leaves_m < -TOUCH_M:
                return None
        if enters_m < -TOUCH_M:
            return None
        slant_m = max(enters_m, 0.0)
        sign = math.copysign(1.0, own_axis[side])
        into = (sign if side == 0 else 0.0, sign if side == 1 else 0.0, sign if side == 2 else 0.0)
        return self._echo((slant_m * abs(own_axis[side]), into, slant_m))

    def _may_be_heard(self, sensor: Vector, axis: Vector, half_angle_rad: HalfAngle) -> bool:
        """False where the sphere around it lies outside the beam; quick."""
        middle_down_m = self._half_height_m - self.top_m
        to_middle = (self._north_m - sensor[0], self._east_m - sensor[1], middle_down_m - sensor[2])
        distance_m = math.sqrt(dot(to_middle, to_middle))
        if distance_m <= self._radius_m:
            return True
        angle_rad = math.acos(min(max(dot(to_middle, axis) / distance_m, -1.0), 1.0))
        return angle_rad <= half_angle_rad(distance_m - self._radius_m) + math.asin(self._radius_m / distance_m)

    def _edges(self, x: float, y: float, above_m: float) -> Iterator[tuple[Vector, Vector, float, float]]:
        """The edges to be seen from (x, y) and this height over its top, as `edge_echo` takes them."""
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
        """Into its own frame."""
        return self._cos * north + self._sin * east, self._cos * east - self._sin * north

    def _place(self, x: float, y: float) -> tuple[float, float]:
        """North and east of a point in its own frame [m]."""
        return self._north_m + self._cos * x - self._sin * y, self._east_m + self._sin * x + self._cos * y

    def _echo(self, found: _Found) -> Echo:
        range_m, (x, y, z), slant_m = found
        direction = (self._cos * x - self._sin * y, self._sin * x + self._cos * y, z)
        return Echo(range_m, direction, slant_m, self._surface, self._size_m)
