"""Lift the vehicle by hand, tilt it and rock it: signs of the attitude, places and directions of the sensors."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from msp_range.commission.edit import Edit
from msp_range.commission.look import Axis, axis_of
from msp_range.commission.motion import Measured, NotMeasured, Places, places
from msp_range.commission.operator import Motion
from msp_range.commission.outcome import Proposal, StepOutcome, shown
from msp_range.commission.samples import Record, Samples, samples_of
from msp_range.commission.session import Session
from msp_range.config import Airframe, SensorSettings
from msp_range.doctor.finding import Finding, Verdict, right, unknown, wrong

FLOOR_S, HOLD_S, TILT_S, ROCK_S = 3.0, 5.0, 4.0, 40.0
"""How long each motion is recorded [s]. Longer rocking gives smaller intervals: with 40 s
places are known to 2.5 cm."""
LEAD_S = 3.0
"""Time to get there [s]; recorded too, as it moves."""
TILTED_DEG = 7.0
"""A guided tilt of 15 degrees has to change the attitude by this [deg]; less is no tilt, or another axis."""
SIDEWAYS_M, DEEPER_M = 0.05, 0.02
"""A place in the file that differs by less [m], sideways or in height, stays. An error of 5 cm costs 1 cm at 10
degrees."""
LIFTED_M = 0.3
"""The lift has to make the distances longer by this [m]: with less, it does not show which sensors look at the
floor."""
FOLLOWED = 0.3
"""A sensor looks at the floor if its distance grew as those of most, to this share of it. The sensor's minimum hides
some centimetres of the floor's distance; a wall does not grow at all."""
WIDEST_M = 0.10
"""Wider intervals [m] do not check a place: the vehicle was hardly tilted."""
TURNED_DEG = 8.0
"""A direction in the file that differs by less [deg] stays, whatever the echoes exclude."""
LITTLE = 0.6
"""A sensor with less than this share of the best one's echoes looks aside, and its place is not compared: few readings
at the edge of its beam, among outliers, would place it."""
SEES_FLOOR = 0.3
"""A sensor that the file has looking elsewhere looks down if this share of its pings gets an echo of it."""
LATE_S = 0.10
"""Attitudes that are later than this [s] are reported: at 20 deg/s a sensor 0.25 m away is 1 cm off."""
FOLLOWS_M = 0.15
"""The autopilot's own distance follows the bridge's to this [m]: its last value is up to 0.5 s old."""

TEXT = """\
Lift by hand. Propellers off, and nothing loose on the vehicle; two people are better for a heavy one. Put it on a flat
hard floor with 2 m of free space around. You will be asked to hold it 1 m high, to tilt its nose up and its right side
down, and to rock it slowly to all sides. The first instruction comes at once, and each lasts some seconds."""
BOARD_TEXT = """\
Some sensors do not see the floor. Put the vehicle on a table, and hold a board or a big book half a metre in front of
it, then at its other sides, as you are asked to."""
SIDES = {
    "front": (0.0, 0.0),
    "right": (0.0, 90.0),
    "rear": (0.0, 180.0),
    "left": (0.0, 270.0),
    "top": (90.0, 0.0),
}
"""Pitch and yaw of the direction to each side [deg]."""
BOARD_M = (0.25, 0.85)
"""Distances that a board half a metre away gives [m]."""
BOARD_S = 3.0


@dataclass(frozen=True)
class Recorded:
    """What was received: all of it, and in each guided position."""

    all: Samples
    floor: Samples
    level: Samples
    nose_up: Samples
    right_down: Samples
    returned_m: tuple[tuple[float, float], ...]
    boards: Mapping[str, Samples]


def run(session: Session) -> StepOutcome:
    """Guide the person through the motions."""
    operator = session.operator
    operator.begin(TEXT)
    everything: list[Record] = []
    parts: dict[Motion, Samples] = {}
    guided = (
        (Motion.FLOOR, "Leave it on the floor.", FLOOR_S),
        (Motion.HOLD, "Lift it to about 1 m and hold it level.", HOLD_S),
        (Motion.NOSE_UP, "Tilt its nose up by about 15 degrees, and hold it so.", TILT_S),
        (
            Motion.RIGHT_DOWN,
            "Level, then tilt its right side down by about 15 degrees, and hold it so.",
            TILT_S,
        ),
        (
            Motion.ROCK,
            f"Rock it slowly for {ROCK_S:.0f} s: nose up and down, left and right, by 15 to 20 degrees, at 1 m.",
            ROCK_S,
        ),
    )
    with session.live() as live:
        for motion, text, duration_s in guided:
            operator.instruct(motion, text)
            everything += live.record(LEAD_S)
            part = live.record(duration_s)
            everything += part
            parts[motion] = samples_of(part)
        operator.instruct(Motion.FLOOR, "Done: put it down.")
    airframe = session.airframe()
    recorded = Recorded(
        samples_of(everything),
        parts[Motion.FLOOR],
        parts[Motion.HOLD],
        parts[Motion.NOSE_UP],
        parts[Motion.RIGHT_DOWN],
        _returned(everything),
        {},
    )
    outcome = compare(airframe, recorded)
    blind = outcome.measured.get("without_floor")
    if blind:
        recorded = replace(recorded, boards=_boards(session))
        outcome = compare(airframe, recorded)
    return outcome


def _boards(session: Session) -> dict[str, Samples]:
    session.operator.begin(BOARD_TEXT)
    found = {}
    with session.live() as live:
        for side in SIDES:
            session.operator.instruct(Motion.BOARD, f"Hold the board half a metre from its {side}.", side)
            live.record(LEAD_S)
            found[side] = samples_of(live.record(BOARD_S))
    return found


def _returned(records: list[Record]) -> tuple[tuple[float, float], ...]:
    """The autopilot's own distances: (time [s], distance [m])."""
    return tuple(
        (time_s, float(message["distance_m"]))
        for topic, time_s, message in records
        if topic == "/autopilot" and message.get("kind") == "DISTANCE_SENSOR" and message.get("orientation") == 25
    )


def compare(airframe: Airframe, recorded: Recorded) -> StepOutcome:
    """What the motions mean for the airframe file."""
    outcome = StepOutcome(again=lambda changed: compare(changed, recorded))
    outcome.findings += attitude_signs(recorded)
    if any(each.verdict is not Verdict.RIGHT for each in outcome.findings):
        outcome.complete = False
        return outcome  # places would be mirrored, or there are none
    rises_m = rises(recorded)
    lifted_m = float(np.median(list(rises_m.values()))) if rises_m else 0.0
    if lifted_m < LIFTED_M:
        text = f"by the sensors it was lifted by {lifted_m:.2f} m"
        outcome.findings.append(
            unknown("lift", text, "lift it from the floor to 1 m when you are asked to, then again")
        )
        outcome.complete = False
        return outcome
    still = [name for name, rise_m in rises_m.items() if abs(rise_m - lifted_m) > FOLLOWED * lifted_m]
    try:
        found = places(
            recorded.all,
            {sensor.name: sensor.position_m for sensor in airframe.sensors if sensor.name not in still},
        )
    except NotMeasured as error:
        outcome.findings.append(wrong("places", str(error), "then again"))
        return outcome
    dim = _axes(airframe, recorded, found, outcome)
    compare_places(airframe, found, outcome, dim)
    _lag(found, outcome)
    _came_back(airframe, recorded, outcome)
    return outcome


def rises(recorded: Recorded) -> dict[str, float]:
    """How much longer each sensor's distance got by the lift, by name [m]; sensors without an echo are left out."""
    found = {}
    for name, held in recorded.level.readings.items():
        before = recorded.floor.readings.get(name)
        if before is not None and np.isfinite(before.range_m).sum() >= 2 and held.is_distance.sum() >= 4:
            found[name] = float(np.median(held.range_m[held.is_distance]) - np.nanmedian(before.range_m))
    return found


def attitude_signs(recorded: Recorded) -> list[Finding]:
    """Whether the autopilot reports the guided tilts as they were."""
    findings = []
    level = _attitude_deg(recorded.level)
    for name, part, axis in (("nose up", recorded.nose_up, 1), ("right side down", recorded.right_down, 0)):
        step = f"attitude, {name}"
        tilted = _attitude_deg(part)
        if level is None or tilted is None:
            remedy = "'msp-range doctor' looks for the reason; ATTITUDE is asked for at 10 Hz"
            findings.append(wrong(step, "no attitude of the autopilot is received", remedy))
            continue
        change = tilted - level
        text = f"the autopilot reports roll {change[0]:+.0f}, pitch {change[1]:+.0f} deg"
        other = 1 - axis
        remedy = (
            "the autopilot is not mounted as it believes: see AHRS_ORIENTATION (PX4: SENS_BOARD_ROT), correct it and "
            "calibrate again"
        )
        if np.abs(change).max() < TILTED_DEG:
            findings.append(unknown(step, text, "tilt it by 15 degrees when you are asked to, then again"))
        elif abs(change[other]) > abs(change[axis]):
            findings.append(wrong(step, f"{text}: the other axis", remedy))
        elif change[axis] < 0:
            findings.append(wrong(step, f"{text}: reversed", remedy))
        else:
            findings.append(right(step, text))
    return findings


def _attitude_deg(part: Samples) -> np.ndarray[tuple[int], np.dtype[np.float64]] | None:
    if len(part.attitude) < 3:
        return None
    median: np.ndarray[tuple[int], np.dtype[np.float64]] = np.degrees(np.median(part.attitude[:, 1:], axis=0))
    return median


def compare_places(airframe: Airframe, found: Places, outcome: StepOutcome, dim: Sequence[str] = ()) -> None:
    """Add what the measured places mean for the airframe file, but for sensors that see little of the floor."""
    mirrored: dict[int, list[str]] = {0: [], 1: []}
    for i, sensor in enumerate(airframe.sensors):
        measured = found.position_m.get(sensor.name)
        if measured is None:
            continue
        if sensor.name in dim:
            text = "it looks aside and sees little of the floor"
            outcome.findings.append(unknown(f"place of {sensor.name}", text, "turn it, then: --step lift"))
            continue
        edits, parts = [], []
        for axis, (name, each, in_file) in enumerate(zip(("x", "y", "z"), measured, sensor.position_m, strict=True)):
            if each.half_width > WIDEST_M:
                text = f"{name} {shown(each)} is not known well enough"
                remedy = "rock it by 15 to 20 degrees to all sides, slowly, 1 m over the floor"
                outcome.findings.append(unknown(f"place of {sensor.name}", text, remedy))
                outcome.complete = False
                continue
            if not each.differs_from(in_file, DEEPER_M if axis == 2 else SIDEWAYS_M):
                continue
            is_mirrored = axis < 2 and abs(each.value + in_file) <= max(each.half_width, SIDEWAYS_M)
            if is_mirrored:
                mirrored[axis].append(sensor.name)
            value = -in_file if is_mirrored else round(each.value, 2)
            edits.append(Edit(("sensors", i, "position_m", axis), value))
            parts.append(f"{name} {shown(each)}, {in_file:g} in the file{': wrong sign' if is_mirrored else ''}")
        if edits:
            outcome.proposals.append(Proposal(f"{sensor.name}: {'; '.join(parts)}", tuple(edits)))
        else:
            at = ", ".join(f"{each.value:.2f}" for each in measured)
            widest = max(each.half_width for each in measured)
            outcome.findings.append(right(f"place of {sensor.name}", f"[{at}] m, each to {widest:.2f}, as in the file"))
    for axis, (letter, meaning) in enumerate((("x", "forward"), ("y", "to the right"))):
        of_axis = [sensor.name for sensor in airframe.sensors if abs(sensor.position_m[axis]) > SIDEWAYS_M]
        if len(of_axis) > 1 and set(of_axis) == set(mirrored[axis]):
            text = f"every {letter} in the file has the wrong sign: positions count {meaning}"
            outcome.findings.append(unknown("places", text, "the changes below turn them round"))
    _exchanged(airframe, found, outcome)


def _exchanged(airframe: Airframe, found: Places, outcome: StepOutcome) -> None:
    """Report two sensors that sit at each other's place."""
    places_m = {sensor.name: sensor.position_m for sensor in airframe.sensors}

    def sits_at(name: str, other: str) -> bool:
        measured = found.position_m.get(name)
        return measured is not None and all(
            abs(each.value - there) <= max(each.half_width, SIDEWAYS_M)
            for each, there in zip(measured, places_m[other], strict=True)
        )

    names = list(places_m)
    for i, one in enumerate(names):
        for other in names[i + 1 :]:
            apart = max(abs(a - b) for a, b in zip(places_m[one], places_m[other], strict=True))
            if apart > 2 * SIDEWAYS_M and sits_at(one, other) and sits_at(other, one):
                text = f"{one} and {other} sit at each other's place"
                outcome.findings.append(
                    unknown("places", text, "if their addresses are exchanged: msp-range commission --step addresses")
                )


def _axes(airframe: Airframe, recorded: Recorded, found: Places, outcome: StepOutcome) -> list[str]:
    """Add what the echoes say of the directions; names of sensors that see little of the floor."""
    without_floor, shares = [], {}
    for i, sensor in enumerate(airframe.sensors):
        if sensor.name not in recorded.all.readings:
            outcome.findings.append(
                wrong(f"direction of {sensor.name}", "no reading", "msp-range commission --step wires")
            )
            continue
        if sensor.sensor_model.medium != "sound":
            outcome.findings.append(unknown(f"direction of {sensor.name}", "a ray has no cone: not measured"))
            continue
        measured = found.position_m.get(sensor.name)
        place = np.array([each.value for each in measured] if measured else sensor.position_m)
        axis = axis_of(recorded.all, sensor.name, found, place, np.array(sensor.boresight), sensor.sensor_model.beam)
        shares[sensor.name] = axis.floor_share
        looks_down = sensor.tilt_from_down_rad < math.radians(45)
        if not looks_down and axis.floor_share < SEES_FLOOR:
            outcome.findings.append(right(f"direction of {sensor.name}", "it does not see the floor, as the file says"))
        elif axis.boresight is None:
            without_floor.append(sensor.name)
            _by_board(i, sensor, recorded.boards, outcome)
        elif not looks_down or (axis.excluded and axis.from_file_deg > TURNED_DEG):
            outcome.proposals.append(_turned(i, sensor, axis))
        else:
            text = f"within {max(axis.from_file_deg, axis.half_width_deg):.0f} deg of what the file says"
            outcome.findings.append(right(f"direction of {sensor.name}", text))
    if without_floor:
        outcome.measured["without_floor"] = without_floor
    most = max(shares.values(), default=0.0)
    return [name for name, share in shares.items() if share < LITTLE * most]


def _turned(i: int, sensor: SensorSettings, axis: Axis) -> Proposal:
    assert axis.boresight is not None
    pitch, yaw = rotation_of(axis.boresight)
    text = (
        f"{sensor.name} looks to pitch {pitch}, yaw {yaw} (to {axis.half_width_deg:.0f} deg), "
        f"{axis.from_file_deg:.0f} deg from pitch {sensor.rotation_deg.pitch:g}, yaw {sensor.rotation_deg.yaw:g} in "
        "the file. Turn the sensor, or change the file"
    )
    return Proposal(text, _rotation(i, sensor, pitch, yaw))


def rotation_of(boresight: tuple[float, float, float]) -> tuple[int, int]:
    """Pitch and yaw of a direction, in whole degrees; straight down is pitch -90, yaw 0.

    Examples
    --------
    >>> rotation_of((0.0, 0.0, 1.0)), rotation_of((0.0, 0.5, 0.866))
    ((-90, 0), (-60, 90))
    """
    forward, to_right, down = boresight
    pitch = -round(math.degrees(math.asin(min(max(down, -1.0), 1.0))))
    if abs(pitch) > 85:
        return (-90 if pitch < 0 else 90), 0
    return pitch, round(math.degrees(math.atan2(to_right, forward))) % 360


def _rotation(i: int, sensor: SensorSettings, pitch: int, yaw: int) -> tuple[Edit, ...]:
    edits = []
    if sensor.rotation_deg.pitch != pitch:
        edits.append(Edit(("sensors", i, "rotation_deg", "pitch"), pitch))
    if sensor.rotation_deg.yaw != yaw:
        edits.append(Edit(("sensors", i, "rotation_deg", "yaw"), yaw))
    return tuple(edits)


def _by_board(i: int, sensor: SensorSettings, boards: Mapping[str, Samples], outcome: StepOutcome) -> None:
    """Where a sensor looks that sees the floor at no tilt: to the side where it saw the board."""
    step = f"direction of {sensor.name}"
    seen = [side for side, samples in boards.items() if _sees_board(samples, sensor.name)]
    if len(seen) != 1:
        tried = "" if not boards else f", and the board at {'several sides' if seen else 'no side'}"
        remedy = "the file says that it looks down: turn it, clear what is in front of it, or correct rotation_deg"
        outcome.findings.append(wrong(step, f"it sees the floor at no tilt{tried}", remedy))
        return
    pitch, yaw = (round(each) for each in SIDES[seen[0]])
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


def _lag(found: Places, outcome: StepOutcome) -> None:
    lag = Measured(1e3 * found.lag.value, 1e3 * found.lag.half_width)
    outcome.measured["attitude_later_s"] = round(found.lag.value, 3)
    text = f"the attitude is {shown(lag, 'ms', 0)} later than the readings"
    if lag.value - lag.half_width > 0 and found.lag.value > LATE_S:
        remedy = "does the autopilot answer TIMESYNC, and is the link slow or shared? A distance is off while it turns"
        outcome.findings.append(wrong("delay of the attitude", text, remedy))
    else:
        outcome.findings.append(right("delay of the attitude", text))


def _came_back(airframe: Airframe, recorded: Recorded, outcome: StepOutcome) -> None:
    """Whether the autopilot's own distance followed the lift."""
    if airframe.send.fused is None or not len(recorded.all.fused):
        return
    step = "distance in the autopilot"
    if len(recorded.returned_m) < 3:
        text = "the autopilot reports no distance of its own"
        outcome.findings.append(
            unknown(step, text, "msp-range commission --step parameters, then restart the autopilot")
        )
        return
    back = np.array(recorded.returned_m)
    fused = recorded.all.fused
    sent = np.interp(back[:, 0] - 0.2, fused[:, 0], fused[:, 1])
    typical_m = float(np.median(np.abs(back[:, 1] - sent)))
    text = f"it follows the lift from {back[:, 1].min():.2f} to {back[:, 1].max():.2f} m, typically to {typical_m:.2f}"
    if typical_m > FOLLOWS_M:
        remedy = "is another range finder set up as the first one? See RNGFND1_TYPE, RNGFND1_ORIENT"
        outcome.findings.append(wrong(step, f"it does not follow the lift: typically {typical_m:.2f} m off", remedy))
    else:
        outcome.findings.append(right(step, text))
