"""What the echoes of the lift mean for the directions of the sensors, and those of a board for one without a floor."""

import math
from collections.abc import Mapping

import numpy as np

from msp_range.commission.edit import Edit
from msp_range.commission.look import Axis, axis_of
from msp_range.commission.motion import Places
from msp_range.commission.outcome import Proposal, StepOutcome
from msp_range.commission.samples import Samples
from msp_range.config import Airframe, SensorSettings

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


def compare_directions(
    airframe: Airframe, lifted: Samples, boards: Mapping[str, Samples], found: Places, outcome: StepOutcome
) -> list[str]:
    """Add what the echoes say of the directions; names of sensors that see little of the floor."""
    without_floor, shares = [], {}
    for i, sensor in enumerate(airframe.sensors):
        if sensor.name not in lifted.readings:
            outcome.wrong(f"direction of {sensor.name}", "no reading", "msp-range commission --step wires")
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
            outcome.proposals.append(_turned(i, sensor, axis))
        else:
            text = f"within {max(axis.from_file_deg, axis.half_width_deg):.0f} deg of what the file says"
            outcome.right(f"direction of {sensor.name}", text)
    if without_floor:
        outcome.measured["without_floor"] = without_floor
    most = max(shares.values(), default=0.0)
    return [name for name, share in shares.items() if share < LITTLE * most]


def _turned(i: int, sensor: SensorSettings, axis: Axis) -> Proposal:
    assert axis.boresight is not None
    pitch, yaw = rotation_of(axis.boresight, axis.half_width_deg)
    text = (
        f"{sensor.name} looks to pitch {pitch}, yaw {yaw} (to {axis.half_width_deg:.0f} deg), "
        f"{axis.from_file_deg:.0f} deg from pitch {sensor.rotation_deg.pitch:g}, yaw {sensor.rotation_deg.yaw:g} in "
        "the file. Turn the sensor, or change the file"
    )
    return Proposal(text, _rotation(i, sensor, pitch, yaw))


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
    seen = [side for side, samples in boards.items() if _sees_board(samples, sensor.name)]
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
    outcome.proposals.append(Proposal(text, _rotation(i, sensor, pitch, yaw)))


def _sees_board(samples: Samples, name: str) -> bool:
    if name not in samples.readings:
        return False
    range_m = samples.readings[name].range_m
    near = (range_m > BOARD_M[0]) & (range_m < BOARD_M[1])
    return len(range_m) > 0 and float(near.mean()) > 0.5
