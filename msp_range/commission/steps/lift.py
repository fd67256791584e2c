"""Lift the vehicle by hand, tilt it and rock it: signs of the attitude, places and directions of the sensors."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from msp_range.arrays import Array
from msp_range.assembly import streams_of
from msp_range.commission.edit import Edit
from msp_range.commission.motion import NotMeasured, places
from msp_range.commission.outcome import StepOutcome
from msp_range.commission.samples import Samples, samples_of
from msp_range.commission.session import Session
from msp_range.commission.steps.directions import SIDES, compare_directions
from msp_range.commission.steps.places import DEEPER_M, compare_lag, compare_places
from msp_range.config import Airframe
from msp_range.doctor.finding import RIGHT, UNKNOWN, Finding, first_of, wrong
from msp_range.mavlink.acceptance import OTHER_FIRST
from msp_range.params.settings import standing_m
from msp_range.recording.topics import Message

FLOOR_S, HOLD_S, TILT_S, ROCK_S, BOARD_S = 3.0, 5.0, 4.0, 40.0, 3.0
"""How long each motion is recorded [s]. Longer rocking gives smaller intervals: with 40 s
places are known to 2.5 cm."""
LEAD_S = 3.0
"""Time to get into each position [s]; recorded too, since places are measured from motion."""
TILTED_DEG = 7.0
"""A guided tilt of 15 degrees has to change the attitude by this [deg]; less is no tilt, or another axis."""
LIFTED_M = 0.3
"""The lift has to make the distances longer by this [m]: with less, it does not show which sensors look at the
floor."""
FOLLOWED = 0.3
"""A sensor looks at the floor if its distance grew by the median growth, to within this share of that. The sensor's
minimum hides some centimetres of the distance to the floor; the distance to a wall does not grow at all."""
FOLLOWS_M = 0.15
"""The distance that the autopilot reports back may typically differ from the sent one by this [m]: it is up to 0.5 s
old."""

TEXT = """\
Lift by hand. Propellers off, and nothing loose on the vehicle; two people are better for a heavy one. Put it on a flat
hard floor with 2 m of free space around. You will be asked to hold it 1 m high, to tilt its nose up and its right side
down, and to rock it slowly to all sides. The first instruction comes at once, and each lasts some seconds."""
BOARD_TEXT = """\
Some sensors do not see the floor. Put the vehicle on a table, and hold a board or a big book half a metre in front of
it, then at its other sides, as you are asked to."""


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
    everything: list[Message] = []
    parts: list[Samples] = []
    guided = (
        ("Leave it on the floor.", FLOOR_S),
        ("Lift it to about 1 m and hold it level.", HOLD_S),
        ("Tilt its nose up by about 15 degrees, and hold it so.", TILT_S),
        ("Level, then tilt its right side down by about 15 degrees, and hold it so.", TILT_S),
        (
            f"Rock it slowly for {ROCK_S:.0f} s: nose up and down, left and right, by 15 to 20 degrees, at 1 m.",
            ROCK_S,
        ),
    )
    with session.live() as live:
        for text, duration_s in guided:
            operator.instruct(text)
            everything += live.record(LEAD_S)
            part = live.record(duration_s)
            everything += part
            parts.append(samples_of(part))
        operator.instruct("Done: put it down.")
    airframe = session.airframe()
    floor, level, nose_up, right_down, _ = parts
    recorded = Recorded(samples_of(everything), floor, level, nose_up, right_down, _returned(everything), {})
    outcome = compare(airframe, recorded)
    if outcome.measured.get("without_floor"):
        outcome = compare(airframe, replace(recorded, boards=_boards(session)))
    return outcome


def _boards(session: Session) -> dict[str, Samples]:
    session.operator.begin(BOARD_TEXT)
    found = {}
    with session.live() as live:
        for side in SIDES:
            session.operator.instruct(f"Hold the board half a metre from its {side}.")
            live.record(LEAD_S)
            found[side] = samples_of(live.record(BOARD_S))
    return found


def _returned(records: list[Message]) -> tuple[tuple[float, float], ...]:
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
    if any(finding.verdict is not RIGHT for finding in outcome.findings):
        outcome.complete = False
        return outcome  # places would be mirrored, or there are none
    rises_m = rises(recorded)
    lifted_m = float(np.median(list(rises_m.values()))) if rises_m else 0.0
    if lifted_m < LIFTED_M:
        text = f"by the sensors it was lifted by {lifted_m:.2f} m"
        outcome.unknown("lift", text, "lift it from the floor to 1 m when you are asked to, then again")
        outcome.complete = False
        return outcome
    not_on_floor = [name for name, rise_m in rises_m.items() if abs(rise_m - lifted_m) > FOLLOWED * lifted_m]
    try:
        found = places(
            recorded.all,
            {sensor.name: sensor.position_m for sensor in airframe.sensors if sensor.name not in not_on_floor},
        )
    except NotMeasured as error:
        if len(airframe.downward) != 1:
            outcome.wrong("places", str(error), "then again")
            return outcome
        text = "not measured: one sensor that looks down has no other one that it could be compared with"
        outcome.unknown("places", text, "measure its place and direction yourself")
    else:
        dim = compare_directions(airframe, recorded.all, recorded.boards, found, outcome)
        compare_places(airframe, found, outcome, dim)
        compare_lag(found, outcome)
    _came_back(airframe, recorded, outcome)
    _standing(airframe, recorded.floor, outcome)
    return outcome


def _standing(airframe: Airframe, floor: Samples, outcome: StepOutcome) -> None:
    """What the fused stream reads on the floor: for the autopilot the distance at which the vehicle stands."""
    stream = streams_of(airframe).fused
    if stream is None or airframe.send.nothing or not len(floor.fused):
        return
    step, in_file_m = "standing on the floor", standing_m(airframe, stream)
    standing = outcome.measured["standing_m"] = round(float(np.median(floor.fused[:, 1])), 2)
    text = f"the fused distance is {standing:.2f} m, {in_file_m:.2f} by the file"
    if abs(standing - in_file_m) > DEEPER_M:
        outcome.propose(f"{step}, {text}: send.standing_m", Edit(("send", "standing_m"), standing))
    else:
        outcome.right(step, text)


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
        remedy = (
            "the autopilot is not mounted as it believes: see AHRS_ORIENTATION (PX4: SENS_BOARD_ROT), correct it and "
            "calibrate again"
        )
        too_little = np.abs(change).max() < TILTED_DEG
        findings.append(
            first_of(
                step,
                (too_little, text, "tilt it by 15 degrees when you are asked to, then again", UNKNOWN),
                (abs(change[1 - axis]) > abs(change[axis]), f"{text}: the other axis", remedy),
                (change[axis] < 0, f"{text}: reversed", remedy),
                (True, text),
            )
        )
    return findings


def _attitude_deg(part: Samples) -> Array | None:
    if len(part.attitude) < 3:
        return None
    return np.degrees(np.median(part.attitude[:, 1:], axis=0))


def _came_back(airframe: Airframe, recorded: Recorded, outcome: StepOutcome) -> None:
    """Whether the autopilot's own distance followed the lift."""
    if airframe.send.fused is None or not len(recorded.all.fused):
        return
    step, fused = "distance in the autopilot", recorded.all.fused
    if airframe.send.nothing:
        outcome.unknown(step, "not compared: the airframe file sends nothing")
        return
    if len(recorded.returned_m) < 3:
        text = "the autopilot reports no distance of its own"
        outcome.unknown(
            step, text, f"msp-range commission {airframe.path} --step parameters, then restart the autopilot"
        )
        return
    time_s, back_m = np.array(recorded.returned_m).T
    sent_m = np.interp(time_s - 0.2, fused[:, 0], fused[:, 1])
    typical_m = float(np.median(np.abs(back_m - sent_m)))
    off = typical_m > FOLLOWS_M, f"it does not follow the lift: typically {typical_m:.2f} m off", OTHER_FIRST
    follows = f"it follows the lift from {back_m.min():.2f} to {back_m.max():.2f} m, typically to {typical_m:.2f}"
    outcome.add(step, off, (True, follows))
