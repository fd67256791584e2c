"""What a sensor on a tilted vehicle reads over a plane of ground, and how that depends on height and slope.

Frames: body FRD; level is north, east, down with the fused distance's reference point as origin (or the body's own
axes, where the attitude is not known). With G = (g_n, g_e, 1), g the rise of the ground per metre north and east, a
sensor at q that looks along the unit vector b, both in the level frame, over ground h below the origin, reads

    along its axis     r = (h - q . G) / (b . G)
    the nearest point  r = (h - q . G) / |G|
    not known which    r = (h - q . G) / the mean of the two
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

from msp_range.geometry import Matrix, Vector

Oblique = Literal["slant", "nearest", "unknown"]

LEVEL: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
_SHARE_SLANT = {"slant": 1.0, "nearest": 0.0, "unknown": 0.5}
STEEPEST = 0.2
"""A beam this flat to the ground meets it nowhere near: cosine of the angle to the ground's normal at least."""


class View(NamedTuple):
    """What a sensor should read, and what changes that.

    Attributes
    ----------
    expected_m
        Range over this ground [m].
    by_height, by_north, by_east
        Its derivatives: by the height [m/m] and by the two rises [m].
    shared_variance_m2
        Of the height, where it is not known which of the two it reads: ((slant - nearest) / 2)^2, else 0 [m^2]. It
        is the same error in every reading and does not average out.
    """

    expected_m: float
    by_height: float
    by_north: float
    by_east: float
    shared_variance_m2: float


@dataclass(frozen=True, slots=True)
class DownwardSensor:
    """Where a sensor that looks down sits and what it reads at an angle.

    Attributes
    ----------
    position_m
        From the fused distance's reference point, body FRD [m].
    boresight
        Unit vector along which it looks, body FRD.
    oblique
        What it reads over flat ground at an angle.
    garbled_from
        Answers that bytes lost or mixed up on the bus would make of the given one, by its driver.
    """

    position_m: Vector
    boresight: Vector
    oblique: Oblique
    garbled_from: Callable[[int], tuple[int, ...]] = lambda raw: ()

    def view(self, rotation: Matrix, height_m: float, rise_north: float, rise_east: float) -> View | None:
        """What it should read with the reference point ``height_m`` over the ground; None where it looks past it."""
        (nx, ny, nz), (ex, ey, ez), (dx, dy, dz) = rotation
        px, py, pz = self.position_m
        bx, by, bz = self.boresight
        q_north, q_east = nx * px + ny * py + nz * pz, ex * px + ey * py + ez * pz
        b_north, b_east = nx * bx + ny * by + nz * bz, ex * bx + ey * by + ez * bz
        over_m = height_m - (dx * px + dy * py + dz * pz) - rise_north * q_north - rise_east * q_east
        axis = dx * bx + dy * by + dz * bz + rise_north * b_north + rise_east * b_east
        if axis < STEEPEST:
            return None
        normal = math.sqrt(1.0 + rise_north * rise_north + rise_east * rise_east)
        slant = _SHARE_SLANT[self.oblique]
        nearest = 1.0 - slant
        divisor = slant * axis + nearest * normal
        range_m = over_m / divisor
        apart_m = range_m * (normal - axis) / 2 if slant == 0.5 else 0.0
        return View(
            range_m,
            1.0 / divisor,
            -(q_north + range_m * (slant * b_north + nearest * rise_north / normal)) / divisor,
            -(q_east + range_m * (slant * b_east + nearest * rise_east / normal)) / divisor,
            apart_m * apart_m,
        )
