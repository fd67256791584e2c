"""Where each sensor looks, from the tilts at which it gets an echo of the floor.

An ultrasonic sensor gets an echo of a flat floor while the angle between its axis and straight down is smaller than its
beam's half angle, and reads the same distance wherever it looks within that. So the distances do not show the axis, and
the echoes do: over many tilts they outline a cone around it. The half angle itself is uncertain, so its scale is fitted
too.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from msp_range.arrays import Array, angle_deg
from msp_range.commission.motion import Places
from msp_range.commission.samples import Samples

FARTHEST_DEG, STEP_DEG = 60.0, 3.0
"""Axes up to the first angle from straight down are tried, this far apart [deg]. A sensor further away gets an echo
of the floor at no tilt of a hand."""
SCALES = np.array([0.7, 0.85, 1.0, 1.15, 1.35, 1.6])
SCALE_STD = 0.2
"""Factors on the half angle that are tried, and the standard deviation of their logarithm: it differs between floors,
sensors and supplies (docs/acoustics.md). With more, a sensor of which one edge is seen may look anywhere."""
EDGE_DEG = 2.5
"""The share of echoes falls from all to none over about four times this [deg]."""
MOST, LEAST = 0.95, 0.04
"""Share of echoes well inside and well outside of the beam: some are missed, and some readings hit by chance."""
OF_FLOOR_M = 0.12
"""A reading within this of the floor's distance [m] is an echo of the floor: five standard deviations."""
EXCLUDED = 8.0
"""An axis is excluded if its log likelihood is this much below the best one's: by chance once in 3000, since twice the
difference has a chi-squared distribution with two degrees of freedom."""
INTERVAL = 3.0
"""The same for the 95 % interval that is shown."""


class Beam(Protocol):
    """What is known of a sensor's beam: `msp_range.acoustics.beam.BreakawayTable` is one."""

    def half_angle_rad(self, range_m: Array) -> Array:
        """Largest angle with an echo [rad] at a range [m], shape (n,)."""


@dataclass(frozen=True)
class Axis:
    """Where a sensor looks."""

    boresight: tuple[float, float, float] | None
    """The likeliest axis: unit vector, forward, right, down; None where no tilt gave enough echoes."""
    half_width_deg: float
    """Half of the 95 % interval, as an angle from the likeliest axis [deg]."""
    excluded: bool
    """Whether the axis of the airframe file is excluded."""
    from_file_deg: float
    """Angle between it and the axis of the airframe file [deg]."""
    floor_share: float
    """Share of the pings that got an echo of the floor."""


def _grid() -> Array:
    steps = np.radians(np.arange(-FARTHEST_DEG, FARTHEST_DEG + STEP_DEG / 2, STEP_DEG))
    forward, right = (each.ravel() for each in np.meshgrid(steps, steps, indexing="ij"))
    off = np.hypot(forward, right)
    inside = off <= np.radians(FARTHEST_DEG) + 1e-9
    forward, right, off = forward[inside], right[inside], off[inside]
    share = np.sinc(off / np.pi)  # sin(off) / off
    return np.stack([forward * share, right * share, np.cos(off)], axis=1)


AXES = _grid()
"""Axes that are tried, unit vectors, shape (a, 3)."""


def axis_of(samples: Samples, name: str, places: Places, position_m: Array, from_file: Array, beam: Beam) -> Axis:
    """Where one sensor looks.

    Parameters
    ----------
    samples
        Readings and attitudes of the motion.
    name
        The sensor.
    places
        What was measured of places and heights.
    position_m
        Its place, shape (3,) [m].
    from_file
        Its axis in the airframe file, unit vector, shape (3,).
    beam
        Its beam.
    """
    readings = samples.readings[name]
    down = samples.down_at(readings.time_s, places.lag.value)
    floor_m = places.height_at(readings.time_s) - down @ position_m
    # On the ground a sensor reads its minimum wherever it looks; a fault says nothing of the floor.
    answers = np.array([each in ("ok", "no_echo", "suspect") for each in readings.status])
    used = answers & np.isfinite(floor_m) & (floor_m > 0.3)
    if used.sum() < 12:
        return Axis(None, np.nan, False, np.nan, 0.0)
    down, floor_m = down[used], floor_m[used]
    has_echo = np.abs(np.nan_to_num(readings.range_m[used], nan=-1.0) - floor_m) <= OF_FLOOR_M
    half_angle = np.degrees(beam.half_angle_rad(floor_m))
    candidates = np.vstack([AXES, from_file])
    off = angle_deg(candidates @ down.T)
    best = np.full(len(candidates), -np.inf)
    for scale in SCALES:
        inside = 1 / (1 + np.exp(-(scale * half_angle - off) / EDGE_DEG))
        share = LEAST + (MOST - LEAST) * inside
        likelihood = np.where(has_echo, np.log(share), np.log(1 - share)).sum(axis=1)
        best = np.maximum(best, likelihood - 0.5 * (np.log(scale) / SCALE_STD) ** 2)
    grid, of_file = best[:-1], best[-1]
    if has_echo.mean() < 2 * LEAST:
        return Axis(None, np.nan, True, np.nan, float(has_echo.mean()))
    top = max(float(grid.max()), float(of_file))
    likely = AXES[grid >= top - INTERVAL]
    # Where whole regions are as likely (no tilt left the beam), their middle.
    weight = np.exp(grid[grid >= top - INTERVAL] - top)
    middle = (weight[:, None] * likely).sum(axis=0) if len(likely) else from_file
    middle = middle / np.linalg.norm(middle)
    width = float(angle_deg(likely @ middle).max()) if len(likely) else STEP_DEG
    angle = float(angle_deg(middle @ from_file))
    return Axis(
        (float(middle[0]), float(middle[1]), float(middle[2])),
        max(width, STEP_DEG),
        bool(of_file < top - EXCLUDED),
        angle,
        float(has_echo.mean()),
    )
