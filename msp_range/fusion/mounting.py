"""What a sensor on a tilted vehicle reads over a plane of ground, and how that depends on height and slope.

Frames: body FRD; level is north, east, down with the fused distance's reference point as origin (or the body's own
axes, where the attitude is not known). With G = (g_n, g_e, 1), g the rise of the ground per metre north and east, a
sensor at q that looks along the unit vector b, both in the level frame, over ground h below the origin, reads

    along its axis     r = (h - q . G) / (b . G)
    the nearest point  r = (h - q . G) / |G|
    not known which    r = (h - q . G) / the mean of the two
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

from msp_range.geometry import Matrix, Vector, dot, rotate

Oblique = Literal["slant", "nearest", "unknown"]

LEVEL: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
_SHARE_SLANT = {"slant": 1.0, "nearest": 0.0, "unknown": 0.5}
STEEPEST = 0.2
"""A beam this flat to the ground meets it nowhere near: cosine of the angle to the ground's normal at least."""

NARROWEST_M = 0.1
"""Root of the summed squared distances from the best line through them that sensors must have to show a slope [m]: a
difference of a centimetre between two sensors is then no more slope than ground usually has. Smaller learns slope from
how the vehicle sways, larger learns none below a small vehicle."""


class View(NamedTuple):
    """What a sensor should read, and what changes that."""

    expected_m: float
    """Range over this ground [m]."""
    by_height: float
    by_north: float
    by_east: float
    """Derivatives of that range: by the height [m/m], and over level ground by the two rises [m]."""
    shared_variance_m2: float
    """Variance of the height, where it is not known which of the two it reads: ((slant - nearest) / 2)^2, else 0 [m^2].
    It is the same error in every reading and does not average out."""
    nearest: float = 0.0
    """Share of the range to the nearest point in it: 0, 0.5 or 1."""


@dataclass(frozen=True, slots=True)
class DownwardSensor:
    """Where a sensor that looks down sits and what it reads at an angle."""

    position_m: Vector
    """Position from the fused distance's reference point, body FRD [m]."""
    boresight: Vector
    """Unit vector along which it looks, body FRD."""
    oblique: Oblique
    """What it reads over flat ground at an angle."""
    garbled_from: Callable[[int], tuple[int, ...]] = lambda raw: ()
    """Answers that bytes lost or mixed up on the bus would make of the given one, by its driver."""
    facing: float = -1.0
    """Cosine of the largest angle from straight down at which level ground at its maximum gives it an echo."""

    def turned(self, rotation: Matrix) -> "TurnedSensor":
        """The sensor on a vehicle that is turned so: body to north, east, down."""
        return TurnedSensor(rotate(rotation, self.position_m), rotate(rotation, self.boresight), self.slant)

    @property
    def slant(self) -> float:
        """Share of the range along its axis in what it reads: 0, 0.5 or 1."""
        return _SHARE_SLANT[self.oblique]

    def faces_ground(self, down: Vector) -> bool:
        """Whether level ground at its maximum gives it an echo; ``down`` is straight down, body FRD."""
        return dot(self.boresight, down) >= self.facing

    def foot_m(self, range_m: float) -> tuple[float, float]:
        """Where it reads ``range_m`` of the ground: forward and right of the reference point, body axes [m]."""
        along_m = self.slant * range_m
        return self.position_m[0] + along_m * self.boresight[0], self.position_m[1] + along_m * self.boresight[1]


class TurnedSensor(NamedTuple):
    """A sensor in the level frame: its place [m], the unit vector along which it looks, and `DownwardSensor.slant`."""

    position_m: Vector
    boresight: Vector
    slant: float

    def view(self, height_m: float, rise_north: float, rise_east: float) -> View | None:
        """What it should read with the reference point ``height_m`` over the ground; None where it looks past it."""
        (q_north, q_east, q_down), (b_north, b_east, b_down), slant = self
        axis = b_down + rise_north * b_north + rise_east * b_east
        if axis < STEEPEST:
            return None
        level_m = height_m - q_down
        normal = math.sqrt(1.0 + rise_north * rise_north + rise_east * rise_east)
        nearest = 1.0 - slant
        divisor = slant * axis + nearest * normal
        range_m = (level_m - rise_north * q_north - rise_east * q_east) / divisor
        apart_m = range_m * (normal - axis) / 2 if slant == 0.5 else 0.0
        # Derivatives by the rises are those over level ground: at the estimate a filter would learn slope from itself.
        level = slant * b_down + nearest
        beam_m = slant * level_m / level
        return View(
            range_m,
            1.0 / divisor,
            -(q_north + beam_m * b_north) / level,
            -(q_east + beam_m * b_east) / level,
            apart_m * apart_m,
            nearest,
        )


def spans_plane(feet_m: Sequence[tuple[float, float]]) -> bool:
    """Whether places on the ground lie so far from any one line through them that their heights show a slope."""
    if len(feet_m) < 3:
        return False
    middle_x, middle_y = (sum(column) / len(feet_m) for column in zip(*feet_m, strict=True))
    xx = yy = xy = 0.0
    for x, y in feet_m:
        x, y = x - middle_x, y - middle_y
        xx, yy, xy = xx + x * x, yy + y * y, xy + x * y
    # The smaller eigenvalue of [[xx, xy], [xy, yy]] is the sum of squared distances from the best line.
    return xx + yy - math.hypot(xx - yy, 2 * xy) > 2 * NARROWEST_M * NARROWEST_M
