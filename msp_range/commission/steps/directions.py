"""Where each sensor looks, from the tilts at which it gets an echo of the floor, and what that means for the file.

An ultrasonic sensor gets an echo of a flat floor while the angle between its axis and straight down is smaller than its
beam's half angle, and reads the same distance wherever it looks within that. So the distances do not show the axis, and
the echoes do: over many tilts they outline a cone around it. The half angle itself is uncertain, so its scale is fitted
too. A sensor without a floor shows its direction by a board.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from msp_range.acoustics.beam import BreakawayTable
from msp_range.arrays import Array, angle_deg
from msp_range.commission.edit import Edit
from msp_range.commission.motion import Places
from msp_range.commission.outcome import StepOutcome
from msp_range.commission.samples import Samples
from msp_range.config import Airframe, SensorSettings

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
TURNED_DEG = 8.0
"""A direction in the file that differs by less [deg] stays, whatever the echoes exclude."""
LITTLE = 0.6
"""A sensor with less than this share of the best one's echoes looks aside, and its place is not compared: few readings
at the edge of its beam, among outliers, would place it."""
SEES_FLOOR = 0.3
"""A sensor that the file has looking elsewhere looks down if this share of its pings gets an echo of it."""
SIDES = {
    "front": (0, 0),
    "right": (0, 90),
    "rear": (0, 180),
    "left": (0, 270),
    "top": (90, 0),
}
"""Pitch and yaw of the direction to each side [deg]."""
SQUARE_DEG = 4
"""A direction this near to straight down is taken as that, however well it is known [deg]: more than the scatter of the
estimate. More would turn a sensor straight that is canted on purpose."""
BOARD_M = (0.25, 0.85)
"""Distances that a board half a metre away gives [m]."""


@dataclass(frozen=True)
class Axis:
    """Measured direction of a sensor's axis."""

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


def axis_of(
    samples: Samples, name: str, places: Places, position_m: Array, from_file: Array, beam: BreakawayTable
) -> Axis:
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
    answers = np.isin(readings.status, ("ok", "no_echo", "suspect"))
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
    top = max(grid.max(), of_file)
    is_likely = grid >= top - INTERVAL
    likely = AXES[is_likely]
    # Where whole regions are as likely (no tilt left the beam), their middle.
    middle = np.exp(grid[is_likely] - top) @ likely if len(likely) else from_file
    middle = middle / np.linalg.norm(middle)
    width = float(angle_deg(likely @ middle).max()) if len(likely) else STEP_DEG
    return Axis(
        (float(middle[0]), float(middle[1]), float(middle[2])),
        max(width, STEP_DEG),
        bool(of_file < top - EXCLUDED),
        float(angle_deg(middle @ from_file)),
        float(has_echo.mean()),
    )


def compare_directions(
    airframe: Airframe, lifted: Samples, boards: Mapping[str, Samples], found: Places, outcome: StepOutcome
) -> list[str]:
    """Add what the echoes say of the directions; names of sensors that see little of the floor."""
    without_floor, shares = [], {}
    for i, sensor in enumerate(airframe.sensors):
        if sensor.name not in lifted.readings:
            outcome.wrong(
                f"direction of {sensor.name}", "no reading", f"msp-range commission {airframe.path} --step wires"
            )
            continue
        if sensor.sensor_model.medium != "sound":
            outcome.unknown(f"direction of {sensor.name}", "a ray has no cone: not measured")
            continue
        measured = found.position_m.get(sensor.name)
        place = np.array([each.value for each in measured] if measured else sensor.position_m)
        axis = axis_of(lifted, sensor.name, found, place, np.array(sensor.boresight), sensor.sensor_model.beam)
        shares[sensor.name] = axis.floor_share
        looks_down = sensor.tilt_from_down_rad < math.radians(45)
        if not looks_down and axis.floor_share < SEES_FLOOR:
            outcome.right(f"direction of {sensor.name}", "it does not see the floor, as the file says")
        elif axis.boresight is None:
            without_floor.append(sensor.name)
            _by_board(i, sensor, boards, outcome)
        elif not looks_down or (axis.excluded and axis.from_file_deg > TURNED_DEG):
            pitch, yaw = rotation_of(axis.boresight, axis.half_width_deg)
            text = (
                f"{sensor.name} looks to pitch {pitch}, yaw {yaw} (to {axis.half_width_deg:.0f} deg), "
                f"{axis.from_file_deg:.0f} deg from pitch {sensor.rotation_deg.pitch:g}, yaw "
                f"{sensor.rotation_deg.yaw:g} in the file. Turn the sensor, or change the file"
            )
            outcome.propose(text, *_rotation(i, sensor, pitch, yaw))
        else:
            text = f"within {max(axis.from_file_deg, axis.half_width_deg):.0f} deg of what the file says"
            outcome.right(f"direction of {sensor.name}", text)
    if without_floor:
        outcome.measured["without_floor"] = without_floor
    most = max(shares.values(), default=0.0)
    return [name for name, share in shares.items() if share < LITTLE * most]


def rotation_of(boresight: tuple[float, float, float], to_deg: float) -> tuple[int, int]:
    """Pitch and yaw of a direction that is known to some degrees, in whole degrees; straight down is pitch -90, yaw 0.

    A direction whose interval includes straight down counts as that, since most mounts are square.

    Examples
    --------
    >>> rotation_of((0.0, 0.0, 1.0), 0.0), rotation_of((0.0, 0.5, 0.866), 0.0), rotation_of((-0.1, 0.0, 0.995), 7.0)
    ((-90, 0), (-60, 90), (-90, 0))
    """
    forward, to_right, down = boresight
    pitch = -round(math.degrees(math.asin(min(max(down, -1.0), 1.0))))
    if 90 - abs(pitch) <= max(to_deg, SQUARE_DEG):
        return (-90 if pitch < 0 else 90), 0
    return pitch, round(math.degrees(math.atan2(to_right, forward))) % 360


def _rotation(i: int, sensor: SensorSettings, pitch: int, yaw: int) -> tuple[Edit, ...]:
    return tuple(
        Edit(("sensors", i, "rotation_deg", key), value)
        for key, value in (("pitch", pitch), ("yaw", yaw))
        if getattr(sensor.rotation_deg, key) != value
    )


def _by_board(i: int, sensor: SensorSettings, boards: Mapping[str, Samples], outcome: StepOutcome) -> None:
    """Where a sensor looks that sees the floor at no tilt: to the side where it saw the board."""
    step = f"direction of {sensor.name}"
    seen = []
    for side, samples in boards.items():
        range_m = samples.readings[sensor.name].range_m if sensor.name in samples.readings else np.array([np.nan])
        if np.mean((range_m > BOARD_M[0]) & (range_m < BOARD_M[1])) > 0.5:
            seen.append(side)
    if len(seen) != 1:
        tried = "" if not boards else f", and the board at {'several sides' if seen else 'no side'}"
        remedy = "the file says that it looks down: turn it, clear what is in front of it, or correct rotation_deg"
        outcome.wrong(step, f"it sees the floor at no tilt{tried}", remedy)
        return
    pitch, yaw = SIDES[seen[0]]
    text = (
        f"{sensor.name} sees the board at the vehicle's {seen[0]} and the floor at no tilt, and the file has pitch "
        f"{sensor.rotation_deg.pitch:g}. Turn the sensor, or change the file to pitch {pitch}, yaw {yaw}"
    )
    outcome.propose(text, *_rotation(i, sensor, pitch, yaw))
